from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.config.evaluation import EvaluateSettings
from mimic.config.play import NOMINAL, Randomisation, RunSettings
from mimic.config.pose import MocapSettings, PoseSettings
from mimic.config.retarget import RetargetSettings
from mimic.config.training import TRAINING_RANDOMISATION, LearnSettings, MdpSettings
from mimic.errors import ConfigError, MimicError


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: RetargetSettings(rate=5.0), "rate is 5 s; it must be from 0.05 to 1 s"),
        (lambda: RetargetSettings(rate=0.01), "rate is 0.01 s"),
        (lambda: RetargetSettings(rate=float("nan")), "rate is nan s"),
        (lambda: RetargetSettings(rate=np.float32(5.0)), "rate is 5 s"),
        (lambda: RetargetSettings(rate="0.1"), "rate is '0.1'; expected a number"),
        (lambda: RunSettings(seed=1.5), "seed is 1.5; expected a whole number"),
        (lambda: MocapSettings(fps=None), "fps is None; expected a number"),
        (lambda: LearnSettings(learning_rate=float("nan")), "learning-rate is nan"),
        (lambda: LearnSettings(hidden=()), "hidden is []; expected the width of each layer"),
        (lambda: LearnSettings(std_range=(1.0, 0.0)), "std-range is [1.0, 0.0]; expected two sizes above 0"),
        (lambda: RetargetSettings(scale=0.0), "scale is 0; it must be from 0.2 to 2"),
        (lambda: RunSettings(stand_up=0.1), "stand-up is 0.1 s"),
        (lambda: RunSettings(hold_last=-1.0), "hold-last is -1 s"),
        (lambda: PoseSettings(min_visibility=1.5), "min-visibility is 1.5"),
        (lambda: EvaluateSettings(episodes=0), "episodes is 0"),
        (lambda: EvaluateSettings(seconds=1.0), "seconds is 1 s"),
        (lambda: MdpSettings(worlds=0), "worlds is 0; it must be from 1"),
    ],
)
def test_a_value_out_of_range_is_reported_with_its_range(make, words):
    with pytest.raises(ConfigError) as error:
        make()
    assert words in str(error.value)


def test_a_bad_setting_is_an_error_of_mimic_and_of_values():
    with pytest.raises(ValueError, match="rate") as error:
        RetargetSettings(rate=2.0)
    assert isinstance(error.value, MimicError)


@pytest.mark.parametrize("ends", [0.05, 1.0])
def test_the_ends_of_the_documented_rates_are_allowed(ends):
    assert RetargetSettings(rate=ends).rate == ends


@pytest.mark.parametrize(
    "kind", [PoseSettings, RetargetSettings, RunSettings, EvaluateSettings, Randomisation, MdpSettings, LearnSettings]
)
def test_settings_have_defaults_and_cannot_be_changed_in_place(kind):
    settings = kind()
    name = dataclasses.fields(kind)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(settings, name, None)


def pairs(ranges: Randomisation) -> dict[str, tuple[float, float]]:
    return {k: v for k, v in dataclasses.asdict(ranges).items() if isinstance(v, tuple)}


def test_nothing_varies_in_the_nominal_robot():
    assert all(low == high for low, high in pairs(NOMINAL).values())


def test_training_covers_what_the_judge_draws():
    wide = pairs(TRAINING_RANDOMISATION)
    for name, (low, high) in pairs(Randomisation()).items():
        assert wide[name][0] <= low <= high <= wide[name][1], name


def test_what_grows_at_the_end_of_a_training_needs_time_to_grow():
    with pytest.raises(ConfigError, match="finish-steps is 5, 5; expected the first to be smaller"):
        MdpSettings(finish_steps=(5.0, 5.0))

from __future__ import annotations

import numpy as np
import pytest

from mimic.config.evaluation import LeadSettings
from mimic.config.leading import HandSettings, LeadingSettings
from mimic.errors import ConfigError
from mimic.evaluation.leading import lead_robot
from mimic.evaluation.led_by_hand import evaluate_leading, lead_figures
from mimic.io.assets import shipped
from mimic.policy.runtime import load_policy
from mimic.simulation.hand import Hand
from mimic.simulation.plant import SimulatedPlant


def lead(description, **changes):
    settings = HandSettings(way=1.0, speed=0.2, begin=3.0, **changes)
    plant = SimulatedPlant(description, samples=False)
    hand = Hand(plant.model, settings)
    seconds = settings.end + settings.after
    plant.watch(hand)
    result = lead_robot(plant, load_policy(None, description), LeadingSettings(), seconds=seconds)
    return result, hand, lead_figures(result, hand, settings), settings


def test_the_shipped_policy_follows_a_hand_and_stops(description):
    result, hand, figures, settings = lead(description)
    assert result.fell_at is None
    assert figures["followed"]
    assert figures["stopped"]
    assert figures["way_m"] == pytest.approx(1.0, abs=0.3)
    assert 0.5 < figures["pull_mean_n"] < settings.most
    assert figures["pull_max_n"] <= settings.most + 1e-9
    assert settings.begin <= hand.t[0] < hand.t[-1] < settings.end


def test_a_hand_that_hardly_pulls_moves_nobody(description):
    _, hand, figures, _ = lead(description, most=0.5)
    assert not figures["followed"]
    assert np.linalg.norm(hand.force, axis=1).max() == pytest.approx(0.5)


def test_an_evaluation_repeats_and_has_every_figure():
    settings = LeadSettings(episodes=2, seconds=9.0, hand=HandSettings(way=0.8, begin=3.0), workers=1)
    one, other = (evaluate_leading(shipped("policies", "stand_track.onnx"), settings) for _ in range(2))
    assert one == other
    assert one["summary"]["episodes"] == 2
    assert 0.0 <= one["summary"]["stopped"] <= one["summary"]["followed"] <= one["summary"]["stood"] <= 1.0


def test_an_evaluation_that_is_too_short_is_refused():
    with pytest.raises(ConfigError, match="seconds is 20 s; it must be from 31 to 629 s"):
        LeadSettings(seconds=20.0)

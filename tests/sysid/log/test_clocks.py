"""Logs of an arm in closed form, by clocks that have nothing to do with that of the targets."""

from pathlib import Path

import pytest

from lab.hidden_effects.planar_arm import CLOCKS, DELAY, EFFECTS, arm_log, arm_model
from mimic.config.sysid import CalibrateSettings
from mimic.sysid.calibrate import calibrate

TRIED = ("spring", "load_friction")


@pytest.mark.slow
@pytest.mark.parametrize(("clock", "hidden"), [("beside", "clean"), ("187", "spring")])
def test_what_is_found_does_not_depend_on_the_clock_of_the_rows(tmp_path: Path, clock: str, hidden: str) -> None:
    log = arm_log(CLOCKS[clock], EFFECTS[hidden], seconds=12.0)
    made = calibrate(log, arm_model(tmp_path), CalibrateSettings(effects=TRIED, threads=1))
    assert made.names == (() if hidden == "clean" else (hidden,))
    assert (made.final.held_out < 1.1 * made.noise).all()
    low, high = next(e for e in made.effects if e.name == "delay").intervals["time"][0]
    assert low < DELAY < high
    assert high - low < (5e-3 if clock == "beside" else 0.6e-3)  # what rows beside each other leave open

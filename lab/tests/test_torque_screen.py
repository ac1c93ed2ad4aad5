"""Sets of effects that are claimed from torques alone, on an arm in closed form."""

from pathlib import Path

import pytest

pytest.importorskip("numba")

from lab.hidden_effects.torque_screen import KD, KP, MJCF, SINGLES, arm_log, screen
from mimic.dynamics.machine import read_machine


@pytest.mark.slow
def test_the_set_that_is_hidden_is_claimed_and_nothing_of_a_clean_log(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(MJCF, encoding="utf-8")
    model = read_machine(tmp_path / "arm.xml", {"kp": KP, "kd": KD})
    assert screen([(arm_log({}, seconds=20.0), model)]).claimed == ()
    both = {**SINGLES["load friction"][1], **SINGLES["spring"][1]}
    made = screen([(arm_log(both, seconds=20.0), model)])
    assert {"load_friction", "spring"} <= set(made.claimed)

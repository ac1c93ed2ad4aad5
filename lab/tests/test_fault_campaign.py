"""Faults on the emulated robot in its own time, one for each rule.

lab/faults/fault_campaign.py plays hundreds of all kinds.
"""

from __future__ import annotations

import pytest

from lab.faults.faults_in_process import KINDS_OF_FAULT, Outcome, play

pytestmark = pytest.mark.slow

STANDS, TRACKS = 2.7, 1.0
"""When the robot stands, and for how long it follows commands, from 2.5 s on [s]."""

AFTER = {
    "ctrl_c": ({"interrupt"}, "sit_down"),
    "watchdog_gone": ({"watchdog_ended"}, "sit_down"),
    "encoder_frozen": ({"encoder_frozen"}, "sit_down"),
    "imu_frozen": ({"imu_frozen"}, "damp"),
    "imu_invalid": ({"imu_invalid"}, "damp"),
    "imu_silent": ({"imu_silent"}, "damp"),
    "imu_tilted": ({"imu_contradicts_itself"}, "damp"),
    "motor_fault": ({"motor_fault"}, "sit_down"),
    "motor_mute": ({"motor_silent"}, "sit_down"),
    "policy_nan": ({"not_finite"}, "damp"),
    "power_cycle": ({"motor_off", "joint_impossible"}, "sit_down"),
    "sigterm": ({"terminated"}, "damp"),
    "sink_raises": ({"exception"}, "damp"),
    "unplugged": ({"exception"}, "damp"),
}
"""One fault of a standing robot for each rule: the rules that may find it, and what they ask for."""

TOLERATED = ("frames_lost", "frames_late", "imu_forged", "joint_jammed", "policy_wild", "target_nan")
"""Faults that may pass without ending the run."""

SOON = 0.22
"""120 ms of a silent IMU or eight readings of an encoder, and the ticks in which it is seen [s]."""


def sound(outcome: Outcome) -> None:
    assert not outcome.undamped, outcome
    assert not outcome.silent, outcome
    assert not outcome.incomplete, outcome
    assert not outcome.escaped, outcome


@pytest.mark.parametrize("kind", sorted(AFTER))
def test_a_fault_of_a_standing_robot_is_found_in_time_by_its_rule(kind, tmp_path):
    outcome = play(2, tmp_path, kind, STANDS, TRACKS)
    sound(outcome)
    rules, mode = AFTER[kind]
    assert outcome.rule in rules, outcome
    assert outcome.mode == mode, outcome
    assert -0.03 <= outcome.after <= SOON, outcome


@pytest.mark.parametrize("kind", TOLERATED)
def test_a_tolerated_fault_leaves_a_damped_robot_and_a_complete_log(kind, tmp_path):
    sound(play(1000 + KINDS_OF_FAULT.index(kind), tmp_path, kind, seconds=TRACKS))


def test_the_same_seed_gives_the_same_end(tmp_path):
    one, other = (play(5, tmp_path / name, "sigterm", 0.5) for name in ("one", "other"))
    assert one == other

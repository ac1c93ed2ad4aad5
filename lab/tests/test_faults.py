"""Faults on the emulated robot in its own time, of each kind a few.

`python -m lab.faults` plays hundreds of all kinds.
"""

from __future__ import annotations

import math

import pytest

from lab.faults.drawn import random_fault
from lab.faults.own_time import RAMP, play
from lab.faults.trouble import CASES, cases
from mimic.control.start import start_seconds
from mimic.emulator.faults import CAN_KINDS, MISWIRED, parse_fault

STANDS = 1.7 + start_seconds(RAMP, 0.02, tested=False)
"""When the robot stands [s]: ramp, a second to stand up, half a second of blending, and .2."""

TRACKS = 1.0
"""For how long it follows commands, from .2 s earlier on [s]."""

AFTER = {
    "sender_killed": {"sender sit_down", "sender damp"},
    "encoder_frozen": {"joint_impossible sit_down"},
    "imu_tilted": {"imu_contradiction damp"},
    "motor_mute": {"motor_silent sit_down"},
    "unplugged": {"bus_errors damp", "motor_silent damp"},
}
"""Faults of a standing robot: the rules that may find each, and what they ask for. `tests/hardware` has others."""

UNJUDGED = (("can", "joint_jammed"), ("can", "repeats"), ("stock", "host_killed"), ("go2", "sender_killed"))
"""Faults that may pass without ending the run, and those that the emulator knows nothing of."""

SOON = 0.22
"""Within which a rule ends the run [s]."""

FROZEN = SOON + 8 * 0.02
"""The same for an encoder that is frozen: it takes sixteen equal readings, no longer eight [s]."""


def sound(outcome):
    assert not any(outcome[bad] for bad in ("undamped", "hung", "traceback", "lost", "silent", "false")), outcome


@pytest.mark.parametrize("kind", sorted(AFTER))
def test_a_fault_of_a_standing_robot_is_found_in_time_by_its_rule(kind, tmp_path):
    outcome = play("can", 2, tmp_path, kind, STANDS, TRACKS, tested=False)
    sound(outcome)
    assert outcome["stood"], outcome
    assert outcome["rule"] in AFTER[kind], outcome
    assert -0.03 <= outcome["after"] <= (FROZEN if kind == "encoder_frozen" else SOON), outcome


@pytest.mark.parametrize(("robot", "kind"), UNJUDGED)
def test_any_other_fault_leaves_a_damped_robot_and_a_complete_log(robot, kind, tmp_path):
    sound(play(robot, 3, tmp_path, kind, seconds=TRACKS))


def test_a_fault_before_the_robot_stands_ends_the_same_with_the_same_seed(tmp_path):
    one, other = (play("can", 5, tmp_path / name, "sigterm", 0.3, TRACKS) for name in ("one", "other"))
    for outcome in (one, other):
        del outcome["seconds"]
    assert one == other
    assert not one["stood"]


@pytest.mark.parametrize("setting", ["own_time", "processes"])
def test_each_robot_has_cases_of_every_place_but_its_own_absent_ones(setting):
    robots = ("can", "stock", "go2") if setting == "own_time" else ("can", "stock")
    for robot in robots:
        places = {CASES[name].place for name in cases(robot, setting)}
        assert {"messages", "second program", "this program", "process"} <= places


def test_a_seed_draws_a_fault_that_can_be_written_down_and_all_kinds_come_up():
    drawn = [random_fault(seed, start=(1.0, 3.0)) for seed in range(400)]
    assert drawn == [random_fault(seed, start=(1.0, 3.0)) for seed in range(400)]
    assert {fault.kind for fault in drawn} == set(CAN_KINDS) - set(MISWIRED), (
        "what is there from power-up on is not drawn"
    )
    assert {fault.joint for fault in drawn} == {None, *range(12)}
    assert any(math.isinf(fault.until) for fault in drawn)
    assert any(math.isfinite(fault.until) for fault in drawn)
    for fault in drawn:
        assert 1.0 <= fault.start <= 3.0
        again = parse_fault(str(fault))
        assert (again.kind, again.joint, again.bus) == (fault.kind, fault.joint, fault.bus)
        assert again.start == pytest.approx(fault.start, rel=1e-4)

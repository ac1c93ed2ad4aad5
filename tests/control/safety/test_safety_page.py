from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mimic.control.safety.safety_rules import FAILURE, RULES, degrees
from mimic.control.start import START
from mimic.robot.description import load_description
from mimic.robot.parts import SafetyLimits

SIT = "sit down*"

WORDS: dict[str, tuple[Callable[[SafetyLimits], str], str, str]] = {
    "asked_to_end": (
        lambda L: "Ctrl-C, the terminal is closed, or `--hold` is released; Ctrl-C again, or SIGTERM",
        "1 tick; a key 0.3 s",
        "sit down; damp",
    ),
    "motor_silent": (lambda L: f"{L.silent_ticks} ticks without an answer", "100 ms", SIT),
    "motor_failed": (lambda L: "any fault bit, two motors with one id, or not in run mode", "1 tick", SIT),
    "too_hot": (
        lambda L: (
            f"a motor at {L.temperature_warning:g} °C, or a winding at {L.rise_warning:.0%} of its limit by the "
            f"thermal model; {L.temperature:g} °C, {L.rise:.0%}"
        ),
        "1 tick",
        f"announce; {SIT}",
    ),
    "answers_slow": (
        lambda L: f"answers take {1e3 * L.slow_answers:g} ms for half a second; {1e3 * L.slowest_answers:g} ms",
        "0.5 s",
        "announce; sit down",
    ),
    "battery_low": (lambda L: f"supply below {L.low_voltage:g} V; {L.lowest_voltage:g} V", "5 s", "announce; sit down"),
    "joint_impossible": (
        lambda L: (
            f"{L.outside:g} rad beyond a joint limit, {L.jump:g} rad in one tick, faster than {L.overspeed:g} rad/s in "
            f"2 ticks, or {L.frozen_ticks} equal readings while a policy moves the target by {L.frozen_targets:g} rad"
        ),
        "1 tick to 320 ms",
        SIT,
    ),
    "off_target": (lambda L: f"more than {L.off_target:g} rad from the target for 0.5 s", "0.5 s", SIT),
    "imu_silent": (
        lambda L: (
            f"older than {1e3 * L.imu_age:g} ms, or not valid by its status; while a policy moves the robot also "
            f"{L.imu_repeats + 1} equal readings, or nothing new for {1e3 * L.imu_age:g} ms"
        ),
        "120 ms",
        "damp",
    ),
    "imu_contradiction": (
        lambda L: (
            f"heading, or tilt, and rate of turn differ by {L.turn_mismatch:g} rad in a tick; tilt {L.doubt_ticks} "
            f"times in a row, or for {L.legs_ticks} ticks hind toes {100 * L.toes_apart:g} cm apart in height while "
            f"standing, {100 * L.toes_apart_moving:g} cm while getting up or down, or front toes less than "
            f"{100 * L.front_above:g} cm above them while standing"
        ),
        "60 ms",
        "jump removed, or reading ignored; damp",
    ),
    "falling": (
        lambda L: (
            f"cosine to upright below {L.upright:g} ({degrees(L.upright)} deg) while standing; sine of the roll above "
            f"{L.side_tilt:g}, or base z below {L.backward:g}, while getting up or down"
        ),
        "1 tick",
        "damp",
    ),
    "step_late": (
        lambda L: (
            f"one of {1e3 * L.overrun:g} ms, or {L.small_overruns_logged} in a row of {1e3 * L.small_overrun:g} "
            f"ms; {L.overrun_ticks} in a row of {1e3 * L.overrun:g} ms, {L.small_overrun_ticks} in a row of "
            f"{1e3 * L.small_overrun:g} ms, or one of {1e3 * L.longest_overrun:g} ms"
        ),
        "1 tick",
        "log; damp",
    ),
    "bus_errors": (
        lambda L: (
            f"any, or the stock robot's firmware reports a command later than 10 ms (0x01); {L.bus_errors} within "
            "0.1 s, or it reports none for 500 ms (0x02)"
        ),
        "0.1 s",
        "log; damp",
    ),
    "sender": (
        lambda L: f"silent for {L.sender_age:g} s; for 0.2 s, has ended, or has damped the robot",
        "1 tick",
        "sit down; damp",
    ),
    "other_program": (
        lambda L: f"a command of another program, or an answer to one; {L.foreign_storm} within 0.1 s",
        "1 tick",
        "sit down; damp",
    ),
}
"""Of each rule: its limit in words, how soon it is detected, and what follows."""

FAILURES = "a target or an answer is not a number, or any exception; the log cannot be written, as on a full disk"
FAILURE_OUTCOMES = "damp; sit down, the rows stay in memory"
START_FINDS = (
    "a joint 7° (Go2 8°) from the crouch after the ramp, base too low, tilt of 6°; "
    "wrong sign, swapped motors or legs, turned IMU; late steps or answers"
)

PAGE = (Path(__file__).parents[3] / "docs" / "manual" / "robot.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_the_page_has_every_rule_as_the_code_has_it(rule, description):
    limit, within, outcome = WORDS[rule.name]
    assert f"| `{rule.name}` | {limit(description.safety)} | {within} | {outcome} |" in PAGE


def test_the_page_has_the_rule_of_the_loop():
    assert f"| `{FAILURE}` | {FAILURES} | 1 tick | {FAILURE_OUTCOMES} |" in PAGE
    assert f"| `{START}` | {START_FINDS} | 2.5 s; 6 s | damp |" in PAGE


@pytest.mark.parametrize(("robot", "joints"), [("cyberdog2", 7), ("go2", 8)])
def test_the_page_has_the_limits_of_the_start(robot, joints):
    start = load_description(robot).start
    assert (round(np.rad2deg(start.joints)), round(np.rad2deg(start.tilt))) == (joints, 6)

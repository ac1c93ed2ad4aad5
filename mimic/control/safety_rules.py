"""The rules by which a robot is stopped, each a function, here or in the modules of checks, and a row of the table."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from mimic.control.alert import Alert, Check
from mimic.control.balance_checks import degrees, fallen, falling, imu_contradiction, imu_silent, tipping
from mimic.control.motor_checks import (
    answers_slow,
    battery_low,
    joint_impossible,
    motor_failed,
    motor_silent,
    off_target,
    too_hot,
)
from mimic.control.safety_limits import Limits
from mimic.control.step_history import StepHistory, StepReport


@dataclass(frozen=True, kw_only=True)
class Rule:
    """A row of the table in docs/manual/robot.md."""

    name: str
    limit: Callable[[Limits], str]
    """Says the limit in words."""
    within: str
    """How soon it is detected."""
    outcome: str
    """What follows, in words."""
    check: Check
    reads_history: bool = True
    """Whether it looks at more than the newest report."""


def asked_to_end(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Ctrl-C once and again, SIGTERM, and what must be held and was let go."""
    if report.terminated:
        yield Alert(outcome="DAMP", text="the process was asked to end (SIGTERM)")
    if report.interrupts > 1:
        yield Alert(outcome="DAMP", text="Ctrl-C was pressed again")
    elif report.interrupts == 1:
        text = "the terminal was closed (SIGHUP)" if report.hung_up else "Ctrl-C was pressed"
        yield Alert(outcome="SIT_DOWN", text=text, needs_upright=False)
    if report.released:
        yield Alert(outcome="SIT_DOWN", text="the key or button was let go (--hold)", needs_upright=False)


def step_late(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Control steps that end late."""
    overrun, row, small = report.health.late, history.overruns, history.small_overruns
    milliseconds = 1e3 * overrun
    if overrun > limits.longest_overrun or row >= limits.overrun_ticks:
        yield Alert(outcome="DAMP", text=f"a tick overran by {milliseconds:.0f} ms, {row} in a row")
    elif small >= limits.small_overrun_ticks:
        yield Alert(outcome="DAMP", text=f"{small} ticks in a row overran, the last one by {milliseconds:.1f} ms")
    elif row:
        yield Alert(outcome="RUN", text=f"a tick overran by {milliseconds:.0f} ms", about="once")
    elif small == limits.small_overruns_logged:
        yield Alert(outcome="RUN", text=f"{small} ticks in a row overran, the last one by {milliseconds:.1f} ms")


def bus_errors(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Frames that make no sense, buses that fail, and commands that a motion board misses."""
    if report.health.err_flag & BOARD_TIMED_OUT:
        yield Alert(outcome="DAMP", text="the robot's firmware ignores commands, as none had reached it (error 0x02)")
    elif report.health.err_flag & BOARD_LATE:
        gap = 1e3 * report.health.command_gap
        yield Alert(outcome="RUN", text=f"the robot got no command for {gap:.0f} ms (error 0x01)", about="board")
    if history.new_errors >= limits.bus_errors:
        yield Alert(outcome="DAMP", text=f"the bus had {history.new_errors} errors within a tenth of a second")
    elif history.new_errors:
        yield Alert(outcome="RUN", text=f"the bus had {history.new_errors} errors")


def sender(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """A process that sends to the robot, and has said nothing for a while."""
    silent = report.health.sender_age
    if silent > limits.sender_age:
        text = f"the process that sends to the robot has said nothing for {silent:.2f} s"
        yield Alert(outcome="SIT_DOWN", text=text, needs_upright=False)


def other_program(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Commands of another program."""
    if history.new_foreign >= limits.foreign_storm:
        text = f"another program commands this robot: {history.new_foreign} times within a tenth of a second"
        yield Alert(outcome="DAMP", text=text)
    elif report.health.foreign:
        yield Alert(outcome="SIT_DOWN", text="another program commands this robot", needs_upright=False)


BOARD_LATE, BOARD_TIMED_OUT = 0x01, 0x02
"""Bits of a motion board's error flag: a late command, and commands that are ignored."""

_SIT = "sit down if upright and at most one motor is lost, else damp"

_ROWS: tuple[tuple[Check, Callable[[Limits], str], str, str], ...] = (
    (
        asked_to_end,
        lambda L: "Ctrl-C, the terminal is closed, or what `--hold` names is let go; Ctrl-C again, or SIGTERM",
        "1 tick; a key 0.3 s",
        "sit down; damp",
    ),
    (motor_silent, lambda L: f"{L.silent_ticks} ticks without an answer", "100 ms", _SIT),
    (motor_failed, lambda L: "any fault bit, two motors with one id, or not in run mode", "1 tick", _SIT),
    (
        too_hot,
        lambda L: (
            f"a motor at {L.temperature_warning:g} °C, or a winding at {L.rise_warning:.0%} of its limit by the "
            f"thermal model; {L.temperature:g} °C, {L.rise:.0%}"
        ),
        "1 tick",
        f"announce; {_SIT}",
    ),
    (
        answers_slow,
        lambda L: f"half a second of answers that take {1e3 * L.slow_answers:g} ms; {1e3 * L.slowest_answers:g} ms",
        "0.5 s",
        "announce; sit down",
    ),
    (
        battery_low,
        lambda L: f"supply below {L.low_voltage:g} V; {L.lowest_voltage:g} V",
        "5 s",
        "announce; sit down",
    ),
    (
        joint_impossible,
        lambda L: (
            f"{L.outside:g} rad beyond a joint limit, {L.jump:g} rad in one tick, faster than {L.overspeed:g} rad/s in "
            f"2 ticks, or {L.frozen_ticks} equal readings while a policy moves the target by {L.frozen_targets:g} rad"
        ),
        "1 tick to 160 ms",
        _SIT,
    ),
    (off_target, lambda L: f"more than {L.off_target:g} rad from the target for 0.5 s", "0.5 s", _SIT),
    (
        imu_silent,
        lambda L: (
            f"older than {1e3 * L.imu_age:g} ms, or not valid by its status; while a policy moves the robot also "
            f"{L.imu_repeats + 1} equal readings, or nothing new for {1e3 * L.imu_age:g} ms"
        ),
        "120 ms",
        "damp",
    ),
    (
        imu_contradiction,
        lambda L: (
            f"heading, or tilt, and rate of turn differ by {L.turn_mismatch:g} rad in a tick; tilt {L.doubt_ticks} "
            f"times in a row, or for {L.legs_ticks} ticks hind toes {100 * L.toes_apart:g} cm apart in height while "
            f"standing, {100 * L.toes_apart_moving:g} cm while getting up or down, or front toes less than "
            f"{100 * L.front_above:g} cm above them while standing"
        ),
        "60 ms",
        "taken out, left out; damp",
    ),
    (
        falling,
        lambda L: (
            f"cosine to upright below {L.upright:g} ({degrees(L.upright)} deg) while standing; sine of the roll above "
            f"{L.side_tilt:g}, or base z below {L.backward:g}, while getting up or down"
        ),
        "1 tick",
        "damp",
    ),
    (
        step_late,
        lambda L: (
            f"one of {1e3 * L.overrun:g} ms, or {L.small_overruns_logged} in a row of {1e3 * L.small_overrun:g} "
            f"ms; {L.overrun_ticks} in a row of {1e3 * L.overrun:g} ms, {L.small_overrun_ticks} in a row of "
            f"{1e3 * L.small_overrun:g} ms, or one of {1e3 * L.longest_overrun:g} ms"
        ),
        "1 tick",
        "log; damp",
    ),
    (
        bus_errors,
        lambda L: (
            f"any, or the stock robot's firmware reports a command later than 10 ms (0x01); {L.bus_errors} within "
            "0.1 s, or it reports none for 500 ms (0x02)"
        ),
        "0.1 s",
        "log; damp",
    ),
    (
        sender,
        lambda L: f"it says nothing for {L.sender_age:g} s; for 0.2 s, has ended, or has damped the robot",
        "1 tick",
        "sit down; damp",
    ),
    (
        other_program,
        lambda L: f"a command that is not ours, or an answer to one; {L.foreign_storm} within 0.1 s",
        "1 tick",
        "sit down; damp",
    ),
)

RULES = tuple(
    Rule(name=check.__name__, limit=limit, within=within, outcome=outcome, check=check)
    for check, limit, within, outcome in _ROWS
)
"""Every rule that checks readings, in the order in which they are checked."""

SUSPENDED_RULES = tuple(rule for rule in RULES if rule.check not in (imu_silent, imu_contradiction, falling))
"""Rules for a suspended robot, which needs no balance."""

FAILURE = "failure"
"""The rule that the control loop applies itself."""

FAILURES = "a target or an answer is no number, or anything is raised; the log cannot be written, as on a full disk"
"""What it finds, in words."""

FAILURE_OUTCOMES = "damp; sit down, the rows stay in memory"
"""What follows from that, in words."""

TIPPING = Rule(name="falling", limit=lambda L: "", within="1 tick", outcome="damp", check=tipping)
"""Of a robot that stands; for episodes in simulation."""

FALLEN = Rule(
    name="fallen",
    limit=lambda L: f"cosine of base x to up below {L.fallen:g} while standing",
    within="1 tick",
    outcome="stop",
    check=fallen,
    reads_history=False,
)
"""Ends an evaluated episode whose robot has fallen; for simulation only."""

FALLS = (falling.__name__, FALLEN.name)
"""Rules that mean that the robot falls."""

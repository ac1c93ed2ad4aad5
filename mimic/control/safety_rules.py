"""The rules by which a robot is stopped, each a function, here or in the modules of checks, and a row of the table."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from mimic.control.alert import Alert, Check
from mimic.control.balance_checks import (
    degrees,
    fallen,
    heading_reset,
    imu_contradicts_itself,
    imu_contradicts_legs,
    imu_frozen,
    imu_invalid,
    imu_silent,
    rolling_over,
    tipping,
)
from mimic.control.motor_checks import (
    answers_slow,
    battery_low,
    encoder_frozen,
    joint_impossible,
    motor_fault,
    motor_hot,
    motor_off,
    motor_silent,
    off_target,
    overspeed,
    winding_hot,
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


def interrupt(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Ctrl-C, once and again."""
    if report.interrupts == 1:
        text = "the terminal was closed (SIGHUP)" if report.hung_up else "Ctrl-C was pressed"
        yield Alert(outcome="SIT_DOWN", text=text, needs_upright=False)
    elif report.interrupts > 1:
        yield Alert(outcome="DAMP", text="Ctrl-C was pressed again")


def released(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """What must be held was let go."""
    if report.released:
        yield Alert(outcome="SIT_DOWN", text="the key or button was let go (--hold)", needs_upright=False)


def terminated(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """SIGTERM."""
    if report.terminated:
        yield Alert(outcome="DAMP", text="the process was asked to end (SIGTERM)")


def tick_overrun(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
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
    """Frames that make no sense, and buses that fail."""
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


def board_error(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Errors that a motion board reports."""
    if report.health.err_flag & BOARD_TIMED_OUT:
        yield Alert(outcome="DAMP", text="the robot's firmware ignores commands, as none had reached it (error 0x02)")
    elif report.health.err_flag & BOARD_LATE:
        gap = 1e3 * report.health.command_gap
        yield Alert(outcome="RUN", text=f"the robot got no command for {gap:.0f} ms (error 0x01)", about="once")


def foreign_commands(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
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
    (interrupt, lambda L: "Ctrl-C, or the terminal is closed; Ctrl-C again", "1 tick", "sit down; damp"),
    (released, lambda L: "`--hold`: the key or button is let go", "1 tick; a key 0.3 s", "sit down"),
    (terminated, lambda L: "SIGTERM", "1 tick", "damp"),
    (motor_silent, lambda L: f"{L.silent_ticks} ticks without an answer", "100 ms", _SIT),
    (motor_fault, lambda L: "any fault bit", "1 tick", _SIT),
    (motor_off, lambda L: "not in run mode, without a fault", "1 tick", _SIT),
    (motor_hot, lambda L: f"{L.temperature_warning:g} °C; {L.temperature:g} °C", "1 tick", f"announce; {_SIT}"),
    (
        winding_hot,
        lambda L: f"{L.rise_warning:.0%}; {L.rise:.0%} of the winding's limit by the thermal model",
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
        lambda L: f"{L.outside:g} rad beyond a joint limit, or {L.jump:g} rad in one tick",
        "1 tick",
        _SIT,
    ),
    (
        encoder_frozen,
        lambda L: (
            f"{L.frozen_ticks} equal readings of a joint whose target moved by {L.frozen_targets:g} rad, "
            "while a policy moves the robot"
        ),
        "160 ms",
        _SIT,
    ),
    (overspeed, lambda L: f"faster than {L.overspeed:g} rad/s in 2 ticks in a row", "40 ms", _SIT),
    (off_target, lambda L: f"more than {L.off_target:g} rad from the target for 0.5 s", "0.5 s", _SIT),
    (imu_silent, lambda L: f"older than {1e3 * L.imu_age:g} ms", "120 ms", "damp"),
    (
        imu_frozen,
        lambda L: (
            f"{L.imu_repeats + 1} equal readings, or nothing new for {1e3 * L.imu_age:g} ms, "
            "while a policy moves the robot"
        ),
        "120 ms",
        "damp",
    ),
    (imu_invalid, lambda L: "its status says so", "1 tick", "damp"),
    (
        imu_contradicts_itself,
        lambda L: f"tilt and rate of turn differ by {L.turn_mismatch:g} rad in a tick; {L.doubt_ticks} in a row",
        "60 ms",
        "left out; damp",
    ),
    (
        heading_reset,
        lambda L: f"heading and rate of turn differ by {L.turn_mismatch:g} rad in a tick, the tilt does not",
        "1 tick",
        "log; the heading follows",
    ),
    (
        imu_contradicts_legs,
        lambda L: (
            f"for {L.legs_ticks} ticks, hind toes {100 * L.toes_apart:g} cm apart in height while standing, "
            f"{100 * L.toes_apart_moving:g} cm while getting up or down, or front toes less than "
            f"{100 * L.front_above:g} cm above them while standing"
        ),
        "60 ms",
        "damp",
    ),
    (
        tipping,
        lambda L: f"cosine to upright below {L.upright:g} ({degrees(L.upright)} deg) while standing",
        "1 tick",
        "damp",
    ),
    (
        rolling_over,
        lambda L: f"sine of the roll above {L.side_tilt:g}, or base z below {L.backward:g}, while getting up or down",
        "1 tick",
        "damp",
    ),
    (
        tick_overrun,
        lambda L: (
            f"one of {1e3 * L.overrun:g} ms, or {L.small_overruns_logged} in a row of {1e3 * L.small_overrun:g} "
            f"ms; {L.overrun_ticks} in a row of {1e3 * L.overrun:g} ms, {L.small_overrun_ticks} in a row of "
            f"{1e3 * L.small_overrun:g} ms, or one of {1e3 * L.longest_overrun:g} ms"
        ),
        "1 tick",
        "log; damp",
    ),
    (bus_errors, lambda L: f"any; {L.bus_errors} within 0.1 s", "0.1 s", "log; damp"),
    (
        sender,
        lambda L: f"it says nothing for {L.sender_age:g} s; for 0.2 s, has ended, or has damped the robot",
        "1 tick",
        "sit down; damp",
    ),
    (
        board_error,
        lambda L: "stock robot: its firmware reports 0x01, a command later than 10 ms; 0x02, none for 500 ms",
        "1 tick",
        "log; damp",
    ),
    (
        foreign_commands,
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

SUSPENDED_RULES = tuple(rule for rule in RULES if not rule.name.startswith(("imu", "tipping", "rolling")))
"""Rules for a suspended robot, which needs no balance."""

_OF_MOTION = (
    "motor_off",
    "encoder_frozen",
    "off_target",
    "imu_frozen",
    "imu_contradicts_legs",
    "tipping",
    "rolling_over",
)

DRY_RULES = tuple(rule for rule in RULES if rule.name not in _OF_MOTION)
"""Rules for a dry run, in which the motors are off and nothing moves."""

LOOP_RULES = {
    "not_finite": "a target or an answer of the policy is not a number: damped in the same tick",
    "outside_limits": "targets, answers and commands beyond their limits: clamped in the same tick, counted",
    "log_failed": "the log cannot be written, as on a full disk: sit down; the rows stay in memory",
    "exception": "anything raised anywhere, the bus among it: damped, then stopped",
    "finished": "the run is over: damped, then stopped",
    "at_rest": "damped and slower than 0.1 rad/s for 0.5 s, or damped for 8 s: stopped",
}
"""Rules that the control loop applies itself, in words."""

TIPPING = next(rule for rule in RULES if rule.name == "tipping")

FALLEN = Rule(
    name="fallen",
    limit=lambda L: f"cosine of base x to up below {L.fallen:g} while standing",
    within="1 tick",
    outcome="stop",
    check=fallen,
    reads_history=False,
)
"""Ends an evaluated episode whose robot has fallen; for simulation only."""

FALLS = ("tipping", "rolling_over", FALLEN.name)
"""Rules that mean that the robot falls."""

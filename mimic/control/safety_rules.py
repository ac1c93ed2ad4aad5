"""The rules by which a robot is stopped: one function and one row of the table each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mimic.control.safety_limits import Limits
from mimic.control.step_history import MOVING, STANDING, StepHistory, StepReport
from mimic.geometry import up_cosine
from mimic.metrics import uprightness
from mimic.records import JOINTS, PHASES


@dataclass(frozen=True, kw_only=True)
class Alert:
    """What a rule found in one control step."""

    outcome: Literal["RUN", "SIT_DOWN", "DAMP", "STOPPED"]
    """What follows, as the name of a SafetyMode."""
    text: str
    """What happened, as a sentence without its full stop."""
    about: str = ""
    """Its subject, such as a joint; each subject is reported once."""
    needs_upright: bool = True
    """Whether sitting down makes sense only for a robot that is still upright."""


Check = Callable[[StepReport, StepHistory, Limits], Iterator[Alert]]


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


def _interrupt(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if report.interrupts == 1:
        yield Alert(outcome="SIT_DOWN", text="Ctrl-C was pressed", needs_upright=False)
    elif report.interrupts > 1:
        yield Alert(outcome="DAMP", text="Ctrl-C was pressed again")


def _terminated(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if report.terminated:
        yield Alert(outcome="DAMP", text="the process was asked to end (SIGTERM)")


def _failed(joint: int, text: str) -> Alert:
    return Alert(outcome="SIT_DOWN", text=text, about=JOINTS[joint])


def _motor_silent(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    health = report.health
    silent = np.flatnonzero((health.missed >= limits.silent_ticks) & (health.age >= limits.silent_seconds))
    history.failed.update(map(int, silent))
    if len(silent) == len(JOINTS):
        yield Alert(outcome="SIT_DOWN", text=f"no motor has answered for {float(health.age.min()):.2f} s", about="all")
        return
    for joint in silent:
        missed, age = int(health.missed[joint]), float(health.age[joint])
        yield _failed(int(joint), f"motor {JOINTS[joint]} has not answered for {missed} ticks ({age:.2f} s)")


def _motor_fault(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    faulty = np.flatnonzero(report.health.faults)
    history.failed.update(map(int, faulty))
    for joint in faulty:
        bits = int(report.health.faults[joint])
        yield _failed(int(joint), f"motor {JOINTS[joint]} reports fault bits {bits:#04x}")


def _motor_off(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    off = np.flatnonzero(~report.health.running & (report.health.missed == 0) & (report.health.faults == 0))
    history.failed.update(map(int, off))
    history.distrusted.update(map(int, off))
    for joint in off:
        yield _failed(int(joint), f"motor {JOINTS[joint]} switched itself off, so its zero may be lost")


def _motor_hot(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    temperature = report.health.temperature
    for joint in np.flatnonzero(temperature >= limits.temperature_warning):
        name, text = JOINTS[joint], f"motor {JOINTS[joint]} is at {temperature[joint]:.0f} degC"
        if temperature[joint] < limits.temperature:
            yield Alert(outcome="RUN", text=f"{text}; it sits down at {limits.temperature:g} degC", about=name)
        else:
            yield Alert(outcome="SIT_DOWN", text=text, about=name)


def _winding_hot(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    for joint in np.flatnonzero(history.rise >= limits.rise_warning):
        name, text = JOINTS[joint], f"the winding of {JOINTS[joint]} is at {history.rise[joint]:.0%} of its limit"
        if history.rise[joint] < limits.rise:
            yield Alert(outcome="RUN", text=f"{text} by the thermal model", about=name)
        else:
            yield Alert(outcome="SIT_DOWN", text=f"{text} by the thermal model", about=name)


def _joint_impossible(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    description, q = history.description, report.state.q
    outside = np.maximum(q - description.q_max, description.q_min - q)
    bad = np.flatnonzero((outside > limits.outside) | (history.jump > limits.jump))
    history.failed.update(map(int, bad))
    history.distrusted.update(map(int, bad))
    for joint in bad:
        if outside[joint] > limits.outside:
            text = f"joint {JOINTS[joint]} reads {q[joint]:.2f} rad, {outside[joint]:.2f} rad beyond its limit"
        else:
            text = f"joint {JOINTS[joint]} jumped by {history.jump[joint]:.2f} rad in one tick"
        yield _failed(int(joint), text)


def _imu_silent(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if not report.health.imu_age <= limits.imu_age:
        yield Alert(outcome="DAMP", text=f"the IMU has been silent for {report.health.imu_age:.2f} s")


def _imu_frozen(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if PHASES[report.phase] not in MOVING:
        return
    if history.imu_repeats >= limits.imu_repeats:
        yield Alert(outcome="DAMP", text=f"the IMU sent the same orientation {history.imu_repeats + 1} times")
    elif report.health.imu_unchanged > limits.imu_age:
        text = f"nothing that the IMU sends has changed for {report.health.imu_unchanged:.2f} s"
        yield Alert(outcome="DAMP", text=text)


def _imu_invalid(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if report.health.imu_valid is False:
        yield Alert(outcome="DAMP", text="the IMU says that its orientation is not valid")


def _imu_contradicts_itself(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if history.turn_mismatch > limits.turn_mismatch:
        text = f"orientation and rate of turn of the IMU disagree by {history.turn_mismatch:.2f} rad in one tick"
        yield Alert(outcome="DAMP", text=text)


def _imu_contradicts_legs(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if PHASES[report.phase] in MOVING and history.legs_contradict >= limits.legs_ticks:
        yield Alert(
            outcome="DAMP",
            text=f"IMU and legs disagree: they put the hind toes {history.hind_apart:.2f} m apart in height, "
            f"and the front toes {history.front_above:.2f} m above the hind toes",
        )


def _degrees(cosine: float) -> int:
    return round(float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def _tipping(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if PHASES[report.phase] in STANDING:
        upright = float(uprightness(report.state.quat_WB, history.description))
        if upright < limits.upright:
            yield Alert(outcome="DAMP", text=f"the robot is tipping over: {_degrees(upright)} deg from upright")


def _fallen(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if PHASES[report.phase] in STANDING and float(up_cosine(*report.state.quat_WB)) < limits.fallen:
        yield Alert(outcome="STOPPED", text="the robot has fallen")


def _rolling_over(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if PHASES[report.phase] not in STANDING:
        _, side, up = history.rotation[2]
        if abs(side) > limits.side_tilt:
            degrees = np.rad2deg(np.arcsin(np.clip(abs(side), 0.0, 1.0)))
            yield Alert(outcome="DAMP", text=f"the robot is rolling over: {degrees:.0f} deg to the side")
        elif up < limits.backward:
            yield Alert(outcome="DAMP", text="the robot is falling onto its back")


def _tick_overrun(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
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


def _bus_errors(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if history.new_errors >= limits.bus_errors:
        yield Alert(outcome="DAMP", text=f"the bus had {history.new_errors} errors within a tenth of a second")
    elif history.new_errors:
        yield Alert(outcome="RUN", text=f"the bus had {history.new_errors} errors")


def _watchdog_ended(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if not report.health.guarded:
        yield Alert(outcome="SIT_DOWN", text="the watchdog process has ended", needs_upright=False)


def _board_error(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if report.health.err_flag & BOARD_TIMED_OUT:
        yield Alert(outcome="DAMP", text="the robot's firmware ignores commands, as none had reached it (error 0x02)")
    elif report.health.err_flag & BOARD_LATE:
        gap = 1e3 * report.health.command_gap
        yield Alert(outcome="RUN", text=f"the robot got no command for {gap:.0f} ms (error 0x01)", about="once")


def _foreign_commands(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    if history.new_foreign >= limits.foreign_storm:
        text = f"another program commands this robot: {history.new_foreign} times within a tenth of a second"
        yield Alert(outcome="DAMP", text=text)
    elif report.health.foreign:
        yield Alert(outcome="SIT_DOWN", text="another program commands this robot", needs_upright=False)


BOARD_LATE, BOARD_TIMED_OUT = 0x01, 0x02
"""Bits of a motion board's error flag: a late command, and commands that are ignored."""

_SIT = "sit down if upright and at most one motor is lost, else damp"

_ROWS: tuple[tuple[Check, Callable[[Limits], str], str, str], ...] = (
    (_interrupt, lambda L: "Ctrl-C; again", "1 tick", "sit down; damp"),
    (_terminated, lambda L: "SIGTERM", "1 tick", "damp"),
    (_motor_silent, lambda L: f"{L.silent_ticks} ticks without an answer", "60 ms", _SIT),
    (_motor_fault, lambda L: "any fault bit", "1 tick", _SIT),
    (_motor_off, lambda L: "not in run mode, without a fault", "1 tick", _SIT),
    (_motor_hot, lambda L: f"{L.temperature_warning:g} °C; {L.temperature:g} °C", "1 tick", f"announce; {_SIT}"),
    (
        _winding_hot,
        lambda L: f"{L.rise_warning:.0%}; {L.rise:.0%} of the winding's limit by the thermal model",
        "1 tick",
        f"announce; {_SIT}",
    ),
    (
        _joint_impossible,
        lambda L: f"{L.outside:g} rad beyond a joint limit, or {L.jump:g} rad in one tick",
        "1 tick",
        _SIT,
    ),
    (_imu_silent, lambda L: f"older than {1e3 * L.imu_age:g} ms", "60 ms", "damp"),
    (
        _imu_frozen,
        lambda L: (
            f"{L.imu_repeats + 1} equal readings, or nothing new for {1e3 * L.imu_age:g} ms, "
            "while a policy moves the robot"
        ),
        "60 ms",
        "damp",
    ),
    (_imu_invalid, lambda L: "its status says so", "1 tick", "damp"),
    (
        _imu_contradicts_itself,
        lambda L: f"orientation and rate of turn differ by {L.turn_mismatch:g} rad in a tick",
        "1 tick",
        "damp",
    ),
    (
        _imu_contradicts_legs,
        lambda L: (
            f"for {L.legs_ticks} ticks, hind toes {100 * L.toes_apart:g} cm apart in height while standing, "
            f"{100 * L.toes_apart_moving:g} cm while getting up or down, or front toes less than "
            f"{100 * L.front_above:g} cm above them while standing"
        ),
        "60 ms",
        "damp",
    ),
    (
        _tipping,
        lambda L: f"cosine to upright below {L.upright:g} ({_degrees(L.upright)} deg) while standing",
        "1 tick",
        "damp",
    ),
    (
        _rolling_over,
        lambda L: f"sine of the roll above {L.side_tilt:g}, or base z below {L.backward:g}, while getting up or down",
        "1 tick",
        "damp",
    ),
    (
        _tick_overrun,
        lambda L: (
            f"one of {1e3 * L.overrun:g} ms, or {L.small_overruns_logged} in a row of {1e3 * L.small_overrun:g} "
            f"ms; {L.overrun_ticks} in a row of {1e3 * L.overrun:g} ms, {L.small_overrun_ticks} in a row of "
            f"{1e3 * L.small_overrun:g} ms, or one of {1e3 * L.longest_overrun:g} ms"
        ),
        "1 tick",
        "log; damp",
    ),
    (_bus_errors, lambda L: f"any; {L.bus_errors} within 0.1 s", "0.1 s", "log; damp"),
    (_watchdog_ended, lambda L: "it has ended", "1 tick", "sit down"),
    (
        _board_error,
        lambda L: "stock robot: its firmware reports 0x01, a command later than 10 ms; 0x02, none for 500 ms",
        "1 tick",
        "log; damp",
    ),
    (
        _foreign_commands,
        lambda L: f"a command that is not ours, or an answer to one; {L.foreign_storm} within 0.1 s",
        "1 tick",
        "sit down; damp",
    ),
)

RULES = tuple(
    Rule(name=check.__name__[1:], limit=limit, within=within, outcome=outcome, check=check)
    for check, limit, within, outcome in _ROWS
)
"""Every rule that checks readings, in the order in which they are checked."""

SUSPENDED_RULES = tuple(rule for rule in RULES if not rule.name.startswith(("imu", "tipping", "rolling")))
"""Rules for a suspended robot, which needs no balance."""

LOOP_RULES = {
    "not_finite": "a target or an answer of the policy is not a number: damped in the same tick",
    "outside_limits": "targets, answers and commands beyond their limits: clamped in the same tick, counted",
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
    check=_fallen,
    reads_history=False,
)
"""Ends an evaluated episode whose robot has fallen; for simulation only."""

FALLS = ("tipping", "rolling_over", FALLEN.name)
"""Rules that mean that the robot falls."""

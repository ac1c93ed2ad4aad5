"""The rules by which a robot is stopped: each a function, with its row of the table in docs/manual/robot.md."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mimic.control.safety.step_history import MOVING, STANDING, StepHistory, StepReport
from mimic.frozen import frozen
from mimic.geometry import up_cosine
from mimic.metrics import uprightness
from mimic.records import DOUBLED, JOINTS, PHASES
from mimic.robot.parts import SafetyLimits

BOARD_LATE = 0x01
"""Bit of a motion board's error flag: a command was late."""
BOARD_TIMED_OUT = 0x02
"""Bit of the same: commands are ignored."""


@dataclass(frozen=True)
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


Check = Callable[[StepReport, StepHistory, SafetyLimits], Iterator[Alert]]


@frozen
class Rule:
    """A row of the table in docs/manual/robot.md."""

    name: str
    check: Check
    reads_history: bool = True
    """Whether it looks at more than the newest report."""


RULES: list[Rule] = []
"""Every rule that checks readings, in the order in which they are checked."""


def _rule(check: Check) -> Check:
    """Add a rule of this function's name to RULES."""
    RULES.append(Rule(name=check.__name__, check=check))
    return check


def degrees(cosine: float) -> int:
    """Return the angle of a cosine [deg]."""
    return round(float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def _failed(joint: int, text: str) -> Alert:
    return Alert("SIT_DOWN", text, JOINTS[joint])


@_rule
def asked_to_end(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """Ctrl-C once and again, SIGTERM, and what must be held and was let go."""
    if report.terminated:
        yield Alert("DAMP", "the process was asked to end (SIGTERM)")
    if report.interrupts > 1:
        yield Alert("DAMP", "Ctrl-C was pressed again")
    elif report.interrupts == 1:
        text = "the terminal was closed (SIGHUP)" if report.hung_up else "Ctrl-C was pressed"
        yield Alert("SIT_DOWN", text, needs_upright=False)
    if report.released:
        yield Alert("SIT_DOWN", "the key or button was let go (--hold)", needs_upright=False)


@_rule
def motor_silent(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """Motors that do not answer."""
    health = report.health
    silent = np.flatnonzero((health.missed >= limits.silent_ticks) & (health.age >= limits.silent_seconds))
    history.failed.update(map(int, silent))
    if len(silent) == len(JOINTS):
        yield Alert("SIT_DOWN", f"no motor has answered for {float(health.age.min()):.2f} s", "all")
        return
    for joint in silent:
        missed = int(health.missed[joint])
        age = float(health.age[joint])
        yield _failed(int(joint), f"motor {JOINTS[joint]} has not answered for {missed} ticks ({age:.2f} s)")


@_rule
def motor_failed(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """Motors that report a fault, or switched themselves off."""
    health = report.health
    for joint in np.flatnonzero(health.faults):
        bits = int(health.faults[joint])
        text = f"motor {JOINTS[joint]} reports fault bits {bits:#04x}"
        if bits & DOUBLED:
            text = f"two motors answer as {JOINTS[joint]}: they have one id"
        history.failed.add(int(joint))
        yield _failed(int(joint), text)
    if not history.moves:
        return
    for joint in np.flatnonzero(~health.running & (health.missed == 0) & (health.faults == 0)):
        history.failed.add(int(joint))
        history.distrusted.add(int(joint))
        yield _failed(int(joint), f"motor {JOINTS[joint]} switched itself off, so its zero may be lost")


@_rule
def too_hot(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """Motors and windings that are warm, and too warm."""
    temperature = report.health.temperature
    for joint in np.flatnonzero(temperature >= limits.temperature_warning):
        name = JOINTS[joint]
        text = f"motor {JOINTS[joint]} is at {temperature[joint]:.0f} degC"
        if temperature[joint] < limits.temperature:
            yield Alert("RUN", f"{text}; it sits down at {limits.temperature:g} degC", name)
        else:
            yield Alert("SIT_DOWN", text, name)
    for joint in np.flatnonzero(history.rise >= limits.rise_warning):
        outcome = "RUN" if history.rise[joint] < limits.rise else "SIT_DOWN"
        text = f"the winding of {JOINTS[joint]} is at {history.rise[joint]:.0%} of its limit by the thermal model"
        yield Alert(outcome, text, f"winding {JOINTS[joint]}")


@_rule
def answers_slow(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """Answers that take long, though none is missing."""
    text = f"answers of the motors take {1e3 * history.round_trip:.0f} ms"
    if history.round_trip > limits.slowest_answers:
        yield Alert("SIT_DOWN", text)
    elif history.round_trip > limits.slow_answers:
        yield Alert("RUN", f"{text}; it sits down at {1e3 * limits.slowest_answers:g} ms")


@_rule
def battery_low(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """A supply that runs down."""
    text = f"the supply is at {history.voltage:.1f} V"
    if history.voltage < limits.lowest_voltage:
        yield Alert("SIT_DOWN", text)
    elif history.voltage < limits.low_voltage:
        yield Alert("RUN", f"{text}; it sits down at {limits.lowest_voltage:g} V")


@_rule
def joint_impossible(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """Readings that no joint can have, that turn too fast, or that do not change although the targets do."""
    description = history.description
    q = report.state.q
    outside = np.maximum(q - description.q_max, description.q_min - q)
    found: dict[int, str] = {}
    for joint in np.flatnonzero(history.fast >= 2):
        found[int(joint)] = f"joint {JOINTS[joint]} turns at {report.state.dq[joint]:.0f} rad/s"
    for joint in np.flatnonzero(history.frozen):
        text = f"joint {JOINTS[joint]} reads the same {limits.frozen_ticks} times, though its target moves"
        found[int(joint)] = text
        history.distrusted.add(int(joint))
    for joint in np.flatnonzero(history.jump > limits.jump):
        found[int(joint)] = f"joint {JOINTS[joint]} jumped by {history.jump[joint]:.2f} rad in one tick"
        history.distrusted.add(int(joint))
    for joint in np.flatnonzero(outside > limits.outside):
        found[int(joint)] = f"joint {JOINTS[joint]} reads {q[joint]:.2f} rad, {outside[joint]:.2f} rad beyond its limit"
        history.distrusted.add(int(joint))
    history.failed.update(found)
    for joint, text in sorted(found.items()):
        yield _failed(joint, text)


@_rule
def off_target(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """Joints that do not get to their targets."""
    away = np.flatnonzero(history.off_target >= limits.off_target_ticks) if history.moves else ()
    history.failed.update(map(int, away))
    for joint in away:
        text = f"joint {JOINTS[joint]} has been more than {limits.off_target:g} rad from its target for half a second"
        yield _failed(int(joint), text)


@_rule
def imu_silent(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """An IMU that sends nothing, nothing new, or nothing valid."""
    health = report.health
    if not health.imu_age <= limits.imu_age:
        yield Alert("DAMP", f"the IMU has been silent for {health.imu_age:.2f} s")
    elif health.imu_valid is False:
        yield Alert("DAMP", "the IMU says that its orientation is not valid")
    elif not history.moves or PHASES[report.phase] not in MOVING:
        return
    elif history.imu_repeats >= limits.imu_repeats:
        yield Alert("DAMP", f"the IMU sent the same orientation {history.imu_repeats + 1} times")
    elif health.imu_unchanged > limits.imu_age:
        yield Alert("DAMP", f"nothing that the IMU sends has changed for {health.imu_unchanged:.2f} s")


@_rule
def imu_contradiction(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """Orientations that do not turn as the rate of turn says, or that the legs contradict."""
    text = f"orientation and rate of turn of the IMU disagree by {history.turn_mismatch:.2f} rad"
    if history.doubtful >= limits.doubt_ticks:
        yield Alert("DAMP", f"{text}, {history.doubtful} times in a row")
    elif history.doubtful:
        yield Alert("RUN", f"{text}; that orientation is left out", "once")
    if history.heading_jump:
        turned = np.rad2deg(history.heading_jump)
        text = f"the heading of the IMU jumped by {turned:.0f} deg; it is taken out"
        yield Alert("RUN", text, "heading")
    if history.moves and PHASES[report.phase] in MOVING and history.legs_contradict >= limits.legs_ticks:
        yield Alert(
            "DAMP",
            f"IMU and legs disagree: they put the hind toes {history.hind_apart:.2f} m apart in height, "
            f"and the front toes {history.front_above:.2f} m above the hind toes",
        )


def tipping(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """A standing robot that is about to fall."""
    if PHASES[report.phase] in STANDING and not history.doubtful:
        upright = float(uprightness(report.state.quat_WB, history.description))
        if upright < limits.upright:
            yield Alert("DAMP", f"the robot is tipping over: {degrees(upright)} deg from upright")


def fallen(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """A robot that should stand and lies."""
    if PHASES[report.phase] in STANDING and float(up_cosine(*report.state.quat_WB)) < limits.fallen:
        yield Alert("STOPPED", "the robot has fallen")


@_rule
def falling(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """A robot that tips over while it stands, or rolls over while it gets up or down."""
    if not history.moves:
        return
    yield from tipping(report, history, limits)
    if PHASES[report.phase] not in STANDING:
        _, side, up = history.rotation[2]
        if abs(side) > limits.side_tilt:
            angle = np.rad2deg(np.arcsin(np.clip(abs(side), 0.0, 1.0)))
            yield Alert("DAMP", f"the robot is rolling over: {angle:.0f} deg to the side")
        elif up < limits.backward:
            yield Alert("DAMP", "the robot is falling onto its back")


@_rule
def step_late(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """Control steps that end late."""
    overrun = report.health.late
    row = history.overruns
    small = history.small_overruns
    milliseconds = 1e3 * overrun
    if overrun > limits.longest_overrun or row >= limits.overrun_ticks:
        yield Alert("DAMP", f"a tick overran by {milliseconds:.0f} ms, {row} in a row")
    elif small >= limits.small_overrun_ticks:
        yield Alert("DAMP", f"{small} ticks in a row overran, the last one by {milliseconds:.1f} ms")
    elif row:
        yield Alert("RUN", f"a tick overran by {milliseconds:.0f} ms", "once")
    elif small == limits.small_overruns_logged:
        yield Alert("RUN", f"{small} ticks in a row overran, the last one by {milliseconds:.1f} ms")


@_rule
def bus_errors(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """Frames that make no sense, buses that fail, and commands that a motion board misses."""
    if report.health.err_flag & BOARD_TIMED_OUT:
        yield Alert("DAMP", "the robot's firmware ignores commands, as none had reached it (error 0x02)")
    elif report.health.err_flag & BOARD_LATE:
        gap = 1e3 * report.health.command_gap
        yield Alert("RUN", f"the robot got no command for {gap:.0f} ms (error 0x01)", "board")
    if history.new_errors >= limits.bus_errors:
        yield Alert("DAMP", f"the bus had {history.new_errors} errors within a tenth of a second")
    elif history.new_errors:
        yield Alert("RUN", f"the bus had {history.new_errors} errors")


@_rule
def sender(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """A process that sends to the robot, and has said nothing for a while."""
    silent = report.health.sender_age
    if silent > limits.sender_age:
        text = f"the process that sends to the robot has said nothing for {silent:.2f} s"
        yield Alert("SIT_DOWN", text, needs_upright=False)


@_rule
def other_program(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    """Commands of another program."""
    if history.new_foreign >= limits.foreign_storm:
        text = f"another program commands this robot: {history.new_foreign} times within a tenth of a second"
        yield Alert("DAMP", text)
    elif report.health.foreign:
        yield Alert("SIT_DOWN", "another program commands this robot", needs_upright=False)


SUSPENDED_RULES = tuple(rule for rule in RULES if rule.check not in (imu_silent, imu_contradiction, falling))
"""Rules for a suspended robot, which needs no balance."""

FAILURE = "failure"
"""The rule that the control loop applies itself."""

TIPPING = Rule(name="falling", check=tipping)
"""Of a robot that stands; for episodes in simulation."""

FALLEN = Rule(
    name="fallen",
    check=fallen,
    reads_history=False,
)
"""Ends an evaluated episode whose robot has fallen; for simulation only."""

FALLS = (falling.__name__, FALLEN.name)
"""Rules that mean that the robot falls."""

"""The safety rules of motors and joints."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mimic.control.alert import Alert
from mimic.control.safety_limits import Limits
from mimic.control.step_history import StepHistory, StepReport
from mimic.records import DOUBLED, JOINTS


def _failed(joint: int, text: str) -> Alert:
    return Alert(outcome="SIT_DOWN", text=text, about=JOINTS[joint])


def motor_silent(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Motors that do not answer."""
    health = report.health
    silent = np.flatnonzero((health.missed >= limits.silent_ticks) & (health.age >= limits.silent_seconds))
    history.failed.update(map(int, silent))
    if len(silent) == len(JOINTS):
        yield Alert(outcome="SIT_DOWN", text=f"no motor has answered for {float(health.age.min()):.2f} s", about="all")
        return
    for joint in silent:
        missed, age = int(health.missed[joint]), float(health.age[joint])
        yield _failed(int(joint), f"motor {JOINTS[joint]} has not answered for {missed} ticks ({age:.2f} s)")


def motor_failed(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
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


def too_hot(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Motors and windings that are warm, and too warm."""
    temperature = report.health.temperature
    for joint in np.flatnonzero(temperature >= limits.temperature_warning):
        name, text = JOINTS[joint], f"motor {JOINTS[joint]} is at {temperature[joint]:.0f} degC"
        if temperature[joint] < limits.temperature:
            yield Alert(outcome="RUN", text=f"{text}; it sits down at {limits.temperature:g} degC", about=name)
        else:
            yield Alert(outcome="SIT_DOWN", text=text, about=name)
    for joint in np.flatnonzero(history.rise >= limits.rise_warning):
        outcome = "RUN" if history.rise[joint] < limits.rise else "SIT_DOWN"
        text = f"the winding of {JOINTS[joint]} is at {history.rise[joint]:.0%} of its limit by the thermal model"
        yield Alert(outcome=outcome, text=text, about=f"winding {JOINTS[joint]}")


def answers_slow(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Answers that take long, though none is missing."""
    text = f"answers of the motors take {1e3 * history.round_trip:.0f} ms"
    if history.round_trip > limits.slowest_answers:
        yield Alert(outcome="SIT_DOWN", text=text)
    elif history.round_trip > limits.slow_answers:
        yield Alert(outcome="RUN", text=f"{text}; it sits down at {1e3 * limits.slowest_answers:g} ms")


def battery_low(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """A supply that runs down."""
    text = f"the supply is at {history.voltage:.1f} V"
    if history.voltage < limits.lowest_voltage:
        yield Alert(outcome="SIT_DOWN", text=text)
    elif history.voltage < limits.low_voltage:
        yield Alert(outcome="RUN", text=f"{text}; it sits down at {limits.lowest_voltage:g} V")


def joint_impossible(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Readings that no joint can have, that turn too fast, or that do not change although the targets do."""
    description, q = history.description, report.state.q
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


def off_target(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Joints that do not get to their targets."""
    away = np.flatnonzero(history.off_target >= limits.off_target_ticks) if history.moves else ()
    history.failed.update(map(int, away))
    for joint in away:
        text = f"joint {JOINTS[joint]} has been more than {limits.off_target:g} rad from its target for half a second"
        yield _failed(int(joint), text)

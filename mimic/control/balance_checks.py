"""The safety rules of the IMU and of balance."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mimic.control.alert import Alert
from mimic.control.safety_limits import Limits
from mimic.control.step_history import MOVING, STANDING, StepHistory, StepReport
from mimic.geometry import up_cosine
from mimic.metrics import uprightness
from mimic.records import PHASES


def imu_silent(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """An IMU that sends nothing, nothing new, or nothing valid."""
    health = report.health
    if not health.imu_age <= limits.imu_age:
        yield Alert(outcome="DAMP", text=f"the IMU has been silent for {health.imu_age:.2f} s")
    elif health.imu_valid is False:
        yield Alert(outcome="DAMP", text="the IMU says that its orientation is not valid")
    elif not history.moves or PHASES[report.phase] not in MOVING:
        return
    elif history.imu_repeats >= limits.imu_repeats:
        yield Alert(outcome="DAMP", text=f"the IMU sent the same orientation {history.imu_repeats + 1} times")
    elif health.imu_unchanged > limits.imu_age:
        yield Alert(outcome="DAMP", text=f"nothing that the IMU sends has changed for {health.imu_unchanged:.2f} s")


def imu_contradiction(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """Orientations that do not turn as the rate of turn says, or that the legs contradict."""
    text = f"orientation and rate of turn of the IMU disagree by {history.turn_mismatch:.2f} rad"
    if history.doubtful >= limits.doubt_ticks:
        yield Alert(outcome="DAMP", text=f"{text}, {history.doubtful} times in a row")
    elif history.doubtful:
        yield Alert(outcome="RUN", text=f"{text}; that orientation is left out", about="once")
    if history.heading_jump:
        turned = np.rad2deg(history.heading_jump)
        text = f"the heading of the IMU jumped by {turned:.0f} deg; it is taken out"
        yield Alert(outcome="RUN", text=text, about="heading")
    if history.moves and PHASES[report.phase] in MOVING and history.legs_contradict >= limits.legs_ticks:
        yield Alert(
            outcome="DAMP",
            text=f"IMU and legs disagree: they put the hind toes {history.hind_apart:.2f} m apart in height, "
            f"and the front toes {history.front_above:.2f} m above the hind toes",
        )


def degrees(cosine: float) -> int:
    """Return the angle of a cosine [deg]."""
    return round(float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def tipping(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """A standing robot that is about to fall."""
    if PHASES[report.phase] in STANDING and not history.doubtful:
        upright = float(uprightness(report.state.quat_WB, history.description))
        if upright < limits.upright:
            yield Alert(outcome="DAMP", text=f"the robot is tipping over: {degrees(upright)} deg from upright")


def fallen(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """A robot that should stand and lies."""
    if PHASES[report.phase] in STANDING and float(up_cosine(*report.state.quat_WB)) < limits.fallen:
        yield Alert(outcome="STOPPED", text="the robot has fallen")


def falling(report: StepReport, history: StepHistory, limits: Limits) -> Iterator[Alert]:
    """A robot that tips over while it stands, or rolls over while it gets up or down."""
    if not history.moves:
        return
    yield from tipping(report, history, limits)
    if PHASES[report.phase] not in STANDING:
        _, side, up = history.rotation[2]
        if abs(side) > limits.side_tilt:
            angle = np.rad2deg(np.arcsin(np.clip(abs(side), 0.0, 1.0)))
            yield Alert(outcome="DAMP", text=f"the robot is rolling over: {angle:.0f} deg to the side")
        elif up < limits.backward:
            yield Alert(outcome="DAMP", text="the robot is falling onto its back")

"""From where a robot lies without power to the crouch that its policy begins in: ramp, test of the joints, check."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

from mimic.control.joint_test import MOVE_TICKS, REST_TICKS, JointTest
from mimic.control.supervisor import SafetyMode
from mimic.control.tick import Run
from mimic.geometry import rotation_from_quat, smoothstep
from mimic.records import JOINTS, PHASES, FloatArray, JointCommand, RobotState
from mimic.robot.description import RobotDescription

START = "start"
"""The rule that the ramp applies itself."""

SETTLE_TICKS = 5
"""Control steps between ramp and test."""

LIE = PHASES.index("lie")


def test_seconds(dt: float) -> float:
    """Return how long the test of the joints takes at a control step dt [s]."""
    return dt * (SETTLE_TICKS + len(JOINTS) * (MOVE_TICKS + REST_TICKS))


def start(run: Run) -> None:
    """Bring a robot into the crouch, and damp it where it does not get there as its policy was trained to begin."""
    d, safety = run.plant.description, run.safety
    for gain, q_des in _ramp(run.sensed.q, d, safety.ramp):
        _hold(run, gain, q_des)
    if safety.tested:
        _test(run)
    if safety.checked and run.mode == SafetyMode.RUN:
        _refuse(run, not_crouched(run.sensed, d))


def _hold(run: Run, gain: float, q_des: FloatArray) -> None:
    """Hold joints for a control step, unless something ended the run."""
    if run.mode > SafetyMode.RUN:
        return
    numbers, zeros = run.plant.description.start, np.zeros(len(JOINTS))
    kp, kd = np.full_like(zeros, gain * numbers.kp), np.full_like(zeros, gain * numbers.kd)
    run.hold(JointCommand(q_des=q_des, dq_des=zeros, kp=kp, kd=kd, tau_ff=zeros), LIE)


def _refuse(run: Run, text: str) -> None:
    if text:
        run.decide(START, SafetyMode.DAMP, f"{text}; it was damped on the ground")


def _ramp(q: FloatArray, description: RobotDescription, seconds: float) -> Iterator[tuple[float, FloatArray]]:
    """Return gain and targets (12,) of each control step: gains rise where the joints are, then the joints move."""
    ticks = max(2, round(seconds / description.dt))
    begin, lie = np.clip(q, description.q_min, description.q_max), description.poses["lie"]
    for tick in range(ticks):
        done = 2.0 * (tick + 1) / ticks
        share = float(np.clip(done - 1.0, 0.0, 1.0))
        yield min(done, 1.0), begin + smoothstep(share) * (lie - begin)


@cache
def _prepared(description: RobotDescription) -> JointTest:
    return JointTest(description)


def _test(run: Run) -> None:
    """Move each joint by itself."""
    description = run.plant.description
    test = _prepared(description)
    for _ in range(SETTLE_TICKS):
        _hold(run, 1.0, description.poses["lie"])
    answers = []
    for joint in range(len(JOINTS)):
        q, quat = [], []
        for q_des in test.targets(joint):
            _hold(run, 1.0, q_des)
            q.append(run.sensed.q)
            quat.append(run.sensed.quat_WB)
        answers.append(test.answer(joint, np.array(q), np.array(quat)))
    if run.mode == SafetyMode.RUN:
        _refuse(run, test.fault(answers))


def not_crouched(state: RobotState, description: RobotDescription) -> str:
    """Return what is wrong with a robot that should be in the crouch, as a sentence; empty where nothing is."""
    limits = description.start
    away = np.abs(state.q - description.poses["lie"])
    worst = int(np.argmax(away))
    if away[worst] > limits.joints:
        return (
            f"{JOINTS[worst]} is {np.rad2deg(away[worst]):.0f} deg from the crouch, at most "
            f"{np.rad2deg(limits.joints):.0f} may be; is it free to move, and the battery full?"
        )
    if state.p_WB[2] < limits.height:
        return (
            f"its base is {100 * state.p_WB[2]:.1f} cm high in the crouch, at least {100 * limits.height:.1f} must be"
        )
    up = rotation_from_quat(state.quat_WB)[2]
    tilt = float(np.arccos(np.clip(up[2], -1.0, 1.0)))
    if tilt > limits.tilt:
        return (
            f"the IMU shows a tilt of {np.rad2deg(tilt):.0f} deg in the crouch, at most {np.rad2deg(limits.tilt):.0f} "
            "may be; is the ground level, and the IMU mounted as the wiring says?"
        )
    return ""

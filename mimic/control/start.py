"""From where a robot lies without power to the crouch that its policy begins in: ramp, test of the joints, check."""

from __future__ import annotations

from functools import cache

import numpy as np

from mimic.config.play import TRIM
from mimic.control.joint_test import MOVE_TICKS, REST_TICKS, JointTest
from mimic.control.safety.supervisor import SafetyMode
from mimic.control.tick import Run
from mimic.geometry import rotation_from_quat, smoothstep
from mimic.records import JOINTS, PHASES, FloatArray, JointCommand, RobotState
from mimic.robot.description import RobotDescription

LATE = 0.005
"""A control step that comes later than this [s] …"""

LATE_SHARE = 0.1
"""… may not be more frequent than this while the robot lies: on a quiet computer none is."""

MISSED_SHARE = 0.04
"""Largest share of the motors' answers that may miss their control step while the robot lies: half of what policies are
trained with."""

START = "start"
"""The rule that the ramp applies itself."""

TRIM_RATE = 0.15
"""Share of its distance by which a joint's target moves on in each control step."""
MOST_TRIM = 0.2
"""How far it moves on at most [rad]."""

SETTLE_TICKS = 40
"""Control steps in which the targets move on again after the test of joints."""
SETTLE_RATE = 0.05
"""Share by which they do: feet stick and slip, and at TRIM_RATE the joints hunt by 10 degrees (Go2)."""
STUCK = 0.02
"""A target stays where its joint is nearer than this [rad]."""

LIE = PHASES.index("lie")


def start_seconds(ramp: float, dt: float, *, tested: bool) -> float:
    """Return how long it takes until a policy begins [s], at a control step dt [s]."""
    return ramp + TRIM + tested * dt * (len(JOINTS) * (MOVE_TICKS + REST_TICKS) + SETTLE_TICKS)


class Ramp:
    """The commands that bring a robot into the crouch: gains rise where the joints are, then the joints move.

    At last the targets move on until the joints are there in spite of their load: a robot that sags is no longer where
    its policy was trained to begin.
    """

    def __init__(self, q: FloatArray, description: RobotDescription, seconds: float) -> None:
        """Begin at joints q (12,) [rad]; gains and joints take so many seconds [s]."""
        self._description = d = description
        self._begin = np.clip(q, d.q_min, d.q_max)
        self._lie = d.poses["lie"]
        self._moving = max(2, round(seconds / d.dt))
        self.ticks = self._moving + round(TRIM / d.dt)
        """How many control steps it takes."""
        self.trim = np.zeros(len(JOINTS))
        """What the targets are beyond the crouch (12,) [rad]."""

    def command(self, tick: int, q: FloatArray) -> JointCommand:
        """Return the command of a control step, from 0, for joints that are at q (12,) [rad]."""
        done = 2.0 * (tick + 1) / self._moving
        share = float(np.clip(done - 1.0, 0.0, 1.0))
        if tick >= self._moving:
            self.trim = np.clip(self.trim + TRIM_RATE * (self._lie - q), -MOST_TRIM, MOST_TRIM)
        q_des = self._begin + smoothstep(share) * (self._lie - self._begin) + self.trim
        return held(q_des, self._description, min(done, 1.0))

    def settling(self, q: FloatArray) -> JointCommand:
        """Return the command of a control step after the test of joints, for joints that are at q (12,) [rad].

        What the targets were beyond the crouch pulled at feet that stuck to the ground; the test has lifted them.
        """
        away = self._lie - q
        away = np.where(np.abs(away) > STUCK, away, 0.0)
        self.trim = np.clip(self.trim + SETTLE_RATE * away, -MOST_TRIM, MOST_TRIM)
        return held(self._lie + self.trim, self._description)


def start(run: Run) -> None:
    """Bring a robot into the crouch, and damp it where it does not get there as its policy was trained to begin."""
    d = run.plant.description
    safety = run.safety
    ramp = Ramp(run.sensed.q, d, safety.ramp)
    for tick in range(ramp.ticks):
        _hold(run, ramp.command(tick, run.sensed.q))
    if safety.tested:
        _test(run, ramp.trim)
        for _ in range(SETTLE_TICKS):
            _hold(run, ramp.settling(run.sensed.q))
    if safety.checked and run.mode == SafetyMode.RUN:
        busy = too_busy(run.journal.health_so_far("late")) or too_slow(run.journal.health_so_far("missed"))
        _refuse(run, busy or not_crouched(run.sensed, d))


def _hold(run: Run, command: JointCommand) -> None:
    """Send a command for a control step, unless something ended the run."""
    if run.mode == SafetyMode.RUN:
        run.hold(command, LIE)


def held(q_des: FloatArray, description: RobotDescription, gain: float = 1.0) -> JointCommand:
    """Return the command that holds joints (12,) [rad] as stiffly as the ramp, or with a share of that."""
    d = description
    zeros = np.zeros(len(JOINTS))
    kp = zeros + gain * d.start.kp
    kd = zeros + gain * d.start.kd
    return JointCommand(q_des=np.clip(q_des, d.q_min, d.q_max), dq_des=zeros, kp=kp, kd=kd, tau_ff=zeros)


def _refuse(run: Run, text: str) -> None:
    if text:
        run.decide(START, SafetyMode.DAMP, f"{text}; it was damped on the ground")


@cache
def _prepared(description: RobotDescription) -> JointTest:
    return JointTest(description)


def _test(run: Run, trim: FloatArray) -> None:
    """Move each joint by itself, its targets and those of the others as far beyond the crouch as the load asks."""
    description = run.plant.description
    test = _prepared(description)
    answers = []
    for joint in range(len(JOINTS)):
        q = []
        quat = []
        for q_des in test.targets(joint):
            _hold(run, held(q_des + trim, description))
            q.append(run.sensed.q)
            quat.append(run.sensed.quat_WB)
        answers.append(test.answer(joint, np.array(q), np.array(quat)))
    if run.mode == SafetyMode.RUN:
        _refuse(run, test.fault(answers))


def too_busy(late: FloatArray) -> str:
    """Return that control steps came late (T,) [s] while the robot lay, as a sentence; empty where few did."""
    share = float(np.mean(late > LATE)) if len(late) else 0.0
    if share <= LATE_SHARE:
        return ""
    return (
        f"this computer is too busy to hold a robot up: {share:.0%} of the control steps came more than "
        f"{1e3 * LATE:g} ms late, by up to {1e3 * late.max():.0f} ms; close other programs, or run as a user with "
        "real-time priority (ulimit -r 20)"
    )


def too_slow(missed: FloatArray) -> str:
    """Return that answers came too late while the robot lay, as a sentence; empty where few did.

    Args:
        missed: Control steps since the last answer of each joint (T, 12).
    """
    heard = missed[np.isfinite(missed)]
    share = float(np.mean(heard > 0)) if heard.size else 0.0
    if share <= MISSED_SHARE:
        return ""
    return (
        f"{share:.0%} of the motors' answers did not come within their control step, at most {MISSED_SHARE:.0%} may; "
        "close other programs, or look at the wiring of the bus"
    )


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

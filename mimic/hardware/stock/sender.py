"""What is sent to the board, at 500 Hz: newest reading in, newest target out. Pure: no socket, no clock.

The firmware cuts a desired position that is far from the measured one, which takes away the torque of a push. So each
message holds the target inside that cut around the newest reading, and what was cut off travels in the desired
velocity, which the firmware does not cut:

    q_c = clip(q_des, q - cut, q + cut)        qd_des = dq_des + kp (q_des - q_c) / kd

The torque is that of the policy's law, up to the limit of qd_des.

The sender is also the robot's watchdog. It damps when no order comes for BEAT_TIMEOUT, or when the process that gives
the orders has ended.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from mimic.control.safety_limits import limits_for
from mimic.errors import ContractError
from mimic.hardware.stock.messages import MOTOR_CTRL, TIMED_OUT
from mimic.hardware.stock.readings import NEVER, Readings
from mimic.hardware.stock.wiring import BoardWiring
from mimic.records import JOINTS, FloatArray, JointCommand
from mimic.robot.description import RobotDescription

PERIOD = 0.002
"""Time between two messages [s]: the firmware's own cycle."""

BEAT_TIMEOUT = 0.1
"""Five control steps without an order [s]; the loop itself damps when one step is that late."""

FRESH = 0.05
"""A reading at most this old shows that the robot answers [s]."""

ZERO_TIME = 0.2
"""How long zero messages are sent at the end [s]."""

_REMEMBERED = 2048
"""Own messages that are recognised when they come back by multicast: 4 s."""

_SMALL_KD = 0.05
"""Below this velocity gain the part that was cut off is sent as torque [N m s/rad]."""


class State(IntEnum):
    """What the sender sends."""

    LISTEN = 0
    """Nothing."""
    ZERO = 1
    """No gains and no torque: enters motor mode, and clears error 0x02."""
    DRIVE = 2
    """The newest target."""
    DAMP = 3
    """Damping, until the robot rests; then ENDING."""
    ENDING = 4
    """Zero messages for a moment; then DONE."""
    DONE = 5
    """Nothing any more."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Order:
    """What the process with the control loop wants: a state and, in DRIVE, a command."""

    state: State
    command: JointCommand | None = None

    def to_bytes(self) -> bytes:
        """Return the order as `from_bytes` reads it."""
        numbers = np.zeros((6, len(JOINTS)))
        if (c := self.command) is not None:
            numbers[:5], numbers[5, 0] = (c.q_des, c.dq_des, c.kp, c.kd, c.tau_ff), c.ramp
        return bytes([self.state]) + numbers.tobytes()

    @staticmethod
    def from_bytes(data: bytes) -> Order:
        """Return an order from its bytes."""
        q, dq, kp, kd, tau, ramp = np.frombuffer(data[1:]).reshape(6, len(JOINTS))
        command = JointCommand(q_des=q, dq_des=dq, kp=kp, kd=kd, tau_ff=tau, ramp=float(ramp[0]))
        return Order(state=State(data[0]), command=command if data[0] == State.DRIVE else None)


class Sender:
    """Decides what is sent, from orders, readings and time."""

    def __init__(self, wiring: BoardWiring, description: RobotDescription) -> None:
        """Begin in LISTEN.

        Args:
            wiring: Of the board.
            description: The robot; its largest velocity gain damps.
        """
        self._wiring, self._kd = wiring, min(description.kd_max, wiring.kd_max)
        self._limits = limits_for(description)
        self.readings = Readings(wiring)
        self.state = State.LISTEN
        self.reason = ""
        """Why it took over from the control loop; empty where it did not."""
        self.ending = ""
        """How the robot was left, as a sentence without a full stop; once DONE."""
        self._command: JointCommand | None = None
        self._from: FloatArray = np.zeros(len(JOINTS))
        self._commanded = self._ordered = self._foreign = NEVER
        self._since = self._rested = 0.0
        self._own: deque[bytes] = deque(maxlen=_REMEMBERED)
        self._own_set: dict[bytes, int] = {}
        self._tag = np.random.default_rng().uniform(-0.05, 0.05, len(JOINTS))  # tells own zero messages from others'

    # ------------------------------------------------------------------ orders

    def order(self, order: Order, t: float) -> None:
        """Take an order at time t [s].

        Raises:
            ContractError: If it holds a number that is not finite.
        """
        self._ordered = t
        if self.state >= State.DAMP:
            return  # a robot that is damped is not driven again
        if order.state == State.DRIVE:
            self._drive(order.command, t)
        elif order.state >= State.DAMP:
            if self.state == State.ZERO and self.readings.report["err_came"] == NEVER:
                self._end(t, NOT_FOLLOWED)  # it is not in motor mode
            else:
                self._damp("", t)
        else:
            self.state = order.state

    def _drive(self, command: JointCommand | None, t: float) -> None:
        assert command is not None
        numbers = np.concatenate([command.q_des, command.dq_des, command.kp, command.kd, command.tau_ff])
        if not np.isfinite(numbers).all():
            self._damp("a command holds numbers that are not finite", t)
            raise ContractError("a command holds numbers that are not finite; the robot is damped")
        self._from = self._target(t) if self._command is not None else command.q_des
        self._command, self._commanded, self.state = command, t, State.DRIVE

    def closed(self, t: float) -> None:
        """Take note that no more orders can come."""
        if self.state in (State.LISTEN, State.ZERO):
            self.state, self.ending = State.DONE, "nothing was switched on"
        elif self.state == State.DRIVE:
            self._damp("the process that drives the robot has ended", t)

    def _damp(self, reason: str, t: float) -> None:
        self.state, self.reason = State.DAMP, reason
        self._since = self._rested = t

    # ------------------------------------------------------------------ messages

    def heard(self, channel: str, data: bytes, t: float) -> None:
        """Take a message that arrived at time t [s]."""
        if channel != MOTOR_CTRL.channel:
            self.readings.take(channel, data, t)
        elif data not in self._own_set:
            self.readings.report["foreign"] += 1
            self._foreign = t

    def message(self, t: float) -> bytes | None:
        """Return the message to send at time t [s], or None."""
        if self.state == State.DRIVE and t - self._ordered > BEAT_TIMEOUT:
            self._damp(f"no order for {t - self._ordered:.2f} s", t)
        if self.state == State.DAMP:
            self._settle(t)
        elif self.state == State.ENDING and t - self._since > ZERO_TIME:
            self._end(t, "the robot was damped until it rested, and its motors are without torque")
        if self.state in (State.LISTEN, State.DONE):
            return None
        data = self._encode(t)
        self._remember(data)
        self.readings.report["sent"] += 1
        return data

    def report(self, t: float) -> bytes:
        """Return the report of the newest readings at time t [s], as bytes of REPORT."""
        report = self.readings.report
        report["t"], report["state"] = t, self.state
        return report.tobytes()

    def _remember(self, data: bytes) -> None:
        if len(self._own) == self._own.maxlen:
            oldest = self._own[0]
            self._own_set[oldest] -= 1
            if not self._own_set[oldest]:
                del self._own_set[oldest]
        self._own.append(data)
        self._own_set[data] = self._own_set.get(data, 0) + 1

    def _target(self, t: float) -> FloatArray:
        """Return the desired positions at time t (12,) [rad]: on the line from the last ones, where that is asked."""
        assert self._command is not None
        ramp = self._command.ramp
        share = 1.0 if ramp <= 0.0 else min(max((t - self._commanded) / ramp, 0.0), 1.0)
        return self._from + share * (self._command.q_des - self._from)

    def _encode(self, t: float) -> bytes:
        wiring, zeros = self._wiring, np.zeros(len(JOINTS))
        q = self.readings.report["q"]
        if self.state == State.DRIVE:
            assert self._command is not None
            return self._encode_drive(self._command, self._target(t), q)
        if self.state == State.DAMP:
            q_des = np.where(np.isfinite(q), q, 0.0)
            kd = np.full(len(JOINTS), self._kd)
            return MOTOR_CTRL.encode(q_des=wiring.wire_angles(q_des), kd_des=kd)
        return MOTOR_CTRL.encode(q_des=self._tag, kp_des=zeros)

    def _encode_drive(self, command: JointCommand, target: FloatArray, q: Any) -> bytes:
        wiring = self._wiring
        kp, kd = np.clip(command.kp, 0.0, wiring.kp_max), np.clip(command.kd, 0.0, wiring.kd_max)
        room = wiring.cut - wiring.cut_margin
        near = np.where(np.isfinite(q), np.clip(target, q - room, q + room), target)
        rest = kp * (target - near)
        by_velocity = kd >= _SMALL_KD
        dq_des = command.dq_des + np.where(by_velocity, rest / np.maximum(kd, _SMALL_KD), 0.0)
        tau = command.tau_ff + np.where(by_velocity, 0.0, rest)
        return MOTOR_CTRL.encode(
            q_des=wiring.wire_angles(near),
            qd_des=wiring.wire(np.clip(dq_des, -wiring.velocity_max, wiring.velocity_max)),
            kp_des=wiring.wire_gains(kp),
            kd_des=wiring.wire_gains(kd),
            tau_des=wiring.wire(np.clip(tau, -wiring.torque_max, wiring.torque_max)),
        )

    def _settle(self, t: float) -> None:
        """End the damping once the robot rests, or after the longest time for it."""
        report = self.readings.report
        answers = t - report["motors_came"] <= FRESH
        if not answers or np.max(np.abs(report["dq"])) >= self._limits.rest_speed:
            self._rested = t
        if t - self._rested >= self._limits.rest_seconds:
            self.state, self._since = State.ENDING, t
        elif t - self._since >= self._limits.damp_seconds:
            still = (
                f"the robot was damped for {self._limits.damp_seconds:g} s and still moves; its firmware damps it for "
                "another 2.5 s: hold it"
            )
            self._end(t, still if answers and not int(report["err_flag"]) & TIMED_OUT else UNREACHED)

    def _end(self, t: float, ending: str) -> None:
        self.state = State.DONE
        self.ending = OBEYS_ANOTHER if t - self._foreign < OBEYED else ending


OBEYED = 0.5
"""For how long the firmware follows a command [s]."""

OBEYS_ANOTHER = "another program still commands the robot, which obeys it: hold the robot, and end that program"
"""How a robot is left to which another program still sends."""

NOT_FOLLOWED = "it has followed no message of this program, and is as it was"
"""How a robot is left that never entered motor mode."""

UNREACHED = (
    "the robot does not answer: its firmware damps it by itself, from 0.5 s after the last message that reached it on; "
    "if it does not sink and lie still, switch it off"
)
"""How a robot is left that no message reaches."""

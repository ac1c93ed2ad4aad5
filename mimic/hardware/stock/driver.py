"""A stock CyberDog 2 behind mimic's `mimic.hardware.robot.driver.Driver`: messages at 500 Hz over LCM.

The firmware cuts a desired position that is far from the measured one, which takes away the torque of a push. So each
message holds the target inside that cut around the newest reading, and what was cut off travels in the desired
velocity, which the firmware does not cut:

    q_c = clip(q_des, q - cut, q + cut)        qd_des = dq_des + kp (q_des - q_c) / kd

The torque is that of the policy's law, up to the limit of qd_des.
"""

from __future__ import annotations

import random
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import FrameError, PlantError
from mimic.hardware.robot.board import ENTER_TIMEOUT, LISTEN, NO_ERR_FLAG, BoardDriver, Bus
from mimic.hardware.robot.board_wiring import PARTS
from mimic.hardware.robot.checks import Check
from mimic.hardware.robot.driver import NEVER, DriverSettings
from mimic.hardware.stock.lcm_bus import LcmBus, check_network
from mimic.hardware.stock.messages import (
    LEG_CONTROL_DATA,
    MOTOR_CTRL,
    MOTOR_CTRL_STATE,
    MOTOR_ERRORS,
    MOTOR_RUNNING,
    SPI_DATA,
    STATE_ESTIMATOR,
    TIMED_OUT,
    TYPES,
)
from mimic.hardware.stock.wiring import BoardWiring, load_board
from mimic.records import JOINTS, LEGS, FloatArray, JointCommand
from mimic.robot.description import RobotDescription, load_description

CLEAR_TIMEOUT = 8.0
"""Error 0x02 is cleared within this [s]; the firmware takes 2.5 s."""

ZERO_TIME = 0.2
"""How long zero messages are sent at the end [s]."""

OBEYED = 0.5
"""For how long the firmware follows a command [s]."""

_REMEMBERED = 2048
"""Own messages that are recognised when they come back by multicast: 4 s."""

_SMALL_KD = 0.05
"""Below this velocity gain the part that was cut off is sent as torque [N m s/rad]."""

OBEYS_ANOTHER = "another program still commands the robot, which obeys it: hold the robot, and end that program"
"""How a robot is left to which another program still sends."""

NOT_FOLLOWED = "it has followed no message of this program, and is as it was"
"""How a robot is left that never entered motor mode."""

UNREACHED = (
    "the robot does not answer: its firmware damps it by itself, from 0.5 s after the last message that reached it on; "
    "if it does not sink and lie still, switch it off"
)
"""How a robot is left that no message reaches."""

RESTED = "the robot was damped until it rested, and its motors are without torque"
"""How a robot should be left."""


class StockDriver(BoardDriver):
    """See `mimic.hardware.robot.driver.Driver`."""

    name = "the stock board"

    def __init__(
        self,
        bus: Bus,
        wiring: BoardWiring,
        description: RobotDescription,
        *,
        network: str = "",
        torque_limit: float | None = None,
    ) -> None:
        """Take an open bus; nothing is sent. See `mimic.hardware.robot.board.BoardDriver`."""
        super().__init__(bus, wiring, description, network=network, torque_limit=torque_limit)
        self._wiring = wiring
        self.commanded = NEVER
        """When the board last spoke of the commands that it gets [s]."""
        self._room = np.tile(wiring.limits.cut, len(LEGS)) - wiring.limits.cut_margin
        self._own: deque[bytes] = deque(maxlen=_REMEMBERED)
        self._own_set: dict[bytes, int] = {}
        # tells own zero messages from others'; NumPy's generators take 40 ms to load, while a robot must be damped
        self._tag = np.array([random.uniform(-0.05, 0.05) for _ in JOINTS])

    def heard(self, channel: str, data: bytes, t: float) -> None:
        """Take a message that arrived at time t [s].

        One that cannot be read, or has numbers outside of the wiring's ranges, is left out and counted.
        """
        report = self.report
        if channel == MOTOR_CTRL.channel:
            if data not in self._own_set:
                report["foreign"] += 1
                self._foreign = t
            return
        try:
            message = TYPES[channel].decode(data)
        except FrameError:
            report["errors"] += 1
            return
        report["heard"] = t
        if channel == SPI_DATA.channel:
            self._take_spi(message, t)
        elif channel == LEG_CONTROL_DATA.channel:
            self._take_legs(message)
        elif channel == STATE_ESTIMATOR.channel:
            quat = message["quat"].astype(np.float64)
            omega = message["omegaBody"].astype(np.float64)
            self._take_orientation(quat, omega, t)
        elif channel == MOTOR_CTRL_STATE.channel:
            self._take_state(message, t)

    def _take_state(self, message: Any, t: float) -> None:
        report = self.report
        interval = float(message["ctrl_topic_interval"])
        if not np.isfinite(interval):
            report["errors"] += 1
            return
        report["err_flag"] = int(message["err_flag"]) & 0xFFFF
        self.commanded = t
        report["gap"] = 1e-3 * interval

    def _take_spi(self, message: Any, t: float) -> None:
        wiring = self._wiring
        report = self.report

        def by_leg(name: str) -> Any:
            return np.stack([message[f"{name}_{part}"] for part in PARTS], axis=1).reshape(len(JOINTS))

        q = wiring.angles(by_leg("q"))
        dq = wiring.joints(by_leg("qd"))
        tau = wiring.joints(by_leg("tau"))
        temperature = wiring.temperature_unit * by_leg("tmp").astype(np.float64)[wiring.index]
        if self._take_motors(q, dq, tau, temperature, t):
            flags = message["flags"].astype(np.int64)[wiring.index] & 0xFFFFFFFF
            report["faults"] = flags & MOTOR_ERRORS
            report["running"] = flags >> 30 == MOTOR_RUNNING

    def _take_legs(self, message: Any) -> None:
        self.joint_messages += 1
        if not self.report["readings"]:
            self._take_joints(self._wiring.angles(message["q"]), self._wiring.joints(message["qd"]))

    asleep = (
        "is it switched on and awake, the cable in, this computer at the wiring's address, and developer access "
        "granted?"
    )

    def counts(self) -> dict[str, int]:
        """Return how many messages with joints and with orientations came so far."""
        return {"leg_control_data": self.joint_messages, "state_estimator": int(self.report["imu_count"])}

    def _own_notes(self) -> list[str]:
        """Return whether it is in motor mode."""
        err_flag = int(self.report["err_flag"])
        return ["not in motor mode" if err_flag == NO_ERR_FLAG else f"error flag {err_flag:#04x}"]

    def _own_checks(self) -> tuple[list[Check], str, list[Check]]:
        advice = (
            "if the robot stands by its own order, let it lie down, switch it off, and start it again lying: motor "
            "mode is entered from there only"
        )
        motors = "motor temperatures and errors are known once the first command was sent, and checked then"
        own = "its firmware damps it by itself 0.5 s after the last message"
        more = [
            Check("motors", "note", motors),
            Check("own timeout", "ok", own),
        ]
        return [_commands(self.report)], advice, more

    # ------------------------------------------------------------------ start

    def start(self, *, suspended: bool) -> None:
        """Enter motor mode, clear error 0x02, and check the robot once more; it is limp until then.

        Raises:
            PlantError: If the board does not follow, or something stands against moving.
        """
        began = self.now()
        self._await(
            lambda: self.commanded > began,
            ENTER_TIMEOUT,
            self._zero,
            "the robot does not enter motor mode, which it does only from lying, switched off or damped. It hears no "
            "other orders now: support it if it stands, switch it off, and start it again lying",
        )
        self._await(
            lambda: not int(self.report["err_flag"]) & TIMED_OUT and self.report["came"][0] > began,
            CLEAR_TIMEOUT,
            self._zero,
            "error 0x02 of the robot does not clear; switch it off and on. Is another program sending to it?",
        )
        self._await(  # the first message may come later than those of the motors
            lambda: self.now() - self.report["imu_came"] <= self._limits.imu_age,
            ENTER_TIMEOUT,
            self._zero,
            "the robot was not moved: no orientation comes from the robot",
        )
        problems = self._problems(suspended)
        if problems:
            raise PlantError(f"the robot was not moved: {'; '.join(problems)}")

    def abandon(self) -> str:
        """Return how a robot is left that never followed; empty where it is in motor mode and must be damped."""
        return NOT_FOLLOWED if self.report["err_flag"] == NO_ERR_FLAG else ""

    # ------------------------------------------------------------------ messages

    def _followed(self, command: JointCommand) -> tuple[FloatArray, ...]:
        q = self.report["q"]
        target = command.q_des
        room = self._room
        near = np.where(np.isfinite(q), np.clip(target, q - room, q + room), target)
        rest = command.kp * (target - near)
        by_velocity = command.kd >= _SMALL_KD
        dq_des = command.dq_des + np.where(by_velocity, rest / np.maximum(command.kd, _SMALL_KD), 0.0)
        return near, dq_des, command.tau_ff + np.where(by_velocity, 0.0, rest)

    def _send(self, q: FloatArray, dq: FloatArray, kp: FloatArray, kd: FloatArray, tau: FloatArray) -> None:
        wiring = self._wiring
        self._say(
            q_des=wiring.wire_angles(q),
            qd_des=wiring.wire(dq),
            kp_des=wiring.wire_gains(kp),
            kd_des=wiring.wire_gains(kd),
            tau_des=wiring.wire(tau),
        )

    def _zero(self) -> None:
        self._say(q_des=self._tag)

    def _say(self, **values: FloatArray) -> None:
        data = MOTOR_CTRL.encode(**values)
        if len(self._own) == self._own.maxlen:
            oldest = self._own[0]
            self._own_set[oldest] -= 1
            if not self._own_set[oldest]:
                del self._own_set[oldest]
        self._own.append(data)
        self._own_set[data] = self._own_set.get(data, 0) + 1
        self.report["sent"] += 1
        self._publish(MOTOR_CTRL.channel, data)

    @property
    def lost(self) -> bool:
        """False: who no longer hears the robot cannot know whether the robot hears, and its firmware damps it."""
        return False

    def end(self, *, since: float, rested: bool) -> str | None:
        """Send zero messages for a moment where the robot rests; return how it was left."""
        if rested and self.now() - since <= ZERO_TIME:
            self._zero()
            return None
        if self.now() - self._foreign < OBEYED:
            return OBEYS_ANOTHER
        if rested:
            return RESTED
        if not self._answers() or int(self.report["err_flag"]) & TIMED_OUT:
            return f"{UNREACHED} ({self.problem})" if self.problem else UNREACHED
        seconds = self._limits.damp_seconds
        return (
            f"the robot was damped for {seconds:g} s and still moves; its firmware damps it for another 2.5 s: hold it"
        )


def _commands(last: Any) -> Check:
    if last["foreign"]:
        text = f"another program commands this robot ({int(last['foreign'])} messages in {LISTEN:g} s); end it first"
        return Check("other programs", "stop", text)
    if last["err_flag"] == NO_ERR_FLAG:
        text = "none commands this robot; its firmware is not in motor mode yet"
        return Check("other programs", "ok", text)
    if not int(last["err_flag"]) & TIMED_OUT:
        text = "a program commanded this robot within the last half second; wait, and try again"
        return Check("other programs", "stop", text)
    return Check("other programs", "ok", "none commands this robot; it is in motor mode from before")


def open_stock_driver(settings: DriverSettings, *, quick: bool = False) -> StockDriver:
    """Open the driver of a stock robot; see `mimic.hardware.robot.opening.open_driver`."""
    wiring = load_board(None if settings.wiring is None else Path(settings.wiring))
    network, ttl = check_network(wiring, settings.interface)
    description = load_description(settings.robot)
    return StockDriver(LcmBus(wiring, ttl), wiring, description, network=network, torque_limit=settings.torque_limit)

"""A Unitree Go2 EDU behind mimic's `mimic.hardware.robot.driver.Driver`: messages at 500 Hz over DDS.

Its own sport mode must be released before it follows anybody else. What it does when no more messages come is not
published, so the last one it gets, again and again, is always damping.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import FrameError, PlantError
from mimic.hardware.go2.dds_bus import DdsBus, check_network
from mimic.hardware.go2.messages import (
    CHECK_MODE,
    LOWCMD,
    LOWSTATE,
    RELEASE_MODE,
    SPORT,
    STAND_DOWN,
    SWITCHER,
    Call,
    blank,
    decode,
    encode,
)
from mimic.hardware.go2.wiring import Go2Wiring, load_go2
from mimic.hardware.robot.board import ENTER_TIMEOUT, LISTEN, PERIOD, BoardDriver
from mimic.hardware.robot.checks import LYING_TOLERANCE, Check, CheckOptions
from mimic.hardware.robot.driver import DriverSettings
from mimic.records import JOINTS, FloatArray, JointCommand
from mimic.robot.description import RobotDescription, load_description

ANSWER = 0.5
"""A service answers within this, or it is asked once more [s]."""

ASKED = 3
"""How often a service is asked."""

LIES_WITHIN = 8.0
"""The robot lies down by its own sport mode within this [s]."""

RELEASES = 3
"""How often the sport mode is released until it is gone; Unitree's examples do it until then."""

SERVO = 1
"""Mode of a motor that follows commands. Source: Unitree's low-level examples."""

DAMPED_BEFORE = 0.3
"""For how long a robot is damped before it is driven, and other programs are looked for meanwhile [s]."""

LAST_DAMPING = 0.5
"""For how long damping is sent to a robot that already rests [s]: messages may be lost."""

GONE_ON = "another program still commands the robot: hold the robot, and end that program"
"""How a robot is left to which another program still sends."""

UNREACHED = (
    "the robot does not answer, or not to damping, and what it does without messages is not published: it may hold its "
    "last command; hold it, and switch it off"
)
"""How a robot is left that no message reaches."""

RESTED = "the robot was damped until it rested, and damping is the last it was sent; restart it to use its own modes"
"""How a robot should be left."""

HOLDS = 2.0
"""A joint that rests with more torque than this still follows an older command [N m]."""

OWN_MODE = (
    "its own mode {mode!r} is active again, as by its remote control, and drives the robot: lay it down with that, or "
    "hold it and switch it off"
)
"""How a robot is left that is driven by its own mode."""

MODE_EVERY = 0.25
"""How often a robot that is driven is asked for its own mode [s]."""

NOT_DRIVEN = "it was sent no command"
"""How a robot is left whose start failed before the first message."""


class Go2Driver(BoardDriver):
    """See `mimic.hardware.robot.driver.Driver`."""

    name = "a Go2"
    usual_rate = 400.0

    def __init__(
        self,
        bus: DdsBus,
        wiring: Go2Wiring,
        description: RobotDescription,
        *,
        network: str = "",
        torque_limit: float | None = None,
    ) -> None:
        """Take an open bus; nothing is sent. See `mimic.hardware.robot.board.BoardDriver`."""
        super().__init__(bus, wiring, description, network=network, torque_limit=torque_limit)
        self._dds = bus
        self._wiring = wiring
        self.mode: str | None = None
        """Name of its own active mode as it said last, empty for none; None if it does not say."""
        self._mode_asked = -np.inf
        self._robot: int | None = None
        self._strangers: set[int] = set()
        """Publisher of the readings that are taken, and of those that are left out."""
        self._calls = itertools.count(1)
        self._answers_to = dict[int, Call]()
        self._lost = np.zeros(len(JOINTS), dtype=np.int64)
        self._modes = np.zeros(len(JOINTS), dtype=np.int64)
        self._says_mode = self._sent = self._released = False
        self._message = blank(LOWCMD)
        self._message["motor_cmd"]["mode"][: len(JOINTS)] = SERVO

    # ------------------------------------------------------------------ readings

    def heard(self, channel: str, data: bytes, t: float) -> None:
        """Take a message that arrived at time t [s]."""
        if channel == LOWCMD:
            self.report["foreign"] += 1
            self._foreign = t
            return
        try:
            if channel == LOWSTATE:
                if self._is_ours(self._dds.source):
                    self._take(decode(LOWSTATE, data), t)
            else:
                call = Call.from_bytes(data, answer=True)
                self._answers_to[call.id] = call
                if call.api == CHECK_MODE and call.code == 0:
                    self.mode = call.name()
        except FrameError:
            self.report["errors"] += 1

    def _is_ours(self, source: int) -> bool:
        """Return whether a publisher is the robot: the first that spoke."""
        self._robot = source if self._robot is None else self._robot
        if source != self._robot:
            self._strangers.add(source)
        return source == self._robot

    def _take(self, message: Any, t: float) -> None:
        wiring = self._wiring
        report = self.report
        motors = message["motor_state"][: len(JOINTS)]
        report["heard"] = t
        self.joint_messages += 1
        came = np.array(report["came"])
        lost = motors["lost"].astype(np.int64)[wiring.index]
        taken = self._take_motors(
            wiring.angles(motors["q"]),
            wiring.joints(motors["dq"]),
            wiring.joints(motors["tau_est"]),
            motors["temperature"].astype(np.float64)[wiring.index],
            t,
        )
        if taken:
            first = not np.isfinite(came).any()
            silent = (lost > self._lost) & (not first)
            self._lost = lost
            report["came"] = np.where(silent, came, t)  # the robot did not hear this motor itself
            serves = motors["mode"][wiring.index] == SERVO
            report["running"] = serves if self._says_mode else True
            report["voltage"] = float(message["power_v"]) if message["power_v"] > 1.0 else np.nan
        imu = message["imu_state"]
        self._take_orientation(imu["quaternion"].astype(np.float64), imu["gyroscope"].astype(np.float64), t)
        self._modes = motors["mode"][wiring.index]

    def counts(self) -> dict[str, int]:
        """Return how many messages came so far."""
        return {LOWSTATE: self.joint_messages, "orientation": int(self.report["imu_count"])}

    # ------------------------------------------------------------------ its own mode, and other programs

    def _ask(self, service: str, api: int) -> Call | None:
        """Ask a service of the robot; None if it does not answer."""
        for _ in range(ASKED):
            number = next(self._calls)
            self._publish(f"{service}request", Call(id=number, api=api).to_bytes())
            end = self.now() + ANSWER
            while self.now() < end:
                self.listen(self.now() + PERIOD)
                if number in self._answers_to:
                    return self._answers_to.pop(number)
        return None

    def ask_mode(self) -> str | None:
        """Ask for its own active mode, and return it: empty for none, None if it does not say."""
        self.mode = ""
        if self._wiring.motion_switcher:
            answer = self._ask(SWITCHER, CHECK_MODE)
            self.mode = None if answer is None or answer.code != 0 else answer.name()
        return self.mode

    def _ask_again(self) -> None:
        """Ask for its own mode now and then, without waiting for the answer."""
        if self._wiring.motion_switcher and self.now() - self._mode_asked >= MODE_EVERY:
            self._mode_asked = self.now()
            self._answers_to.clear()
            self._publish(f"{SWITCHER}request", Call(id=next(self._calls), api=CHECK_MODE).to_bytes())

    def drive(self, command: JointCommand) -> None:
        """Send a command, and ask for its own mode now and then.

        Raises:
            FrameError: If its own mode drives it, or the command cannot be sent.
        """
        if self.mode:
            raise FrameError(f"its own mode {self.mode!r} is active again, and drives the robot")
        super().drive(command)
        self._ask_again()

    def _own_notes(self) -> list[str]:
        """Return what is known of its own mode."""
        others = self._dds.others()
        return [f"commands may come from {', '.join(others)}"] if others else ["nobody else may command it"]

    def _own_checks(self) -> tuple[list[Check], str, list[Check]]:
        self.ask_mode()
        found = self._robots()
        text = "none commands this robot"
        others = self._dds.others()
        came = int(self.report["foreign"])
        if self.mode is None:
            text = (
                "its motion switcher does not answer, so its own sport mode may command it: restart it, and wait until "
                "it has stood up; is it a Go2 EDU? No other one obeys"
            )
            found.append(Check("own mode", "stop", text))
        elif self.mode:
            text = f"its own mode {self.mode!r} is active: it lies down and is released when you begin"
            found.append(Check("own mode", "note", text))
        else:
            found.append(Check("own mode", "ok", "none is active"))
        if others or came:
            text = f"{came} commands came; who may send: {', '.join(others) or 'unknown'}"
            expected = bool(self.mode)  # the robot's own mode commands it until it is released
            text += "; looked at again once its own mode is released" if expected else "; end that program first"
            found.append(Check("other programs", "note" if expected else "stop", text))
        else:
            found.append(Check("other programs", "ok", "none commands this robot"))
        own = "not published: it is expected to hold its last command, so mimic never falls silent before damping"
        return found, "lay it down with its remote control", [Check("own timeout", "note", own)]

    def _robots(self) -> list[Check]:
        """Return what stands against it where more than one robot speaks: each would obey the commands."""
        robots = self._dds.others(LOWSTATE)
        if len(robots) < 2 and not self._strangers:
            return []
        text = f"more than one sends rt/lowstate on this network ({'; '.join(robots)}), and all of them would obey"
        return [Check("robot", "stop", f"{text}: leave one robot switched on")]

    def checks(self, options: CheckOptions) -> list[Check]:
        """Check a robot by listening to it and asking for its own mode; nothing moves."""
        self._robot = None
        self._strangers.clear()
        found = super().checks(options)
        if not self.mode:
            return found
        later = ("pose", "IMU and legs")  # it lies down first
        return [
            replace(check, verdict="note", text=f"{check.text}; looked at again once it lies")
            if check.name in later and check.verdict == "stop"
            else check
            for check in found
        ]

    # ------------------------------------------------------------------ start

    def start(self, *, suspended: bool) -> None:
        """Release the robot's own mode, look for other programs, damp it, and check it once more.

        Raises:
            PlantError: If it does not follow, or something stands against moving.
        """
        self._await(
            lambda: self._dds.ready(LOWCMD),
            ENTER_TIMEOUT,
            lambda: None,
            "nobody on the robot's network hears commands on rt/lowcmd; only a Go2 EDU does",
        )
        self._release(suspended)
        self.report["foreign"] = 0
        self.listen(self.now() + LISTEN)
        if self.report["foreign"]:
            raise PlantError(
                f"the robot was not moved: {int(self.report['foreign'])} commands came of another program "
                f"({', '.join(self._dds.others()) or 'unknown'}); end it first"
            )
        began = self.now()
        self._await(
            lambda: self.now() - began >= DAMPED_BEFORE, 2.0 * DAMPED_BEFORE, self.damp, "the clock stands still"
        )
        self._says_mode = bool((self._modes == SERVO).any())
        problems = self._problems(suspended)
        if self._says_mode:
            problems += [f"motor {JOINTS[j]} does not switch on" for j in np.flatnonzero(self._modes != SERVO)]
        if not self._answers():
            problems.append("it no longer answers")
        if problems:
            raise PlantError(f"the robot was not moved: {'; '.join(problems)}")

    def _release(self, suspended: bool) -> None:
        """Let the robot lie down and give up its own mode.

        Raises:
            PlantError: If it does not.
        """
        for _ in range(RELEASES):
            self.ask_mode()
            if self.mode is None:
                raise PlantError("the robot was not moved: its motion switcher does not answer; restart the robot")
            if not self.mode:
                return
            if self._ask(SPORT, STAND_DOWN) is None:
                raise PlantError(
                    "the robot was not moved: its sport service does not answer; lay it down with its remote control"
                )
            rested = self.now()
            end = self.now() + LIES_WITHIN
            while self.now() - rested < self._limits.rest_seconds:
                self.listen(self.now() + PERIOD)
                away = np.abs(self.report["q"] - self._description.poses["lie"]).max()
                if self.speed() > self._limits.rest_speed or (away > LYING_TOLERANCE and not suspended):
                    rested = self.now()
                if self.now() > end:
                    raise PlantError("the robot did not lie down by itself; lay it down with its remote control")
            if self._ask(SWITCHER, RELEASE_MODE) is None:
                raise PlantError("the robot lies in its own mode, which was not released; restart it")
            self._released = True
            self.listen(self.now() + 2.0 * ANSWER)
        raise PlantError(f"the robot lies, and its own mode {self.mode!r} stays active; switch it off in its app")

    def abandon(self) -> str:
        """Return how a robot is left that was sent no command; empty where it must be damped."""
        if self._sent:
            return ""
        return f"{NOT_DRIVEN}; its own mode was released: restart it" if self._released else NOT_DRIVEN

    # ------------------------------------------------------------------ messages

    def _send(self, q: FloatArray, dq: FloatArray, kp: FloatArray, kd: FloatArray, tau: FloatArray) -> None:
        wiring = self._wiring
        motors = self._message["motor_cmd"][: len(JOINTS)]
        motors["q"] = wiring.wire_angles(q)
        motors["dq"] = wiring.wire(dq)
        motors["tau"] = wiring.wire(tau)
        motors["kp"] = wiring.wire_gains(kp)
        motors["kd"] = wiring.wire_gains(kd)
        self._sent = True
        self.report["sent"] += 1
        self._publish(LOWCMD, encode(LOWCMD, self._message))

    @property
    def lost(self) -> bool:
        """Whether the robot no longer answers: it may hold its last command, and is damped for as long as possible."""
        return not self._answers()

    def end(self, *, since: float, rested: bool) -> str | None:
        """Send damping for a moment; return how the robot was left."""
        if self.now() - since <= LAST_DAMPING:
            self._ask_again()
            self.damp()
            return None
        if self._strangers:
            return f"{self._left_as(rested)}; another robot that speaks on this network was left out"
        return self._left_as(rested)

    def _left_as(self, rested: bool) -> str:
        if self.mode:
            return OWN_MODE.format(mode=self.mode)
        if self.now() - self._foreign < LAST_DAMPING:
            return GONE_ON
        if rested and np.abs(self.report["tau"]).max() <= HOLDS:
            return RESTED
        if rested or not self._answers():
            return f"{UNREACHED} ({self.problem})" if self.problem else UNREACHED
        seconds = self._limits.damp_seconds
        return f"the robot was damped for {seconds:g} s and still moves; damping is the last it was sent: hold it"


def open_go2_driver(settings: DriverSettings, *, quick: bool = False) -> Go2Driver:
    """Open the driver of a Go2; see `mimic.hardware.robot.opening.open_driver`."""
    wiring = load_go2(None if settings.wiring is None else Path(settings.wiring))
    interface = check_network(wiring, settings.interface)
    description = load_description(settings.robot)
    network = "messages stay on this computer" if interface == "lo" else f"messages leave through {interface}"
    return Go2Driver(
        DdsBus(wiring, interface), wiring, description, network=network, torque_limit=settings.torque_limit
    )

"""What all motion boards have in common: messages at 500 Hz, readings that count from when they came, a pre-flight that
listens, and a second check before anything moves.
"""

from __future__ import annotations

import fcntl
import select
import socket
import struct
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mimic.errors import BusError, ConfigError, FrameError, PlantError
from mimic.hardware.robot.board_wiring import JointWiring
from mimic.hardware.robot.checks import HOT, LYING_TOLERANCE, Check, CheckOptions, imu_checks, pose_check
from mimic.hardware.robot.driver import NEVER, SILENT, no_report
from mimic.records import JOINTS, FloatArray, JointCommand
from mimic.robot.description import RobotDescription

_SIOCGIFADDR = 0x8915
"""Question to the kernel: the address of a network interface. Source: Linux, include/uapi/linux/sockios.h."""
_SIOCGIFFLAGS = 0x8913
"""Question to the kernel: its flags."""
_IFF_UP = 1
"""Flag of an interface that is up. Source: Linux, include/uapi/linux/if.h."""

PERIOD = 0.002
"""Time between two messages [s]: the firmware's own cycle."""

ENTER_TIMEOUT = 2.0
"""A board does what the first messages ask for within this [s]."""

START_TILT = 0.3
"""Largest tilt of the robot when it is taken over [rad]."""

FRESH = 0.05
"""A reading at most this old shows that the robot answers [s]."""

NO_ERR_FLAG = -1
"""err_flag before the first word of the board about it."""

LISTEN = 1.5
"""How long to listen [s]: three times as long as the firmware waits for another command."""

LOWEST_RATE = 30.0
"""Messages a second that a robot sends at least [Hz]: a stock one 50 before the first command, 500 afterwards."""

FLOOD = 0.02
"""A flood of messages must not stop the sending for longer than this [s]."""


def address_of(interface: str) -> str | None:
    """Return the IPv4 address of a network interface, or None where it has none.

    Raises:
        ConfigError: If there is no such interface.
        BusError: If it is down.
    """
    names = [name for _, name in socket.if_nameindex()]
    if interface not in names:
        raise ConfigError(f"there is no network interface {interface!r}; this computer has {', '.join(names)}")
    question = struct.pack("256s", interface.encode()[:15])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        (flags,) = struct.unpack_from("<H", fcntl.ioctl(sock.fileno(), _SIOCGIFFLAGS, question), 16)
        if not flags & _IFF_UP:
            raise BusError(f"{interface} is down; to bring it up: sudo ip link set {interface} up")
        try:
            answer = fcntl.ioctl(sock.fileno(), _SIOCGIFADDR, question)
        except OSError:
            return None
    return socket.inet_ntoa(answer[20:24])


class Bus:
    """The network of a board: hands every message on with the time at which it was read."""

    heard: Callable[[str, bytes, float], None]
    """Called with channel or topic, bytes and time [s] of each message."""
    source = 0
    """Who sent the message that is being handed on, where the network says it."""
    _sources: Mapping[int, Callable[[], object]]
    """Descriptor -> what hands on the messages that came there."""

    def now(self) -> float:
        """Return the time of the messages [s]: the monotonic clock."""
        return time.monotonic()

    def publish(self, channel: str, data: bytes) -> None:
        """Send a message.

        Raises:
            OSError: If the network does not take it.
        """
        raise NotImplementedError

    def listen(self, until: float, wake: int | None = None) -> None:
        """Hand on messages until a time [s]; return early where something is to be read from a descriptor."""
        files = [*self._sources, *([] if wake is None else [wake])]
        while True:
            left = until - self.now()
            ready, _, _ = select.select(files, [], [], max(left, 0.0))
            for file in ready:
                if file in self._sources:
                    self._sources[file]()
            if wake in ready or (left <= 0.0 and not ready) or left < -FLOOD:
                return

    def close(self) -> None:
        """Let go of the network."""
        raise NotImplementedError


class BoardDriver:
    """What a `mimic.hardware.robot.driver.Driver` of any board does; `start`, `_send` and `end` are its own."""

    period = PERIOD
    repeats = True
    name: str
    """In messages."""
    usual_rate = LOWEST_RATE
    """Fewer messages a second are mentioned before the robot moves [Hz]."""

    def __init__(
        self,
        bus: Bus,
        wiring: JointWiring,
        description: RobotDescription,
        *,
        network: str,
        torque_limit: float | None,
    ) -> None:
        """Take an open bus; nothing is sent.

        Args:
            bus: The network.
            wiring: Of the board.
            description: The robot; its largest velocity gain damps.
            network: How messages leave this computer, in words.
            torque_limit: Refused if below the motors' own: a board has no such limit.

        Raises:
            PlantError: If a torque limit is asked for.
        """
        if torque_limit is not None and torque_limit < description.torque_max.max():
            raise PlantError(
                f"{self.name} has no torque limit to set; leave out --torque-limit (given: {torque_limit:g} N m)"
            )
        self.bus = bus
        self.network = network
        self.problem = ""
        bus.heard = self.heard
        self._description = description
        self._limits = description.safety
        self._order = wiring
        self._kd = min(description.kd_max, wiring.limits.kd)
        self._foreign = NEVER
        self.report: Any = no_report()
        """Newest readings; a scalar of REPORT. They count from when their messages came: the robot's own clock may be
        set at any time, and is not used."""
        self.report["err_flag"] = NO_ERR_FLAG
        self.joint_messages = 0
        """Messages with joint angles so far."""

    def now(self) -> float:
        """Return the time of the messages [s]."""
        return self.bus.now()

    def heard(self, channel: str, data: bytes, t: float) -> None:
        """Take a message that arrived at time t [s]."""
        raise NotImplementedError

    def _take_joints(self, q: FloatArray, dq: FloatArray) -> bool:
        """Take angles (12,) [rad] and velocities (12,) [rad/s], if joints can have them; else count an error."""
        ranges = self._order.readings
        if not bool(np.all(np.abs(q) <= ranges.angle) and np.all(np.abs(dq) <= ranges.velocity)):  # false for NaN
            self.report["errors"] += 1
            return False
        self.report["q"] = q
        self.report["dq"] = dq
        return True

    def _take_motors(self, q: FloatArray, dq: FloatArray, tau: FloatArray, temperature: FloatArray, t: float) -> bool:
        """Take a full set of readings (12,) that came at time t [s], if motors can have them; else count an error."""
        report = self.report
        (coldest, warmest) = self._order.readings.temperature
        if not (
            np.all(np.abs(tau) <= self._order.readings.torque)
            and temperature.min() >= coldest
            and temperature.max() <= warmest
        ):
            report["errors"] += 1
            return False
        if not self._take_joints(q, dq):
            return False
        if report["readings"]:
            report["round_trip"] = t - float(report["came"].max())
        report["tau"] = tau
        report["temperature"] = temperature
        report["came"] = t
        report["readings"] += 1
        return True

    def _take_orientation(self, quat: FloatArray, omega: FloatArray, t: float) -> None:
        """Take a quaternion in the board's order (4,) and a rate of turn (3,) [rad/s], or count an error."""
        report = self.report
        quat = quat[self._order.wxyz]
        length = float(np.linalg.norm(quat))
        if not (np.all(np.abs(omega) <= self._order.readings.turn_rate) and abs(length - 1.0) < 0.05):
            report["errors"] += 1
            return
        quat = quat / length
        if not (np.array_equal(quat, report["quat_WB"]) and np.array_equal(omega, report["omega_B"])):
            report["imu_changed"] = t
        report["quat_WB"] = quat
        report["omega_B"] = omega
        report["imu_came"] = t
        report["imu_count"] += 1

    def listen(self, until: float, wake: int | None = None) -> bool:
        """Take what comes until a time [s], or until something is to be read from a descriptor."""
        self.bus.listen(until, wake)
        return False

    def speed(self) -> float:
        """Return how fast the fastest joint moves [rad/s]; infinite where the robot does not answer."""
        return float(np.max(np.abs(self.report["dq"]))) if self._answers() else float("inf")

    def _answers(self) -> bool:
        return bool(self.now() - self.report["came"].max() <= FRESH)

    def close(self) -> None:
        """Let go of the network."""
        self.bus.close()

    def drive(self, command: JointCommand) -> None:
        """Send a command; a message holds those of all joints.

        Raises:
            FrameError: If it is not finite, or has gains that the board does not take.
        """
        if not np.isfinite([command.q_des, command.dq_des, command.kp, command.kd, command.tau_ff]).all():
            raise FrameError("a command holds numbers that are not finite")
        limits = self._order.limits
        report = self.report
        if command.kp.max() > limits.kp or command.kd.max() > limits.kd:
            raise FrameError(
                f"a command has Kp {command.kp.max():g} and Kd {command.kd.max():g}; {self.name} takes up to "
                f"{limits.kp:g} and {limits.kd:g}"
            )
        q, dq, tau = self._followed(command)
        dq, tau = (np.clip(v, -most, most) for v, most in ((dq, limits.velocity), (tau, limits.torque)))
        self._send(q, dq, command.kp, command.kd, tau)
        report["q_sent"] = command.q_des
        report["kp_sent"] = command.kp
        report["kd_sent"] = command.kd

    def _followed(self, command: JointCommand) -> tuple[FloatArray, ...]:
        """Return desired angles, velocities and torques (12,) that the board follows as the command means it."""
        return command.q_des, command.dq_des, command.tau_ff

    def damp(self) -> None:
        """Send damping."""
        report = self.report
        zero = np.zeros(len(JOINTS))
        q = np.where(np.isfinite(report["q"]), report["q"], 0.0)
        self._send(q, zero, zero, np.full(len(JOINTS), self._kd), zero)
        report["q_sent"] = q
        report["kp_sent"] = zero
        report["kd_sent"] = self._kd

    def _send(self, q: FloatArray, dq: FloatArray, kp: FloatArray, kd: FloatArray, tau: FloatArray) -> None:
        """Send a message with these values of all joints (12,)."""
        raise NotImplementedError

    def _await(self, reached: Callable[[], bool], timeout: float, send: Callable[[], None], problem: str) -> None:
        """Send messages until something is reached.

        Raises:
            PlantError: If that takes too long.
        """
        end = self.now() + timeout
        while self.now() < end:
            send()
            self.listen(self.now() + PERIOD)
            if reached():
                return
        raise PlantError(problem)

    def _publish(self, channel: str, data: bytes) -> None:
        """Send a message; where the network does not take it, ``problem`` says so."""
        try:
            self.bus.publish(channel, data)
        except OSError as reason:
            self.problem = f"the network takes no messages: {reason.strerror or reason}"

    def _problems(self, suspended: bool) -> list[str]:
        """Return what stands against moving of what is known only in motor mode, or may have changed meanwhile."""
        report = self.report
        found = []
        found += [
            f"motor {JOINTS[j]} reports the error {int(bits):#x}" for j, bits in enumerate(report["faults"]) if bits
        ]
        warmest = int(np.argmax(report["temperature"]))
        if report["temperature"][warmest] >= HOT:
            found.append(f"motor {JOINTS[warmest]} is at {report['temperature'][warmest]:.0f} degC; let it cool")
        if report["foreign"]:
            found.append("another program commands this robot")
        if not suspended:
            _, x, y, _ = report["quat_WB"]
            if 1.0 - 2.0 * (x * x + y * y) < np.cos(START_TILT):
                found.append("the robot is tilted")
            away = np.abs(report["q"] - self._description.poses["lie"])
            worst = int(np.argmax(away))
            if away[worst] > LYING_TOLERANCE:
                found.append(f"{JOINTS[worst]} is {np.rad2deg(away[worst]):.0f} deg from the lying pose")
        return found

    # ------------------------------------------------------------------ pre-flight

    def counts(self) -> dict[str, int]:
        """Return how many messages of each kind came so far."""
        raise NotImplementedError

    def notes(self) -> list[str]:
        """Return what there is to say of the robot beside its readings."""
        report = self.report
        notes = self._own_notes() if self.now() - report["heard"] < SILENT else ["no message comes from the robot"]
        if report["errors"]:
            notes.append(f"{int(report['errors'])} messages made no sense")
        if report["foreign"]:
            notes.append(f"{int(report['foreign'])} commands of other programs")
        return notes

    def _own_notes(self) -> list[str]:
        """Return what there is to say of a robot that answers."""
        raise NotImplementedError

    def _own_checks(self) -> tuple[list[Check], str, list[Check]]:
        """Return what is found of commands, what to do about a robot that does not lie, and what else to say."""
        raise NotImplementedError

    asleep = "is it switched on, the cable in, and this computer at the wiring's address?"
    """What to look at if nothing comes."""

    def checks(self, options: CheckOptions) -> list[Check]:
        """Check a robot by listening to it; nothing moves."""
        description = self._description
        suspended = options.suspended
        self.listen(self.now() + 0.02)
        begin = self.now()
        before = self.counts()
        self.listen(begin + LISTEN)
        last = self.report
        seconds = self.now() - begin
        found = [Check("network", "ok", self.network)]
        if last["heard"] < begin:
            text = f"no message came from the robot; {self.asleep}"
            return [*found, Check("messages", "stop", text)]
        rates = {name: (count - before[name]) / seconds for name, count in self.counts().items()}
        commands, advice, more = self._own_checks()
        found += [self._messages(rates, int(last["errors"])), *commands]
        q = np.array(last["q"])
        if np.isnan(q).any():
            return [*found, Check("pose", "stop", "the robot sends no joint angles")]
        found.append(pose_check(q, description, LYING_TOLERANCE, suspended=suspended, advice=advice))
        if last["imu_came"] == NEVER:
            found.append(Check("IMU", "stop", "the robot sends no orientation"))
        else:
            quat = np.array(last["quat_WB"])
            omega = np.array(last["omega_B"])
            text = f"turns at {np.linalg.norm(omega):.3f} rad/s"
            found += imu_checks(quat, omega, q, description, suspended=suspended, text=text)
        return [*found, *more]

    def _messages(self, rates: dict[str, float], errors: int) -> Check:
        text = ", ".join(f"{name} {rate:.0f} Hz" for name, rate in rates.items())
        if errors:
            text += f"; {errors} could not be read: the firmware may define its messages differently"
            return Check("messages", "stop", text)
        if min(rates.values()) < LOWEST_RATE:
            return Check("messages", "stop", f"{text}; expected at least {LOWEST_RATE:g} Hz of each")
        if min(rates.values()) < self.usual_rate:
            return Check("messages", "note", f"{text}; more than {self.usual_rate:g} Hz are usual")
        return Check("messages", "ok", text)

"""An emulated Unitree Go2: its low-level interface and the two services that release it, on an emulated body.

What Unitree publishes of the interface is followed: checksum, header, wire order, modes, services. What the firmware
does when no more commands come is not published. Here it holds the last one, which is the worst it can do, or damps
after half a second (``can_timeout``); either way a silence while motors are driven is counted.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

import numpy as np

from mimic.emulator.boards.board_base import MESSAGE_FAULTS, NetworkBoard
from mimic.emulator.faults import MISWIRED
from mimic.emulator.motor import FREE, Drive
from mimic.errors import FrameError
from mimic.geometry import rotation_from_quat, rpy_from_quat
from mimic.hardware.go2.dds_bus import TO_ROBOT
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
from mimic.hardware.go2.wiring import Go2Wiring
from mimic.records import JOINTS

TIMEOUT = 0.5
"""Without a command for this long it counts as a silence [s]; assumed."""

HOLD = Drive(kp=60.0, kd=5.0)
"""How its own mode holds the robot where it lies."""

SAFE = Drive(kd=3.0)
"""What motors do after a silence, where they do something."""

SUPPLY = 29.0
"""[V]"""

FAULTS = (
    "motor_dead",
    "motor_hot",
    *MESSAGE_FAULTS,
    *MISWIRED,
    "imu_frozen",
    "imu_tilted",
    "bus_off",
    "mode_refused",
    "mode_returns",
    "service_silent",
)
"""Kinds of faults that it has."""

UNKNOWN_API = 3203
"""Code of an answer to something that a service does not know. Source: unitree_sdk2_python, rpc/internal.py."""


class EmulatedGo2(NetworkBoard[Go2Wiring]):
    """A Go2 from power-up on, lying or suspended, in its own mode."""

    name = "the Go2"
    hears = TO_ROBOT
    kinds = FAULTS

    mode = "normal"
    """Name of its own active mode."""
    refused = 0
    """Commands with a wrong checksum or header; ignored."""
    fights = 0
    """Commands while its own mode was active; ignored here, a robot obeys both."""
    silences = 0
    """How often no command came for TIMEOUT while motors were driven."""
    applied: Sequence[Drive] = (FREE,) * len(JOINTS)
    """What each motor does, in joint order."""
    _modes = np.zeros(len(JOINTS), dtype=np.uint8)
    _lost = np.zeros(len(JOINTS), dtype=np.uint32)
    _came = math.inf
    _arrived = math.inf
    """When the newest command came [s]; infinite before the first."""

    # ------------------------------------------------------------------ what it hears

    def _cycle(self) -> None:
        self.body.advance(self.now)
        self._arrived_by_now(self._heard)
        if not self.mode and self._has("mode_returns"):
            self.mode = "normal"
            self.applied = [FREE] * len(JOINTS)
            self._placed = self.body.joints(self.now)[0]
            self.events.append((self.now, "its own mode is active again"))
        if self.driven():
            self._count_age(self.now - self._arrived)
        if self.now - self._came > TIMEOUT:
            self._came = math.inf
            if self.driven():
                self.silences += 1
                self.events.append((self.now, f"no command for {TIMEOUT:g} s: {', '.join(self.driven())} driven"))
            if self._settings.can_timeout:
                self.applied = [SAFE] * len(JOINTS)
        dead = self._joints_with("motor_dead")
        for joint, drive in enumerate(self.applied):
            if self.mode:
                drive = HOLD._replace(q=float(self._placed[joint]))
            self._drive(joint, FREE if joint in dead else drive)
        self._lost = self._lost + np.array([joint in dead for joint in range(len(JOINTS))])
        self._speak(dead)

    def _heard(self, topic: str, data: bytes, at: float) -> None:
        if topic == LOWCMD:
            self._commanded(data, at)
            return
        if self._has("service_silent"):
            return
        try:
            call = Call.from_bytes(data, answer=False)
        except FrameError:
            return
        service = SWITCHER if topic.startswith(SWITCHER) else SPORT
        code = 0
        text = ""
        if (service, call.api) == (SWITCHER, CHECK_MODE):
            text = json.dumps({"form": "0", "name": self.mode})
        elif (service, call.api) == (SWITCHER, RELEASE_MODE):
            if not self._has("mode_refused"):
                self.mode = ""
                self.events.append((self.now, "its own mode was released"))
        elif (service, call.api) != (SPORT, STAND_DOWN):
            code = UNKNOWN_API
        self._publish(f"{service}response", Call(id=call.id, api=call.api, text=text, code=code).to_bytes())

    def _commanded(self, data: bytes, at: float) -> None:
        try:
            message = decode(LOWCMD, data)
        except FrameError:
            self.refused += 1
            return
        if not message["crc"] or message["head"].tolist() != [0xFE, 0xEF] or message["level_flag"] != 0xFF:
            self.refused += 1
            return
        if self.mode:
            self.fights += 1
            return
        if not self._modes.any():
            self._began()
        self._came = self._arrived = at
        wiring = self._wiring
        motors = message["motor_cmd"][: len(JOINTS)]
        self._modes = motors["mode"][wiring.index]
        q = wiring.angles(motors["q"])
        dq = wiring.joints(motors["dq"])
        tau = wiring.joints(motors["tau"])
        kp = motors["kp"][wiring.index].astype(float)
        kd = motors["kd"][wiring.index].astype(float)
        self.applied = [
            Drive(*numbers) if on else FREE
            for on, numbers in zip(self._modes, np.stack([kp, kd, q, dq, tau], axis=1).tolist(), strict=True)
        ]

    def driven(self) -> tuple[str, ...]:
        """Return the joints with stiffness or a torque of a command."""
        return tuple(name for name, drive in zip(JOINTS, self.applied, strict=True) if drive.drives)

    # ------------------------------------------------------------------ what it says

    def _speak(self, dead: dict[int, float]) -> None:
        wiring = self._wiring
        message = blank(LOWSTATE)
        (q, dq, tau) = self.body.joints(self.now)
        motors = message["motor_state"][: len(JOINTS)]
        motors["q"] = wiring.wire_angles(q)
        motors["dq"] = wiring.wire(dq)
        motors["tau_est"] = wiring.wire(tau)
        motors["temperature"][wiring.index] = np.clip(np.round(self._warm()), 0, 255)
        modes = self._modes.copy()
        modes[list(dead)] = 0
        motors["mode"][wiring.index] = modes
        motors["lost"][wiring.index] = self._lost
        quat, omega, _ = self.orientation()
        imu = message["imu_state"]
        imu["quaternion"][wiring.wxyz] = quat
        imu["gyroscope"] = omega
        imu["rpy"] = rpy_from_quat(np.asarray(quat))
        imu["accelerometer"] = rotation_from_quat(quat).T @ np.array([0.0, 0.0, 9.81])
        message["tick"] = round(1e3 * self.now)
        message["power_v"] = SUPPLY
        self._publish(LOWSTATE, encode(LOWSTATE, message))

    def line(self) -> str:
        """Return a line of what has happened so far."""
        return f"{self.commands} messages, {self.refused} of them with a wrong checksum, {self.ages()}"

    def figures(self) -> dict[str, str]:
        """Return rows of a table of what has happened."""
        mode = f"{self.mode!r} is active" if self.mode else "released"
        return {
            "messages": f"{self.commands}; {self.refused} with a wrong checksum, {self.fights} against its own mode",
            "commands": self.ages(),
            "silences": f"{self.silences} times without a command for {TIMEOUT:g} s while motors were driven",
            "its own mode": mode,
        }

"""Which motor moves which joint, with which sign, and how the IMU sits: found by moving the robot by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from mimic.commissioning.scan import BusScan
from mimic.commissioning.watching import Watcher, newest
from mimic.errors import PlantError
from mimic.hardware.can.frame import Link
from mimic.hardware.can.wiring import Wiring
from mimic.records import JOINTS, FloatArray
from mimic.robot.description import RobotDescription

MOVED = 0.2
"""A joint that was moved by hand has turned by this [rad]."""

CARRIED = 0.5
"""Share of the largest motion above which a second motor makes it unclear which one was meant."""

TILTED = 0.15
"""The trunk was tilted by this [rad]."""

STILL = 0.03
"""Between two looks nothing that is held moves by more than this [rad]."""

LOOK = 0.3
"""Length of a look [s]."""

PATIENCE = 120.0
"""How long to wait for a motion [s]."""

SQUARE = np.deg2rad(25.0)
"""How far the two tilts and up may be from right angles [rad]."""

SNAP = np.deg2rad(15.0)
"""A mounting this close to right angles is taken for one [rad]."""

MOTIONS = {
    "abad": "swing the whole {leg} leg out to the robot's left",
    "hip": "swing the {leg} upper leg back, towards the tail",
    "knee": "straighten the {leg} knee",
}
"""What to do to each kind of joint so that its angle rises."""

_LEGS = {"FL": "left front", "FR": "right front", "RL": "left hind", "RR": "right hind"}

Say = Callable[[str], None]
"""Tells the person what to do now."""


class WireCheck:
    """The motors of a robot whose wiring is not known, in the order in which a scan found them."""

    def __init__(self, link: Link, wiring: Wiring, found: list[BusScan], description: RobotDescription) -> None:
        """Take what a scan found.

        Args:
            link: The buses.
            wiring: Of which maker, ids of this computer and the IMU's kind and bus are taken.
            found: On each bus.
            description: The robot.

        Raises:
            PlantError: If there are not twelve motors, no IMU, or another program commands them.
        """
        self.motors = [(bus, motor) for bus, one in enumerate(found) for motor in one.motors]
        """Bus and id of each motor."""
        if len(self.motors) != len(JOINTS):
            names = "; ".join(f"{one.name}: {', '.join(map(str, one.motors)) or 'none'}" for one in found)
            raise PlantError(f"{len(self.motors)} motors answer ({names}); expected twelve, each with an id of its own")
        heard = [bus for bus, one in enumerate(found) if one.imu]
        if len(heard) != 1:
            raise PlantError(f"an IMU is heard on {len(heard)} buses; expected one")
        ones = np.ones(len(JOINTS))
        self.raw = replace(
            wiring,
            bus=np.array([bus for bus, _ in self.motors]),
            motor=np.array([motor for _, motor in self.motors]),
            sign=ones,
            offset=0.0 * ones,
            imu=replace(wiring.imu, bus=heard[0], quat_BI=np.array([1.0, 0.0, 0.0, 0.0])),
        )
        self._watcher = Watcher(link, self.raw, description, asks=True)
        self._refuse_others()

    def _refuse_others(self) -> None:
        if self._watcher.only_listens:
            raise PlantError(self._watcher.only_listens)

    def _look(self) -> tuple[FloatArray, FloatArray]:
        """Return the motors' readings (12,) [rad] and the orientation of the IMU, wxyz (4,)."""
        watcher = self._watcher
        begin = watcher.now()
        watcher.listen(begin + LOOK)
        self._refuse_others()
        seen = newest(watcher.report, begin)
        if np.isnan(seen["q"]).any():
            places = [self.name(int(i)) for i in np.flatnonzero(np.isnan(seen["q"]))]
            raise PlantError(f"{', '.join(places)} no longer answers; are its wires in place?")
        imu = watcher.motor_bus.imu.reading(watcher.now())
        if imu.problem is not None:
            raise PlantError(imu.problem)
        return seen["q"], imu.quat_WB

    def name(self, place: int) -> str:
        """Return a motor as a person knows it."""
        bus, motor = self.motors[place]
        return f"motor {motor} on {self._watcher.motor_bus.link.names[bus]}"

    def _wait(self, enough: Callable[[FloatArray, FloatArray], bool], what: str) -> tuple[FloatArray, FloatArray]:
        """Return the first two readings that are enough and at rest."""
        end = self._watcher.now() + PATIENCE
        before = self._look()
        while self._watcher.now() < end:
            now = self._look()
            rests = np.abs(now[0] - before[0]).max() < STILL and _angle(before[1], now[1]) < STILL
            if rests and enough(*now):
                return now
            before = now
        raise PlantError(f"nothing was seen for {PATIENCE:.0f} s while you should {what}; begin again")

    def joint(self, joint: str, say: Say) -> tuple[int, float]:
        """Let a person move one joint; return the place of the motor that turned, and by how much [rad].

        Raises:
            PlantError: If no motor turns, or more than one.
        """
        leg, part = joint.split("_")
        what = MOTIONS[part].format(leg=_LEGS[leg])  # so that its angle rises
        begin, _ = self._look()
        say(f"{joint}: {what}, and hold it there.")
        q, _ = self._wait(lambda q, _: bool(np.abs(q - begin).max() > MOVED), what)
        turn = q - begin
        place = int(np.argmax(np.abs(turn)))
        others = [i for i in range(len(JOINTS)) if i != place and abs(turn[i]) > CARRIED * abs(turn[place])]
        if others:
            names = ", ".join(self.name(i) for i in (place, *others))
            raise PlantError(f"{joint}: {names} turned together; move this joint alone and hold the others")
        return place, float(turn[place])

    def joints(self, say: Say) -> tuple[list[int], FloatArray]:
        """Let a person move every joint, and return the motor of each (12) and its sign (12,).

        Raises:
            PlantError: If a motion contradicts another one.
        """
        places: list[int] = []
        signs = np.ones(len(JOINTS))
        for index, joint in enumerate(JOINTS):
            place, turn = self.joint(joint, say)
            if place in places:
                before = JOINTS[places.index(place)]
                raise PlantError(f"{joint}: {self.name(place)} turned, which turned for {before} already")
            places.append(place)
            signs[index] = np.sign(turn)
            say(f"    {self.name(place)}, sign {signs[index]:+.0f}")
        return places, signs

    def imu(self, say: Say) -> FloatArray:
        """Let a person tilt the trunk twice, and return how the IMU sits on it, wxyz (4,).

        Raises:
            PlantError: If the two tilts contradict each other or gravity.
        """
        say("IMU: put the robot down level, and let it rest.")
        _, level = self._wait(lambda q, quat: True, "let it rest")
        nose = self._tilt(level, "lift the nose by about 30 degrees", say)
        say("    seen; put it down level again.")
        _, level = self._wait(lambda q, quat: _tilt(level, quat) < 0.5 * TILTED, "put it down level again")
        left = self._tilt(level, "roll it to its left by about 30 degrees (the left side goes down)", say)
        up = Rotation.from_quat(level, scalar_first=True).inv().apply([0.0, 0.0, 1.0])
        return mounting(up, nose, left)

    def _tilt(self, level: FloatArray, what: str, say: Say) -> FloatArray:
        """Return the axis about which a person tilted the trunk, IMU axes (3,)."""
        say(f"IMU: {what}, and hold it there.")
        _, quat = self._wait(lambda q, quat: _tilt(level, quat) > TILTED, what)
        vector = _turn(level, quat).as_rotvec()
        return vector / np.linalg.norm(vector)


def _turn(a: FloatArray, b: FloatArray) -> Rotation:
    return Rotation.from_quat(a, scalar_first=True).inv() * Rotation.from_quat(b, scalar_first=True)


def _angle(a: FloatArray, b: FloatArray) -> float:
    return float(_turn(a, b).magnitude())


def _tilt(a: FloatArray, b: FloatArray) -> float:
    """Return the angle between up in two orientations [rad]."""
    ups = [Rotation.from_quat(quat, scalar_first=True).inv().apply([0.0, 0.0, 1.0]) for quat in (a, b)]
    return float(np.arccos(np.clip(ups[0] @ ups[1], -1.0, 1.0)))


def mounting(up: FloatArray, nose: FloatArray, left: FloatArray) -> FloatArray:
    """Return how an IMU sits on the trunk: the turn from its axes to those of the base, wxyz (4,).

    Args:
        up: Up while the robot is level, IMU axes (3,).
        nose: Axis about which lifting the nose turned it, IMU axes (3,): minus y of the base.
        left: Axis about which rolling to the left turned it, IMU axes (3,): minus x of the base.

    Raises:
        PlantError: If the three are not at right angles, or are a mirror image.
    """
    axes = np.array([-left, -nose, up])
    for a, b, what in ((0, 1, "the two tilts"), (0, 2, "the roll and gravity"), (1, 2, "lifting the nose and gravity")):
        off = abs(np.arcsin(np.clip(axes[a] @ axes[b], -1.0, 1.0)))
        if off > SQUARE:
            raise PlantError(f"IMU: {what} are {90 - np.rad2deg(off):.0f} deg apart; expected 90. Begin again")
    if np.linalg.det(axes) < 0.0:
        raise PlantError(
            "IMU: the two tilts are a mirror image; was the tail lifted, or the robot rolled to the right?"
        )
    u, _, v = np.linalg.svd(axes)
    measured = Rotation.from_matrix(u @ v)
    right_angles = Rotation.create_group("O")
    off = (right_angles * measured.inv()).magnitude()
    found = right_angles[int(np.argmin(off))] if off.min() < SNAP else measured
    quat = found.as_quat(scalar_first=True)
    return quat if quat[np.argmax(np.abs(quat))] > 0 else -quat

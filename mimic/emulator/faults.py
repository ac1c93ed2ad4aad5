"""What may go wrong with the emulated robot: said in a word, on a schedule in its own time.

motor_dead:FL_knee@12.5        from 12.5 s on
motor_hot:FR_hip=85@3-6        from 3 s to 6 s, with a value
frames_lost:bus1=0.2@2-4       on one of several buses; without a place on all
imu_frozen@5
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from mimic.errors import ConfigError
from mimic.frozen import frozen
from mimic.records import JOINTS, FloatArray, IntArray


class FaultKind(NamedTuple):
    """One thing that can go wrong."""

    scope: Literal["joint", "bus", "robot"]
    """Where it happens; a joint's fault must name one, a bus's without a place happens on all."""
    default: float = 1.0
    """Value where none is given."""


KINDS = {
    "motor_dead": FaultKind("joint"),  # without power: silent and limp
    "motor_mute": FaultKind("joint"),  # obeys, but its answers do not come
    "motor_deaf": FaultKind("joint"),  # hears nothing and goes on with its last command
    "motor_hot": FaultKind("joint", 85.0),  # at least this warm [degC]
    # reports these fault bits (1 under-voltage, 2 over-current, 4 over-temperature, 8 magnetic encoder, 16 Hall
    # encoder, 32 not calibrated) and switches off
    "motor_fault": FaultKind("joint", 8.0),
    "motor_weak": FaultKind("joint", 0.3),  # gives this share of its torque limit
    "motor_runaway": FaultKind("joint", 12.0),  # gives this torque while it is on, whatever it is told [N m]
    "joint_jammed": FaultKind("joint", 30.0),  # turns against this friction [N m]
    "encoder_frozen": FaultKind("joint"),  # reads and controls an angle that no longer changes
    "power_cycle": FaultKind("joint"),  # loses its power for a moment: off, parameters and zero forgotten
    "under_voltage": FaultKind("robot", 14.0),  # all motors have this voltage [V]
    "frames_lost": FaultKind("bus", 0.1),  # share of frames lost
    "frames_late": FaultKind("bus", 0.01),  # frames come late by this [s]
    "frames_doubled": FaultKind("bus", 0.1),  # share of frames that come twice
    "frames_corrupted": FaultKind("bus", 0.05),  # share of frames with a bit that is wrong
    "frames_reordered": FaultKind("bus", 0.1),  # share of messages overtaken by later ones (stock board)
    "mode_refused": FaultKind("robot"),  # the robot stands by its own order and does not enter motor mode (stock board)
    "mode_returns": FaultKind("robot"),  # its own mode becomes active, as by its remote control (go2)
    "service_silent": FaultKind("robot"),  # its services do not answer (go2)
    "imu_silent": FaultKind("robot"),  # sends nothing
    "imu_frozen": FaultKind("robot"),  # repeats its last sample, counter and all
    "imu_stuck": FaultKind("robot"),  # repeats its last sample under a counter that goes on
    "imu_invalid": FaultKind("robot"),  # calls its orientation invalid
    "imu_tilted": FaultKind("robot", 0.5),  # its orientation is wrong by this, about its y axis [rad]
    "imu_forged": FaultKind("robot", 0.1),  # share of orientations that are another one
    "sign_wrong": FaultKind("joint"),  # its sign in the wiring is wrong
    "motors_swapped": FaultKind("joint"),  # its motor and the next one of its leg are swapped
    "legs_swapped": FaultKind("joint"),  # its leg and the other one at that end are swapped
    "stalled": FaultKind("bus"),  # the adapter keeps everything back and lets it go at the end
    "bus_off": FaultKind("bus"),  # nothing gets through, and no error is reported
    "unplugged": FaultKind("bus"),  # the adapter is gone: the connection breaks
}
"""Kinds of faults, with what happens and the unit of the value."""


MISWIRED = ("sign_wrong", "motors_swapped", "legs_swapped")
"""Kinds that are there from power-up on, whenever they are said to begin."""

BOARD_ONLY = ("frames_reordered", "mode_refused", "mode_returns", "service_silent")
"""Kinds that only boards have; what else they have is in `mimic.emulator.boards`."""

CAN_KINDS = tuple(kind for kind in KINDS if kind not in BOARD_ONLY)
"""Kinds that the robot on CAN has."""


def miswiring(faults: Iterable[EmulatedFault]) -> tuple[IntArray, FloatArray]:
    """Return which joint each is really (12,), and the sign of its readings and commands (12,)."""
    order = np.arange(len(JOINTS))
    sign = np.ones(len(JOINTS))
    for fault in faults:
        if fault.kind not in MISWIRED or fault.joint is None:
            continue
        leg, part = divmod(fault.joint, 3)
        if fault.kind == "sign_wrong":
            sign[fault.joint] *= -1.0
        elif fault.kind == "motors_swapped":
            swapped = [fault.joint, 3 * leg + (part + 1) % 3]
            order[swapped] = order[swapped[::-1]]
        else:
            own = 3 * leg + np.arange(3)
            other = 3 * (leg ^ 1) + np.arange(3)
            order[[own, other]] = order[[other, own]]
    return order, sign


@frozen
class EmulatedFault:
    """One fault on the schedule."""

    kind: str
    value: float
    start: float
    """[s], time of the emulation"""
    until: float = math.inf
    after_release: bool = False
    """Times count from when the first motor is switched on."""
    joint: int | None = None
    """Index of the joint."""
    bus: int | None = None
    """Index of the bus; None for all of them."""

    def __str__(self) -> str:
        """Return it as `parse_fault` reads it."""
        place = (
            f":{JOINTS[self.joint]}" if self.joint is not None else f":bus{self.bus}" if self.bus is not None else ""
        )
        end = "" if math.isinf(self.until) else f"-{self.until:g}"
        sign = "+" if self.after_release else ""
        return f"{self.kind}{place}={self.value:g}@{sign}{self.start:g}{end}"

    def active(self, t: float) -> bool:
        """Return whether it is there at time t [s]."""
        return not self.after_release and self.start <= t < self.until

    def released(self, t: float) -> EmulatedFault:
        """Return the fault as it is once the first motor was switched on at time t [s]."""
        if not self.after_release:
            return self
        return replace(self, start=t + self.start, until=t + self.until, after_release=False)


class Schedule:
    """The faults of a robot, and chance."""

    def __init__(self, faults: Iterable[EmulatedFault], rng: np.random.Generator) -> None:
        self.faults = list(faults)
        self._rng = rng

    def value(self, kind: str, t: float, *, joint: int | None = None, bus: int | None = None) -> float | None:
        """Return the value of a fault that is there at time t [s], or None."""
        for fault in self.faults:
            if fault.kind == kind and fault.joint == joint and fault.bus in (None, bus) and fault.active(t):
                return fault.value
        return None

    def happens(self, kind: str, t: float, bus: int | None = None) -> bool:
        """Return whether a fault strikes now, whose value is the share in which it does."""
        share = self.value(kind, t, bus=bus)
        return share is not None and bool(self._rng.random() < share)

    def release(self, t: float) -> None:
        """Let times count that begin when the first motor is switched on, at time t [s]."""
        self.faults = [fault.released(t) for fault in self.faults]


_FORM = re.compile(
    r"(?P<kind>\w+)(:(?P<place>\w+))?(=(?P<value>[-+.\deE]+))?(@(?P<plus>\+)?(?P<start>[.\d]+)(-(?P<until>[.\d]+))?)?"
)


def parse_fault(text: str) -> EmulatedFault:
    """Return the fault that a person names as KIND[:PLACE][=VALUE][@[+]FROM[-UNTIL]].

    Raises:
        ConfigError: If it is no such word, or names what does not exist.
    """
    found = _FORM.fullmatch(text.strip())
    if found is None:
        raise ConfigError(
            f"the fault {text!r} is not KIND[:PLACE][=VALUE][@[+]FROM[-UNTIL]], such as motor_dead:FL_knee@12.5"
        )
    name = found["kind"]
    place = found["place"]
    if name not in KINDS:
        raise ConfigError(f"there is no fault {name!r}; known are {', '.join(KINDS)}")
    kind = KINDS[name]
    try:
        value = kind.default if found["value"] is None else float(found["value"])
        start = float(found["start"] or 0.0)
        until = float(found["until"] or math.inf)
    except ValueError:
        raise ConfigError(f"the fault {text!r} has a number that is none") from None
    if not start < until:
        raise ConfigError(f"the fault {text!r} ends before it begins")
    joint = bus = None
    if kind.scope == "joint":
        if place not in JOINTS:
            raise ConfigError(
                f"the fault {text!r} needs a joint, such as {name}:FL_knee; there are {', '.join(JOINTS)}"
            )
        joint = JOINTS.index(place)
    elif place is not None:
        if kind.scope != "bus" or not re.fullmatch(r"bus\d", place):
            raise ConfigError(f"the fault {text!r} cannot be at {place!r}; {name} is of the whole {kind.scope}")
        bus = int(place[3:])
    after = found["plus"] is not None
    return EmulatedFault(kind=name, value=value, start=start, until=until, joint=joint, bus=bus, after_release=after)

"""What may go wrong with the emulated robot: said in a word, on a schedule in its own time, or drawn by a seed.

motor_dead:FL_knee@12.5        from 12.5 s on
motor_hot:FR_hip=85@3-6        from 3 s to 6 s, with a value
frames_lost:bus1=0.2@2-4       on one of several buses; without a place on all
imu_frozen@5
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mimic.errors import ConfigError
from mimic.records import JOINTS, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True, slots=True)
class FaultKind:
    """One thing that can go wrong."""

    text: str
    scope: Literal["joint", "bus", "robot"]
    """Where it happens; a joint's fault must name one, a bus's without a place happens on all."""
    default: float = 1.0
    """Value where none is given."""
    drawn: tuple[float, float] | None = None
    """Range from which `random_fault` draws the value; None takes the default."""
    unit: str = ""


KINDS: dict[str, FaultKind] = {
    "motor_dead": FaultKind(text="without power: silent and limp", scope="joint"),
    "motor_mute": FaultKind(text="obeys, but its answers do not come", scope="joint"),
    "motor_deaf": FaultKind(text="hears nothing and goes on with its last command", scope="joint"),
    "motor_hot": FaultKind(text="at least this warm", scope="joint", default=85.0, drawn=(80.0, 120.0), unit="degC"),
    "motor_fault": FaultKind(
        text="reports these fault bits (1 under-voltage, 2 over-current, 4 over-temperature, 8 magnetic encoder, "
        "16 Hall encoder, 32 not calibrated) and switches off",
        scope="joint",
        default=8.0,
    ),
    "motor_weak": FaultKind(text="gives this share of its torque limit", scope="joint", default=0.3, drawn=(0.0, 0.6)),
    "motor_runaway": FaultKind(
        text="gives this torque while it is on, whatever it is told",
        scope="joint",
        default=12.0,
        drawn=(-12.0, 12.0),
        unit="N m",
    ),
    "joint_jammed": FaultKind(
        text="turns against this friction", scope="joint", default=30.0, drawn=(10.0, 30.0), unit="N m"
    ),
    "encoder_frozen": FaultKind(text="reads and controls an angle that no longer changes", scope="joint"),
    "power_cycle": FaultKind(text="loses its power for a moment: off, parameters and zero forgotten", scope="joint"),
    "under_voltage": FaultKind(text="all motors have this voltage", scope="robot", default=14.0, unit="V"),
    "frames_lost": FaultKind(text="share of frames lost", scope="bus", default=0.1, drawn=(0.05, 1.0)),
    "frames_late": FaultKind(text="frames come late by this", scope="bus", default=0.01, drawn=(0.002, 0.1), unit="s"),
    "frames_doubled": FaultKind(text="share of frames that come twice", scope="bus", default=0.1, drawn=(0.05, 1.0)),
    "frames_corrupted": FaultKind(
        text="share of frames with a bit that is wrong", scope="bus", default=0.05, drawn=(0.01, 0.5)
    ),
    "frames_reordered": FaultKind(
        text="share of messages overtaken by later ones (stock board)", scope="bus", default=0.1, drawn=(0.05, 0.5)
    ),
    "mode_refused": FaultKind(
        text="the robot stands by its own order and does not enter motor mode (stock board)", scope="robot"
    ),
    "mode_returns": FaultKind(text="its own mode becomes active, as by its remote control (go2)", scope="robot"),
    "service_silent": FaultKind(text="its services do not answer (go2)", scope="robot"),
    "imu_silent": FaultKind(text="sends nothing", scope="robot"),
    "imu_frozen": FaultKind(text="repeats its last sample, counter and all", scope="robot"),
    "imu_stuck": FaultKind(text="repeats its last sample under a counter that goes on", scope="robot"),
    "imu_invalid": FaultKind(text="calls its orientation invalid", scope="robot"),
    "imu_tilted": FaultKind(
        text="its orientation is wrong by this, about its y axis",
        scope="robot",
        default=0.5,
        drawn=(0.3, 1.5),
        unit="rad",
    ),
    "imu_forged": FaultKind(
        text="share of orientations that are another one", scope="robot", default=0.1, drawn=(0.02, 0.5)
    ),
    "sign_wrong": FaultKind(text="its sign in the wiring is wrong", scope="joint"),
    "motors_swapped": FaultKind(text="its motor and the next one of its leg are swapped", scope="joint"),
    "legs_swapped": FaultKind(text="its leg and the other one at that end are swapped", scope="joint"),
    "stalled": FaultKind(text="the adapter keeps everything back and lets it go at the end", scope="bus"),
    "bus_off": FaultKind(text="nothing gets through, and no error is reported", scope="bus"),
    "unplugged": FaultKind(text="the adapter is gone: the connection breaks", scope="bus"),
}


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


@dataclass(frozen=True, kw_only=True, slots=True)
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


def random_fault(
    seed: int, *, start: tuple[float, float], after_release: bool = False, kinds: tuple[str, ...] = CAN_KINDS
) -> EmulatedFault:
    """Return a fault drawn by a seed: kind, place, value, begin, and whether and when it passes.

    Args:
        seed: The same seed and ranges give the same fault.
        start: Range of its begin [s].
        after_release: Count from when the first motor is switched on.
        kinds: To draw from; miswired joints are not drawn.
    """
    rng = np.random.default_rng([seed, 23])
    name = str(rng.choice([kind for kind in kinds if kind not in MISWIRED]))
    kind = KINDS[name]
    begin = float(rng.uniform(*start))
    lasts = math.inf if rng.random() < 0.5 else float(rng.choice([0.05, 0.2, 1.0]))
    value = kind.default if kind.drawn is None else float(rng.uniform(*kind.drawn))
    if name == "motor_fault":
        value = float(1 << int(rng.integers(6)))
    joint = int(rng.integers(len(JOINTS))) if kind.scope == "joint" else None
    return EmulatedFault(
        kind=name, value=value, start=begin, until=begin + lasts, joint=joint, after_release=after_release
    )

"""One number a joint for each hidden effect: how its parameters follow from a size, and how far a size can go.

A size of 0 is no effect. Caps are what a machine of this kind could have at all; larger would not be the same
machine, would run into the end stops, or would make energy out of friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lab.hidden_effects.generator import ALIENS, Alien, Machine, robot_numbers
from mimic.dynamics.catalogue import effect
from mimic.dynamics.effect_set import EffectValues
from mimic.records import JOINTS, FloatArray

PARTS = ("abad", "hip", "knee")

ROOM = np.array([0.07, 0.12, 0.12])
"""From the ranges of the motion to the end stops: abad, hip, knee [rad]."""


@dataclass(frozen=True, slots=True)
class Family:
    """What a size means."""

    unit: str
    cap: float
    """Greatest size."""
    why: str
    """Why no more."""
    parts: tuple[str, ...] = PARTS
    """Joints that can have it."""
    signed: bool = False
    """Either sign is drawn."""


FAMILIES: Mapping[str, Family] = {
    "armature": Family("kg m^2 more", 0.03, "ten times the rotor"),
    "gains": Family("share by which Kp is greater", 0.5, "a drive that is half wrong", signed=True),
    "torque_speed": Family("halvings of torque and speed", 3.5, "1 N m left"),
    "supply_sag": Family("1/W", 0.02, "half of the supply gone at 25 W"),
    "kt_gain": Family("share by which it is off", 0.4, "another motor", signed=True),
    "kt_drift": Family("1/(100 s)", 0.5, "30 % in a minute", signed=True),
    "kt_heat": Family("1/(N m)^2", 0.5, "bound of the catalogue"),
    "torque_lag": Family("s", 0.02, "the loop begins to oscillate"),
    "velocity_lag": Family("s", 0.015, "the loop begins to oscillate"),
    "stribeck": Family("N m", 1.0, "eight times dry friction"),
    "load_friction": Family("1", 0.6, "a gear of 40 % efficiency"),
    "asymmetric_friction": Family("share of dry and viscous friction", 0.9, "beyond 1 friction drives", signed=True),
    "quadratic_drag": Family("N m s^2/rad^2", 0.5, "as Kd at 6 rad/s"),
    "coupling": Family("N m s/rad", 0.4, "ten times the damping", signed=True),
    "backlash": Family("rad", 0.12, "7 deg"),
    "compliance": Family("rad/(N m)", 0.12, "softer than Kp by a factor of four only"),
    "encoder_offset": Family("share of the room to the end stops", 1.0, "an end stop", signed=True),
    "encoder_scale": Family("share by which it reads more", 0.2, "the end stop of the knee"),
    "encoder_step": Family("rad", 0.05, "bound of the catalogue"),
    "cogging": Family("N m", 1.0, "a tenth of the peak torque"),
    "spring": Family("N m/rad", 4.0, "an eighth of Kp", signed=True),
    "base_tilt": Family("rad", 0.7, "40 deg; the catalogue ends at 46"),
    "payload": Family("kg", 0.5, "as heavy as the thigh", parts=("knee",)),
    "com_shift": Family("m", 0.09, "half of the link", signed=True),
    "joint_delay": Family("s", 0.04, "two targets"),
    "delay_jitter": Family("s", 0.06, "three targets"),
    "lost_commands": Family("1", 0.5, "every other target"),
}
"""Effects of the catalogue that are not baseline and that the physics of this suite has."""

ALIEN_CAPS: Mapping[str, tuple[float, str]] = {
    "cable_stop": (30.0, "as stiff as Kp"),
    "base_swing": (5.0, "27 deg of apparent tilt"),
    "eccentricity": (0.1, "6 deg"),
    "wearing_in": (12.0, "twelve times dry friction"),
    "imbalance": (0.0028, "the rotor's own inertia"),
    "cable_hysteresis": (1.0, "gravity of two legs"),
    "detent": (1.5, "gravity of three legs"),
    "random_walk": (1.0, "gravity of two legs"),
    "periodic_force": (1.5, "as gravity of three legs"),
    "integral": (200.0, "the loop begins to oscillate"),
    "target_filter": (0.05, "two and a half targets"),
    "deadband": (0.05, "3 deg"),
    "friction_wave": (1.0, "eight times dry friction"),
    "slip": (0.12, "an end stop"),
    "zero_drift": (0.003, "an end stop within a minute"),
}


def hidden_effect(
    name: str, sizes: Mapping[str, float], machine: Machine, rng: np.random.Generator, spread: bool = True
) -> EffectValues:
    """Return an effect of the catalogue.

    Args:
        name: Effect.
        sizes: Size of each affected joint, by name; for an effect of the whole machine that of the first joint.
        machine: Whose baseline values some effects are relative to.
        rng: Draws signs and what has no size.
        spread: Draw what has no size; otherwise take the middle.
    """
    joints = tuple(j for j in JOINTS if j in sizes)
    machine_wide = effect(name).scope == "machine"
    s = np.array([sizes[j] for j in joints][: 1 if machine_wide else None])
    if FAMILIES[name].signed and spread:
        s = s * rng.choice((-1.0, 1.0), len(s))
    index = [JOINTS.index(j) for j in joints]

    def draw(low: float, high: float, middle: float) -> FloatArray:
        return rng.uniform(low, high, len(s)) if spread else np.full(len(s), middle)

    values: dict[str, FloatArray]
    motor = robot_numbers()["motor"]
    if name == "armature":
        values = {"inertia": motor["armature"] + s}
    elif name == "gains":
        values = {"kp": 1.0 + s, "kd": np.ones(len(s))}
    elif name == "torque_speed":
        values = {"torque": 12.0 * 2.0**-s, "speed": 30.997 * 2.0**-s, "flat": 0.0 * s}
    elif name == "kt_gain":
        values = {"factor": 1.0 + s}
    elif name == "kt_heat":
        values = {"loss": s, "time": np.full(len(s), float(draw(20.0, 70.0, 40.0)[0]))}
    elif name == "stribeck":
        values = {"level": s, "speed": draw(0.05, 0.15, 0.08)}
    elif name == "asymmetric_friction":
        values = {"level": s * machine.friction[index], "coefficient": s * machine.damping[index]}
    elif name == "encoder_offset":
        values = {"angle": s * ROOM[np.array(index) % 3]}
    elif name == "encoder_scale":
        values = {"factor": 1.0 + s}
    elif name == "cogging":
        phase = draw(0.0, 2 * np.pi, 0.6)
        order = np.full(len(s), np.round(draw(12.0, 60.0, 31.0)[0], 2))
        values = {"cosine": s * np.cos(phase), "sine": s * np.sin(phase), "order": order}
    elif name == "spring":
        values = {"stiffness": s, "moment": s * draw(-0.5, 0.5, 0.2)}
    elif name == "base_tilt":
        angle = float(draw(0.0, 2 * np.pi, 0.8)[0])
        values = {"roll": s[:1] * np.cos(angle), "pitch": s[:1] * np.sin(angle)}
    else:
        parameter = next(p.name for p in effect(name).parameters if not p.shape)
        values = {parameter: s}
    return EffectValues(name=name, joints=() if machine_wide else joints, values=values, source="benchmark")


def alien(name: str, sizes: Mapping[str, float]) -> tuple[Alien, ...]:
    """Return an alien on each joint of sizes; one for the whole machine where it moves the base."""
    assert name in ALIENS
    if name == "base_swing":
        return (Alien(name=name, joints=JOINTS, size=next(iter(sizes.values()))),)
    return tuple(Alien(name=name, joints=(joint,), size=size) for joint, size in sizes.items())

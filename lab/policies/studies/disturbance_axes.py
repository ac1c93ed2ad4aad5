"""Disturbances with one parameter each, and the values at which they are evaluated."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lab.policies.disturbed import NO_DISTURBANCE, Disturbance
from mimic.config.play import NOMINAL, Randomisation
from mimic.config.training import TRAINING_RANDOMISATION, DisturbanceRanges

START = dataclasses.replace(
    NOMINAL,
    start_q=Randomisation().start_q,
    start_height=Randomisation().start_height,
    heading=Randomisation().heading,
)
"""The robot as described, at the paper's random starts."""

PUSH_INTERVAL = 4.0
"""Time between two pushes [s]."""

World = tuple[Randomisation, Disturbance]
"""Ranges that a robot is drawn from, and its disturbance."""


@dataclass(frozen=True)
class Axis:
    """A disturbance with one parameter."""

    unit: str
    nominal: float
    points: tuple[float, ...]
    """Evaluated values; some lie outside the target range, to find where the policy fails."""
    asked: tuple[float, float]
    """Range that a policy should tolerate."""
    trained: tuple[float, float] | None
    """Range of the training by default; None where it has none."""
    apply: Callable[[World, float], World]
    alone: bool = False
    """Whether it is left out where all axes act at once: it is the worst case of another one."""


def _range(*names: str, scale: float = 1.0) -> Callable[[World, float], World]:
    def apply(world: World, value: float) -> World:
        ranges: dict[str, Any] = {name: (value * scale, value * scale) for name in names}
        return dataclasses.replace(world[0], **ranges), world[1]

    return apply


def _disturb(**scales: float) -> Callable[[World, float], World]:
    def apply(world: World, value: float) -> World:
        values: dict[str, Any] = {name: scale * value for name, scale in scales.items()}
        return world[0], dataclasses.replace(world[1], **values)

    return apply


def _worst(apply: Callable[[World, float], World], **ways: Any) -> Callable[[World, float], World]:
    def applied(world: World, value: float) -> World:
        ranges, disturbance = apply(world, value)
        return ranges, dataclasses.replace(disturbance, **(ways if value else {}))

    return applied


def _push(world: World, value: float) -> World:
    return dataclasses.replace(world[0], push=(value, value), push_interval=PUSH_INTERVAL), world[1]


def _axes() -> dict[str, Axis]:
    t, d = TRAINING_RANDOMISATION, DisturbanceRanges()
    gains = (0.6, 0.7, 0.75, 0.85, 1.0, 1.25, 1.3, 1.5)
    delay = (1e3 * t.delay[0], 1e3 * t.delay[1])
    lost = (1e2 * d.lost_share[0], 1e2 * d.lost_share[1])

    friction = (0.2, 0.3, 0.4, 0.5, 0.6, 1.0, 2.0, 3.0)
    delays = (0.0, 5.0, 15.0, 25.0, 35.0, 40.0, 50.0, 60.0)
    masses = (-2.0, -1.5, -1.0, 0.0, 1.0, 1.5, 2.0, 3.0)
    dry = (0.0, 1.0, 2.4, 4.0, 5.0, 6.0, 8.0, 10.0)
    payload = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
    noise = _disturb(noise_q=0.01, noise_imu=0.015, noise_gyro=0.2, noise_dq=1.0)  # the default noise of training
    tilts, pulls = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0), (0.0, 2.5, 5.0, 7.5, 10.0, 12.5, 15.0, 20.0)
    tilt, pull = _disturb(imu_tilt=1.0), _disturb(drag=1.0)
    worst = {
        "imu_pitch": Axis("deg", 0.0, tilts, (0.0, 3.0), d.imu_tilt, _worst(tilt, imu_axis="pitch")),
        "toe_drag_sideways": Axis("N", 0.0, pulls, (0.0, 15.0), d.drag, _worst(pull, drag_way="sideways")),
    }
    return {
        "ground_friction": Axis("", 1.0, friction, (0.4, 3.0), t.ground_friction, _range("ground_friction")),
        "delay": Axis("ms", 15.0, delays, (0.0, 40.0), delay, _range("delay", scale=1e-3)),
        "base_mass": Axis("kg", 0.0, masses, (-1.5, 1.5), t.base_mass, _range("base_mass")),
        "kp": Axis("x", 1.0, gains, (0.7, 1.3), d.kp, _range("kp")),
        "kd": Axis("x", 1.0, gains, (0.7, 1.3), d.kd, _range("kd")),
        "dry_friction": Axis("x", 1.0, dry, (0.0, 6.0), t.dry_friction, _range("dry_friction")),
        "toe_payload": Axis("kg", 0.0, payload, (0.0, 0.3), d.toe_payload, _disturb(toe_payload=1.0)),
        "push": Axis("m/s", 0.0, (0.0, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0), (0.0, 0.8), t.push, _push),
        "noise": Axis("x training's", 0.0, (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0), (0.0, 2.0), (0.0, 1.0), noise),
        "imu_tilt": Axis("deg", 0.0, tilts, (0.0, 3.0), d.imu_tilt, tilt),
        "slope": Axis("deg", 0.0, (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0), (0.0, 5.0), d.slope, _disturb(slope=1.0)),
        "lost_commands": Axis(
            "%", 0.0, (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0), (0.0, 5.0), lost, _disturb(lost_share=0.01)
        ),
        "toe_drag": Axis("N", 0.0, pulls, (0.0, 15.0), d.drag, pull),
    } | {name: dataclasses.replace(one, alone=True) for name, one in worst.items()}


AXES = _axes()


def all_at_once(share: float, seed: int) -> World:
    """Return a world in which every axis is drawn between its nominal value and a share of its target range."""
    rng = np.random.default_rng([seed, 11])
    world: World = (START, NO_DISTURBANCE)
    for axis in AXES.values():
        if axis.alone:
            continue
        low, high = (axis.nominal + share * (end - axis.nominal) for end in axis.asked)
        world = axis.apply(world, float(rng.uniform(low, high)))
    return world

"""Random arm motions of many kinds, as key poses over time.

Hands are given from their own shoulder in arm lengths: forward, outward, up, before the torso turns. A family takes a
random generator and a length in seconds and returns the motion of both arms; `FAMILIES` has those to train on,
`KEPT_ASIDE` those that no training clip shows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from lab.people.skeleton import SIDES, SIGN, Motion
from lab.people.surface import Array

FINE_HZ = 120.0
Rng = np.random.Generator
Point = Sequence[float] | Array


@dataclass
class Arm:
    """Key poses of one arm."""

    keys: list[tuple[float, Array]] = field(default_factory=list)
    """Time [s]; wrist forward, outward, up [arm lengths]."""
    elbow: list[tuple[float, Array]] = field(default_factory=list)
    """Time [s]; where the elbow points, forward, outward, up."""
    round_s: float = 0.05

    def go(self, rng: Rng, at: float, wrist: Point, elbow: Point | None = None) -> None:
        """Be at a place at a time; without `elbow`, the elbow points where it does by nature."""
        place = possible(np.asarray(wrist, float))
        to = natural_elbow(place) + 0.22 * rng.standard_normal(3) if elbow is None else np.asarray(elbow, float)
        self.keys.append((at, place))
        self.elbow.append((at, to))


Arms = dict[str, Arm]
Family = Callable[[Rng, float], Arms]


def possible(wrist: Array) -> Array:
    """Return the nearest place that a hand can reach without passing through the body."""
    x, y, z = wrist
    if y < 0.10 and z < 0.15:
        x = max(x, 0.20 if z > -0.75 else 0.12)
    if x < -0.1:
        x, y = max(x, -0.45), max(y, 0.15)
    y = max(y, -0.62)
    place = np.array([x, y, z])
    length = np.linalg.norm(place)
    return place * np.clip(length, 0.30, 0.995) / max(length, 1e-6)


def natural_elbow(wrist: Array) -> Array:
    """Return where an elbow points when nobody thinks of it: down and out in front, back at the hip, out overhead."""
    _, y, z = wrist
    up = np.clip(0.5 + 0.8 * z, 0.0, 1.0)
    low = np.clip(-1.5 * z - 0.6, 0.0, 1.0)
    return np.array([-0.25 - 0.7 * low, 0.35 + 0.55 * up - 0.2 * min(y, 0.0), -0.75 + 0.65 * low + 0.25 * up])


def anywhere(rng: Rng) -> Array:
    """Return a random place for a hand."""
    kind = rng.random()
    if kind < 0.45:  # around the front
        yaw, pitch = rng.uniform(-0.75, 1.5), rng.uniform(-1.0, 1.0)
    elif kind < 0.65:  # to the side
        yaw, pitch = rng.uniform(0.9, 1.8), rng.uniform(-1.2, 1.2)
    elif kind < 0.8:  # overhead
        yaw, pitch = rng.uniform(-0.5, 2.0), rng.uniform(0.7, 1.5)
    else:  # hanging
        yaw, pitch = rng.uniform(-0.5, 2.6), rng.uniform(-1.55, -0.9)
    reach = rng.choice([rng.uniform(0.4, 0.85), rng.uniform(0.8, 0.995)])
    return reach * np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])


def quiet(rng: Rng) -> tuple[Array, Array | None]:
    """Return where an arm that does nothing may be, and its elbow."""
    kind = rng.random()
    if kind < 0.5:
        return np.array([rng.uniform(0.02, 0.15), rng.uniform(0.08, 0.25), -0.95]), None
    if kind < 0.65:  # hand on the hip
        return np.array([0.05, 0.10, -0.68]), np.array([-0.5, 1.0, 0.0])
    if kind < 0.8:  # before the belly
        return np.array([0.38, -0.22, -0.50]), np.array([-0.5, 0.8, -0.4])
    return anywhere(rng), None


def both(make: Callable[[str], Arm]) -> Arms:
    return {side: make(side) for side in SIDES}


def paths(rng: Rng, length: float) -> Arms:
    """Smooth random paths, each arm by itself or both alike."""
    pace = rng.uniform(0.35, 1.3)
    alike = rng.random() < 0.35
    seed = int(rng.integers(1 << 30))

    def arm(side: str) -> Arm:
        own = np.random.default_rng(seed) if alike else rng
        made, at = Arm(round_s=own.uniform(0.04, 0.16)), 0.0
        while at < length + 1:
            made.go(own, at, anywhere(own))
            at += pace * own.uniform(0.5, 1.5)
            if own.random() < 0.2:
                made.go(own, at, made.keys[-1][1])
                at += pace * own.uniform(0.3, 1.0)
        return made

    return both(arm)


def to_and_fro(rng: Rng, length: float) -> Arms:
    """Between two places again and again: waving, pumping, pushing, sawing, clapping."""
    period = rng.uniform(0.45, 2.2)
    phase = rng.choice([0.0, 0.5, rng.random()])
    alike, one = rng.random() < 0.5, rng.random() < 0.35
    busy = rng.choice(SIDES)
    a, b = anywhere(rng), anywhere(rng)

    def arm(side: str) -> Arm:
        made = Arm(round_s=min(0.12, 0.1 * period))
        rest, elbow = quiet(rng)
        if one and side != busy:
            made.go(rng, 0.0, rest, elbow)
            made.go(rng, length, rest + 0.05 * rng.standard_normal(3), elbow)
            return made
        first, last = (a, b) if alike else (anywhere(rng), anywhere(rng))
        at, k = -phase * period * (side == "R"), 0
        e1, e2 = (natural_elbow(p) + 0.25 * rng.standard_normal(3) for p in (first, last))
        while at < length + period:
            made.go(rng, at, (last if k % 2 else first) + 0.04 * rng.standard_normal(3), e2 if k % 2 else e1)
            at += 0.5 * period * rng.uniform(0.85, 1.15)
            k += 1
        return made

    return both(arm)


def punches(rng: Rng, length: float) -> Arms:
    """Guard, straight punches, hooks and uppercuts."""
    arms = {}
    for side in SIDES:
        made = Arm(round_s=rng.uniform(0.025, 0.05))
        guard = np.array([rng.uniform(0.25, 0.48), rng.uniform(-0.22, 0.05), rng.uniform(-0.20, 0.22)])
        down = np.array([-0.25, rng.uniform(0.3, 0.6), -1.0])
        at = rng.uniform(0.0, 1.0)
        made.go(rng, -1.0, guard, down)
        made.go(rng, at, guard, down)
        while at < length:
            kind, pull, back = rng.random(), rng.uniform(0.14, 0.28), rng.uniform(0.2, 0.4)
            made.go(rng, at, guard + 0.03 * rng.standard_normal(3), down)
            at += pull
            if kind < 0.6:
                up, aside = rng.uniform(-0.5, 0.35), rng.uniform(-0.3, 0.25)
                ahead = np.sqrt(max(rng.uniform(0.75, 0.985) ** 2 - up**2 - aside**2, 0.04))
                made.go(rng, at, (ahead, aside, up), (-0.1, 0.8, -0.6))
            elif kind < 0.8:
                made.go(rng, at, (rng.uniform(0.5, 0.7), rng.uniform(0.0, 0.3), rng.uniform(0.0, 0.2)), (-0.2, 1, 0.05))
                at += 0.09
                made.go(rng, at, (rng.uniform(0.45, 0.6), rng.uniform(-0.5, -0.2), 0.1), (-0.2, 1.0, 0.1))
            else:
                made.go(rng, at, (rng.uniform(0.3, 0.5), 0.05, rng.uniform(-0.6, -0.4)), (-1.0, 0.3, -0.3))
                at += rng.uniform(0.12, 0.2)
                made.go(rng, at, (rng.uniform(0.45, 0.65), -0.1, rng.uniform(0.2, 0.65)), (-0.2, 0.3, -1.0))
            at += rng.uniform(0.03, 0.12)
            made.go(rng, at, made.keys[-1][1], made.elbow[-1][1])
            at += back
            made.go(rng, at, guard, down)
            at += rng.exponential(0.6)
        arms[side] = made
    return arms


def dance(rng: Rng, length: float) -> Arms:
    """Slow round arms, mostly both alike."""
    alike = rng.random() < 0.7
    seed = int(rng.integers(1 << 30))

    def arm(side: str) -> Arm:
        own = np.random.default_rng(seed) if alike else rng
        made, at = Arm(round_s=own.uniform(0.1, 0.2)), -own.uniform(0, 1)
        while at < length + 2:
            pitch = own.choice([-1.2, -0.5, -0.1, 0.4, 1.2]) + 0.12 * own.standard_normal()
            yaw = own.uniform(-0.1, 1.45) if abs(pitch) < 1 else own.uniform(-0.3, 0.6)
            p = own.uniform(0.66, 0.95) * np.array(
                [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)]
            )
            made.go(own, at, p, natural_elbow(p) * [1, 0.5, 0.3] + [0.1, 0.8, 0.0])
            at += own.uniform(0.7, 1.8)
        return made

    return both(arm)


def straight_arms(rng: Rng, length: float) -> Arms:
    """Nearly straight arms on arcs: balancing, raising, windmills, gymnastics."""
    alike, pace = rng.random() < 0.5, rng.uniform(0.4, 1.4)
    seed = int(rng.integers(1 << 30))
    side_only = rng.random() < 0.5

    def arm(side: str) -> Arm:
        own = np.random.default_rng(seed) if alike else rng
        made, at = Arm(round_s=own.uniform(0.05, 0.15)), 0.0
        yaw, pitch = own.uniform(0.0, 1.6), own.uniform(-1.4, 1.0)
        while at < length + 1:
            reach = own.uniform(0.9, 0.997)
            made.go(
                own, at, reach * np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
            )
            at += pace * own.uniform(0.5, 1.4)
            yaw = np.clip(yaw + own.normal(0, 0.7), 0.6 if side_only else -0.3, 1.9)
            pitch = np.clip(pitch + own.normal(0, 0.8), -1.5, 1.5)
        return made

    return both(arm)


def gestures(rng: Rng, length: float) -> Arms:
    """Hands before the chest, as people do when they talk, sign, show or handle something."""

    def arm(side: str) -> Arm:
        made, at = Arm(round_s=rng.uniform(0.04, 0.1)), 0.0
        home = np.array([rng.uniform(0.35, 0.65), rng.uniform(-0.3, 0.3), rng.uniform(-0.55, 0.15)])
        wide = rng.uniform(0.08, 0.28)
        idle = rng.random() < 0.2
        rest, elbow = quiet(rng)
        while at < length + 1:
            if idle or rng.random() < 0.12:
                made.go(rng, at, rest, elbow)
            else:
                made.go(rng, at, home + wide * rng.standard_normal(3))
            at += rng.uniform(0.2, 0.8)
            if rng.random() < 0.3:
                made.go(rng, at, made.keys[-1][1], made.elbow[-1][1])
                at += rng.uniform(0.1, 0.8)
        return made

    return both(arm)


def swings(rng: Rng, length: float) -> Arms:
    """Arms that swing beside the body: walking, marching, running, skiing."""
    period, bend = rng.uniform(0.6, 1.6), rng.uniform(0.0, 1.6)
    wide, height = rng.uniform(0.25, 1.0), rng.uniform(0.0, 0.5)

    def arm(side: str) -> Arm:
        made = Arm(round_s=0.08)
        at = 0.0 if side == "L" else -0.5 * period
        k, out = 0, rng.uniform(0.05, 0.3)
        while at < length + period:
            angle = (wide if k % 2 else -0.6 * wide) * rng.uniform(0.8, 1.2) + height * (k % 2)
            upper = 0.53 * np.array([np.sin(angle), 0.1, -np.cos(angle)])
            lower = 0.47 * np.array([np.sin(angle + bend), 0.0, -np.cos(angle + bend)])
            made.go(rng, at, upper + lower + [0, out, 0], (-1.0, 0.3, -0.2))
            at += 0.5 * period * rng.uniform(0.95, 1.05)
            k += 1
        return made

    return both(arm)


def raise_and_reach(rng: Rng, length: float) -> Arms:
    """From rest to a place and back, as in exercises and everyday reaching, often straight ahead."""
    alike = rng.random() < 0.5
    seed = int(rng.integers(1 << 30))

    def arm(side: str) -> Arm:
        own = np.random.default_rng(seed) if alike else rng
        made = Arm(round_s=own.uniform(0.05, 0.14))
        rest, elbow = quiet(own)
        if own.random() < 0.4:  # at the chest
            rest, elbow = np.array([own.uniform(0.3, 0.45), own.uniform(-0.15, 0.15), own.uniform(-0.3, 0.0)]), None
        at = 0.0 if alike else own.uniform(0.0, 0.8)
        made.go(own, at - 1, rest, elbow)
        while at < length + 1:
            made.go(own, at, rest, elbow)
            at += own.uniform(0.25, 1.0)
            goal = anywhere(own)
            if own.random() < 0.6:
                up, aside = own.uniform(-0.6, 0.7), own.uniform(-0.4, 0.5)
                goal = own.uniform(0.8, 0.99) * np.array([np.sqrt(max(1 - up**2 - aside**2, 0.02)), aside, up])
            made.go(own, at, goal)
            at += own.uniform(0.0, 0.9)
            made.go(own, at, goal)
            at += own.uniform(0.25, 1.0)
            made.go(own, at, rest, elbow)
            at += own.uniform(0.0, 0.8)
        return made

    return both(arm)


def circles(rng: Rng, length: float) -> Arms:
    """Closed loops in a plane of any direction: cranking, stirring, polishing, winding."""
    period, turn = rng.uniform(0.6, 2.5), rng.choice([-1, 1])
    normal = rng.standard_normal(3)
    u = np.cross(normal, rng.standard_normal(3))
    u /= np.linalg.norm(u)
    v = np.cross(normal / np.linalg.norm(normal), u)
    lag = rng.choice([0.0, 0.5, 0.25])

    def arm(side: str) -> Arm:
        made = Arm(round_s=0.06)
        middle = 0.75 * anywhere(rng)
        middle[0] = max(middle[0], 0.1)
        a, b = rng.uniform(0.1, 0.5, 2)
        elbow = natural_elbow(middle) + 0.25 * rng.standard_normal(3)
        for at in np.arange(0, length + 0.5, period / 8):
            w = 2 * np.pi * (turn * at / period + lag * (side == "R"))
            made.go(rng, float(at), middle + a * np.cos(w) * u + b * np.sin(w) * v, elbow)
        return made

    return both(arm)


FAMILIES: dict[str, Family] = {
    f.__name__: f
    for f in (paths, to_and_fro, punches, dance, straight_arms, gestures, swings, raise_and_reach, circles)
}


def _story(*steps: tuple[float, Point, Point], repeat: int = 1) -> list[tuple[float, Point, Point]]:
    """Steps of (seconds, left, right), repeated."""
    return list(steps) * repeat


def _told(steps: list[tuple[float, Point, Point]], round_s: float) -> Family:
    def family(rng: Rng, length: float) -> Arms:
        arms = {side: Arm(round_s=round_s) for side in SIDES}
        at = 0.0
        while at < length + 1:
            for seconds, left, right in steps:
                for side, place in (("L", left), ("R", right)):
                    arms[side].go(rng, at, np.asarray(place, float) + 0.03 * rng.standard_normal(3))
                at += seconds * rng.uniform(0.9, 1.1)
        return arms

    return family


_HANG, _CHEST = (0.06, 0.17, -0.95), (0.36, -0.02, -0.12)
TUNING: dict[str, Family] = {
    "tai_chi": _told(
        _story(
            (1.2, (0.75, -0.05, 0.05), (0.35, 0.0, -0.35)), (1.2, (0.35, 0.1, -0.4), (0.80, 0.0, 0.1)),
            (1.0, (0.5, 0.55, 0.1), (0.5, 0.5, -0.1)), (1.0, (0.40, -0.2, 0.1), (0.40, -0.2, -0.3)),
        ), 0.15,
    ),
    "basketball": _told(
        _story(
            (0.5, (0.35, -0.1, -0.35), (0.35, -0.1, -0.35)), (0.35, (0.9, -0.1, 0.05), (0.9, -0.1, 0.05)),
            (0.6, (0.35, -0.1, -0.2), (0.35, -0.1, -0.2)), (0.4, (0.35, 0.0, 0.8), (0.35, 0.0, 0.8)),
        ), 0.05,
    ),
    "traffic_police": _told(
        _story(
            (0.8, _HANG, (0.95, 0.1, 0.05)), (0.8, _HANG, (0.95, 0.1, 0.05)), (0.7, (0.1, 0.97, 0.0), _HANG),
            (0.6, (0.1, 0.97, 0.0), (0.45, -0.3, 0.1)), (0.8, (0.95, 0.0, 0.1), _HANG),
        ), 0.06,
    ),
    "rowing": _told(
        _story((0.9, (0.92, -0.1, -0.2), (0.92, -0.1, -0.2)), (0.9, (0.2, 0.2, -0.4), (0.2, 0.2, -0.4))), 0.1
    ),
    "southpaw": _told(
        _story(
            (0.5, (0.3, -0.1, 0.05), (0.4, -0.1, 0.0)), (0.18, (0.3, -0.1, 0.05), (0.96, -0.05, 0.1)),
            (0.3, (0.3, -0.1, 0.05), (0.4, -0.1, 0.0)), (0.2, (0.95, 0.1, 0.1), (0.3, -0.1, 0.0)),
            (0.6, (0.3, -0.1, 0.05), (0.4, -0.1, 0.0)),
        ), 0.03,
    ),
}  # fmt: skip
KEPT_ASIDE: dict[str, Family] = {
    "volley": _told(
        _story(
            (0.6, (0.45, 0.2, -0.2), (0.45, 0.3, -0.2)), (0.25, (0.4, -0.1, -0.1), (0.80, 0.35, 0.25)),
            (0.4, (0.35, 0.1, -0.3), (0.7, -0.45, 0.1)), (0.7, (0.45, 0.2, -0.2), (0.45, 0.3, -0.2)),
            (0.3, (0.2, 0.6, 0.3), (0.1, 0.5, 0.75)), (0.2, (0.4, 0.0, -0.3), (0.85, 0.1, 0.3)),
        ), 0.05,
    ),
    "conductor": _told(
        _story(
            (0.45, (0.55, 0.1, 0.25), (0.55, 0.1, 0.35)), (0.45, (0.6, 0.15, -0.3), (0.6, 0.1, -0.35)),
            (0.45, (0.5, -0.15, -0.1), (0.5, -0.2, -0.1)), (0.45, (0.45, 0.5, 0.0), (0.5, 0.6, 0.0)),
            (0.6, (0.85, 0.1, 0.1), (0.5, 0.3, 0.5)),
        ), 0.07,
    ),
    "crawl": _told(
        _story(
            (0.5, (0.95, 0.05, 0.15), (-0.15, 0.3, -0.85)), (0.5, (0.45, 0.0, -0.7), (0.1, 0.6, 0.35)),
            (0.5, (-0.15, 0.3, -0.85), (0.95, 0.05, 0.15)), (0.5, (0.1, 0.6, 0.35), (0.45, 0.0, -0.7)),
        ), 0.09,
    ),
    "sparring": _told(
        _story(
            (0.4, (0.42, -0.08, 0.02), (0.3, -0.1, 0.05)), (0.17, (0.97, 0.0, 0.08), (0.3, -0.1, 0.05)),
            (0.28, (0.42, -0.08, 0.02), (0.3, -0.1, 0.05)), (0.17, (0.97, 0.0, 0.08), (0.3, -0.1, 0.05)),
            (0.2, (0.4, -0.08, 0.02), (0.97, 0.12, 0.1)), (0.5, (0.42, -0.08, 0.02), (0.3, -0.1, 0.05)),
            (0.22, (0.42, -0.08, 0.0), (0.72, -0.05, -0.55)), (0.6, (0.42, -0.08, 0.02), (0.3, -0.1, 0.05)),
        ), 0.03,
    ),
    "semaphore": _told(
        _story(
            (0.7, (0.1, 0.7, -0.68), (0.1, 0.97, 0.0)), (0.7, (0.1, 0.97, 0.0), (0.1, 0.7, 0.68)),
            (0.7, (0.96, 0.1, 0.0), (0.1, 0.7, 0.68)), (0.7, (0.1, 0.1, 0.97), (0.96, 0.1, 0.0)),
            (0.7, _CHEST, _CHEST), (0.6, _HANG, (0.1, 0.97, 0.0)),
        ), 0.06,
    ),
}  # fmt: skip


def motion_of(arms: Arms, rng: Rng, length: float, rate_hz: float) -> Motion:
    """Return the motion of the whole person at the frames of a clip; the torso sways, leans and turns at random."""
    fine = np.arange(round(length * FINE_HZ)) / FINE_HZ
    frames = np.rint(np.arange(round(length * rate_hz)) * FINE_HZ / rate_hz).astype(int)
    t = fine[frames]

    def wander(size: float, period: float) -> Array:
        a, b, c, d = rng.uniform(0, 2 * np.pi, 4)
        w = 2 * np.pi * fine / period
        return size * (0.6 * np.sin(w + a) + 0.4 * np.sin(1.618 * w + b) * np.sin(0.31 * w + c) + 0.1 * np.cos(d))

    def path(keys: list[tuple[float, Array]], round_s: float) -> Array:
        keys = sorted(keys, key=lambda key: key[0])
        times = np.array([at for at, _ in keys])
        keep = np.concatenate([[True], np.diff(times) > 0.02])
        values = np.array([v for _, v in keys])[keep]
        times = times[keep]
        if len(times) < 2:
            return np.repeat(values, len(fine), axis=0)
        shown = PchipInterpolator(times, values)(np.clip(fine, times[0], times[-1]))
        return gaussian_filter1d(shown, round_s * FINE_HZ, axis=0, mode="nearest")

    deg = np.pi / 180
    lively = rng.choice([0.3, 1.0, 2.0])
    yaw = wander(lively * rng.uniform(1, 9) * deg, rng.uniform(0.8, 3))
    if rng.random() < 0.3:  # a slow turn
        yaw = yaw + wander(rng.uniform(10, 40) * deg, rng.uniform(5, 10))
    twist = wander(lively * 5 * deg, rng.uniform(0.8, 3)) + rng.normal(0, 5) * deg
    if rng.random() < 0.5:  # the shoulders follow the arms
        ahead = {side: path(arms[side].keys, 0.08)[:, 0] for side in SIDES}
        twist = twist + rng.uniform(0.1, 0.5) * (ahead["R"] - ahead["L"])
    chest = np.stack([
        yaw + twist,
        wander(lively * 3 * deg, 2.5) + rng.normal(2, 5) * deg,
        wander(lively * 3 * deg, 3.1) + rng.normal(0, 2) * deg,
    ], axis=1)  # fmt: skip
    chest[:, 1] = np.clip(chest[:, 1], -0.2, 0.4)
    follows = float(rng.choice([0.0, 1.0]))  # the arms go with the chest, or with the slow yaw
    c, s = np.cos(yaw + follows * twist), np.sin(yaw + follows * twist)

    def in_world(keys: list[tuple[float, Array]], side: str, round_s: float) -> Array:
        x, y, z = (path(keys, round_s) * [1.0, SIGN[side], 1.0]).T
        return np.stack([c * x - s * y, s * x + c * y, z], axis=1)[frames]

    wrist = {side: in_world(arms[side].keys, side, arms[side].round_s) for side in SIDES}
    elbow = {side: in_world(arms[side].elbow, side, arms[side].round_s) for side in SIDES}
    tremble = rng.uniform(0, 0.015)
    for side in SIDES:
        wrist[side] = wrist[side] + np.stack([wander(tremble, rng.uniform(0.7, 2))[frames] for _ in range(3)], axis=1)
        length_now = np.linalg.norm(wrist[side], axis=1, keepdims=True)
        wrist[side] = wrist[side] * np.clip(length_now, 0.25, 0.997) / np.maximum(length_now, 1e-6)
    sink = rng.uniform(0.0, 0.10) * rng.choice([0, 1])
    pelvis = np.stack([wander(0.02 * lively, 2.3), wander(0.02 * lively, 2.9), wander(0.01, 1.7) - 0.02 - sink], axis=1)
    head = chest * [0.8, 0.5, 0.5] + np.stack([wander(12 * deg, 4.0), wander(6 * deg, 3.3), wander(3 * deg, 5)], axis=1)
    head[:, 0] += rng.normal(0, 10) * deg
    palm_turn = rng.uniform(-np.pi, np.pi)
    palm = {
        side: np.tile([0.4 * np.cos(palm_turn), -SIGN[side], 0.6 * np.sin(palm_turn)], (len(t), 1)) for side in SIDES
    }
    fingers = {side: _along_forearm(wrist[side], elbow[side]) for side in SIDES}
    pelvis_ypr = np.stack([yaw, 0 * yaw, 0.2 * chest[:, 2]], axis=1)
    stand = rng.uniform(0.09, 0.17)
    step = rng.uniform(-0.15, 0.15)
    return Motion(
        t=t,
        pelvis=pelvis[frames],
        pelvis_ypr=pelvis_ypr[frames],
        chest_ypr=chest[frames],
        head_ypr=head[frames],
        wrist=wrist,
        elbow=elbow,
        palm=palm,
        fingers=fingers,
        foot={"L": (step, stand, 0.3), "R": (-step, -stand, -0.3)},
    )


def _along_forearm(wrist: Array, elbow: Array) -> Array:
    """Return the direction from elbow to wrist (n, 3)."""
    d = np.linalg.norm(wrist, axis=1, keepdims=True)
    u = wrist / d
    aside = elbow - (elbow * u).sum(axis=1, keepdims=True) * u
    aside = aside / np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-6)
    d = np.clip(d, 0.1, 0.9985)
    first, second = 0.532, 0.468
    along = (first**2 - second**2 + d**2) / (2 * d)
    return d * u - along * u - np.sqrt(np.maximum(first**2 - along**2, 0.0)) * aside

"""What the person does in each clip, as key poses over time.

Hands are given from their own shoulder in arm lengths: forward, to the left, up. Between keys the curves are
monotone (no overshoot), then rounded off by a Gaussian: short for punches, long for dance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from lab.people.skeleton import SIDES, SIGN, Motion
from lab.people.surface import Array

RATE_HZ = 30.0
FINE = 8
"""Curves are made at this many times the frame rate, then sampled."""

Value = float | Sequence[float] | Array
Key = tuple[float, Value]


def curve(keys: Sequence[Key], duration: float, *, round_s: float = 0.035) -> Array:
    """Return the curve through the keys (time [s], values) at the frames (n, k); constant before and after."""
    fine = np.arange(round(duration * RATE_HZ) * FINE) / (RATE_HZ * FINE)
    times = np.array([t for t, _ in keys])
    values = np.array([np.atleast_1d(np.asarray(v, float)) for _, v in keys])
    if len(keys) == 1:
        return np.repeat(values, round(duration * RATE_HZ), axis=0)
    path = PchipInterpolator(times, values)(np.clip(fine, times[0], times[-1]))
    return gaussian_filter1d(path, round_s * RATE_HZ * FINE, axis=0, mode="nearest")[::FINE]


def _sway(t: Array, amplitude: float, period: float, phase: float = 0.0) -> Array:
    """A slow wander of two incommensurate sines."""
    a, b = 2 * np.pi * t / period, 2 * np.pi * t / (1.618 * period)
    return amplitude * (0.65 * np.sin(a + phase) + 0.35 * np.sin(b + 2.1 * phase + 0.7))


def _stack(*columns: Array) -> Array:
    return np.stack([c.reshape(-1) for c in columns], axis=1)


DEG = np.pi / 180.0


def boxing() -> Motion:
    """Shadow boxing in orthodox stance: jabs, crosses, hooks, an uppercut with each hand, a slip, guard between."""
    duration = 12.6
    n = round(duration * RATE_HZ)
    t = np.arange(n) / RATE_HZ

    guard_l, guard_r = (0.38, -0.14, 0.02), (0.28, 0.01, -0.10)
    left: list[Key] = [(0.0, guard_l)]
    right: list[Key] = [(0.0, guard_r)]
    elbow_l: list[Key] = [(0.0, (-0.25, 0.45, -1.0))]
    elbow_r: list[Key] = [(0.0, (-0.25, -0.45, -1.0))]
    palm_l: list[Key] = [(0.0, (-0.25, -1.0, -0.1))]
    palm_r: list[Key] = [(0.0, (-0.25, 1.0, -0.1))]
    chest: list[Key] = [(0.0, (-37, 7, 0))]
    hips: list[Key] = [(0.0, (-36, 0, 0))]
    shift: list[Key] = [(0.0, (0.0, 0.0, -0.055))]
    heel_r: list[Key] = [(0.0, (16,))]
    free: dict[str, list[Key]] = {"L": [(0.0, (0,))], "R": [(0.0, (0,))]}
    """1 while a fist is on its way, 0 while it follows the chest in guard."""

    def out(keys: list[Key], at: float, pull: float, back: float, rest: Value, *path: Key) -> None:
        """Leave the resting value `pull` before the first key, pass the keys, be back `back` after the last."""
        keys.append((at + path[0][0] - pull, rest))
        keys.extend((at + dt, value) for dt, value in path)
        keys.append((at + path[-1][0] + back, rest))
        if keys is left or keys is right:
            busy = free["L" if keys is left else "R"]
            out(busy, at, pull, back, (0,), (path[0][0], (1,)), (path[-1][0], (1,)))

    chest_0, hips_0, shift_0, heel_0 = chest[0][1], hips[0][1], shift[0][1], heel_r[0][1]

    def jab(at: float, up: float = 0.13) -> None:
        """Straight to the head, or to the body with `up` below the shoulder."""
        hit = (np.sqrt(0.97 - up**2), -0.03, up)
        out(left, at, 0.17, 0.26, guard_l, (0.0, hit), (0.09, hit))
        out(elbow_l, at, 0.17, 0.26, elbow_l[0][1], (0.0, (-0.1, 0.9, -0.6)), (0.09, (-0.1, 0.9, -0.6)))
        out(palm_l, at, 0.17, 0.26, palm_l[0][1], (0.0, (0.1, -0.4, -1.0)), (0.09, (0.1, -0.4, -1.0)))
        out(chest, at, 0.17, 0.28, chest_0, (0.02, (-48, 8, 2)))
        out(shift, at, 0.20, 0.30, shift_0, (0.02, (0.055, 0.005, -0.07 + 0.10 * min(up, 0.0))))

    def cross(at: float, up: float = 0.13) -> None:
        hit = (np.sqrt(0.96 - up**2), 0.10, up)
        out(right, at, 0.20, 0.30, guard_r, (0.0, hit), (0.06, hit))
        out(elbow_r, at, 0.20, 0.30, elbow_r[0][1], (0.0, (-0.1, -0.9, -0.6)), (0.06, (-0.1, -0.9, -0.6)))
        out(palm_r, at, 0.20, 0.30, palm_r[0][1], (0.0, (0.1, 0.4, -1.0)), (0.06, (0.1, 0.4, -1.0)))
        out(chest, at, 0.24, 0.32, chest_0, (0.02, (-2, 11, -2)))
        out(hips, at, 0.24, 0.34, hips_0, (0.0, (-8, 0, 0)))
        out(shift, at, 0.24, 0.34, shift_0, (0.02, (0.085, 0.02, -0.075 + 0.12 * min(up, 0.0))))
        out(heel_r, at, 0.24, 0.34, heel_0, (0.0, (34,)))

    def hook_left(at: float) -> None:
        load, hit, through = (0.38, 0.22, -0.02), (0.66, -0.06, 0.10), (0.52, -0.46, 0.10)
        out(left, at, 0.16, 0.28, guard_l, (-0.16, load), (0.0, hit), (0.08, through))
        out(elbow_l, at, 0.16, 0.30, elbow_l[0][1], (-0.14, (-0.3, 1.0, -0.3)), (0.06, (-0.2, 1.0, 0.12)))
        out(palm_l, at, 0.16, 0.30, palm_l[0][1], (-0.05, (-0.6, -0.7, -0.6)), (0.06, (-0.9, -0.3, -0.5)))
        out(chest, at, 0.20, 0.34, chest_0, (-0.18, (-22, 8, -4)), (0.05, (-60, 7, 3)))
        out(hips, at, 0.20, 0.34, hips_0, (-0.18, (-27, 0, 0)), (0.05, (-50, 0, 0)))
        out(shift, at, 0.20, 0.34, shift_0, (-0.16, (0.05, 0.035, -0.085)), (0.06, (0.02, -0.02, -0.065)))

    def hook_right(at: float) -> None:
        load, hit, through = (0.34, -0.34, -0.02), (0.70, 0.02, 0.10), (0.60, 0.44, 0.10)
        out(right, at, 0.16, 0.30, guard_r, (-0.17, load), (0.0, hit), (0.08, through))
        out(elbow_r, at, 0.16, 0.30, elbow_r[0][1], (-0.14, (-0.3, -1.0, -0.3)), (0.06, (-0.2, -1.0, 0.12)))
        out(palm_r, at, 0.16, 0.30, palm_r[0][1], (-0.05, (-0.6, 0.7, -0.6)), (0.06, (-0.9, 0.3, -0.5)))
        out(chest, at, 0.20, 0.34, chest_0, (-0.18, (-42, 8, 5)), (0.05, (2, 8, -3)))
        out(hips, at, 0.20, 0.34, hips_0, (0.05, (-6, 0, 0)))
        out(shift, at, 0.20, 0.34, shift_0, (-0.16, (-0.01, -0.03, -0.085)), (0.06, (0.06, 0.02, -0.065)))
        out(heel_r, at, 0.22, 0.34, heel_0, (0.04, (36,)))

    def uppercut_right(at: float) -> None:
        dip, rise, top = (0.30, 0.06, -0.62), (0.60, 0.10, -0.30), (0.52, 0.20, 0.60)
        out(right, at, 0.20, 0.32, guard_r, (-0.20, dip), (-0.06, rise), (0.05, top))
        out(elbow_r, at, 0.20, 0.32, elbow_r[0][1], (-0.2, (-1.0, -0.3, -0.3)), (0.05, (-0.2, -0.35, -1.0)))
        out(palm_r, at, 0.20, 0.32, palm_r[0][1], (-0.2, (0.2, 0.7, 0.7)), (0.05, (-1.0, 0.2, 0.2)))
        out(chest, at, 0.24, 0.36, chest_0, (-0.20, (-40, 15, 9)), (0.04, (2, 1, -3)))
        out(hips, at, 0.24, 0.36, hips_0, (0.03, (-6, 0, 0)))
        out(shift, at, 0.26, 0.38, shift_0, (-0.20, (-0.02, -0.035, -0.13)), (0.05, (0.06, 0.01, -0.020)))
        out(heel_r, at, 0.24, 0.36, heel_0, (0.03, (36,)))

    def uppercut_left(at: float) -> None:
        dip, rise, top = (0.46, 0.06, -0.50), (0.66, -0.02, -0.24), (0.54, -0.10, 0.60)
        out(left, at, 0.20, 0.30, guard_l, (-0.20, dip), (-0.06, rise), (0.05, top))
        out(elbow_l, at, 0.20, 0.30, elbow_l[0][1], (-0.2, (-1.0, 0.3, -0.3)), (0.05, (-0.2, 0.35, -1.0)))
        out(palm_l, at, 0.20, 0.30, palm_l[0][1], (-0.2, (0.2, -0.7, 0.7)), (0.05, (-1.0, -0.2, 0.2)))
        out(chest, at, 0.24, 0.34, chest_0, (-0.20, (-27, 13, -6)), (0.04, (-54, 1, 3)))
        out(shift, at, 0.26, 0.36, shift_0, (-0.20, (0.05, 0.04, -0.12)), (0.05, (0.03, 0.0, -0.020)))

    def slip(at: float) -> None:
        out(chest, at, 0.24, 0.30, chest_0, (0.0, (-20, 13, 15)))
        out(shift, at, 0.24, 0.30, shift_0, (0.0, (0.0, -0.06, -0.12)))

    jab(1.55)
    jab(2.12, -0.52)
    jab(2.85)
    cross(3.26)
    hook_left(4.15)
    jab(5.00)
    cross(5.42, -0.40)
    hook_left(6.10)
    slip(6.95)
    uppercut_right(7.75)
    hook_right(8.75)
    uppercut_left(9.60)
    jab(10.32)

    def made(keys: list[Key]) -> Array:
        return curve(_in_order(keys), duration)

    def from_rest(keys: list[Key], rest: Value) -> Array:
        """The arms hang at the start, come up to the guard and go down again at the end."""
        between = [(at, value) for at, value in _in_order(keys) if at > 0.0]
        ends = [(0.0, rest), (0.62, rest), (1.15, keys[0][1])], [(10.85, keys[0][1]), (11.50, rest)]
        return curve([*ends[0], *between, *ends[1]], duration)

    wrist = {"L": from_rest(left, (0.085, 0.18, -0.925)), "R": from_rest(right, (0.06, -0.22, -0.92))}
    elbow = {"L": from_rest(elbow_l, (-0.9, 0.6, 0.0)), "R": from_rest(elbow_r, (-0.9, -0.6, 0.0))}
    palm = {"L": from_rest(palm_l, (-0.4, -1.0, 0.0)), "R": from_rest(palm_r, (-0.2, 1.0, 0.0))}
    bounce = np.sin(2 * np.pi * 1.9 * t)
    for side, phase in (("L", 0.0), ("R", 1.3)):
        wrist[side][:, 2] += 0.014 * np.sin(2 * np.pi * 1.9 * t - 0.9 + phase)
        wrist[side][:, 0] += _sway(t, 0.02, 1.9, phase)
        wrist[side][:, 1] += _sway(t, 0.012, 1.5, 2 + phase)
    chest_a, hips_a, pelvis = made(chest) * DEG, made(hips) * DEG, made(shift)
    chest_a[:, 0] += _sway(t, 2.5 * DEG, 1.7)
    chest_a[:, 2] += _sway(t, 1.5 * DEG, 2.3, 1.0)
    pelvis[:, 0] += _sway(t, 0.016, 2.1, 0.4)
    pelvis[:, 1] += _sway(t, 0.016, 2.6, 1.4)
    pelvis[:, 2] += 0.009 * bounce
    for side in SIDES:
        follow = (chest_a[:, 0] + 37 * DEG) * (1.0 - made(free[side])[:, 0])
        for part in (wrist, elbow, palm):
            part[side] = _turned(part[side], follow)
    head = _stack(-21 * DEG + 0.28 * (chest_a[:, 0] + 37 * DEG), 5 * DEG + 0.3 * chest_a[:, 1], 0.45 * chest_a[:, 2])
    heel = {"R": made(heel_r)[:, 0] * DEG + 2.5 * DEG * bounce, "L": 2.0 * DEG * (1 + bounce)}
    return Motion(
        t=t,
        pelvis=pelvis,
        pelvis_ypr=hips_a,
        chest_ypr=chest_a,
        head_ypr=head,
        wrist=wrist,
        elbow=elbow,
        palm=palm,
        fingers=_along_forearm(wrist, elbow),
        foot={"L": (0.17, 0.115, -0.20), "R": (-0.27, -0.155, -0.75)},
        heel=heel,
    )


def ballet() -> Motion:
    """Port de bras: low, first, second, third to fifth with a rise on the toes, opened and closed, and to each side."""
    duration = 15.0
    t = np.arange(round(duration * RATE_HZ)) / RATE_HZ
    # Forward, outward, up; where the elbow points; where the palm faces; where the fingers point.
    places = {
        "low": ((0.36, 0.00, -0.80), (-0.25, 1.0, 0.10), (0.0, -0.55, 0.9), (0.25, -0.85, -0.45)),
        "first": ((0.66, 0.10, -0.28), (-0.10, 1.0, -0.10), (-1.0, -0.25, 0.1), (0.15, -1.0, 0.0)),
        "second": ((0.32, 0.87, -0.08), (-0.75, 0.15, -0.55), (0.95, -0.35, -0.1), (0.35, 0.90, -0.2)),
        "half": ((0.34, 0.58, -0.58), (-0.75, 0.45, 0.10), (0.75, -0.45, 0.3), (0.30, 0.60, -0.7)),
        "fifth": ((0.30, 0.08, 0.84), (-0.05, 1.0, 0.05), (0.05, -0.45, -0.9), (0.10, -0.85, 0.45)),
        "wide": ((0.26, 0.66, 0.58), (-0.60, 0.55, -0.65), (0.60, -0.70, -0.4), (0.20, 0.75, 0.55)),
        "reach": ((0.66, 0.40, 0.38), (-0.35, 0.55, -0.80), (0.20, -0.45, -0.9), (0.80, 0.30, 0.30)),
    }
    left = (
        (0.0, "low"), (0.7, "low"), (2.1, "first"), (3.5, "second"), (4.2, "second"), (5.4, "first"), (6.7, "fifth"),
        (7.6, "fifth"), (8.6, "wide"), (9.5, "second"), (10.4, "second"), (11.5, "reach"), (12.6, "second"),
        (13.4, "half"), (14.3, "low"), (15.0, "low"),
    )  # fmt: skip
    right = (
        (0.0, "low"), (0.7, "low"), (2.1, "first"), (3.5, "second"), (4.2, "second"), (5.4, "first"), (6.7, "fifth"),
        (7.6, "fifth"), (8.6, "wide"), (9.5, "second"), (10.4, "wide"), (11.4, "fifth"), (12.4, "wide"),
        (13.4, "half"), (14.3, "low"), (15.0, "low"),
    )  # fmt: skip
    parts: list[dict[str, Array]] = [{}, {}, {}, {}]
    for side, steps in (("L", left), ("R", right)):
        for i, part in enumerate(parts):
            keys = [(at, np.array(places[name][i]) * [1.0, SIGN[side], 1.0]) for at, name in steps]
            part[side] = curve(keys, duration, round_s=0.13)
    wrist, elbow, palm, fingers = parts

    def made(*keys: Key) -> Array:
        return curve(keys, duration, round_s=0.16)

    rise = made((6.0, 0), (6.9, 1), (8.1, 1), (9.2, 0))[:, 0]
    lean = made((0, 0), (2.1, -3), (3.5, 3), (5.4, -1), (6.7, 0), (9.6, 0), (11.3, 15), (11.7, 15), (13.0, 0))[:, 0]
    plie = made((4.0, 0), (5.2, 1), (6.3, 0), (9.2, 0), (10.0, 0.8), (11.2, 0.1), (13.4, 0.5), (14.6, 0))[:, 0]
    turn = made((0, 0), (2.1, -4), (3.5, 9), (5.4, 0), (6.7, 0), (9.6, 0), (11.5, -8), (13.2, 0))[:, 0]
    look = made(
        (0, 6), (2.1, -6), (3.5, 28), (4.2, 26), (5.4, -3), (7.6, 0), (8.8, -22), (9.8, -5), (11.5, 20), (13.5, -4)
    )
    nod = made((0, 10), (2.1, 12), (3.5, 0), (5.4, 8), (6.8, -14), (7.8, -12), (9.5, 0), (11.5, 2), (14.3, 10))[:, 0]
    breath = np.sin(2 * np.pi * t / 3.7)
    chest = _stack(turn * DEG, (-2.0 - 1.2 * breath - 3 * rise) * DEG, -lean * DEG)
    pelvis = _stack(0.01 + 0.012 * rise, 0.0022 * lean + _sway(t, 0.006, 5), -0.012 - 0.060 * plie + 0.052 * rise)
    heel = 26 * DEG * rise
    return Motion(
        t=t,
        pelvis=pelvis,
        pelvis_ypr=_stack(0.35 * turn * DEG, 0 * t, -0.15 * lean * DEG),
        chest_ypr=chest,
        head_ypr=_stack(look[:, 0] * DEG, nod * DEG, -0.9 * lean * DEG),
        wrist=wrist,
        elbow=elbow,
        palm=palm,
        fingers=fingers,
        foot={"L": (0.02, 0.105, 0.75), "R": (-0.02, -0.105, -0.75)},
        heel={"L": heel, "R": heel},
    )


def waving() -> Motion:
    """A friendly wave with the right hand, with the left, then with both."""
    duration = 10.0
    t = np.arange(round(duration * RATE_HZ)) / RATE_HZ
    hang = ((0.07, 0.17, -0.965), (-1.0, 0.25, 0.0), (-0.15, -1.0, 0.1), (0.12, -0.03, -1.0))
    spans = {"R": [(0.9, 3.4), (6.5, 9.0)], "L": [(3.6, 5.55), (6.5, 9.0)]}
    parts: list[dict[str, Array]] = [{}, {}, {}, {}]
    for side in SIDES:
        keys: list[list[Key]] = [[(0.0, v)] for v in hang]
        for first, last in spans[side]:
            _append(keys, first - 0.35, hang)
            _append(keys, first + 0.05, ((0.42, 0.42, -0.42), (-0.6, 0.5, -0.6), (-0.2, -0.8, -0.1), (0.7, 0.2, 0.4)))
            outward = True
            for at in np.arange(first + 0.45, last - 0.3, 0.29):
                tilt = 0.20 if outward else -0.10
                up = ((0.30, 0.56 + tilt, 0.40 - 0.45 * abs(tilt - 0.03)), (-0.25, 0.75, -1.0), (1.0, -0.1, 0.0))
                _append(keys, float(at), (*up, (0.12, 1.7 * tilt - 0.02, 1.0)))
                outward = not outward
            _append(keys, last + 0.10, ((0.40, 0.44, -0.42), (-0.6, 0.5, -0.6), (-0.2, -0.8, -0.1), (0.7, 0.2, 0.1)))
            _append(keys, last + 0.55, hang)
        for i, part in enumerate(parts):
            merged = _in_order([(at, np.asarray(v) * [1.0, SIGN[side], 1.0]) for at, v in keys[i]])
            part[side] = curve(merged, duration, round_s=0.05)
    wrist, elbow, palm, fingers = parts

    def made(*keys: Key) -> Array:
        return curve(keys, duration, round_s=0.12)[:, 0]

    who = made((0.5, 0), (1.2, -1), (3.2, -1), (3.9, 1), (5.5, 1), (6.4, 0))
    both = made((6.3, 0), (7.0, 1), (8.9, 1), (9.5, 0))
    pulse = np.sin(2 * np.pi * (t - 0.3) / 0.58) * (np.abs(who) + both).clip(0, 1)
    breath = np.sin(2 * np.pi * t / 3.1)
    return Motion(
        t=t,
        pelvis=_stack(0.004 * breath, -0.028 * who + _sway(t, 0.008, 3.4), -0.014 - 0.006 * both * (1 + pulse)),
        pelvis_ypr=_stack(3 * who * DEG, 0 * t, 1.5 * who * DEG),
        chest_ypr=_stack((5 * who + _sway(t, 1.2, 2.9)) * DEG, (1.0 + breath) * DEG, (-3.0 * who + 0.8 * pulse) * DEG),
        head_ypr=_stack((-5 * who + _sway(t, 2, 4.1)) * DEG, (2 - 3 * both) * DEG, (5 * who + 2.0 * pulse) * DEG),
        wrist=wrist,
        elbow=elbow,
        palm=palm,
        fingers=fingers,
        foot={"L": (0.0, 0.125, 0.22), "R": (0.0, -0.125, -0.22)},
    )


def _turned(v: Array, yaw: Array) -> Array:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1], v[:, 2]], axis=1)


def _append(keys: list[list[Key]], at: float, values: Sequence[Sequence[float]]) -> None:
    for channel, value in zip(keys, values, strict=True):
        channel.append((at, value))


def _in_order(keys: list[Key]) -> list[Key]:
    """Sort keys by time; of keys closer than 30 ms keep the earlier one, and leave a rest that a new move overtakes."""
    rest = np.asarray(keys[0][1], float)
    kept: list[Key] = []
    for at, value in sorted(keys, key=lambda key: key[0]):
        if kept and at - kept[-1][0] < 0.03:
            if np.allclose(kept[-1][1], rest):
                kept[-1] = (kept[-1][0], value)
            continue
        kept.append((at, value))
    return kept


def _along_forearm(wrist: dict[str, Array], elbow: dict[str, Array]) -> dict[str, Array]:
    """Direction from elbow to wrist, so that the fist continues the forearm."""
    found = {}
    for side in SIDES:
        reach = wrist[side]
        d = np.linalg.norm(reach, axis=1, keepdims=True)
        u = reach / d
        toward = elbow[side] - (elbow[side] * u).sum(axis=1, keepdims=True) * u
        toward = toward / np.linalg.norm(toward, axis=1, keepdims=True)
        d = np.clip(d, 0.1, 0.9985)
        first, second = 0.532, 0.468
        along = (first**2 - second**2 + d**2) / (2 * d)
        found[side] = d * u - along * u - np.sqrt(np.maximum(first**2 - along**2, 0.0)) * toward
    return found


MOTIONS = {"boxing": boxing, "ballet": ballet, "waving": waving}

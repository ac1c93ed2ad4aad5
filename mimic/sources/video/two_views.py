"""One person from two uncalibrated cameras: the depth that one hardly sees lies in the picture of the other.

Both clips are brought to one clock by the heights of elbows and wrists, which all cameras see alike. The turn between
the cameras and the ratio of their scales are those at which the lines of arms and trunk agree best, each camera being
less sure of depth and lines that one of them takes for something else counting little. Whether both show one motion
tells what is left, and how much more is left where their times do not belong together. Each line is then the
least-squares mean of both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from mimic.errors import SourceError
from mimic.records import ELBOWS, HIPS, SHOULDERS, WRISTS, BoolArray, FloatArray, IntArray, PoseTrack, landmarks_of
from mimic.sources.video.smoothing import interpolated

LATEST = 2.0
"""One clip starts at most this long after the other [s]."""
DELAYS = 8
"""Delays that are tried."""
NEAR = 15.0
"""Cameras that look along lines closer than this show no depth to each other [deg]; 18° was the least tried."""
ALIKE = 0.675
"""Above this a second view is not used: those of one motion have up to 0.67, those of other ones 0.68 and more."""
UNLIKE = 0.9
"""Above this it shows another motion; a view with an arm that hides another, or of people who sit still, has less."""
FAR = 3.0
"""Lines that are more standard deviations apart than this count little in the turn."""
ROWS = 300
"""At most this many rows are compared."""
SHIFTS = 6
"""Parts of the clip by which the second view is shifted in a circle to see what chance makes alike."""
GRID_HZ = 100.0
"""Rate at which their motion is compared [Hz]."""
ACROSS = 0.03
"""Standard deviation of a line across the picture [m]."""
DEPTH = 0.12
"""Standard deviation in depth where the track declares none [m]."""
TURN_DOUBT = 0.14
"""Standard deviation of the turn found, about each axis [rad]: 14° in all on twelve pairs of calibrated views."""
STARTS = 4
"""Turns about the vertical from which the best one is sought."""

_STARTS = np.array([*np.repeat(SHOULDERS, 2), SHOULDERS[1], HIPS[1]])
_ENDS = np.array([ELBOWS[0], WRISTS[0], ELBOWS[1], WRISTS[1], SHOULDERS[0], HIPS[0]])
"""Landmarks at both ends of the first six lines of `_Lines`."""
_FINGERS = landmarks_of("pinky", "index", "thumb")


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How a second view lies to the first."""

    delay: float
    """Time of the second clip less that of the first at the same moment [s]."""
    turn: FloatArray
    """From axes of the second camera to those of the first, times the ratio of their scales (3, 3)."""
    unlike: float
    """What is left between the lines of both views over what ACROSS and DEPTH let expect, times its ratio to what is
    left at the likest of other times.

    Source: 36 pairs of calibrated views of three people, and 93 of different motions (lab/results/depth.md).
    """

    @property
    def angle_deg(self) -> float:
        """Angle between the directions in which the cameras look [deg]."""
        return float(np.degrees(np.arccos(np.clip(self.turn[2, 2] / np.cbrt(np.linalg.det(self.turn)), -1.0, 1.0))))


def merge_views(first: PoseTrack, second: PoseTrack, names: tuple[str, str]) -> tuple[PoseTrack, Fit]:
    """Return the first track with arms and trunk from both views, and how the second one lies to it.

    Args:
        first, second: Tracks of one person at the same time; times, pictures and axes are those of the first.
        names: Of their videos, for messages.

    Raises:
        SourceError: If the two show different motions, or one has a cut.
    """
    for track, name in zip((first, second), names, strict=True):
        if len(np.unique(track.shot)) > 1:
            raise SourceError(f"{name} has a cut or a change of person; two views need clips without one")
    seen = _lines(first)
    lines = _lines(second)
    found = []
    for delay in _delays(first, second):
        turn, unlike = _turn(seen, _at(lines, second.t, first.t + delay))
        found.append((unlike, delay, turn))
    unlike, delay, turn = min(found, key=lambda one: one[0], default=(np.inf, 0.0, np.eye(3)))
    if np.isinf(unlike):
        raise SourceError(f"{names[0]} and {names[1]} never show the same arm at once; film both at the same time")
    other = _at(lines, second.t, first.t + delay)
    fit = Fit(delay, turn, unlike**2 / _by_chance(seen, other))
    if fit.unlike > UNLIKE:
        raise SourceError(
            f"{names[0]} and {names[1]} do not show the same motion, from whatever angle; film one person with both at "
            f"once, starting within {LATEST:g} s"
        )
    said = tuple(f"{names[1]}: {text}" for text in second.warnings)
    alone = ""
    if fit.unlike > ALIKE:
        alone = f"it shows arms or trunk otherwise than {names[0]} does: hidden arms, or another motion"
    elif fit.angle_deg < NEAR:
        alone = f"its camera, {fit.angle_deg:.0f}° beside that of {names[0]}, adds no depth"
    if alone:
        return replace(first, warnings=(*first.warnings, *said, f"{names[1]} is not used: {alone}")), fit
    merged = _with_lines(first, _mean(seen, other, turn))
    return replace(merged, warnings=(*first.warnings, *said)), fit


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """Shoulder -> elbow and wrist of each side, right -> left shoulder and hip, mid-hip -> middle of the shoulders."""

    xyz: FloatArray
    """(T, 7, 3), axes of the camera [m]."""
    spread: FloatArray
    """Standard deviation of their depth (T, 7) [m]."""
    valid: BoolArray
    """(T, 7)."""


def _lines(track: PoseTrack) -> _Lines:
    p = track.landmarks
    middle = p[:, SHOULDERS].mean(axis=1) - p[:, HIPS].mean(axis=1)
    xyz = np.concatenate([p[:, _ENDS] - p[:, _STARTS], middle[:, None]], axis=1)
    valid = np.column_stack([track.valid[:, _ENDS] & track.valid[:, _STARTS], track.valid[:, SHOULDERS].all(axis=1)])
    spread = np.full(valid.shape, DEPTH)
    spread[:, [1, 3]] = np.where(np.isfinite(track.depth_spread), track.depth_spread, DEPTH)
    return _Lines(xyz, spread, valid & np.isfinite(xyz).all(axis=-1))


def _at(lines: _Lines, t: FloatArray, times: FloatArray) -> _Lines:
    """Return lines at other times; beyond the clip they are not seen."""
    xyz, spread, valid = (interpolated(times, t, values) for values in (lines.xyz, lines.spread, lines.valid + 0.0))
    inside = (times >= t[0]) & (times <= t[-1])
    return _Lines(xyz, spread, (valid == 1.0) & inside[:, None] & np.isfinite(xyz).all(axis=-1))


def _delays(first: PoseTrack, second: PoseTrack) -> FloatArray:
    """Return the delays at which elbows and wrists go up and down most alike, at most DELAYS of them [s]."""
    one, other = (_speeds(track) for track in (first, second))

    def sums(of: FloatArray, to: FloatArray) -> FloatArray:
        return np.sum([np.correlate(b, a, "full") for a, b in zip(of.T, to.T, strict=True)], axis=0)

    lags = np.arange(1 - len(one), len(other))
    shared = np.sqrt(sums(one**2, (other != 0.0) + 0.0) * sums((one != 0.0) + 0.0, other**2))
    alike = sums(one, other) / np.maximum(shared, 1e-9)
    overlap = np.minimum(len(one), len(other) - lags) - np.maximum(0, -lags)
    alike[(np.abs(lags) > LATEST * GRID_HZ) | (2 * overlap < min(len(one), len(other)))] = -1.0
    peaks = np.flatnonzero((alike >= np.roll(alike, 1)) & (alike >= np.roll(alike, -1)) & (alike > -1.0))
    return lags[peaks[np.argsort(-alike[peaks])[:DELAYS]]] / GRID_HZ


def _speeds(track: PoseTrack) -> FloatArray:
    """Return how fast elbows and wrists go down from their shoulder at GRID_HZ (T, 4) [m/s]; 0 where unseen."""
    lines = _lines(track)
    grid = np.arange(track.t[0], track.t[-1], 1.0 / GRID_HZ)
    seen = _at(lines, track.t, grid)
    speed = GRID_HZ * np.gradient(seen.xyz[:, :4, 1], axis=0) if len(grid) > 1 else np.zeros((len(grid), 4))
    return np.where(seen.valid[:, :4] & np.isfinite(speed), speed, 0.0)


def _turn(seen: _Lines, other: _Lines) -> tuple[FloatArray, float]:
    """Return the turn and scale (3, 3) that bring lines of the other view to those seen, few of which may be wrong.

    Last comes the root mean square of what is left, over what is expected; infinite if no line is seen in both.
    """
    both = seen.valid & other.valid
    if not both.any():
        return np.eye(3), np.inf
    every = -(-int(both.any(axis=1).sum()) // ROWS)
    rows = np.flatnonzero(both.any(axis=1))[::every]
    a = seen.xyz[rows][both[rows]]
    b = other.xyz[rows][both[rows]]
    noise = np.diag(np.square([ACROSS, ACROSS, DEPTH]))

    def matrix(p: FloatArray) -> FloatArray:
        return np.exp(p[3]) * Rotation.from_rotvec(p[:3]).as_matrix()

    def cost(p: FloatArray) -> float:
        m = matrix(p)
        weight = np.linalg.cholesky(np.linalg.inv(noise + m @ noise @ m.T))
        square = np.square((a - b @ m.T) @ weight).sum(axis=-1)
        return float(FAR**2 * np.log1p(square / FAR**2).mean())

    about = [np.array([0.0, angle, 0.0, 0.0]) for angle in np.linspace(-np.pi, np.pi, STARTS, endpoint=False)]
    best = min((minimize(cost, start) for start in about), key=lambda one: one.fun)
    return matrix(best.x), float(np.sqrt(best.fun / 3.0))


def _by_chance(seen: _Lines, other: _Lines) -> float:
    """Return what is left as in `_turn` if the other view runs backwards or is shifted in a circle, the least."""
    rows = np.flatnonzero((seen.valid & other.valid).any(axis=1))
    orders = [rows[::-1], *(np.roll(rows, part * len(rows) // SHIFTS) for part in range(1, SHIFTS))]
    return min(_turn(_rows(seen, rows), _rows(other, order))[1] for order in orders)


def _rows(lines: _Lines, rows: IntArray) -> _Lines:
    return _Lines(lines.xyz[rows], lines.spread[rows], lines.valid[rows])


def _mean(seen: _Lines, other: _Lines, turn: FloatArray) -> _Lines:
    """Return the least-squares mean of lines in two views, with what is left of their spread."""

    def information(lines: _Lines) -> FloatArray:
        across = np.full(lines.spread.shape, ACROSS)
        weights = np.stack([across, across, lines.spread], axis=-1) ** -2.0 * lines.valid[..., None]
        return weights[..., None] * np.eye(3)

    back = np.linalg.inv(turn)
    own = information(seen)
    others = back.T @ information(other) @ back
    covariance = np.linalg.inv(own + others + 1e-9 * np.eye(3))
    values = [np.where(lines.valid[..., None], lines.xyz, 0.0) for lines in (seen, other)]
    total = (own @ values[0][..., None] + others @ (values[1] @ turn.T)[..., None])[..., 0]
    xyz = (covariance @ total[..., None])[..., 0]
    turned = TURN_DOUBT * np.linalg.norm(xyz, axis=-1) * (covariance @ others)[..., 2, 2]
    spread = np.hypot(np.sqrt(covariance[..., 2, 2]), turned)
    return _Lines(xyz, spread, seen.valid | other.valid)


def _with_lines(track: PoseTrack, lines: _Lines) -> PoseTrack:
    """Return a track with these lines; what neither view shows stays as it is."""
    landmarks = np.array(track.landmarks)
    valid = np.array(track.valid)
    score = np.array(track.score)
    spread = np.array(track.depth_spread)
    for i in range(2):
        half = 0.5 - i
        elbow = 2 * i
        wrist = 2 * i + 1
        shoulder = lines.xyz[:, 6] + half * lines.xyz[:, 4]
        seen = lines.valid[:, 4] & lines.valid[:, 6]
        places = {
            HIPS[i]: (half * lines.xyz[:, 5], lines.valid[:, 5]),
            SHOULDERS[i]: (shoulder, seen),
            ELBOWS[i]: (shoulder + lines.xyz[:, elbow], seen & lines.valid[:, elbow]),
            WRISTS[i]: (shoulder + lines.xyz[:, wrist], seen & lines.valid[:, wrist]),
        }
        moved = places[WRISTS[i]][0] - landmarks[:, WRISTS[i]]
        landmarks[:, _FINGERS[i::2]] += moved[:, None]
        for column, (xyz, known) in places.items():
            landmarks[known, column] = xyz[known]
            score[known, column] = np.where(valid[known, column], score[known, column], 1.0)
            valid[known, column] = True
        spread[:, i] = np.where(lines.valid[:, wrist], lines.spread[:, wrist], np.nan)
    return replace(track, landmarks=landmarks, valid=valid, score=score, depth_spread=spread)

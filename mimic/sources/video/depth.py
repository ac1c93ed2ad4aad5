"""Depth of elbows and wrists from their shoulder, which the detector hardly sees, from the motion in the picture.

For each arm the unknown is (zu, zf): depth of the elbow from the shoulder and of the wrist from the elbow, on a grid. A
frame says how likely each cell is: bones of known length look short when they point along the camera axis; the
detector's depth is a weak and biased sensor; elbows and shoulders do not bend in every way. Between frames both
depths walk. The posterior of this hidden Markov model has a mean, which is taken, and a standard deviation, which says
how sure it is. A clip is seen whole (forward and backward), a camera from the past only (forward).

Across and up, the arms come from the picture, with perspective. Views from behind are left as they are. The numbers
were fitted on rendered clips with exact truth.

Source of the foreshortening: C. J. Taylor, "Reconstruction of articulated objects from point correspondences in a
single uncalibrated image", CVIU 2000.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from mimic.records import LANDMARKS, FloatArray, IntArray
from mimic.sources.video.smoothing import segments

RATE_HZ = 30.0
"""Rate at which a clip is looked at [Hz]."""
SHORTEST = 8
"""Shorter segments are left as they are [rows at RATE_HZ]."""
CELLS, WIDEST = 21, 0.98
"""Cells of each depth, and the outermost one in lengths of the bone."""
LENS = 1.5
"""Focal length over the longer side of the picture."""
WEIGHT = 0.155
"""Share that a frame counts at RATE_HZ: neighbouring frames err alike."""
DRAWN_SD = 0.035
"""Error of the length of a bone in the picture [m]."""
UPPER_SENSOR, FORE_SENSOR = (0.66, 0.030, 0.079), (0.45, 0.096, 0.057)
"""The detector's depth of a bone is gain times the depth, less an offset [m] that vanishes in profile, within an error
[m]: it puts arms toward the camera."""
STEPS = ((0.85, 0.08), (0.15, 0.20))
"""Shares and sizes of the steps of a depth from one frame to the next at RATE_HZ [m]."""
UPPER_LENGTH, FORE_LENGTH, LEAST_LENGTH = 0.94, 1.02, 0.97
"""Lengths of the bones over the longest seen; at least this share of the longest in the picture."""
DRAWN_QUANTILE, SOLID_QUANTILE = 0.95, 0.90
"""Quantiles over time that count as the longest, in the picture and by the detector."""
SCALE_S = 0.5
"""Standard deviation of the Gaussian over the scale of the picture [s]."""
HEADING_S = 0.44
"""Standard deviation of the Gaussian over the heading [s]: it has a gain of 0.71 at 0.3 Hz."""
SHORTEST_GAP_S = 1e-3
"""Two frames of a camera are taken to be at least this far apart [s]."""
FORGET_S = 1.0
"""A camera starts anew after a gap of this length, and averages scale and heading with this time constant [s]."""
REMEMBERED = 900
"""Frames of a camera in which bones are measured."""

_SHOULDERS, _ELBOWS, _WRISTS, _HIPS = (
    [LANDMARKS.index(f"{side}_{part}") for side in ("left", "right")] for part in ("shoulder", "elbow", "wrist", "hip")
)
_HANDS = [[LANDMARKS.index(f"{side}_{part}") for part in ("pinky", "index", "thumb")] for side in ("left", "right")]
_TRUNK = [*_SHOULDERS, *_HIPS]
_BLOCK = 256
_NODES = np.linspace(-WIDEST, WIDEST, CELLS)


def with_depth(
    t: FloatArray, landmarks: FloatArray, image: FloatArray, size: tuple[int, int], shots: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the landmarks of a whole clip with arms of estimated depth (T, 33, 3) [m], and its spread (T, 2) [m].

    The spread is the standard deviation of each wrist's depth from its shoulder, NaN where nothing was estimated.

    Args:
        t: Times (T,) [s].
        landmarks: Mid-hip -> landmark, smooth (T, 33, 3), camera axes [m]; NaN rows without a person.
        image: Place in the picture, smooth (T, 33, 2), fractions of width and height.
        size: Width and height of the picture [px].
        shots: Rows at which a new shot begins.
    """
    result, spread = np.array(landmarks, dtype=np.float64), np.full((len(t), 2), np.nan)
    for rows in segments(t, np.flatnonzero(np.isfinite(landmarks[:, 0, 0])), shots):
        grid = np.arange(float(t[rows[0]]), float(t[rows[-1]]) + 1e-9, 1.0 / RATE_HZ)
        if len(grid) < SHORTEST or from_behind(landmarks[rows]):
            continue
        world, flat = (_resampled(t[rows], grid, values[rows]) for values in (landmarks, image))
        metres, drawn = (_slow(values, SCALE_S) for values in _spreads(world, flat, size))
        scale = metres / drawn
        line = _slow(_left_line(world), HEADING_S)
        bones = _Bones(_lengths(world, _metres(flat, size, scale)))
        found = np.stack(
            [_Arm(side, bones).whole(world, _metres(flat, size, scale), _away(size, scale), line) for side in range(2)],
            axis=1,
        )
        at_rows = PchipInterpolator(grid, found, axis=0)(np.minimum(t[rows], grid[-1]))
        own_scale = np.interp(t[rows], grid, scale)
        result[rows] = placed(landmarks[rows], image[rows], size, own_scale, at_rows[..., :2])
        spread[rows] = at_rows[..., 2]
    return result, spread


def from_behind(landmarks: FloatArray) -> bool:
    """Return whether the camera looks at a person's back: the left side is on the left of the picture (T, 33, 3)."""
    return bool(np.median(_left_line(landmarks)[:, 0]) < 0.0)


def placed(
    landmarks: FloatArray, image: FloatArray, size: tuple[int, int], scale: FloatArray, depth: FloatArray
) -> FloatArray:
    """Return landmarks whose arms have this depth, and lie in the picture where they were seen (T, 33, 3) [m].

    What is nearer to the camera looks larger: a point seen at W in the plane of the shoulder is at W (1 + z / Z).

    Args:
        landmarks, image: As in a pose track (T, 33, ...).
        size: Width and height of the picture [px].
        scale: Of the picture (T,) [m/px].
        depth: Of elbow and wrist from the shoulder, both sides (T, 2, 2) [m].
    """
    flat, away = _metres(image, size, scale), _away(size, scale)
    result = np.array(landmarks, dtype=np.float64)
    for side in range(2):
        shoulder = _SHOULDERS[side]
        for part, point in enumerate((_ELBOWS[side], _WRISTS[side])):
            z = depth[:, side, part]
            across = flat[:, point] * (1.0 + z / away)[:, None] - flat[:, shoulder]
            result[:, point] = landmarks[:, shoulder] + np.column_stack([across, z])
        moved = result[:, _WRISTS[side]] - landmarks[:, _WRISTS[side]]
        result[:, _HANDS[side]] += moved[:, None]
    return result


class LiveDepth:
    """The same for a camera, frame by frame and from the past only."""

    def __init__(self) -> None:
        self._t = -np.inf
        self._lengths: deque[FloatArray] = deque(maxlen=REMEMBERED)
        self._arms: list[_Arm] = []
        self._metres, self._drawn, self._line = 0.0, 0.0, np.zeros(3)

    def see(
        self, t: float, landmarks: FloatArray, image: FloatArray, size: tuple[int, int]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the landmarks with arms of estimated depth (33, 3) [m], and its spread (2,) [m].

        Args:
            t: Time of the frame [s].
            landmarks, image: One row of a pose track, of a person.
            size: Width and height of the picture [px].
        """
        passed, self._t = t - self._t, t
        if passed > FORGET_S:
            self._arms = []
            self._lengths.clear()
        share = 1.0 - np.exp(-passed / FORGET_S) if self._arms else 1.0
        world, picture = landmarks[None], image[None]
        metres, drawn = _spreads(world, picture, size)
        self._metres += share * (metres[0] - self._metres)
        self._drawn += share * (drawn[0] - self._drawn)
        self._line = self._line + share * (_left_line(world)[0] - self._line)
        scale = np.array([self._metres / self._drawn])
        flat, away = _metres(picture, size, scale), _away(size, scale)
        self._lengths.append(_lengths(world, flat)[0])
        bones = _Bones(np.array(self._lengths))
        self._arms = self._arms or [_Arm(side, bones) for side in range(2)]
        if self._line[0] < 0.0:
            return landmarks, np.full(2, np.nan)
        found = np.stack([arm.next(passed, bones, world, flat, away, self._line[None]) for arm in self._arms])
        return placed(world, picture, size, scale, found[None, :, :2])[0], found[:, 2]


@dataclass(frozen=True, slots=True)
class _Bones:
    """Lengths of upper arm and forearm [m], from what was seen of them (T, 8): see `_lengths`."""

    seen: FloatArray

    @property
    def lengths(self) -> tuple[float, float]:
        parts = self.seen.reshape(len(self.seen), 2, 2, 2)  # bone, in the picture or by the detector, side
        found = []
        for part, share in zip(range(2), (UPPER_LENGTH, FORE_LENGTH), strict=True):
            drawn = float(np.quantile(parts[:, part, 0], DRAWN_QUANTILE))
            solid = float(np.quantile(parts[:, part, 1], SOLID_QUANTILE))
            found.append(max(share * max(drawn, solid), LEAST_LENGTH * drawn))
        return found[0], found[1]


class _Arm:
    """The hidden Markov model of one arm."""

    def __init__(self, side: int, bones: _Bones) -> None:
        self._side = side
        self._belief = np.full((CELLS, CELLS), 1.0 / CELLS**2)
        self._take(bones)

    def _take(self, bones: _Bones) -> None:
        self._upper, self._fore = bones.lengths
        self._zu, self._zf = _NODES * self._upper, _NODES * self._fore

    def whole(self, world: FloatArray, flat: FloatArray, away: FloatArray, line: FloatArray) -> FloatArray:
        """Return depth of elbow and wrist from the shoulder, and the spread of the latter (T, 3) [m]."""
        ahead = self._likelihood(world, flat, away, line)
        step_u, step_f = (_steps(nodes, 1.0) for nodes in (self._zu, self._zf))
        forward = np.empty_like(ahead)
        belief = np.full((CELLS, CELLS), 1.0 / CELLS**2)
        for i, seen in enumerate(ahead):
            belief = seen * (step_u.T @ belief @ step_f if i else belief)
            belief /= belief.sum()
            forward[i] = belief
        future = np.ones((CELLS, CELLS))
        for i in range(len(ahead) - 2, -1, -1):
            future = step_u @ (ahead[i + 1] * future) @ step_f.T
            future /= future.sum()
            forward[i] *= future
        return self._summary(forward)

    def next(
        self, passed: float, bones: _Bones, world: FloatArray, flat: FloatArray, away: FloatArray, line: FloatArray
    ) -> FloatArray:
        """Return the same (3,) for the next frame, from the past only."""
        self._take(bones)
        frames = np.clip(passed, SHORTEST_GAP_S, FORGET_S) * RATE_HZ
        step_u, step_f = (_steps(nodes, frames) for nodes in (self._zu, self._zf))
        seen = self._likelihood(world, flat, away, line)[0] ** min(frames, 3.0)
        self._belief = seen * (step_u.T @ self._belief @ step_f)
        self._belief /= self._belief.sum()
        return self._summary(self._belief[None])[0]

    def _summary(self, belief: FloatArray) -> FloatArray:
        belief = belief / belief.sum(axis=(1, 2), keepdims=True)
        wrist = self._zu[:, None] + self._zf
        mean = (belief * wrist).sum(axis=(1, 2))
        variance = (belief * wrist**2).sum(axis=(1, 2)) - mean**2
        return np.stack([(belief.sum(axis=2) * self._zu).sum(axis=1), mean, np.sqrt(np.maximum(variance, 0.0))], axis=1)

    def _likelihood(self, world: FloatArray, flat: FloatArray, away: FloatArray, line: FloatArray) -> FloatArray:
        """Return how likely each cell is by one frame (T, CELLS, CELLS), 1 at most."""
        blocks = [slice(i, i + _BLOCK) for i in range(0, len(world), _BLOCK)]
        return np.concatenate([self._of_block(world[b], flat[b], away[b], line[b]) for b in blocks])

    def _of_block(self, world: FloatArray, flat: FloatArray, away: FloatArray, line: FloatArray) -> FloatArray:
        a, b, c = _SHOULDERS[self._side], _ELBOWS[self._side], _WRISTS[self._side]
        zu, zf = self._zu[None, :, None], self._zf[None, None, :]
        wide_u = 1.0 + zu / away[:, None, None]
        wide_w = 1.0 + (zu + zf) / away[:, None, None]
        upper = [flat[:, b, i, None, None] * wide_u - flat[:, a, i, None, None] for i in range(2)]
        fore = [flat[:, c, i, None, None] * wide_w - flat[:, b, i, None, None] * wide_u for i in range(2)]
        upper_drawn, fore_drawn = np.hypot(*upper), np.hypot(*fore)
        total = _heavy(upper_drawn - np.sqrt(self._upper**2 - zu**2), DRAWN_SD)
        total = total + _heavy(fore_drawn - np.sqrt(self._fore**2 - zf**2), DRAWN_SD)
        facing = (line[:, 0] / np.maximum(np.hypot(line[:, 0], line[:, 2]), 1e-9))[:, None, None]
        turned = (line[:, 2] / np.maximum(np.hypot(line[:, 0], line[:, 2]), 1e-9))[:, None, None]
        for first, last, z, (gain, offset, error) in ((a, b, zu, UPPER_SENSOR), (b, c, zf, FORE_SENSOR)):
            said = (world[:, last, 2] - world[:, first, 2])[:, None, None]
            total = total + _heavy(said - (gain * z - offset * facing), error)
        upper_long, fore_long = np.sqrt(upper_drawn**2 + zu**2), np.sqrt(fore_drawn**2 + zf**2)
        upper_ahead = (turned * upper[0] - facing * zu) / upper_long
        fore_ahead = (turned * fore[0] - facing * zf) / fore_long
        out = (1.0 if self._side == 0 else -1.0) * (facing * upper[0] + turned * zu) / upper_long
        bend = (upper[0] * fore[0] + upper[1] * fore[1] + zu * zf) / (upper_long * fore_long)
        for short, by in (
            (np.minimum(upper_ahead + 0.25, 0.0), 0.25),  # an upper arm hardly points backward,
            (np.minimum(fore_ahead, 0.0), 0.25),  # nor a forearm,
            (np.minimum(out + 0.35, 0.0), 0.2),  # nor an upper arm through the body,
            (np.minimum(bend + 0.75, 0.0), 0.1),  # and an elbow does not fold up
        ):
            total = total - 0.5 * (short / by) ** 2
        return np.exp(WEIGHT * (total - total.max(axis=(1, 2), keepdims=True)))


def _heavy(error: FloatArray, sd: float) -> FloatArray:
    """Return the logarithm of a density with heavy tails."""
    return -2.0 * np.log1p(error**2 / (4.0 * sd**2))


def _steps(nodes: FloatArray, frames: float) -> FloatArray:
    """Return the probability of each cell (to) after some frames for each cell before (from, to)."""
    apart = nodes[None] - nodes[:, None]
    total = sum(w * np.exp(-0.5 * (apart / (s * np.sqrt(frames))) ** 2) / s for w, s in STEPS)
    return np.asarray(total / np.sum(total, axis=1, keepdims=True))


def _spreads(landmarks: FloatArray, image: FloatArray, size: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Return how far shoulders and hips are spread, across and up: in metres and in pixels (T,) each."""
    return _spread(landmarks[:, _TRUNK, :2]), np.maximum(_spread(image[:, _TRUNK] * np.asarray(size, float)), 1e-6)


def _spread(points: FloatArray) -> FloatArray:
    return np.sqrt(((points - points.mean(axis=1, keepdims=True)) ** 2).sum(axis=-1).mean(axis=1))


def _metres(image: FloatArray, size: tuple[int, int], scale: FloatArray) -> FloatArray:
    """Return places in the picture from its centre, in the plane of the person (T, 33, 2) [m]."""
    return (image - 0.5) * np.asarray(size, dtype=np.float64) * scale[:, None, None]


def _away(size: tuple[int, int], scale: FloatArray) -> FloatArray:
    """Return the distance of the camera from the person (T,) [m]."""
    return LENS * max(size) * scale


def _left_line(landmarks: FloatArray) -> FloatArray:
    """Return the right -> left line of shoulders and hips (T, 3) [m]."""
    first, last = [_SHOULDERS[0], _HIPS[0]], [_SHOULDERS[1], _HIPS[1]]
    return (landmarks[:, first] - landmarks[:, last]).sum(axis=1)


def _lengths(landmarks: FloatArray, flat: FloatArray) -> FloatArray:
    """Return the lengths of upper arms, then forearms (T, 8) [m]: in the picture, then by the detector, both sides."""
    pairs = ((_SHOULDERS, _ELBOWS), (_ELBOWS, _WRISTS))
    return np.concatenate(
        [np.linalg.norm(p[:, b] - p[:, a], axis=-1) for a, b in pairs for p in (flat, landmarks)], axis=1
    )


def _slow(values: FloatArray, seconds: float) -> FloatArray:
    return gaussian_filter1d(values, seconds * RATE_HZ, axis=0, mode="nearest")


def _resampled(t: FloatArray, grid: FloatArray, values: FloatArray) -> FloatArray:
    flat = values.reshape(len(t), -1)
    return np.stack([np.interp(grid, t, column) for column in flat.T], axis=1).reshape(len(grid), *values.shape[1:])

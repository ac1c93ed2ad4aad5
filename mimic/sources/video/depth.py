"""Depth of elbows and wrists from their shoulder, which the detector hardly sees.

A small network looks at two seconds of landmarks, in the picture and as the detector places them, and says for each arm
how far elbow and wrist lie behind the shoulder, and how sure that is. It sees one arm at a time, as if it were the left
one. It was trained on rendered people (assets/depth/README.md), and knows the motion of real ones better than their
average pose, which is therefore in part the detector's. Live, the newest row is repeated, as the future is unknown.

Across and up, the arms come from the picture, with perspective.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import onnxruntime
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from mimic.io.assets import shipped
from mimic.records import ELBOWS, HIPS, LANDMARKS, SHOULDERS, WRISTS, FloatArray, PoseTrack, landmarks_of
from mimic.sources.video.screening import spread_of
from mimic.sources.video.smoothing import interpolated, segments

RATE_HZ = 15.0
"""Rate at which the network sees the landmarks [Hz]."""
WINDOW = 31
"""Rows that one answer follows from, as many before it as after it."""
FEATURES = 47
"""Numbers of a row that the network takes."""
SHORTEST = 4
"""Shorter segments are left as they are [rows at RATE_HZ]."""
LENS = 1.0
"""Focal length over the longer side of the picture: 0.7 to 1 of phones and webcams."""
UPPER_LENGTH = 1.10
"""Length of the upper arm over the longest seen; chosen as MEAN_SHARE is (lab/people/left_out.py)."""
FORE_LENGTH = 1.18
"""Length of the forearm over the longest seen; likewise."""
LEAST_LENGTH = 0.97
"""At least this share of the longest in the picture."""
DRAWN_QUANTILE = 0.95
"""Quantile over time that counts as the longest in the picture."""
SOLID_QUANTILE = 0.90
"""Quantile that counts as the longest by the detector."""
SURE_SHARE = 0.5
"""Share of the network's own doubt in the declared spread; chosen as MEAN_SHARE is (lab/people/left_out.py)."""
UNKNOWN = 0.04
"""What no picture tells of a person from the front, in quadrature with it [m]; chosen likewise."""
TURNED = 0.09
"""What turning away adds to that, times the sine of half the angle [m]; chosen likewise."""
MEAN_SHARE = 0.8
"""Share of the network in the average depth of an arm; the rest is the detector's (lab/people/left_out.py)."""
SLOW_S = 0.5
"""Standard deviation of the Gaussian over scale and heading of a clip [s]."""
MEAN_S = 1.0
"""Standard deviation of the Gaussian over the average depth of an arm [s]."""
FORGET_S = 1.0
"""A camera starts anew after a gap of this length [s]."""
PAST_S = 2.0
"""What it averages over [s]."""
REMEMBERED = 900
"""Frames of a camera in which bones are measured."""

_INDEX = landmarks_of("index")
_EARS = landmarks_of("ear")
_FINGERS = landmarks_of("pinky", "index", "thumb")
_NOSE = LANDMARKS.index("nose")
_TRUNK = [*SHOULDERS, *HIPS]


def with_depth(track: PoseTrack) -> PoseTrack:
    """Return the smooth track of a whole clip with arms of estimated depth, and its spread."""
    t = track.t
    size = track.size
    landmarks = np.array(track.landmarks, dtype=np.float64)
    spread = np.full((len(t), 2), np.nan)
    for rows in segments(t, np.flatnonzero(np.isfinite(landmarks[:, 0, 0])), track.cuts()):
        image = track.image[rows]
        grid, seen = sight(t[rows], landmarks[rows], image, track.score[rows], size)
        if len(grid) < SHORTEST:
            continue
        at_rows = PchipInterpolator(grid, _found(seen), axis=0)(np.minimum(t[rows], grid[-1]))
        scale = np.interp(t[rows], grid, seen.scale)
        landmarks[rows] = placed(landmarks[rows], image, size, scale, at_rows[..., :2])
        spread[rows] = at_rows[..., 2]
    return replace(track, landmarks=landmarks, depth_spread=spread)


class LiveDepth:
    """The same for a camera, frame by frame and from the past only."""

    def __init__(self) -> None:
        """Load the network, so that the first frame need not wait for it."""
        _network()
        self._rows: deque[tuple[float, FloatArray, FloatArray, FloatArray]] = deque()
        self._bones: deque[FloatArray] = deque(maxlen=REMEMBERED)

    def see(
        self, t: float, landmarks: FloatArray, image: FloatArray, score: FloatArray, size: tuple[int, int]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the landmarks with arms of estimated depth (33, 3) [m], and its spread (2,) [m].

        Args:
            t: Time of the frame [s].
            landmarks, image, score: One row of a pose track, of a person.
            size: Width and height of the picture [px].
        """
        if self._rows and t - self._rows[-1][0] > FORGET_S:
            self._rows.clear()
            self._bones.clear()
        self._rows.append((t, landmarks, image, score))
        while t - self._rows[0][0] > PAST_S:
            self._rows.popleft()
        times, world, picture, visible = (np.array(column) for column in zip(*self._rows, strict=True))
        grid = t - np.arange(round(PAST_S * RATE_HZ), -1, -1) / RATE_HZ
        seen = sight(times, world, picture, visible, size, grid)[1]
        flat = _metres(image[None], size, seen.scale[-1:])
        self._bones.append(_lengths(landmarks[None], flat)[0])
        seen.bones[:] = _longest(np.array(self._bones))
        found = _found(seen)[-1:]
        return placed(landmarks[None], image[None], size, seen.scale[-1:], found[..., :2])[0], found[0, :, 2]


def _found(seen: Seen) -> FloatArray:
    """Return the depth of elbow and wrist of both arms, and the spread of the latter (T, 2, 3) [m]."""
    depth, sure = _answer(seen.features())
    unlike = gaussian_filter1d(seen.detected() - depth, MEAN_S * RATE_HZ, axis=1, mode="nearest")
    away = np.abs(np.sin(np.arctan2(seen.line[:, 2:], seen.line[:, :1]) / 2))
    spread = np.hypot(SURE_SHARE * sure, UNKNOWN + TURNED * away)
    return np.moveaxis(np.concatenate([depth + (1.0 - MEAN_SHARE) * unlike, spread], axis=2), 0, 1)


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
    flat = _metres(image, size, scale)
    away = LENS * max(size) * scale
    result = np.array(landmarks, dtype=np.float64)
    for side in range(2):
        shoulder = SHOULDERS[side]
        for part, point in enumerate((ELBOWS[side], WRISTS[side])):
            z = depth[:, side, part]
            across = flat[:, point] * (1.0 + z / away)[:, None] - flat[:, shoulder]
            result[:, point] = landmarks[:, shoulder] + np.column_stack([across, z])
        moved = result[:, WRISTS[side]] - landmarks[:, WRISTS[side]]
        result[:, _FINGERS[side::2]] += moved[:, None]
    return result


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What the network sees of a person, at RATE_HZ."""

    world: FloatArray
    """Mid-hip -> landmark (T, 33, 3), camera axes [m]."""
    flat: FloatArray
    """Place in the picture from its centre, in the plane of the person (T, 33, 2) [m]."""
    score: FloatArray
    """Visibility (T, 33)."""
    scale: FloatArray
    """Of the picture (T,) [m/px]."""
    line: FloatArray
    """Slow right -> left line of shoulders and hips, by the detector (T, 3) [m]."""
    bones: FloatArray
    """Lengths of upper arm and forearm (T, 2) [m]."""

    def features(self) -> FloatArray:
        """Return what the network takes of each arm (2, T, FEATURES), the right one in the mirror."""
        return np.stack([self._of_arm(side) for side in range(2)])

    def detected(self) -> FloatArray:
        """Return the depth of elbow and wrist from the shoulder as the detector places them (2, T, 2) [m]."""
        z = self.world[..., 2]
        return np.stack([z[:, [ELBOWS[i], WRISTS[i]]] - z[:, [SHOULDERS[i]]] for i in range(2)])

    def _of_arm(self, side: int) -> FloatArray:
        other = 1 - side
        mirror = 1.0 - 2.0 * side
        rows = len(self.world)
        points = [
            ELBOWS[side], WRISTS[side], _INDEX[side], SHOULDERS[other], ELBOWS[other], WRISTS[other],
            HIPS[side], HIPS[other], _NOSE, _EARS[side], _EARS[other],
        ]  # fmt: skip
        drawn = (self.flat[:, points] - self.flat[:, [SHOULDERS[side]]]) * (mirror, 1.0)
        solid = (self.world[:, points] - self.world[:, [SHOULDERS[side]]]) * (mirror, 1.0, 1.0)
        heading = self.line[:, [0, 2]] * (1.0, mirror)
        heading = heading / np.maximum(np.linalg.norm(heading, axis=1, keepdims=True), 1e-9)
        upper = drawn[:, 0]
        fore = drawn[:, 1] - drawn[:, 0]
        drawn_share = np.linalg.norm(np.stack([upper, fore], axis=1), axis=2) / self.bones
        arms = [ELBOWS[side], WRISTS[side], ELBOWS[other], WRISTS[other]]
        columns = (drawn, solid[..., 2], solid[:, :2, :2], heading, self.score[:, arms], drawn_share, self.bones)
        return np.concatenate([column.reshape(rows, -1) for column in columns], axis=1)


def sight(
    t: FloatArray,
    landmarks: FloatArray,
    image: FloatArray,
    score: FloatArray,
    size: tuple[int, int],
    grid: FloatArray | None = None,
) -> tuple[FloatArray, Seen]:
    """Return times at RATE_HZ and what the network sees of a segment of a track then.

    Args:
        t, landmarks, image, score, size: As in a pose track, without gaps.
        grid: Other times than from the first row on.
    """
    grid = np.arange(float(t[0]), float(t[-1]) + 1e-9, 1.0 / RATE_HZ) if grid is None else grid
    world, picture, visible = (interpolated(grid, t, values) for values in (landmarks, image, score))
    slow = gaussian_filter1d(_to_average(world, picture, size), SLOW_S * RATE_HZ, axis=0, mode="nearest")
    scale = slow[:, 0] / slow[:, 1]
    flat = _metres(picture, size, scale)
    bones = np.tile(_longest(_lengths(world, flat)), (len(world), 1))
    return grid, Seen(world, flat, visible, scale, slow[:, 2:], bones)


def framed(features: FloatArray) -> FloatArray:
    """Return features (..., T + WINDOW - 1, FEATURES) that give T answers: the first and last row go on."""
    around = [(0, 0)] * (features.ndim - 2) + [(WINDOW // 2, WINDOW // 2), (0, 0)]
    return np.pad(features, around, mode="edge")


@cache
def _network() -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    path = shipped("assets", "depth", "arms.onnx")
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def _answer(features: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return depth of elbow and wrist (2, T, 2) [m] and spread of the latter (2, T, 1) [m]."""
    (found,) = _network().run(None, {"features": framed(features).astype(np.float32)})
    found = np.asarray(found, dtype=np.float64)
    return found[..., :2], found[..., 2:3]


def _to_average(landmarks: FloatArray, image: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return how far shoulders and hips are spread [m, px], and their right -> left line [m] (T, 5)."""
    first = [SHOULDERS[0], HIPS[0]]
    last = [SHOULDERS[1], HIPS[1]]
    line = (landmarks[:, first] - landmarks[:, last]).sum(axis=1)
    drawn = np.maximum(spread_of(image[:, _TRUNK] * np.asarray(size, float)), 1e-6)
    return np.column_stack([spread_of(landmarks[:, _TRUNK, :2]), drawn, line])


def _metres(image: FloatArray, size: tuple[int, int], scale: FloatArray) -> FloatArray:
    """Return places in the picture from its centre, in the plane of the person (T, 33, 2) [m]."""
    return (image - 0.5) * np.asarray(size, dtype=np.float64) * scale[:, None, None]


def _lengths(landmarks: FloatArray, flat: FloatArray) -> FloatArray:
    """Return the lengths of the bones (T, 2, 2, 2) [m]: upper arm, forearm; in the picture, by the detector; sides."""

    def bones(places: FloatArray) -> FloatArray:
        joints = places[:, [SHOULDERS, ELBOWS, WRISTS]]
        return np.linalg.norm(np.diff(joints, axis=1), axis=-1)

    return np.stack([bones(flat), bones(landmarks)], axis=2)


def _longest(lengths: FloatArray) -> FloatArray:
    """Return the lengths of upper arm and forearm (2,) [m] from what was seen of them (T, 2, 2, 2)."""
    drawn = np.quantile(lengths[:, :, 0], DRAWN_QUANTILE, axis=(0, 2))
    solid = np.quantile(lengths[:, :, 1], SOLID_QUANTILE, axis=(0, 2))
    return np.maximum((UPPER_LENGTH, FORE_LENGTH) * np.maximum(drawn, solid), LEAST_LENGTH * drawn)

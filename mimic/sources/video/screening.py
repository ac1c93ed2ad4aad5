"""Checks that a clip shows one person in one shot."""

from __future__ import annotations

import numpy as np

from mimic.records import (
    ELBOWS,
    HIPS,
    KNEES,
    LANDMARKS,
    SHOULDERS,
    WRISTS,
    BoolArray,
    FloatArray,
    IntArray,
    PoseTrack,
    landmarks_of,
)

CUT_CHANGE = 8.0
"""Minimum thumbnail change at a cut [grey levels of 255]; a hard cut between similar rooms gives 22."""
CUT_RATIO = 4.0
"""Minimum ratio to the change in neighbouring frames: 12 at that cut, at most 2.1 in fourteen clips without a cut."""
SHORTEST = 0.1
"""A clip or a recording is no shorter: the usual time between two targets [s]."""
JUMP = 7.5
"""Faster than this no hip and no wrist moves [m/s], 0.25 m in a frame of FRAME and as far in a shorter one."""
FRAME = 1 / 30
MOST_JUMPS = 0.05
"""A larger share of frames with a jump is reported."""

UNSTEADY = (0.145, 0.075)
"""What `unsteadiness` of both kinds must exceed where no body is: of 25 clips of people at most 0.12 and 0.06, of five
phantoms (a foot in a pool, a fist before a face, dances of several people) at least 0.17 and 0.09."""
ACROSS = 53.0
"""Usual lean of a trunk that lies across the picture [deg]: of who stands or sits at most 33, turned by 90° 57."""
FRONT = 1.85
"""Distance of the ears over that of eyes and mouth of a face from the front; of nose and ears from the side it is 1."""
SQUEEZED = (0.84, 1.28)
"""Least and most width over height of a person in the picture, as a share of people's: of 38 clips 0.86 to 1.22, of
eleven in half the width at most 0.82, of five in half the height at least 1.33."""
BENT = 45.0
"""Bend of the hips in the picture beyond which a person does not stand, in a fifth of the rows [deg]: of people who
stand at most 34, who squat, sit or lie at least 53."""
LEANT = 35.0
"""The same for the lean of the trunk [deg]: of people who stand at most 23."""

_TRUNK = SHOULDERS + HIPS
_EARS = landmarks_of("ear")
_EYES = landmarks_of("eye")
_MOUTH = [LANDMARKS.index("mouth_left"), LANDMARKS.index("mouth_right")]
_NOSE = LANDMARKS.index("nose")
_UPPER = [*SHOULDERS, *ELBOWS, *WRISTS, *HIPS, _NOSE]
_BONES = np.array([(11, 12), (11, 13), (12, 14), (13, 15), (14, 16)])
"""Shoulder line, upper arms and forearms in LANDMARKS."""


def person_rows(score: FloatArray, min_visibility: float) -> BoolArray:
    """Return the rows (T,) that show a person: both shoulders and a wrist are visible.

    A detection alone is not a person: BlazePose reports one in 23 % of the frames of a clip of bottles.

    Args:
        score: Visibility (T, 33).
        min_visibility: Minimum visibility of a detected landmark.
    """
    seen = score >= min_visibility
    return np.logical_and(seen[:, SHOULDERS].all(axis=1), seen[:, WRISTS].any(axis=1))


def shot_starts(change: FloatArray) -> IntArray:
    """Return the first row after each cut.

    Args:
        change: Difference of each frame's thumbnail from the previous one (T,) [grey levels].
    """
    neighbours = [np.roll(np.pad(change, 3), k)[3:-3] for k in (-3, -2, -1, 1, 2, 3)]
    return np.flatnonzero((change > CUT_CHANGE) & (change > CUT_RATIO * (np.max(neighbours, axis=0) + 1.0)))


def jump_share(track: PoseTrack) -> float:
    """Return the share of frames in which a wrist or the whole person moves faster than JUMP."""
    rows = np.flatnonzero(track.valid[:, SHOULDERS].all(axis=1))
    if len(rows) < 2:
        return 0.0
    limit = JUMP * np.maximum(FRAME, np.diff(track.t[rows]))
    wrists = np.where(track.valid[rows][:, WRISTS, None], track.landmarks[rows][:, WRISTS], np.nan)
    wrists_moved = np.linalg.norm(np.diff(wrists, axis=0), axis=-1)
    pixels = in_pixels(track)[rows][:, _TRUNK]
    metres = track.landmarks[rows][:, _TRUNK, :2]
    scale = np.median(spread_of(metres) / np.maximum(spread_of(pixels), 1e-9))
    body_moved = scale * np.linalg.norm(np.diff(pixels[:, :2].mean(axis=1), axis=0), axis=-1)
    return float(((wrists_moved > limit[:, None]).any(axis=1) | (body_moved > limit)).mean())


def in_pixels(track: PoseTrack) -> FloatArray:
    """Return where the landmarks are in the picture (T, 33, 2) [px]."""
    return track.image * np.asarray(track.size, dtype=np.float64)


def trunk_of(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the middle of the shoulders and the height of the trunk, at least the width of the shoulders.

    Args:
        points: Landmarks (..., 33, 2), in one unit across and down.
    """
    left = points[..., SHOULDERS[0], :]
    right = points[..., SHOULDERS[1], :]
    middle = (left + right) / 2
    high = np.linalg.norm(points[..., HIPS, :].mean(axis=-2) - middle, axis=-1)
    return middle, np.maximum(high, np.linalg.norm(left - right, axis=-1))


def spread_of(points: FloatArray) -> FloatArray:
    """Return the root mean square distance of points (T, N, 2) from their mean (T,)."""
    return np.sqrt(((points - points.mean(axis=1, keepdims=True)) ** 2).sum(axis=-1).mean(axis=1))


def unsteadiness(track: PoseTrack, rows: BoolArray) -> FloatArray:
    """Return how much the bones of a found body change, and its size in the picture from one row to the next.

    First is the standard deviation over the mean of arms and shoulder line, last the 90th percentile of the change
    of the natural logarithm of pixels in a metre, in the rows (T,) that show a person.
    """
    metres = track.landmarks[rows]
    pixels = in_pixels(track)[rows]
    bones = np.linalg.norm(metres[:, _BONES[:, 0]] - metres[:, _BONES[:, 1]], axis=-1)
    scale = np.log(spread_of(pixels[:, _UPPER]) / spread_of(metres[:, _UPPER, :2]))
    steps = np.abs(np.diff(scale))[np.diff(np.flatnonzero(rows)) == 1]
    return np.array([(bones.std(axis=0) / bones.mean(axis=0)).mean(), np.quantile(steps, 0.9) if len(steps) else 0.0])


def is_invented(track: PoseTrack, rows: BoolArray) -> bool:
    """Return whether a body that was found in some rows (T,) is none: neither its bones nor its size keep."""
    return rows.sum() > 2 and bool((unsteadiness(track, rows) > UNSTEADY).all())


def posture(track: PoseTrack) -> str:
    """Return a sentence about a picture that is turned or squeezed, or a person who does not stand; else nothing."""
    rows = track.valid[:, _TRUNK].all(axis=1)
    if not rows.any():
        return ""
    pixels = in_pixels(track)[rows]
    trunk = pixels[:, SHOULDERS].mean(axis=1) - pixels[:, HIPS].mean(axis=1)
    lean = np.degrees(np.arctan2(np.abs(trunk[:, 0]), -trunk[:, 1]))
    usual = np.median(lean)
    if usual > 180.0 - ACROSS:
        return "the shoulders are below the hips; if the video is upside down, rotate it"
    if usual > ACROSS:
        return (
            "the trunk lies across the picture; if the video is turned by 90°, rotate it; if the person leans or lies, "
            "the robot does not"
        )
    shape = _width_over_height(pixels, track.landmarks[rows])
    squeezed = "than people are; if the picture is squeezed, restore its width and height"
    if shape > SQUEEZED[1]:
        return f"the person is wider {squeezed}"
    if np.quantile(lean, 0.8) > LEANT or _hips_bent(track) > BENT:
        return (
            "the person bends, sits, squats or leans: the robot follows how height and lean change, as far as it can, "
            "and not the posture"
        )
    return f"the person is narrower {squeezed}" if shape < SQUEEZED[0] else ""


def _width_over_height(pixels: FloatArray, landmarks: FloatArray) -> float:
    """Return the usual width over height of a person as a share of people's; 1 from behind.

    It is that of the face, which tells by nose and ears how far it is turned, times that of the upper body over the
    same in the landmarks.

    Args:
        pixels: Of a person in the picture (T, 33, 2) [px].
        landmarks: Of the same (T, 33, 3) [m].
    """
    if np.median(pixels[:, SHOULDERS[0], 0] - pixels[:, SHOULDERS[1], 0]) < 0:
        return 1.0
    down = pixels[:, _MOUTH].mean(axis=1) - pixels[:, _EYES].mean(axis=1)
    across = down[:, ::-1] * (-1, 1) / np.maximum((down**2).sum(axis=-1, keepdims=True), 1.0)
    ears = ((pixels[:, _EARS[0]] - pixels[:, _EARS[1]]) * across).sum(axis=-1)
    nose = ((pixels[:, _NOSE] - pixels[:, _EARS].mean(axis=1)) * across).sum(axis=-1)
    scale = pixels[:, _UPPER].std(axis=1) / landmarks[:, _UPPER, :2].std(axis=1)
    return float(np.median(np.hypot(ears / FRONT, nose) * scale[:, 0] / scale[:, 1]))


def _hips_bent(track: PoseTrack) -> float:
    """Return the bend of the straighter hip that a fifth of the rows exceeds [deg]; 0 where no knee is seen."""
    rows = track.valid[:, _TRUNK].all(axis=1) & track.valid[:, KNEES].any(axis=1)
    if not rows.any():
        return 0.0
    shoulders, hips, knees = (track.landmarks[rows][:, limb] for limb in (SHOULDERS, HIPS, KNEES))
    trunk = (shoulders - hips).mean(axis=1, keepdims=True)
    thighs = knees - hips
    cosine = -(thighs * trunk).sum(axis=-1) / np.linalg.norm(thighs, axis=-1) / np.linalg.norm(trunk, axis=-1)
    return float(np.quantile(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).min(axis=1), 0.8))

"""Which way a person's trunk faces: what one camera shows of it besides the detector's depth.

The detector takes people for facing the camera more than they do (at a desk by 19 degrees on average), and sees them
along the line of sight, which is not the camera's axis for who stands beside the middle of the picture. The width of
the shoulders over the height of the trunk tells how far a trunk is turned, but not which way. Both have a say.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mimic.records import HIPS, SHOULDERS, BoolArray, FloatArray, PoseTrack, landmarks_of
from mimic.sources.video.screening import in_pixels

WIDTH = 0.70
"""Width of the shoulders over the height of the trunk, as the detector has them from the front."""
LEANING = 0.85
"""A greater one is of a trunk that leans to the camera, and tells nothing."""
SHARE = 0.25
"""Share of the shoulders' width in the heading; chosen with WIDTH by lab/people/left_out.py."""
FOCAL = 0.75
"""Focal length of a camera of which nothing is known [longer sides of the picture]."""

_ARMS = landmarks_of("shoulder", "elbow", "wrist", "pinky", "index", "thumb")
"""What moves with a shoulder, left and right in turn."""
_LEGS = landmarks_of("hip", "knee", "ankle", "heel", "foot_index")
"""What moves with a hip, left and right in turn."""


def with_heading(track: PoseTrack) -> PoseTrack:
    """Return a track whose lines of shoulders and hips face where the person does; arms and legs go with them.

    Each shot is turned by one angle.
    """
    landmarks = track.landmarks
    pixels = in_pixels(track)
    result = track.landmarks.copy()
    for rows in np.split(np.arange(len(landmarks)), track.cuts()):
        turn = _turn(landmarks[rows], pixels[rows], track.valid[rows], track.size)
        c = np.cos(turn)
        s = np.sin(turn)
        for left, right in ((_ARMS[::2], _ARMS[1::2]), (_LEGS[::2], _LEGS[1::2])):
            half = (landmarks[rows, left[0]] - landmarks[rows, right[0]]) / 2
            x = half[:, 0]
            z = half[:, 2]
            moved = np.stack([c * x - s * z - x, np.zeros(len(x)), s * x + c * z - z], axis=-1)[:, None]
            result[rows[:, None], left] += moved
            result[rows[:, None], right] -= moved
    return replace(track, landmarks=result)


def _turn(landmarks: FloatArray, pixels: FloatArray, valid: BoolArray, size: tuple[int, int]) -> float:
    """Return by how much the trunk of a shot must be turned to the left [rad]."""
    rows = valid[:, SHOULDERS].all(axis=1)
    if not rows.any():
        return 0.0
    line = landmarks[:, SHOULDERS[0]] - landmarks[:, SHOULDERS[1]]
    line = line + valid[:, HIPS].min(axis=1, keepdims=True) * (landmarks[:, HIPS[0]] - landmarks[:, HIPS[1]])
    middle = pixels[rows][:, SHOULDERS].mean(axis=1)
    aside = np.arctan((np.median(middle[:, 0]) - size[0] / 2) / (FOCAL * max(size)))
    x, _, z = np.median(line[rows], axis=0)
    heading = (np.arctan2(z, x) - aside + np.pi) % (2 * np.pi) - np.pi
    wide = np.linalg.norm(pixels[rows, SHOULDERS[0]] - pixels[rows, SHOULDERS[1]], axis=-1)
    high = np.linalg.norm(middle - pixels[rows][:, HIPS].mean(axis=1), axis=-1)
    ratio = float(np.median(wide / np.maximum(high, 1.0)))
    if ratio > LEANING:
        return float(-aside)
    away = np.arccos(min(1.0, ratio / WIDTH))  # from the line of sight, whichever way
    found = np.arccos(abs(np.cos(heading)))
    outward = np.sign(np.sin(2 * heading)) or 1.0
    return float(SHARE * (away - found) * outward - aside)

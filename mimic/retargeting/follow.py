"""Walking velocity of the person, from their size and position in the picture.

Distance is the focal length times the trunk's metres over its size in the picture; the focal length of an unknown
camera is assumed. Speeds are therefore right to a factor of about 1.3, and a person who bends or crouches seems to
walk; hence the slow filter and the dead zone.
"""

from __future__ import annotations

import numpy as np

from mimic.records import HIPS, SHOULDERS, BoolArray, FloatArray
from mimic.retargeting.one_euro import weight_of_new

FOCAL = 0.87
"""Focal length over the picture's width: 60 degrees across, as most webcams have."""
WALK_HZ = 0.4
"""Cut-off of position and velocity [Hz]."""
DEAD = 0.08
"""Dead zone of the speed [m/s]."""
FORGET = 1.0
"""The filter restarts after a gap of this length [s]."""

_TRUNK = [*SHOULDERS, *HIPS]


class Follower:
    """The person's speed along where they face, from row to row."""

    def __init__(self) -> None:
        self._t = -np.inf
        self._slow = np.zeros(2)
        self._v = np.zeros(2)

    def see(
        self, t: float, heading: float, landmarks: FloatArray, image: FloatArray, valid: BoolArray, aspect: float
    ) -> float:
        """Return the forward speed [m/s], 0 within the dead zone or where shoulders and hips are not all seen.

        Args:
            t: Time [s].
            heading: Of the torso; 0 faces the camera [rad].
            landmarks: Mid-hip -> landmark (33, 3), camera axes [m].
            image: Place in the image (33, 2), fraction of width and height.
            valid: Which landmarks count (33,).
            aspect: Width of the image over its height.
        """
        if not valid[_TRUNK].all():
            return 0.0
        flat = image[_TRUNK] * (1.0, 1.0 / aspect)
        away = FOCAL * _size(landmarks[_TRUNK][:, :2]) / max(_size(flat), 1e-6)
        place = np.array([away * (flat[:, 0].mean() - 0.5) / FOCAL, away])
        dt = t - self._t
        if not 0.0 < dt < FORGET:
            self._slow = place
            self._v = np.zeros(2)
        else:
            share = weight_of_new(WALK_HZ, dt)
            before = self._slow
            self._slow = before + share * (place - before)
            self._v = self._v + share * ((self._slow - before) / dt - self._v)
        self._t = t
        speed = float(self._v @ (np.sin(heading), -np.cos(heading)))
        return speed if abs(speed) > DEAD else 0.0


def _size(points: FloatArray) -> float:
    """Return the root mean square distance of points (n, 2) from their middle."""
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))

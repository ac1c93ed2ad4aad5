"""BlazePose, as the mediapipe wheel carries it: one RGB frame in, 33 landmarks of one person out.

Complexity 1 is the only model that the wheel contains (0 and 2 would be downloaded). The detector's own smoothing is off:
it lags, and :mod:`mimic.sources.smoothing` does it without lag.

BlazePose is 2.5-D: in the image plane wrists are good (r 0.93-1.00, gain 0.85-1.05, 20-55 mm); along the camera axis they
are weak (gain 0.2-0.7, 60-180 mm).
"""

from __future__ import annotations

import warnings
from types import TracebackType
from typing import Any, Self

import numpy as np

from mimic.sources.quiet import quiet_stderr
from mimic.types import FloatArray

_SEEN = tuple[FloatArray, FloatArray, FloatArray]


class BlazePose:
    """The detector, following one person from frame to frame; use it in a ``with`` block."""

    def __enter__(self) -> Self:
        self._warnings = warnings.catch_warnings()
        self._warnings.__enter__()
        warnings.filterwarnings("ignore", message="SymbolDatabase.GetPrototype")
        with quiet_stderr():
            from mediapipe.python.solutions import pose

            self._pose: Any = pose.Pose(model_complexity=1, smooth_landmarks=False)
            self._pose.process(np.zeros((64, 64, 3), np.uint8))  # its threads log when they see the first picture
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._pose.close()
        self._warnings.__exit__(kind, error, traceback)

    def __call__(self, rgb: np.ndarray) -> _SEEN | None:
        """Return what is seen in the next frame of the video, None where no pose is found.

        Args:
            rgb: Upright picture (H, W, 3), uint8.

        Returns:
            Mid-hip -> landmark (33, 3), camera axes [m]; place in the image (33, 2), fraction of width and height;
            visibility (33,), 0 to 1.
        """
        rgb.flags.writeable = False  # mediapipe then takes the picture by reference
        found = self._pose.process(rgb)
        if found.pose_world_landmarks is None:
            return None
        world, image = found.pose_world_landmarks.landmark, found.pose_landmarks.landmark
        return (
            np.array([(p.x, p.y, p.z) for p in world]),
            np.array([(p.x, p.y) for p in image]),
            np.array([p.visibility for p in image]),
        )

"""BlazePose from the mediapipe wheel: one RGB frame in, 33 landmarks of one person out.

Complexity 1 is the only model that the wheel contains (0 and 2 would be downloaded). The detector's own smoothing
adds lag and is off; `mimic.sources.video.smoothing` smooths without lag.

BlazePose is 2.5-D. In the image plane the wrists are accurate (r 0.93-1.00, gain 0.85-1.05, error 20-55 mm). Along the
camera axis they are poor (gain 0.2-0.7, error 60-180 mm).
"""

from __future__ import annotations

import warnings
from types import TracebackType
from typing import Any, Self

import numpy as np

from mimic.records import FloatArray
from mimic.sources.video.quiet import quiet_stderr

_Detection = tuple[FloatArray, FloatArray, FloatArray]


class BlazePose:
    """The detector, which tracks one person from frame to frame; use it in a ``with`` block."""

    def __enter__(self) -> Self:
        self._warnings = warnings.catch_warnings()
        self._warnings.__enter__()
        warnings.filterwarnings("ignore", message="SymbolDatabase.GetPrototype")
        with quiet_stderr():
            from mediapipe.python.solutions import pose

            self._pose: Any = pose.Pose(model_complexity=1, smooth_landmarks=False)
            self._pose.process(np.zeros((64, 64, 3), np.uint8))  # its threads write messages at the first picture
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._pose.close()
        self._warnings.__exit__(kind, error, traceback)

    def __call__(self, rgb: np.ndarray) -> _Detection | None:
        """Return the landmarks in the next frame of the video, None if no pose is detected.

        Args:
            rgb: Upright picture (H, W, 3), uint8.

        Returns:
            Mid-hip -> landmark (33, 3), camera axes [m]; image coordinates (33, 2), fractions of width and
            height; visibility (33,), 0 to 1.
        """
        rgb.flags.writeable = False  # mediapipe then takes the picture without a copy
        found = self._pose.process(rgb)
        if found.pose_world_landmarks is None:
            return None
        world, image = found.pose_world_landmarks.landmark, found.pose_landmarks.landmark
        return (
            np.array([(p.x, p.y, p.z) for p in world]),
            np.array([(p.x, p.y) for p in image]),
            np.array([p.visibility for p in image]),
        )

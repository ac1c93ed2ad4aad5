"""BlazePose by mediapipe's Tasks API: one RGB frame in, 33 landmarks of one person out.

BlazePose is 2.5-D. In the image plane the wrists are accurate (r 0.93-1.00, gain 0.85-1.05, error 20-55 mm). Along the
camera axis they are poor (gain 0.2-0.7, error 60-180 mm).
"""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any, Self

import numpy as np

from mimic.errors import AssetError
from mimic.records import FloatArray
from mimic.sources.video.quiet import quiet_stderr

_Detection = tuple[FloatArray, FloatArray, FloatArray]
NOBODY: _Detection = np.full((33, 3), np.nan), np.full((33, 2), np.nan), np.zeros(33)
"""What stands in a track for a frame without a person."""

_STEP_MS = 10_000_000
"""Time between two frames as the detector is told [ms].

It smooths landmarks by One-Euro filters, which add lag (`mimic.sources.video.smoothing` smooths without). Their lowest
cut-off is 0.01 Hz; over a frame interval this long they keep less than 0.2 % of the previous frame.
"""


class _Landmarker:
    """mediapipe's landmarker of poses; use it in a ``with`` block."""

    mode = "VIDEO"
    most = 1

    def __init__(self, model: Path) -> None:
        """Take the bundle of models that `mimic.sources.video.pose_models.pose_model` returns."""
        self._model = model
        self._frames = 0
        self._seen = False

    def __enter__(self) -> Self:
        with quiet_stderr():
            import mediapipe
            from mediapipe.tasks.python import BaseOptions, vision

            self._image = mediapipe.Image
            self._format = mediapipe.ImageFormat.SRGB
            options = vision.PoseLandmarkerOptions(
                base_options=BaseOptions(model_asset_path=str(self._model)),
                running_mode=vision.RunningMode[self.mode],
                num_poses=self.most,
            )
            try:
                self._pose: Any = vision.PoseLandmarker.create_from_options(options)
            except (RuntimeError, ValueError, OSError) as reason:
                raise AssetError(
                    f"mediapipe cannot use the pose model {self._model} ({str(reason).splitlines()[0]}); remove it: it "
                    "is made anew"
                ) from None
        return self

    def __exit__(self, *_: object) -> None:
        with quiet_stderr():
            self._pose.close()

    def _picture(self, rgb: np.ndarray) -> Any:
        return self._image(image_format=self._format, data=np.ascontiguousarray(rgb))


class BlazePose(_Landmarker):
    """The detector, which tracks one person from frame to frame."""

    def forget(self) -> None:
        """Forget who was followed: in the next frame it looks for anybody."""
        for _ in range(2):
            self(np.zeros((64, 64, 3), np.uint8))

    def __call__(self, rgb: np.ndarray) -> _Detection | None:
        """Return the landmarks in the next frame of the video, None if no pose is detected.

        Args:
            rgb: Upright picture (H, W, 3), uint8.

        Returns:
            Mid-hip -> landmark (33, 3), camera axes [m]; image coordinates (33, 2), fractions of width and
            height; visibility (33,), 0 to 1.
        """
        with nullcontext() if self._seen else quiet_stderr():  # it writes messages up to the first person
            found = self._pose.detect_for_video(self._picture(rgb), self._frames * _STEP_MS)
        self._frames += 1
        if not found.pose_world_landmarks:
            return None
        self._seen = True
        world = np.array([(p.x, p.y, p.z) for p in found.pose_world_landmarks[0]])
        return world, *_in_picture(found.pose_landmarks[0])


class Everybody(_Landmarker):
    """Finds up to five people in a picture by itself."""

    mode = "IMAGE"
    most = 5

    def __call__(self, rgb: np.ndarray) -> list[tuple[FloatArray, FloatArray]]:
        """Return image coordinates (33, 2), fractions of width and height, and visibility (33,) of each."""
        with quiet_stderr():
            return [_in_picture(pose) for pose in self._pose.detect(self._picture(rgb)).pose_landmarks]


def _in_picture(pose: Any) -> tuple[FloatArray, FloatArray]:
    return np.array([(p.x, p.y) for p in pose]), np.array([p.visibility for p in pose])

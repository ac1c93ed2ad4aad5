"""What all records share: array types, the labels of their axes, and the check of every array."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mimic.errors import ContractError
from mimic.frozen import frozen_arrays
from mimic.records.table import ShownAsTable

FloatArray = NDArray[np.floating[Any]]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.integer[Any]]

LEGS = ("FL", "FR", "RL", "RR")
"""Roles of the legs: front left, front right, rear left, rear right."""

JOINTS = tuple(f"{leg}_{part}" for leg in LEGS for part in ("abad", "hip", "knee"))
"""Roles of the joints, and the order of every (12,) joint array: abad turns about +x, hip and knee about +y. A robot's
own names of its joints stand in its description."""


def joint_names(joints: Iterable[int]) -> str:
    """Return the roles of joints, for a sentence."""
    return ", ".join(JOINTS[j] for j in joints)


SIDES = ("left", "right")

LANDMARKS = (
    "nose",
    "left_eye_inner",
    "left_eye",
    "left_eye_outer",
    "right_eye_inner",
    "right_eye",
    "right_eye_outer",
    "left_ear",
    "right_ear",
    "mouth_left",
    "mouth_right",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_pinky",
    "right_pinky",
    "left_index",
    "right_index",
    "left_thumb",
    "right_thumb",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
    "left_heel",
    "right_heel",
    "left_foot_index",
    "right_foot_index",
)
"""The 33 landmarks of BlazePose, in its order. Left and right are the person's."""


def landmarks_of(*parts: str) -> list[int]:
    """Return where the left and the right one of each of these parts of the body are in LANDMARKS."""
    return [LANDMARKS.index(f"{side}_{part}") for part in parts for side in SIDES]


SHOULDERS = landmarks_of("shoulder")
"""Left and right in LANDMARKS."""
ELBOWS = landmarks_of("elbow")
WRISTS = landmarks_of("wrist")
HIPS = landmarks_of("hip")
KNEES = landmarks_of("knee")

AXES: Mapping[str, tuple[str, ...]] = {
    "xyz": ("x", "y", "z"),
    "xy": ("x", "y"),
    "uv": ("u", "v"),
    "height_pitch": ("height", "pitch"),
    "wxyz": ("w", "x", "y", "z"),
    "side": SIDES,
    "joint": JOINTS,
}
"""Labels of the axes that every record shares."""


def array(*axes: str, dtype: type = np.float64, optional: bool = False, **kwargs: Any) -> Any:
    """Declare an array field: one row a time, then the named axes (see AXES; other names have no fixed length).

    An optional field is NaN where it is not given, as in a file of an earlier version.
    """
    if optional:
        kwargs.setdefault("default", None)
    return field(metadata={"axes": axes, "dtype": dtype, "optional": optional}, **kwargs)


class Record(ShownAsTable):
    """Base of the frozen records: arrays are copied, made read-only, checked for shape; times do not decrease."""

    __slots__ = ()

    def __post_init__(self) -> None:
        rows: int | None = None
        for f in fields(self):  # type: ignore[arg-type]
            axes = f.metadata.get("axes")
            if axes is None:
                continue
            labels = [self.labels(axis) for axis in axes]
            expected = tuple(-1 if names is None else len(names) for names in labels)
            given = getattr(self, f.name)
            if given is None and f.metadata["optional"]:
                given = np.full((rows or 0, *expected), np.nan)
            value = np.array(given, dtype=f.metadata["dtype"])
            rows = value.shape[0] if rows is None and value.ndim else rows
            fits = value.ndim == 1 + len(axes) and value.shape[0] == rows
            if not fits or any(e not in (-1, s) for e, s in zip(expected, value.shape[1:], strict=True)):
                wanted = ", ".join([str(rows), *("any" if e < 0 else str(e) for e in expected)])
                raise ContractError(f"{type(self).__name__}.{f.name} has shape {value.shape}; expected ({wanted})")
            if f.name == "t" and (np.diff(value) < 0.0).any():
                row = int(np.argmax(np.diff(value) < 0.0)) + 1
                raise ContractError(
                    f"{type(self).__name__}.t decreases: row {row} is at {value[row]:g} s, after {value[row - 1]:g} s"
                )
            value.setflags(write=False)
            object.__setattr__(self, f.name, value)

    def labels(self, axis: str) -> tuple[str, ...] | None:
        """Return the labels of an axis, or None where its length is free."""
        return AXES.get(axis)


@frozen_arrays
class Provenance:
    """Where a stored record came from."""

    version: str
    """Version of mimic that wrote it."""
    command: str = ""
    """The command line, or the call."""
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """The settings used, as plain data."""
    inputs: Mapping[str, str] = field(default_factory=dict[str, str])
    """Name of each input -> its SHA-256."""

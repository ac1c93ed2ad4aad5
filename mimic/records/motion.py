"""What a source shows and what becomes of it: pose, wrists, toe targets, commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, Protocol, runtime_checkable

import numpy as np

from mimic.errors import ContractError
from mimic.frozen import frozen_arrays
from mimic.records.base import AXES, LANDMARKS, BoolArray, FloatArray, IntArray, Record, array


@frozen_arrays
class PoseTrack(Record):
    """A person's landmarks, one row for every frame of the source."""

    t: FloatArray = array()
    """Time of the frame since the first [s], strictly increasing."""
    landmarks: FloatArray = array("landmark", "xyz")
    """Mid-hip -> landmark, camera axes [m]; NaN where nothing was seen."""
    image: FloatArray = array("landmark", "uv")
    """Position in the upright image, as a fraction of its width and height; NaN where nothing was seen."""
    score: FloatArray = array("landmark")
    """Visibility, 0 to 1; 0 where nothing was seen."""
    valid: BoolArray = array("landmark", dtype=np.bool_)
    """True where the landmark may be used."""
    names: tuple[str, ...] = LANDMARKS
    """Name of each landmark."""
    size: tuple[int, int] = (0, 0)
    """Width and height of the upright image [px]; zeros where there is none."""
    swapped: BoolArray = array(dtype=np.bool_)
    """True where left and right of the detector were exchanged."""
    shot: FloatArray = array(optional=True)
    """Number of the uninterrupted part, from 0: after a cut, a fade or a change of person a new one begins. NaN where
    nobody looked."""
    depth_spread: FloatArray = array("side", optional=True)
    """Standard deviation of each wrist's depth from its shoulder [m]: how sure the estimate is. NaN where depth was not
    estimated but taken from the source as it is."""
    warnings: tuple[str, ...] = ()
    """What the user should know about this source."""

    def labels(self, axis: str) -> tuple[str, ...] | None:
        """Return the labels of an axis, or None where its length is free."""
        return self.names if axis == "landmark" else AXES.get(axis)

    def index(self, name: str) -> int:
        """Return the column of a landmark.

        Raises:
            ContractError: If this track has no landmark of that name.
        """
        if name not in self.names:
            raise ContractError(f"the track has no landmark {name!r}; it has {', '.join(self.names)}")
        return self.names.index(name)

    def cuts(self) -> IntArray:
        """Return the rows at which a new shot begins."""
        return np.flatnonzero(np.diff(self.shot) > 0) + 1


@frozen_arrays
class WristTrack(Record):
    """Where each hand is from its own shoulder, in a measure that does not depend on the person's size."""

    t: FloatArray = array()
    """Time since the first row [s], strictly increasing."""
    p_SH: FloatArray = array("side", "xyz")
    """Shoulder -> wrist in torso axes (x forward, y left, z up) [arm lengths]; NaN where not valid."""
    heading: FloatArray = array()
    """Heading of the torso; 0 faces the camera, positive turns to the person's left [rad]."""
    valid: BoolArray = array("side", dtype=np.bool_)
    """False where the source saw nothing."""
    trunk: FloatArray = array("height_pitch", optional=True)
    """Hips above standing, as a share of their standing height, and forward lean of the trunk [rad]; NaN where not
    seen."""
    arm_length: float = float("nan")
    """The clip's own reach that was divided by [m]; NaN where the source has no metres."""
    warnings: tuple[str, ...] = ()
    """What the user should know, carried over from the source."""


@frozen_arrays
class TargetTrack(Record):
    """Where each front toe should be, over time; every row is reachable."""

    t: FloatArray = array()
    """Time since the first row [s], strictly increasing."""
    p_BE: FloatArray = array("side", "xyz")
    """Base -> toe, base axes [m]."""
    heading: FloatArray = array()
    """Desired heading of the robot relative to its heading at the start [rad]."""
    valid: BoolArray = array("side", dtype=np.bool_)
    """False where the source saw nothing and the position was filled in."""
    moved: FloatArray = array("side")
    """How far clamping moved the wanted position [m]."""
    limited: BoolArray = array("side", dtype=np.bool_)
    """True where the speed or acceleration limit moved the position."""
    wanted: FloatArray = array("side", "xyz")
    """Base -> toe before clamping [m]."""
    within_reach: FloatArray = array("side", "xyz", optional=True)
    """Base -> toe after clamping, before the speed limit [m]."""
    trunk: FloatArray = array("height_pitch", optional=True)
    """Desired height of the hind hips [m] and forward lean [rad], from how the robot stands by itself; NaN is as it
    does."""
    person: FloatArray = array("side", "xyz", optional=True)
    """Base -> toe as every frame of the source asks for it, before sampling [m]; NaN without a person."""
    robot: str = ""
    """Name of the robot whose toes these are; empty where not known."""
    report: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Figures of the retargeting, as plain data."""
    warnings: tuple[str, ...] = ()
    """What the user should know."""


@frozen_arrays
class CommandTrack(Record):
    """What the policy is asked for, at the control rate."""

    t: FloatArray = array()
    """Time since the first row [s], uniform."""
    v: FloatArray = array("xy")
    """Desired base velocity in the heading frame, forward and left [m/s]."""
    heading: FloatArray = array()
    """Desired heading relative to the heading at the start [rad]."""
    p_BE: FloatArray = array("side", "xyz")
    """Desired base -> toe, base axes [m]."""
    trunk: FloatArray = array("height_pitch", optional=True)
    """Desired height of the hind hips [m] and forward lean [rad], from how the robot stands by itself; NaN is as it
    does."""
    robot: str = ""
    """Name of the robot whose toes these are; empty where not known."""


@frozen_arrays
class LiveTrack(Record):
    """How a camera was followed, one row for every frame that became a target."""

    t: FloatArray = array()
    """When the frame was there, since the first command [s]."""
    latency: FloatArray = array()
    """From then to the target [s]."""
    detector: FloatArray = array()
    """Of it in the detector [s]."""
    skipped: IntArray = array(dtype=np.int64)
    """Frames dropped since the row before, because a newer one was there."""
    seen: BoolArray = array("side", dtype=np.bool_)
    """Which of the person's hands were seen."""


@frozen_arrays
class Command:
    """What the policy is asked for at one control tick."""

    v: FloatArray
    """Desired base velocity in the heading frame, forward and left (2,) [m/s]."""
    heading: float
    """Desired heading relative to the heading at the start [rad]."""
    p_BE: FloatArray
    """Desired base -> toe, base axes (2, 3) [m]."""
    height: float = 0.0
    """Desired height of the hind hips above how the robot stands by itself [m]."""
    pitch: float = 0.0
    """Desired forward lean beyond how it stands by itself [rad]."""


@runtime_checkable
class LiveCommands(Protocol):
    """Commands that are made while the robot moves, such as those of a camera."""

    def newest(self) -> Command | None:
        """Return what is asked for now; None ends the motion. Asked once a control tick; must not wait."""
        ...

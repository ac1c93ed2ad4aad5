"""Frozen records that flow from a source to a log; the vocabulary of mimic.

Arrays are copied, made read-only and checked for shape when a record is made. Each array field declares its axes after
the first; :mod:`mimic.store` names its columns by them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mimic.errors import ContractError

FloatArray = NDArray[np.floating[Any]]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.integer[Any]]

LEGS = ("FL", "FR", "RL", "RR")
"""Front left, front right, rear left, rear right."""

JOINTS = tuple(f"{leg}_{part}" for leg in LEGS for part in ("abad", "hip", "knee"))
"""The order of every (12,) joint array. Names of the official model; signs are those of rotations about +x and +y."""

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

AXES: Mapping[str, tuple[str, ...]] = {
    "xyz": ("x", "y", "z"),
    "xy": ("x", "y"),
    "uv": ("u", "v"),
    "wxyz": ("w", "x", "y", "z"),
    "side": SIDES,
    "joint": JOINTS,
}
"""Labels of the axes that every record shares."""


def array(*axes: str, dtype: type = np.float64, **kwargs: Any) -> Any:
    """Declare an array field: one row a time, then the named axes (see AXES; other names have no fixed length)."""
    return field(metadata={"axes": axes, "dtype": dtype}, **kwargs)


class Record:
    """Base of the frozen records: array fields are copied, made read-only and checked for shape."""

    __slots__ = ()

    def __post_init__(self) -> None:
        rows: int | None = None
        for f in fields(self):  # type: ignore[arg-type]
            axes = f.metadata.get("axes")
            if axes is None:
                continue
            value = np.array(getattr(self, f.name), dtype=f.metadata["dtype"])
            labels = [self.labels(axis) for axis in axes]
            expected = tuple(-1 if names is None else len(names) for names in labels)
            rows = value.shape[0] if rows is None and value.ndim else rows
            fits = value.ndim == 1 + len(axes) and value.shape[0] == rows
            if not fits or any(e not in (-1, s) for e, s in zip(expected, value.shape[1:], strict=True)):
                wanted = ", ".join([str(rows), *("any" if e < 0 else str(e) for e in expected)])
                raise ContractError(f"{type(self).__name__}.{f.name} has shape {value.shape}; expected ({wanted})")
            value.setflags(write=False)
            object.__setattr__(self, f.name, value)

    def labels(self, axis: str) -> tuple[str, ...] | None:
        """Return the labels of an axis, or None where its length is free."""
        return AXES.get(axis)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Provenance:
    """Where a stored record came from."""

    version: str
    """Version of mimic that wrote it."""
    command: str = ""
    """The command line, or the call."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """The settings used, as plain data."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """Name of each input -> its SHA-256."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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
    arm_length: float = float("nan")
    """The clip's own reach that was divided by [m]; NaN where the source has no metres."""
    warnings: tuple[str, ...] = ()
    """What the user should know, carried over from the source."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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
    report: Mapping[str, Any] = field(default_factory=dict)
    """Figures of the retargeting, as plain data."""
    warnings: tuple[str, ...] = ()
    """What the user should know."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Command:
    """What the policy is asked for at one control tick."""

    v: FloatArray
    """Desired base velocity in the heading frame, forward and left (2,) [m/s]."""
    heading: float
    """Desired heading relative to the heading at the start [rad]."""
    p_BE: FloatArray
    """Desired base -> toe, base axes (2, 3) [m]."""


@runtime_checkable
class LiveCommands(Protocol):
    """Commands that are made while the robot moves, such as those of a camera."""

    def newest(self) -> Command | None:
        """Return what is asked for now; None ends the motion. Asked once a control tick; must not wait."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RobotState:
    """The robot at one instant; NaN where a quantity is not measured."""

    t: float
    """Time of the plant [s]."""
    q: FloatArray
    """Joint positions (12,) [rad]."""
    dq: FloatArray
    """Joint velocities (12,) [rad/s]."""
    tau: FloatArray
    """Joint torques (12,) [N m]."""
    quat_WB: FloatArray
    """Orientation of the base (4,), wxyz."""
    omega_B: FloatArray
    """Angular velocity of the base, base axes (3,) [rad/s]."""
    p_WB: FloatArray
    """Position of the base (3,) [m]; NaN on a robot that cannot measure it."""
    v_WB: FloatArray
    """Velocity of the base, world axes (3,) [m/s]; NaN on a robot that cannot measure it."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class JointCommand:
    """What the joints are asked for: tau = tau_ff + kp (q_des - q) + kd (dq_des - dq)."""

    q_des: FloatArray
    """Desired positions (12,) [rad]."""
    dq_des: FloatArray
    """Desired velocities (12,) [rad/s]."""
    kp: FloatArray
    """Position gains (12,) [N m/rad]."""
    kd: FloatArray
    """Velocity gains (12,) [N m s/rad]."""
    tau_ff: FloatArray
    """Feed-forward torques (12,) [N m]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class JointSamples(Record):
    """Joint readings faster than the control rate; the columns are those of a calibration log."""

    t: FloatArray = array()
    """Time of the plant [s]."""
    q: FloatArray = array("joint")
    """Positions [rad]."""
    dq: FloatArray = array("joint")
    """Velocities [rad/s]."""
    tau: FloatArray = array("joint")
    """Torques [N m]."""
    q_des: FloatArray = array("joint")
    """Desired positions as they were sent [rad]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Health:
    """How far the readings of one control step can be trusted, and what a robot says about itself."""

    age: FloatArray
    """Age of each motor's newest answer (12,) [s]; infinite where none ever came."""
    missed: IntArray
    """Control steps in a row without an answer (12,)."""
    faults: IntArray
    """Fault bits of each motor's newest answer (12,); 0 where all is well."""
    running: BoolArray
    """Whether each motor said last that it is switched on (12,)."""
    temperature: FloatArray
    """Of each motor (12,) [degC]; NaN where not known."""
    imu_age: float
    """Age of the newest orientation [s]; infinite where none ever came."""
    imu_unchanged: float
    """Since anything that the IMU sends was last new [s]."""
    imu_count: int
    """Orientations received since the start."""
    imu_valid: bool | None
    """What the IMU says about its orientation; None where it says nothing."""
    compute: float
    """From the end of the step before to the sending of this one's command [s]."""
    late: float
    """How much later than planned the step ended [s]."""
    bus_errors: int
    """Error frames and frames that made no sense since the start."""
    guarded: bool = True
    """Whether the guardian that should watch is still there; True where none was wanted."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HealthLog(Record):
    """What a robot said about itself at each control tick, beside the RunLog of the same rows."""

    t: FloatArray = array()
    """Time of the plant [s]."""
    age: FloatArray = array("joint")
    """Age of each motor's newest answer [s]."""
    missed: FloatArray = array("joint")
    """Control steps in a row without an answer."""
    faults: FloatArray = array("joint")
    """Fault bits."""
    running: FloatArray = array("joint")
    """1 where the motor was switched on."""
    temperature: FloatArray = array("joint")
    """Of each motor [degC]."""
    imu_age: FloatArray = array()
    """Age of the newest orientation [s]."""
    imu_unchanged: FloatArray = array()
    """Since anything that the IMU sends was last new [s]."""
    imu_count: FloatArray = array()
    """Orientations received."""
    compute: FloatArray = array()
    """From the end of the step before to the sending of this one's command [s]."""
    late: FloatArray = array()
    """How much later than planned the step ended [s]."""
    bus_errors: FloatArray = array()
    """Error frames and frames that made no sense."""
    clamped: FloatArray = array()
    """Numbers of this tick's targets and command that were outside their limits."""
    mode: FloatArray = array()
    """What the supervisor had decided: 0 run, 1 sit down, 2 damp, 3 stopped."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Tick:
    """One control step of a plant: the state after it, and the command that really went out."""

    state: RobotState
    sent: JointCommand
    samples: JointSamples | None = None
    """Joint readings during the step, where the plant has them."""
    health: Health | None = None
    """How far the readings can be trusted, where the plant measures."""


PHASES = ("lie", "stand_up", "blend", "track", "hold", "sit_down", "damp")
"""Phases of a run; a log stores their index."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RunLog(Record):
    """Every control tick of a run: the state at its start, and what was decided and sent from it."""

    t: FloatArray = array()
    """Time of the plant [s]."""
    t_host: FloatArray = array()
    """Monotonic clock of the computer [s]."""
    phase: IntArray = array(dtype=np.int64)
    """Index into PHASES."""
    q: FloatArray = array("joint")
    """Joint positions [rad]."""
    dq: FloatArray = array("joint")
    """Joint velocities [rad/s]."""
    tau: FloatArray = array("joint")
    """Joint torques [N m]."""
    quat_WB: FloatArray = array("wxyz")
    """Orientation of the base."""
    omega_B: FloatArray = array("xyz")
    """Angular velocity of the base, base axes [rad/s]."""
    p_WB: FloatArray = array("xyz")
    """Position of the base [m]; NaN where not measured."""
    v_WB: FloatArray = array("xyz")
    """Velocity of the base, world axes [m/s]; NaN where not measured."""
    p_BE: FloatArray = array("side", "xyz")
    """Base -> front toe by forward kinematics, base axes [m]."""
    v_des: FloatArray = array("xy")
    """Desired base velocity in the heading frame [m/s]."""
    heading_des: FloatArray = array()
    """Desired heading, world [rad]."""
    p_BE_des: FloatArray = array("side", "xyz")
    """Desired base -> front toe, base axes [m]."""
    observation: FloatArray = array("observation")
    """What the policy saw, NaN behind it where the other policy of the run sees more; NaN while no policy ran."""
    action: FloatArray = array("joint")
    """What the policy answered; NaN while no policy ran."""
    q_des: FloatArray = array("joint")
    """Commanded joint positions [rad]."""
    q_sent: FloatArray = array("joint")
    """Joint positions that really went out [rad]."""
    kp: FloatArray = array("joint")
    """Position gains that went out [N m/rad]."""
    kd: FloatArray = array("joint")
    """Velocity gains that went out [N m s/rad]."""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """Plant, policy and settings, as plain data."""

    @property
    def aimed(self) -> BoolArray:
        """Return where the robot should stand and its toes should be somewhere: from blend to hold (ticks,)."""
        return (self.phase >= PHASES.index("blend")) & (self.phase <= PHASES.index("hold"))

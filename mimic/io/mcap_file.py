"""A run as an MCAP file of ROS 2 messages, for Foxglove, `ros2 bag` and Rerun.

Source: the message definitions of sensor_msgs, tf2_msgs, geometry_msgs, std_msgs and builtin_interfaces of ROS 2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mimic.errors import MissingExtra
from mimic.records import FloatArray

_TYPES = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
}
"""Messages that are parts of others."""
JOINT_STATE = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
_MESSAGES = {
    "sensor_msgs/msg/JointState": JOINT_STATE,
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "geometry_msgs/msg/PointStamped": "std_msgs/Header header\ngeometry_msgs/Point point",
}
WORLD = "world"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RosRun:
    """What of a run becomes messages, a row each time."""

    t: FloatArray
    """Time (T,) [s]."""
    joints: Sequence[str]
    """Names of the joints."""
    q: FloatArray
    """Positions (T, J) [rad]; with velocities [rad/s] and torques [N m] on ``/joint_states``."""
    dq: FloatArray
    tau: FloatArray
    q_des: FloatArray
    """Commanded positions (T, J) [rad], on ``/joint_commands``."""
    frames: Mapping[str, tuple[FloatArray, FloatArray]]
    """Link -> position (T, 3) [m] and orientation (T, 4), wxyz, in the world, on ``/tf``."""
    points: Mapping[str, FloatArray]
    """Topic -> point (T, 3) in base axes [m]; a row that is NaN gives no message."""
    base: str
    """Link that the points are relative to."""


def write_mcap(path: Path, run: RosRun) -> None:
    """Write a run as MCAP.

    Raises:
        MissingExtra: If mcap-ros2-support is not installed.
    """
    try:
        from mcap_ros2.writer import Writer
    except ImportError:
        raise MissingExtra("mcap_ros2", "mcap") from None
    parts = "\n".join(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in _TYPES.items())
    with path.open("wb") as file, Writer(file) as writer:
        kinds = {name: writer.register_msgdef(name, f"{text}\n{parts}") for name, text in _MESSAGES.items()}
        for row, t in enumerate(run.t):
            nanos = round(1e9 * float(t))
            for topic, kind, message in _messages(run, row, nanos):
                writer.write_message(topic, kinds[kind], message, log_time=nanos)


def _messages(run: RosRun, row: int, nanos: int) -> list[tuple[str, str, dict[str, Any]]]:
    """Return topic, type and content of each message of a row."""
    stamp = {"sec": nanos // 10**9, "nanosec": nanos % 10**9}
    header = {"stamp": stamp, "frame_id": WORLD}
    joints = {"header": header, "name": list(run.joints)}
    state = {"position": run.q[row].tolist(), "velocity": run.dq[row].tolist(), "effort": run.tau[row].tolist()}
    asked = {"position": run.q_des[row].tolist(), "velocity": [], "effort": []}
    transforms = [_transform(header, name, p[row], quat[row]) for name, (p, quat) in run.frames.items()]
    local = {"stamp": stamp, "frame_id": run.base}
    known = {topic: p[row] for topic, p in run.points.items() if p[row].sum() == p[row].sum()}
    return [
        ("/joint_states", "sensor_msgs/msg/JointState", joints | state),
        ("/joint_commands", "sensor_msgs/msg/JointState", joints | asked),
        ("/tf", "tf2_msgs/msg/TFMessage", {"transforms": transforms}),
        *(
            (topic, "geometry_msgs/msg/PointStamped", {"header": local, "point": _named(p, "xyz")})
            for topic, p in known.items()
        ),
    ]


def _transform(header: dict[str, Any], name: str, p: FloatArray, quat: FloatArray) -> dict[str, Any]:
    where = {"translation": _named(p, "xyz"), "rotation": _named(quat, "wxyz")}
    return {"header": header, "child_frame_id": name, "transform": where}


def _named(values: FloatArray, axes: str) -> dict[str, float]:
    return dict(zip(axes, values.tolist(), strict=True))

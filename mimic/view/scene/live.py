"""Live Rerun viewer: the camera with the skeleton, the robot with its toes, the latency.

A background thread draws. If it is slower than the robot, the items that it skips are counted.
"""

from __future__ import annotations

import queue
import threading
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mimic.dynamics.robot_model import load_model
from mimic.geometry import rotation_from_quat
from mimic.records import LANDMARKS, SIDES, BoolArray, FloatArray, Tick
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import front_toes
from mimic.view.film import skeleton
from mimic.view.scene import layout
from mimic.view.scene.floor import draw_floor
from mimic.view.scene.robot_drawing import draw_shapes
from mimic.view.scene.robot_shapes import body_poses
from mimic.view.scene.viewer import start_viewer
from mimic.view.scene.viewpoint import SIDEWAYS

EVERY = 2
"""Control ticks between two drawings of the robot."""
WAITING = 8
"""Maximum number of items in the queue."""

EYE_SHARE = 0.03
"""Share of the distance to the robot that the camera covers per drawing."""

_LATENCY = "/latency"
_HEIGHT = 0.43
"""Base height to draw if the base position is unknown [m]."""


class LiveView:
    """Viewer that is updated while the robot moves; use it in a ``with`` block."""

    def __init__(self, description: RobotDescription, *, path: Path | None = None) -> None:
        """Open a viewer, or write to a file.

        Args:
            description: The robot.
            path: Scene file (.rrd) to write; None opens a window.
        """
        self._description = description
        self._model = load_model(description)
        self._scene = rr.RecordingStream("mimic live")
        pictures = [
            rrb.Spatial2DView(origin=layout.VIDEO, name="camera"),
            layout.view_robot(SIDEWAYS, description, distance=2.64),
        ]
        plot = rrb.TimeSeriesView(origin=_LATENCY, name="frame to target [ms]")
        shown = rrb.Blueprint(rrb.Vertical(rrb.Horizontal(*pictures), plot, row_shares=[3, 1]), collapse_panels=True)
        if path is None:
            start_viewer("--expect-data-soon")
            self._scene.connect_grpc(default_blueprint=shown)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._scene.save(path, default_blueprint=shown)
        self._bodies = draw_shapes(self._scene, self._model)
        self._queue: queue.Queue[tuple[str, tuple[object, ...]] | None] = queue.Queue(WAITING)
        self.dropped = 0
        """Number of items skipped because the queue was full."""
        self._ticks = 0
        self._path = np.zeros(2)
        draw_floor(self._scene, f"{layout.ROBOT}/floor", np.zeros((1, 2)), tile=0.25)
        self._thread = threading.Thread(target=self._draw, name="live view", daemon=True)

    def __enter__(self) -> LiveView:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._queue.put(None)
        self._thread.join(10.0)
        self._scene.flush()
        self._scene.disconnect()

    def tick(self, done: Tick) -> None:
        """Show the robot after a control tick; never blocks."""
        self._ticks += 1
        if self._ticks % EVERY == 0:
            self._put("robot", done.state.t, done.state.q, done.state.quat_WB, done.state.p_WB)

    def pose(self, t: float, q: FloatArray, quat_WB: FloatArray) -> None:
        """Show joint angles (12,) [rad] and orientation (4,), wxyz, at time t [s]; never blocks."""
        self._put("robot", t, q, quat_WB, np.full(3, np.nan))

    def frame(self, t: float, jpeg: bytes | None, image: FloatArray, valid: BoolArray, latency: float) -> None:
        """Show a frame of the camera; never blocks.

        Args:
            t: Time on the clock of the robot's ticks [s].
            jpeg: The picture, or None.
            image: Image coordinates of the landmarks (33, 2), fractions of width and height.
            valid: Which of them are usable (33,).
            latency: Time from the frame to its target [s].
        """
        self._put("camera", t, jpeg, image, valid, latency)

    def _put(self, kind: str, *values: object) -> None:
        try:
            self._queue.put_nowait((kind, values))
        except queue.Full:
            self.dropped += 1

    def _draw(self) -> None:
        while (item := self._queue.get()) is not None:
            kind, values = item
            (self._robot if kind == "robot" else self._camera)(*values)  # type: ignore[arg-type]

    def _at(self, t: float) -> None:
        self._scene.set_time(layout.TIMELINE, duration=t)

    def _robot(self, t: float, q: FloatArray, quat: FloatArray, p: FloatArray) -> None:
        self._at(t)
        base = p if np.isfinite(p).all() else np.array([0.0, 0.0, _HEIGHT])
        position, turn = body_poses(self._model, np.concatenate([base, quat, q])[None])
        for body in self._bodies:
            i = self._model.body(body).id
            pose = rr.Transform3D(translation=position[0, i], quaternion=turn[0, i, [1, 2, 3, 0]].tolist())
            self._scene.log(f"{layout.ROBOT}/links/{body}", pose)
        self._path = self._path + EYE_SHARE * (base[:2] - self._path)
        self._scene.log(layout.EYE, rr.Transform3D(translation=[*self._path, 0.0]))
        toes = base + front_toes(q, self._description) @ rotation_from_quat(quat).T
        for i, side in enumerate(SIDES):
            ball = rr.Points3D(toes[i : i + 1], radii=0.026, colors=skeleton.COLOURS[side])
            self._scene.log(f"{layout.ROBOT}/toes/{side}", ball)

    def _camera(self, t: float, jpeg: bytes | None, image: FloatArray, valid: BoolArray, latency: float) -> None:
        self._at(t)
        self._scene.log(_LATENCY, rr.Scalars(1e3 * latency))
        if jpeg is None:
            return
        self._scene.log(layout.VIDEO, rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
        import cv2

        small = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert small is not None
        points = image * (small.shape[1], small.shape[0])
        seen = skeleton.visible(points[None], valid[None])
        for side, pairs in skeleton.bones(LANDMARKS).items():
            ends = skeleton.segments(points[None], seen, pairs).ends
            lines = rr.LineStrips2D(ends, colors=skeleton.COLOURS[side], radii=rr.Radius.ui_points(2.5))
            self._scene.log(f"{layout.VIDEO}/skeleton/{side}", lines)

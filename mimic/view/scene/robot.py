"""The robot as Rerun entities: its visual shapes, its toes wanted and reached, and the floor."""

from __future__ import annotations

import numpy as np
import rerun as rr

from mimic.frames import rotation_from_quat
from mimic.robot.description import RobotDescription
from mimic.robot.model import load_model
from mimic.types import SIDES, FloatArray, RunLog, TargetTrack
from mimic.view import layout, skeleton
from mimic.view.draw_floor import draw_floor
from mimic.view.robot_shapes import Shapes, body_poses, in_world, placed, visual_shapes
from mimic.view.skeleton import soft
from mimic.view.timing import followed, shared_time

_TRAIL = 0.7
"""How long the trail behind a toe is [s]."""
_TILE = 0.25
"""Side of a floor tile [m]."""
_WANTED_RADIUS = 0.03
"""A wanted toe is drawn a little larger than the toe, so that one sees when the toe is inside [m]."""
_CLAMPED = 0.005
"""What was asked for is drawn where clamping moved it farther than this [m]."""


def draw_robot(
    scene: rr.RecordingStream, log: RunLog, description: RobotDescription, targets: TargetTrack | None
) -> None:
    """Add the robot, its toes and the floor to a scene; with targets, also what clamping kept from it."""
    model = load_model(description)
    qpos = placed(log, model)
    position, quat = body_poses(model, qpos)
    t = layout.time_column(shared_time(log))
    for shapes in visual_shapes(model):
        scene.log(f"{layout.ROBOT}/links/{shapes.body}/{shapes.kind}", drawn(shapes), static=True)
    for body in sorted({shapes.body for shapes in visual_shapes(model)}):
        i = model.body(body).id
        poses = rr.Transform3D.columns(translation=position[:, i], quaternion=quat[:, i][:, [1, 2, 3, 0]])
        scene.send_columns(f"{layout.ROBOT}/links/{body}", indexes=[t], columns=poses)
    path = followed(log, qpos[:, :3])
    eye = np.column_stack([path, np.zeros(len(path))])
    scene.send_columns(layout.EYE, indexes=[t], columns=rr.Transform3D.columns(translation=eye))
    draw_floor(scene, f"{layout.ROBOT}/floor", path, tile=_TILE)
    _toes(scene, log, qpos, description)
    if targets is not None:
        _asked_for(scene, targets)


def drawn(shapes: Shapes) -> rr.AsComponents:
    """Return the shapes as Rerun draws them."""
    xyzw = shapes.quat[:, [1, 2, 3, 0]]
    colours = np.round(255 * shapes.rgba).astype(np.uint8)
    if shapes.kind == "box":
        return rr.Boxes3D(
            centers=shapes.position, half_sizes=shapes.size, quaternions=xyzw, colors=colours, fill_mode="Solid"
        )
    if shapes.kind == "ellipsoid":
        return rr.Ellipsoids3D(
            centers=shapes.position, half_sizes=shapes.size, quaternions=xyzw, colors=colours, fill_mode="Solid"
        )
    radius, length = shapes.size[:, 0], 2 * shapes.size[:, 1]
    if shapes.kind == "cylinder":
        return rr.Cylinders3D(
            centers=shapes.position, radii=radius, lengths=length, quaternions=xyzw, colors=colours, fill_mode="Solid"
        )
    return rr.Capsules3D(
        translations=capsule_starts(shapes),
        radii=radius,
        lengths=length,
        quaternions=xyzw,
        colors=colours,
        fill_mode="Solid",
    )


def capsule_starts(shapes: Shapes) -> FloatArray:
    """Return where each capsule begins (N, 3) [m]: Rerun draws it from there along its z axis, MuJoCo from the middle."""
    return shapes.position - rotation_from_quat(shapes.quat)[..., 2] * shapes.size[:, 1:2]


def trails(points: FloatArray, ticks: int) -> FloatArray:
    """Return the last ``ticks`` points (T, ticks, 3) before each of the points (T, 3)."""
    rows = np.maximum(np.arange(len(points))[:, None] - np.arange(ticks)[::-1], 0)
    return points[rows]


def _toes(scene: rr.RecordingStream, log: RunLog, qpos: FloatArray, description: RobotDescription) -> None:
    wanted, reached = in_world(qpos, log.p_BE_des), in_world(qpos, log.p_BE)
    shown = np.flatnonzero(log.aimed & np.isfinite(wanted).all(axis=(1, 2)))
    if not len(shown):
        return
    t = layout.time_column(shared_time(log)[shown])
    ticks = max(2, round(_TRAIL / description.dt))
    see_through = rr.components.FillMode.TransparentFillMajorWireframe
    for i, (side, colour) in enumerate((side, skeleton.COLOURS[side]) for side in SIDES):
        entity = f"{layout.ROBOT}/toes/{side}"
        for name, points, radius, colours, fill in (
            ("wanted", wanted, _WANTED_RADIUS, (*colour, 110), see_through),
            ("reached", reached, 1.05 * description.toe_radius, colour, rr.components.FillMode.Solid),
        ):
            scene.log(f"{entity}/{name}", rr.Ellipsoids3D.from_fields(colors=colours, fill_mode=fill), static=True)
            centers = points[shown, i]
            # The sizes come with the centres: a static size would draw a ball at the origin before the first of them.
            balls = rr.Ellipsoids3D.columns(centers=centers, half_sizes=np.full_like(centers, radius))
            scene.send_columns(f"{entity}/{name}", indexes=[t], columns=balls)
        for name, points, line, radius in (
            ("wanted_trail", wanted, soft(colour), 0.002),
            ("reached_trail", reached, colour, 0.004),
        ):
            scene.log(f"{entity}/{name}", rr.LineStrips3D.from_fields(colors=line, radii=radius), static=True)
            strips = list(trails(points[shown, i], ticks))
            scene.send_columns(f"{entity}/{name}", indexes=[t], columns=rr.LineStrips3D.columns(strips=strips))


def _asked_for(scene: rr.RecordingStream, targets: TargetTrack) -> None:
    """Show where the toes would be without clamping, as small white balls in the base's axes."""
    t = layout.time_column(targets.t)
    for i, side in enumerate(SIDES):
        entity = f"{layout.ROBOT}/links/base/asked_{side}"
        shown = (targets.moved[:, i] > _CLAMPED) & np.isfinite(targets.wanted[:, i]).all(axis=1)
        scene.log(entity, rr.Points3D.from_fields(colors=(255, 255, 255), radii=0.012), static=True)
        points = rr.Points3D.columns(positions=targets.wanted[shown, i]).partition(shown.astype(int))
        scene.send_columns(entity, indexes=[t], columns=points)

"""The person as Rerun entities: a 2-D skeleton over the video and a 3-D skeleton."""

from __future__ import annotations

import numpy as np
import rerun as rr

from mimic.records import PoseTrack
from mimic.view.film import skeleton
from mimic.view.scene import layout
from mimic.view.scene.floor import draw_floor
from mimic.view.scene.timing import hold_first_row

_HEAD = (0.085, 0.085, 0.11)
"""Half-sizes of the head: length, width, height [m]."""


def draw_person(scene: rr.RecordingStream, pose: PoseTrack, size: tuple[int, int] | None, start: float) -> None:
    """Add the person to a scene.

    Args:
        size: Width and height of the video picture [px]; None for no 2-D skeleton.
        start: First tick of the robot on the shared clock [s]; the person stands still from then to the first frame.
    """
    t, rows = hold_first_row(pose.t, start)
    points = skeleton.standing_points(pose)
    pairs = skeleton.bones(pose.names)
    for side, colour in skeleton.COLOURS.items():
        if size is not None:
            flat = pose.image * size
            found = skeleton.segments(flat[rows], skeleton.visible(flat, pose.valid)[rows], pairs[side])
            entity = f"{layout.VIDEO}/skeleton/{side}"
            scene.log(entity, rr.LineStrips2D.from_fields(colors=colour, radii=rr.Radius.ui_points(2.5)), static=True)
            strips = rr.LineStrips2D.columns(strips=list(found.ends)).partition(found.counts)
            scene.send_columns(entity, indexes=layout.time_columns(t, pose.t), columns=strips)
        found = skeleton.segments(points[rows], skeleton.visible(points, pose.valid)[rows], pairs[side])
        entity = f"{layout.BODY}/{side}"
        scene.log(entity, rr.LineStrips3D.from_fields(colors=colour, radii=0.022), static=True)
        strips = rr.LineStrips3D.columns(strips=list(found.ends)).partition(found.counts)
        scene.send_columns(entity, indexes=layout.time_columns(t, pose.t), columns=strips)
    certain = skeleton.certainty(pose)
    for side, (wrist, known) in skeleton.wrists(pose, points).items():
        entity = f"{layout.BODY}/{side}/wrist"
        scene.log(entity, rr.Points3D.from_fields(radii=0.05), static=True)
        shown = rows[known[rows]]
        colours = [skeleton.doubtful(skeleton.COLOURS[side], sure) for sure in certain[side][shown]]
        balls = rr.Points3D.columns(positions=wrist[shown], colors=colours).partition(known[rows].astype(int))
        scene.send_columns(entity, indexes=layout.time_columns(t, pose.t), columns=balls)
    middle, known = skeleton.heads(pose, points)
    middle = middle[rows]
    known = known[rows]
    entity = f"{layout.BODY}/head"
    style = rr.Ellipsoids3D.from_fields(colors=skeleton.CENTRE, fill_mode="Solid")
    scene.log(entity, style, static=True)
    heads = rr.Ellipsoids3D.columns(centers=middle[known], half_sizes=np.tile(_HEAD, (known.sum(), 1))).partition(
        known.astype(int)
    )
    scene.send_columns(entity, indexes=layout.time_columns(t, pose.t), columns=heads)
    if skeleton.feet_seen(pose):
        draw_floor(scene, f"{layout.BODY}/floor", np.zeros((1, 2)), tile=0.5)

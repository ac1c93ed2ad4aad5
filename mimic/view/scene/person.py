"""The person as Rerun entities: a 2-D skeleton over the video and a 3-D skeleton."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from mimic.records import FloatArray, PoseTrack
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
    times = layout.time_columns(t, pose.t)
    points = skeleton.standing_points(pose)
    pairs = skeleton.bones(pose.names)
    drawn: list[tuple[str, FloatArray, Any, Any]] = [(layout.BODY, points, rr.LineStrips3D, 0.022)]
    if size is not None:
        flat = pose.image * size
        drawn.append((f"{layout.VIDEO}/skeleton", flat, rr.LineStrips2D, rr.Radius.ui_points(2.5)))
    for root, places, kind, radius in drawn:
        for side, colour in skeleton.COLOURS.items():
            found = skeleton.segments(places[rows], skeleton.visible(places, pose.valid)[rows], pairs[side])
            style = kind.from_fields(colors=colour, radii=radius)
            strips = kind.columns(strips=list(found.ends)).partition(found.counts)
            layout.draw_over_time(scene, f"{root}/{side}", style, times, strips)
    certain = skeleton.certainty(pose)
    for side, (wrist, known) in skeleton.wrists(pose, points).items():
        shown = rows[known[rows]]
        colours = [skeleton.doubtful(skeleton.COLOURS[side], sure) for sure in certain[side][shown]]
        balls = rr.Points3D.columns(positions=wrist[shown], colors=colours).partition(known[rows].astype(int))
        style = rr.Points3D.from_fields(radii=0.05)
        layout.draw_over_time(scene, f"{layout.BODY}/{side}/wrist", style, times, balls)
    middle, known = (values[rows] for values in skeleton.heads(pose, points))
    style = rr.Ellipsoids3D.from_fields(colors=skeleton.CENTRE, fill_mode="Solid")
    heads = rr.Ellipsoids3D.columns(centers=middle[known], half_sizes=np.tile(_HEAD, (known.sum(), 1)))
    layout.draw_over_time(scene, f"{layout.BODY}/head", style, times, heads.partition(known.astype(int)))
    if skeleton.feet_seen(pose):
        draw_floor(scene, f"{layout.BODY}/floor", np.zeros((1, 2)), tile=0.5)

"""Layout of the viewer: video | person | robot, with the plots below."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mimic.view.scene import plots
from mimic.view.scene.timing import frame_numbers
from mimic.view.scene.viewpoint import SIDEWAYS

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from mimic.records import FloatArray
    from mimic.robot.description import RobotDescription

TIMELINE = "time"
VIDEO = "/video"
"""Root entity of the view of the video."""
BODY = "/person"
"""Of the view of the person."""
ROBOT = "/robot"
"""Of the view of the robot."""
EYE = f"{ROBOT}/eye"
"""Point on the floor that follows the robot; the camera looks at it."""

PersonView = Literal["whole", "upper"]
"""Whole person, or upper body if the legs are not in the picture."""


PHASE = "/phase"
"""What the robot is doing, in words."""
FRAME = "frame"
"""Second timeline: numbers of the video's frames."""


def time_column(t: FloatArray) -> rr.TimeColumn:
    """Return shared times [s] as a time column of Rerun, in whole microseconds."""
    import rerun as rr

    return rr.TimeColumn(TIMELINE, duration=np.round(1e6 * t).astype("timedelta64[us]").astype("timedelta64[ns]"))


def time_columns(t: FloatArray, frames: FloatArray | None) -> list[rr.TimeColumn]:
    """Return shared times [s] as columns of Rerun's timelines: seconds and, with a video, its frames.

    Args:
        t: Shared times (N,) [s].
        frames: Times of the frames of the video (F,) [s]; None without one.
    """
    import rerun as rr

    if frames is None or not len(frames):
        return [time_column(t)]
    return [time_column(t), rr.TimeColumn(FRAME, sequence=frame_numbers(t, frames))]


def draw_over_time(scene: rr.RecordingStream, entity: str, style: Any, times: Any, columns: Any) -> None:
    """Add an entity to a scene: what stays the same, and what it has at each time (`time_columns`)."""
    scene.log(entity, style, static=True)
    scene.send_columns(entity, indexes=times, columns=columns)


def camera_at(
    direction: float, *, distance: float, height: float, target: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return position and target of a camera that looks at the origin [m].

    Args:
        direction: Where the camera stands [rad].
        distance: Horizontal distance [m].
        height: Height of the camera [m].
        target: Height of the point it looks at [m].
    """
    return (distance * np.cos(direction), distance * np.sin(direction), height), (0.0, 0.0, target)


def view_3d(name: str, origin: str, camera: Any, contents: str = "$origin/**") -> rrb.Spatial3DView:
    """Return a view with a camera at a position that looks at a target [m], see `camera_at`."""
    import rerun.blueprint as rrb

    eye, target = camera
    return rrb.Spatial3DView(
        origin=origin,
        contents=contents,
        name=name,
        background=rrb.Background(color=(226, 231, 237)),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0, 0, 1)),
    )


def view_robot(camera: float, description: RobotDescription, *, distance: float) -> rrb.Spatial3DView:
    """Return the view of the robot from a direction [rad] and a distance in upright heights."""
    tall = description.pose_height["upright"]
    eye = camera_at(camera, distance=distance * tall, height=1.38 * tall, target=0.965 * tall)
    return view_3d("robot", EYE, eye, f"{ROBOT}/**")


def blueprint(
    description: RobotDescription,
    *,
    span: tuple[float, float],
    camera: float,
    video: tuple[int, int] | None,
    person: PersonView | None,
) -> rrb.Blueprint:
    """Return the layout.

    Args:
        description: The robot.
        span: First and last time of the plots on the shared clock [s].
        camera: Direction from which the robot is seen [rad].
        video: Width and height of the video picture [px]; None for no video.
        person: How much of the person is visible; None for no 3-D person.
    """
    import rerun.blueprint as rrb

    pictures: list[rrb.Spatial2DView | rrb.Spatial3DView] = []
    shares: list[float] = []
    if video is not None:
        width, tall = video
        bounds = rrb.VisualBounds2D(x_range=[0, width], y_range=[0, tall])
        pictures.append(rrb.Spatial2DView(origin=VIDEO, name="video", visual_bounds=bounds))
        shares.append(float(np.clip(width / tall, 0.7, 1.5)))
    if person is not None:
        distance, target_height = (2.35, 0.98) if person == "whole" else (1.45, 1.32)
        eye = camera_at(SIDEWAYS, distance=distance, height=target_height + 0.42, target=target_height)
        pictures.append(view_3d("person", BODY, eye))
        shares.append(0.9)
    pictures.append(view_robot(camera, description, distance=2.25))
    shares.append(1.1)
    toes = (_plot(plots.toe_plot(axis), span) for axis in reversed(plots.TOE_AXES))
    now = rrb.TextDocumentView(origin=PHASE, name="the robot is")
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*pictures, column_shares=shares),
            rrb.Horizontal(
                _plot(plots.ERROR, span),
                rrb.Vertical(*toes),
                _plot(plots.KNEES, span),
                rrb.Vertical(_plot(plots.STANDING, span), now, row_shares=[3.0, 1.0]),
                column_shares=[1.0, 1.4, 0.9, 0.9],
            ),
            row_shares=[1.55, 1.0],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="playing", loop_mode="all"),
        collapse_panels=True,
    )


def _plot(title: str, span: tuple[float, float]) -> rrb.TimeSeriesView:
    """Return a plot; all plots share one time range. Its title says what the colours are: a legend would hide data."""
    import rerun.blueprint as rrb

    begin, end = (rrb.TimeRangeBoundary.absolute(seconds=moment) for moment in span)
    return rrb.TimeSeriesView(
        origin=plots.plot_path(title),
        name=title,
        axis_x=rrb.TimeAxis(view_range=rrb.TimeRange(start=begin, end=end)),
        plot_legend=rrb.PlotLegend(visible=False),
    )

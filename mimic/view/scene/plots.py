"""The plots of a scene: toe error, target and actual toe positions, knee torques, uprightness and height."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mimic.geometry import R_BT
from mimic.metrics import uprightness
from mimic.records import JOINTS, PHASES, SIDES, FloatArray, RunLog, TargetTrack
from mimic.robot.description import RobotDescription
from mimic.view.film.skeleton import CENTRE, LEFT, RIGHT, Colour, soft
from mimic.view.scene.timing import shared_time

ROOT = "/plots"

ERROR = "toe error [cm], clamped by: pale"
KNEES = "knee torque [N m]"
STANDING = "standing [orange; height m: grey]"
TOE_AXES = ("forward", "left", "up")
"""The axes of the person's torso, in the order of torso coordinates."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One line of a plot."""

    plot: str
    name: str
    colour: Colour
    width: float
    t: FloatArray
    """Shared time [s]."""
    value: FloatArray

    @property
    def path(self) -> str:
        """Entity path in the scene."""
        return f"{plot_path(self.plot)}/{self.name.replace(' ', '_')}"


def plot_path(plot: str) -> str:
    """Return the entity path of a plot in the scene."""
    return f"{ROOT}/{plot.split(' [')[0].replace(' ', '_')}"


def toe_plot(axis: str) -> str:
    """Return the title of the plot of one toe axis."""
    return f"toe {axis} [cm]: left green, right pink; target pale"


def curves(log: RunLog, description: RobotDescription, targets: TargetTrack | None) -> Iterator[Curve]:
    """Yield every curve of a run; toe positions are relative to the base, in torso axes."""
    t = shared_time(log)
    shown = log.aimed
    followed = log.phase == PHASES.index("track")  # the way to the first target would set the scale of the error
    wanted = log.p_BE_des
    error = 100 * np.linalg.norm(log.p_BE - wanted, axis=-1)
    target = 100 * wanted @ R_BT
    actual = 100 * log.p_BE @ R_BT
    for i, (side, colour) in enumerate(zip(SIDES, (LEFT, RIGHT), strict=True)):
        yield Curve(ERROR, side, colour, 2.0, t[followed], error[followed, i])
        if targets is not None:
            moved = 100 * targets.moved[:, i]
            yield Curve(ERROR, f"{side} clamped by", soft(colour), 1.0, targets.t, moved)
        for axis, title in enumerate(TOE_AXES):
            for name, values, line, width in (
                ("target", target, soft(colour), 1.2),
                ("actual", actual, colour, 2.0),
            ):
                yield Curve(toe_plot(title), f"{side} {name}", line, width, t[shown], values[shown, i, axis])
    for name, leg, colour in (("rear left", "RL", LEFT), ("rear right", "RR", RIGHT)):
        yield Curve(KNEES, name, colour, 1.2, t, log.tau[:, JOINTS.index(f"{leg}_knee")])
    upright = uprightness(log.quat_WB, description)
    yield Curve(STANDING, "upright 0 to 1", (240, 160, 50), 2.0, t, upright)
    if np.isfinite(log.p_WB[:, 2]).any():
        yield Curve(STANDING, "height m", CENTRE, 2.0, t, log.p_WB[:, 2])

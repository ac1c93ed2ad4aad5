"""The state of a calibration in progress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.least_squares import Fit
from mimic.sysid.fit.point import Key
from mimic.sysid.fit.residuals import Problem
from mimic.sysid.result import Errors
from mimic.sysid.selection.moving_base import BaseMotion

Progress = Callable[[str, int], None]
"""Called with what is being done and the number of replays so far."""


@dataclass
class CalibrationState:
    """The state of one calibration."""

    problem: Problem
    settings: CalibrateSettings
    progress: Progress
    joints: dict[str, BoolArray]
    names: list[str]
    current: Fit
    baseline: FloatArray
    """What the baseline parameters leave: mean square of each channel, each block judged without itself (C,)."""
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Of the numbers that are read off the lateness of the targets."""
    unsure: dict[Key, float] = field(default_factory=dict)
    """Half of the 95 % interval of numbers that goes with these."""
    rejections: list[str] = field(default_factory=list)
    """Why effects that were found are not named."""
    base: BaseMotion | None = None
    """A motion of the base, where that is what explains the rest."""

    def tick(self, text: str) -> None:
        """Report the present activity."""
        self.progress(text, self.problem.replay.replays)


def errors_of(problem: Problem, residual: FloatArray) -> Errors:
    """Return the errors of each joint [rad or m] of a residual (T, C) in noise floors."""
    joints = len(problem.machine.joints)
    scale, residual = problem.noise[:joints], problem.in_floors(residual)
    train, held = (np.sqrt(problem.mean_squares(residual, side)[:joints]) * scale for side in (False, True))
    return Errors(train=train, held_out=held)

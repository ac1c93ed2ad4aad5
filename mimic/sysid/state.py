"""What one calibration knows so far."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mimic.calibrate.fit import Fit
from mimic.calibrate.moving_base import BaseMotion
from mimic.calibrate.point import Key
from mimic.calibrate.problem import Problem
from mimic.calibration import Errors
from mimic.settings import CalibrateSettings
from mimic.types import BoolArray, FloatArray

Progress = Callable[[str, int], None]
"""Called with what is being done and the number of replays so far."""


@dataclass
class Search:
    """The state of one calibration."""

    problem: Problem
    settings: CalibrateSettings
    progress: Progress
    joints: dict[str, BoolArray]
    names: list[str]
    current: Fit
    declared: FloatArray
    """What the declared numbers leave: mean square of each channel on the blocks held out (C,)."""
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Of the numbers that are read off the lateness of the targets."""
    unsure: dict[Key, float] = field(default_factory=dict)
    """Half of the 95 % interval of numbers that goes with these."""
    withdrawn: list[str] = field(default_factory=list)
    """Why effects that were found are not named."""
    base: BaseMotion | None = None
    """A motion of the base, where that is what explains the rest."""

    def tick(self, text: str) -> None:
        """Tell what is being done."""
        self.progress(text, self.problem.replay.replays)


def errors_of(problem: Problem, residual: FloatArray) -> Errors:
    """Return the errors of each joint [rad or m] of a residual (T, C) in noise floors."""
    joints = len(problem.machine.joints)
    scale = problem.noise[:joints]
    train, held = (np.sqrt(problem.mean_squares(residual, side)[:joints]) * scale for side in (False, True))
    return Errors(train=train, held_out=held)

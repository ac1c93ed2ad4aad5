"""Replays in which single targets arrive at other times, and how far to follow a linear model of them.

Where targets come so late that the next ones overtake them, what one of them does depends on the others, and a step of
all at once that a linear model finds overshoots in some places. So it is replayed in parts, and each target takes the
part that suits what follows it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mimic.records import FloatArray
from mimic.sysid.fit.point import Point, stack
from mimic.sysid.fit.residuals import Problem
from mimic.sysid.replay.targets import Targets

STEP_SHARES = (1.0, 0.6, 0.3, 0.1, 0.0)
"""Parts of a step that are replayed."""

FOLLOWING = 0.25
"""Time after a target in which it is seen whether a part of the step suits it [s]."""


def with_lateness(problem: Problem, point: Point, lates: Sequence[FloatArray]) -> FloatArray:
    """Return whitened residuals (N, T, C), 0 where masked, with each target delayed (K,) [s] in each replay."""
    replay, joints = problem.replay, len(problem.machine.joints)
    made = replay.run(
        stack([point] * len(lates), problem.machine), len(lates), Targets.stacked([replay.delayed(x) for x in lates])
    )
    parts = [made.residual]
    if made.torque_residual is not None and problem.channels > joints:
        parts.append(made.torque_residual)
    whitened = np.concatenate(parts, -1) / (problem.noise.astype(np.float32) * problem.log_scale)
    if problem.correction is not None:
        whitened += problem.correction
    whitened[:, problem.blocks.index < 0] = 0.0
    return np.nan_to_num(whitened)


def eased(problem: Problem, point: Point, had: FloatArray, late: FloatArray) -> FloatArray:
    """Return delays (K,) [s] between two sets, each target taking the share that suits the readings after it.

    Args:
        problem: Log and model.
        point: Its delay is that of both.
        had: Lateness before a step.
        late: After it.
    """
    lates = [had + share * (late - had) for share in STEP_SHARES]
    residual = with_lateness(problem, point, lates)
    squares = np.cumsum((residual.astype(np.float64) ** 2).sum(-1), axis=1)
    replay = problem.replay
    ends = np.searchsorted(replay.log.t, replay.log.t[replay.sent] + FOLLOWING) - 1
    choice = np.argmin(squares[:, ends] - squares[:, replay.sent], axis=0)
    mixed = np.stack(lates)[choice, np.arange(len(late))]
    mixed_squares = float((with_lateness(problem, point, [mixed]).astype(np.float64) ** 2).sum())
    best = int(np.argmin(squares[:, -1]))
    return mixed if mixed_squares < squares[best, -1] else lates[best]

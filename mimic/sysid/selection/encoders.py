"""Coarse encoders: reported last, with a replay that rounds as they do."""

from __future__ import annotations

import numpy as np

from mimic.records import FloatArray
from mimic.sysid.fit.least_squares import Fit
from mimic.sysid.fit.step_refinement import FINE, FINE_SEGMENT
from mimic.sysid.result import Candidate, Stage
from mimic.sysid.selection.evidence import paired
from mimic.sysid.state import CalibrationState, errors_of

LEAST_ROUNDING = 0.25
"""What a coarse encoder rounds off, over what is left of its joint; less may be in the encoder, but is not what is
missing.
"""


def _as_read(state: CalibrationState, fitted: Fit) -> FloatArray:
    """Return a fit's residual (T, C) with encoder rounding, in chains where rounding lowers it.

    Numbers are fitted without them, and what they round off is noise: a servo hunts between two steps, in an order that
    no replay predicts for long, and derivatives of a replay that hunts are those of its steps.
    """
    problem = state.problem
    angle = np.where(state.joints["encoder_step"], problem.encoder_steps, 0.0)
    point = fitted.point.with_effect("encoder_step", problem.machine, {"angle": angle})
    rounded = problem.in_steps_of_columns(point, FINE, FINE_SEGMENT)
    costs = [problem.mean_squares(r, False) for r in (rounded, fitted.residual)]
    chains = np.unique(problem.channel_chain)
    less = [
        c for c in chains if costs[0][problem.channel_chain == c].sum() < costs[1][problem.channel_chain == c].sum()
    ]
    return np.where(np.isin(problem.channel_chain, less), rounded, fitted.residual)


def with_encoders(state: CalibrationState, stages: list[Stage], final: Fit) -> tuple[list[Stage], FloatArray]:
    """Return the stages and residual (T, C) with coarse encoders added, where rounding matters."""
    problem, machine = state.problem, state.problem.machine
    count, train = len(machine.joints), problem.blocks.train
    left = np.sqrt(problem.mean_squares(final.residual, False)[:count]) * problem.noise[:count]
    has = problem.encoder_steps / np.sqrt(12.0) > LEAST_ROUNDING * left
    if not has.any():
        return stages, final.residual
    state.tick("adding encoder rounding")
    state.joints["encoder_step"] = has
    residual = _as_read(state, final)
    before, after = (problem.block_squares(r)[train] for r in (final.residual, residual))
    fell = problem.mean_squares(final.residual, False) - problem.mean_squares(residual, False)
    gain, z = paired(after, before, has[problem.channel_joint])
    found = Candidate(
        name="encoder_step",
        gain=gain,
        z=z,
        improvement=float(np.sqrt(np.maximum(fell, 0.0)).max()),
        values={"angle": np.where(has, problem.encoder_steps, 0.0)},
        joints=tuple(np.array(machine.joints)[has]),
        accepted=True,
    )
    others = tuple(c for s in stages if not s.added for c in s.candidates)
    stage = Stage(added="encoder_step", errors=errors_of(problem, residual), candidates=(found, *others))
    return [*(s for s in stages if s.added), stage], residual

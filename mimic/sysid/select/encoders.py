"""Encoders so coarse that what they round off matters beside what is left."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import uniform

from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.baseline import errors_of
from mimic.sysid.result import RULES, Candidate, Stage
from mimic.sysid.select.models import FittedModel, compare


def coarse_encoders(model: FittedModel) -> BoolArray:
    """Return the joints (J,) with an encoder so coarse that it matters beside what is left."""
    problem = model.problem
    count = problem.joints
    left = np.sqrt(problem.mean_squares(model.fitted.residual, False)[:count]) * problem.noise[:count]
    return problem.encoder_steps * uniform.std() > RULES.rounding * left


def as_read(model: FittedModel, has: BoolArray) -> FloatArray:
    """Return the residual (T, C) with the rounding of encoders (J,), in chains where rounding lowers it.

    Numbers are fitted without them, and what they round off is noise: a servo hunts between two steps, in an order that
    no replay predicts for long, and derivatives of a replay that hunts are those of its steps.
    """
    problem = model.problem
    angle = np.where(has, problem.encoder_steps, 0.0)
    point = model.fitted.point.with_effect("encoder_step", problem.machine, {"angle": angle})
    both = (problem.residuals([point])[0], model.fitted.residual)
    chains = np.unique(problem.channel_chain)
    costs = [[problem.mean_squares(r, False)[problem.channel_chain == c].sum() for c in chains] for r in both]
    less = [c for c, rounded, smooth in zip(chains, *costs, strict=True) if rounded < smooth]
    return np.where(np.isin(problem.channel_chain, less), *both)


def with_encoders(model: FittedModel, stages: Sequence[Stage], has: BoolArray, residual: FloatArray) -> list[Stage]:
    """Return the stages with coarse encoders (J,) added, which leave a residual (T, C)."""
    problem, machine = model.problem, model.problem.machine
    before, after = (problem.block_squares(r)[problem.blocks.train] for r in (model.fitted.residual, residual))
    against = compare(problem, after, before, 0, has[problem.channel_joint])
    found = Candidate(
        name="encoder_step",
        gain=against.gain,
        z=against.z,
        improvement=against.share,
        values={"angle": np.where(has, problem.encoder_steps, 0.0)},
        joints=tuple(np.array(machine.joints)[has]),
        accepted=True,
    )
    others = tuple(c for s in stages if not s.added for c in s.candidates)
    stage = Stage(added="encoder_step", errors=errors_of(problem, residual), candidates=(found, *others))
    return [*(s for s in stages if s.added), stage]

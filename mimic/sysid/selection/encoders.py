"""Coarse encoders: reported last, with a replay that rounds as they do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.by_log import errors_of
from mimic.sysid.fit.step_refinement import FINE, FINE_SEGMENT
from mimic.sysid.result import Candidate, Stage
from mimic.sysid.selection.evidence import paired
from mimic.sysid.selection.hypotheses import Hypothesis

LEAST_ROUNDING = 0.25
"""What a coarse encoder rounds off, over what is left of its joint; less may be in the encoder, but is not what is
missing.
"""


def coarse_encoders(h: Hypothesis) -> BoolArray:
    """Return the joints (J,) with an encoder so coarse that it matters beside what is left."""
    problem = h.problem
    count = len(problem.machine.joints)
    left = np.sqrt(problem.mean_squares(h.fitted.residual, False)[:count]) * problem.noise[:count]
    return problem.encoder_steps / np.sqrt(12.0) > LEAST_ROUNDING * left


def as_read(h: Hypothesis, has: BoolArray) -> FloatArray:
    """Return the residual (T, C) with the rounding of encoders (J,), in chains where rounding lowers it.

    Numbers are fitted without them, and what they round off is noise: a servo hunts between two steps, in an order that
    no replay predicts for long, and derivatives of a replay that hunts are those of its steps.
    """
    problem = h.problem
    angle = np.where(has, problem.encoder_steps, 0.0)
    point = h.fitted.point.with_effect("encoder_step", problem.machine, {"angle": angle})
    both = (problem.in_steps_of_columns(point, FINE, FINE_SEGMENT), h.fitted.residual)
    chains = np.unique(problem.channel_chain)
    costs = [[problem.mean_squares(r, False)[problem.channel_chain == c].sum() for c in chains] for r in both]
    less = [c for c, rounded, smooth in zip(chains, *costs, strict=True) if rounded < smooth]
    return np.where(np.isin(problem.channel_chain, less), *both)


def with_encoders(h: Hypothesis, stages: Sequence[Stage], has: BoolArray, residual: FloatArray) -> list[Stage]:
    """Return the stages with coarse encoders (J,) added, which leave a residual (T, C)."""
    problem, machine = h.problem, h.problem.machine
    before, after = (problem.block_squares(r)[problem.blocks.train] for r in (h.fitted.residual, residual))
    fell = problem.mean_squares(h.fitted.residual, False) - problem.mean_squares(residual, False)
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
    return [*(s for s in stages if s.added), stage]

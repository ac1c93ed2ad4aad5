"""What a calibration found: errors before and after, effects with evidence, and what stays unexplained; and the
thresholds: when an effect counts as found, and a joint as explained.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from mimic.io.store import plain
from mimic.records import BoolArray, FloatArray, IntArray
from mimic.records.table import ShownAsTable


@dataclass(frozen=True, kw_only=True, slots=True)
class Thresholds:
    """What a calibration decides by.

    "Suite" is lab/hidden_effects: these were chosen by its logs before one half of them was set apart.
    """

    z: float = 3.0
    """Standard errors over the blocks by which a model must be better. Holm's correction over 25 candidates at 5 %."""
    gain: float = 0.01
    """Share by which the error of blocks judged without themselves must fall: less is of no use in a simulation."""
    share: float = 0.15
    """Share of what noise does not explain that it must remove where it acts; less is a wrong name (suite)."""
    enough: float = 1.06
    """Error over noise floor in all joints from which on more effects are looked for: below, what is left is the
    difference between integrators (suite)."""
    rounding: float = 0.25
    """Share of what is left of a joint that its encoder must round off to be called coarse (suite)."""
    most: float = 0.5
    """Share that is most of something: of the spread of positions (with more error, log and model have nothing to do
    with each other), of what is left (what single events explain), and of readings: if their mean unit vector is as
    long, wound round a circle of the length of a step, they are multiples of it."""
    predictable: float = 0.1
    """Share of what is left that state or time must predict on blocks left out to be what it depends on (suite)."""
    explained: float = 1.2
    """Error over noise floor up to which a joint is explained; the right effects leave 1.02 to 1.13 (suite)."""
    finished: int = 4
    """Effects of each model that are fitted to the end, those that one linear step says most of; what was hidden in
    logs of a closed-form arm was first, a low-pass third and a torque limit fourth (lab/results/calibration.md)."""
    correlated: float = 0.7
    """Correlation of two fitted numbers from which on they are listed."""
    far: float = 100.0
    """Mean square of what is left, in noise floors, from which on short segments say more than long ones. What is not
    measured begins each of them wrong: a low-pass on the targets, at eight noise floors, was missed in short ones."""
    doubtful: float = 1.5
    """Growth of a block's sum of squares without it, from which on a replay says what it is, not the linear model."""
    material: float = 0.0125
    """Change of half the log of a block's sum of squares and its noise that counts: a twentieth of the noise."""
    beam: int = 2
    """Models that are kept of each size: one more than a search of one effect at a time, at twice its cost."""


RULES = Thresholds()
"""Those in use."""


FORMAT = 4
"""Version of the keys of `Calibration.to_json`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Errors:
    """Root mean square of measured - predicted, in the unit of the joints' positions."""

    train: FloatArray
    """On the blocks that were fitted, for each joint (J,)."""
    held_out: FloatArray
    """On the blocks that nothing was fitted to (J,)."""

    @staticmethod
    def total(values: FloatArray) -> float:
        """Return the root mean square over the joints."""
        return float((values**2).mean() ** 0.5)


@dataclass(frozen=True, kw_only=True, eq=False)
class LogErrors:
    """Root mean square of measured - predicted of one of several logs, (J,) in the unit of the positions."""

    name: str
    fitted: bool
    """False for a log that was held out whole."""
    baseline: FloatArray
    """With the baseline parameters fitted to the logs that are fitted."""
    final: FloatArray
    """With what was found."""
    left_out_baseline: FloatArray | None = None
    """The same fitted to the other logs alone, of three or more."""
    left_out_final: FloatArray | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """An effect that was tried at one stage."""

    name: str
    gain: float
    """log(error without / error with) over all blocks, each judged without itself; 0.01 is 1 %."""
    z: float
    """How sure that is, in standard errors: by the mean over the blocks, or by the ranks of blocks of single joints."""
    improvement: float
    """Share of the unexplained error that it removes on blocks judged without themselves."""
    values: Mapping[str, FloatArray]
    """Fitted value of each parameter (J,) or (1,)."""
    joints: tuple[str, ...]
    """Joints where it differs from none; empty for the whole machine."""
    accepted: bool = False
    why: str = ""
    """Why it was not accepted; empty where it was."""
    odds: float = 0.0
    """Probability of blocks that were left out over that with the accepted one, with a price for each number; 0 where
    none was accepted.
    """
    alternative_z: float = 0.0
    """How far, in standard errors, the accepted one is better."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """The model after one more effect; the first stage is the baseline model."""

    added: str
    """Name of the effect, or "baseline"."""
    errors: Errors
    candidates: tuple[Candidate, ...] = ()
    """All that were tried to get here, best first."""
    alternatives: tuple[str, ...] = ()
    """Effects that this log cannot tell from the one added."""


@dataclass(frozen=True, kw_only=True, eq=False)
class UnexplainedResidual:
    """The residual of one joint in the final model."""

    joint: str
    ratio: float
    """Error over noise floor."""
    state_r2: float
    """Share of it that the state predicts on held-out blocks; at or below 0 none."""
    depends_on: tuple[str, ...]
    """What it depends on most: position, velocity, torque, time, another joint."""
    peak_hz: float
    """Where its spectrum is highest [Hz]."""
    peak_ratio: float
    """That peak over the median of the spectrum."""
    verdict: str
    """explained, state-dependent, periodic, events, or broadband."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Traces:
    """Curves for the report, one row a reading."""

    t: FloatArray
    """(T,) [s]"""
    held_out: BoolArray
    """True in held-out blocks (T,)."""
    q: FloatArray
    """Measured (T, J)."""
    dq: FloatArray
    """Predicted velocity (T, J)."""
    tau: FloatArray
    """Predicted torque (T, J)."""
    before: FloatArray
    """Residual of the baseline model (T, J)."""
    after: FloatArray
    """Residual of the final model (T, J)."""
    target: FloatArray | None = None
    """What the drives were sent (T, J); none where the log has forces."""
    log: IntArray | None = None
    """Number of the log of each reading (T,), where there are several."""
    torque_before: FloatArray | None = None
    """Residual of the measured torque under the baseline model (T, J), where it was explained too."""
    torque_after: FloatArray | None = None
    """The same under the final model."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Correlations:
    """How the errors of the fitted numbers hang together; near 1 or -1 the log hardly tells two apart."""

    names: tuple[str, ...]
    """Effect, parameter and joint of each number (P,)."""
    matrix: FloatArray
    """(P, P), 1 on the diagonal."""

    def pairs(self, least: float = 0.0) -> tuple[tuple[str, str, float], ...]:
        """Return the pairs whose correlation is at least so large, either way, strongest first."""
        i, j = np.triu_indices(len(self.names), 1)
        values = self.matrix[i, j]
        order = np.argsort(-np.abs(values), kind="stable")
        return tuple((self.names[i[k]], self.names[j[k]], float(values[k])) for k in order if abs(values[k]) >= least)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Calibration(ShownAsTable):
    """The whole result."""

    joints: tuple[str, ...]
    unit: str
    """Unit of the errors: rad or m."""
    noise: FloatArray
    """Noise floor of each joint (J,)."""
    nominal: Errors
    """Before anything was fitted."""
    stages: tuple[Stage, ...]
    effects: Any
    """`mimic.dynamics.effect_set.EffectSet` of everything fitted, baseline effects first."""
    unexplained: tuple[UnexplainedResidual, ...]
    """One a joint."""
    sentence: str
    """The verdict in plain words."""
    log_matches_model: bool = True
    """False where log and model do not belong together; nothing is then named."""
    experiments: tuple[str, ...] = ()
    """What to log next to tell apart what this log cannot."""
    warnings: tuple[str, ...] = ()
    correlations: Correlations | None = None
    """Of the numbers that were fitted."""
    traces: Traces
    replays: int = 0
    """Simulated logs."""
    seconds: float = 0.0
    """Time taken [s]."""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """Log, model, settings."""
    logs: tuple[LogErrors, ...] = ()
    """Of several logs, one each."""

    def to_json(self) -> dict[str, Any]:
        """Return everything but the traces as plain data; the keys are described in docs/manual/calibration.md."""
        ends = {"nominal": self.nominal, "baseline": self.nominal, "final": self.nominal}
        if self.stages:
            ends |= {"baseline": self.stages[0].errors, "final": self.stages[-1].errors}
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("nominal", "traces")}
        kept = ("name", "joints", "role", "values", "intervals")
        return plain(
            {"format": FORMAT, "found": [s.added for s in self.stages if s.added not in ("", "baseline")]}
            | own
            | {
                "noise": dict(zip(self.joints, self.noise, strict=True)),
                "errors": {name: self._errors(errors) for name, errors in ends.items()},
                "stages": [plain(s) | {"errors": self._errors(s.errors)} for s in self.stages],
                "effects": [{key: getattr(e, key) for key in kept} for e in self.effects],
                "correlations": [] if self.correlations is None else self.correlations.pairs(RULES.correlated),
            }
        )

    def _errors(self, errors: Errors) -> dict[str, Any]:
        return {
            side: {**dict(zip(self.joints, values, strict=True)), "all": Errors.total(values)}
            for side, values in (("train", errors.train), ("held_out", errors.held_out))
        }

"""What a calibration found: errors before and after, effects with evidence, and what stays unexplained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from mimic.io.store import plain
from mimic.records import FloatArray, IntArray
from mimic.records.table import ShownAsTable

EXPLAINED = 1.5
"""Error over noise floor up to which a joint is explained."""

CORRELATED = 0.7
"""Correlation of two fitted numbers from which on they are listed."""

FORMAT = 5
"""Version of the keys of `Calibration.to_json`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Errors:
    """Root mean square of measured - predicted to the end of blocks of 1.5 s, in the unit of the joints' positions."""

    train: FloatArray
    """Under a fit to all blocks, for each joint (J,)."""
    held_out: FloatArray
    """Each block under a fit without it and every sixth beside (J,)."""

    @staticmethod
    def total(values: FloatArray) -> float:
        """Return the root mean square over the joints."""
        return float((values**2).mean() ** 0.5)


@dataclass(frozen=True, eq=False)
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
    """The same fitted to the other logs alone, of three or more; those of the same gains or load are left out too."""
    left_out_final: FloatArray | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """An effect that the model lacked."""

    name: str
    joints: tuple[str, ...]
    """Empty for the whole machine."""
    evidence: float
    """By how much blocks left out are likelier with it, a price for each number paid [nats of independent readings]; 0
    where it was read off the log.
    """
    share: float
    """Share of what the baseline leaves beyond the noise that it removes on blocks left out."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Alternative:
    """Another explanation that the logs do not tell from the one found."""

    effects: tuple[tuple[str, tuple[str, ...]], ...]
    """Names and joints."""
    behind: float
    """By how much blocks left out are less likely under it [nats]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """An effect that was tried beside others."""

    name: str
    joints: tuple[str, ...]
    gain: float
    """By how much it predicts better, numbers paid [nats of independent readings]."""
    fitted: bool
    """Whether that is the gain of a fit, and of blocks left out; else of a linear step."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """What was tried beside some effects."""

    beside: tuple[str, ...]
    """Names of effects that the model had already."""
    candidates: tuple[Candidate, ...]
    """Best first, each effect once."""


@dataclass(frozen=True, kw_only=True, eq=False)
class UnexplainedResidual:
    """What is left of one joint in the final model."""

    joint: str
    ratio: float
    """Error over noise floor."""
    torque: float
    """Root mean square of the unknown torque that would explain it [N m or N]."""
    depends_on: tuple[tuple[str, float], ...]
    """Quantities (position, speed, torque, time, position of another joint) and the share of that torque that each
    tells in blocks left out, the most telling first.
    """

    @property
    def explained(self) -> bool:
        """Whether noise explains what is left."""
        return self.ratio < EXPLAINED


@dataclass(frozen=True, kw_only=True, eq=False)
class Traces:
    """Curves for the report, one row a reading."""

    t: FloatArray
    """(T,) [s]"""
    q: FloatArray
    """Measured (T, J)."""
    dq: FloatArray
    """Predicted velocity (T, J)."""
    tau: FloatArray
    """Predicted torque (T, J)."""
    before: FloatArray
    """Residual of the baseline model, each block under a fit without it (T, J)."""
    after: FloatArray
    """Residual of the final model (T, J)."""
    target: FloatArray | None = None
    """What the drives were sent (T, J); none where the log has forces."""
    log: IntArray | None = None
    """Number of the log of each reading (T,), where there are several."""
    torque_before: FloatArray | None = None
    """Measured torque less that of the baseline model (T, J), where the log has it; it is compared, not fitted."""
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
    """Noise floor of each joint (J,): what is left where every reading corrects the prediction of the next."""
    nominal: Errors
    """Before anything was fitted."""
    baseline: Errors
    """With the baseline parameters fitted."""
    final: Errors
    """With the effects found."""
    found: tuple[Found, ...]
    """What the model lacked, in the order in which it was found."""
    alternatives: tuple[Alternative, ...] = ()
    tried: tuple[Stage, ...] = ()
    explained: bool = True
    """Whether what was found explains the machine: down to the noise, or nine tenths of what is beyond it."""
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
    next_motion: Any = None
    """`mimic.sysid.next_motion.NextMotion` that tells what was found from the nearest alternative; None without one."""
    warnings: tuple[str, ...] = ()
    correlations: Correlations | None = None
    """Of the numbers that were fitted."""
    traces: Traces
    passes: int = 0
    """Passes over the logs."""
    seconds: float = 0.0
    """Time taken [s]."""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """Log, model, settings."""
    logs: tuple[LogErrors, ...] = ()
    """Of several logs, one each."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects found; none where they only help, and something unknown is left."""
        return tuple(one.name for one in self.found) if self.explained else ()

    def to_json(self) -> dict[str, Any]:
        """Return everything but the traces as plain data; the keys are described in docs/manual/calibration.md."""
        ends = {name: self._errors(getattr(self, name)) for name in ("nominal", "baseline", "final")}
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in (*ends, "traces", "next_motion")}
        own |= {
            "noise": dict(zip(self.joints, self.noise, strict=True)),
            "errors": ends,
            "effects": [_fields(e) for e in self.effects],
            "correlations": [] if self.correlations is None else self.correlations.pairs(CORRELATED),
        }
        return plain({"format": FORMAT, **own})

    def _errors(self, errors: Errors) -> dict[str, Any]:
        sides = {}
        for side in ("train", "held_out"):
            values = getattr(errors, side)
            sides[side] = {**dict(zip(self.joints, values, strict=True)), "all": Errors.total(values)}
        return sides


def _fields(effect: Any) -> dict[str, Any]:
    return {key: getattr(effect, key) for key in ("name", "joints", "role", "values", "intervals")}

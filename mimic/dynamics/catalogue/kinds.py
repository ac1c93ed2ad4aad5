"""What an effect of the catalogue and its parameters say of themselves."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal

from mimic.errors import ConfigError

MODEL = "model"
"""Neutral value of a parameter that replaces a number of the model."""

UNLIMITED = 1e6
"""Stands for no limit on a torque or a speed."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect, for each joint or for the whole machine."""

    name: str
    unit: str
    _: KW_ONLY
    neutral: float | Literal["model"] = 0.0
    """Value without the effect; "model" where the model has a number of its own."""
    low: float
    high: float
    step: float
    """A difference that matters, and the unit of ``starts`` and ``spread``: a share of the machine's own scale for
    units that have one (`scale_of`), else a value.
    """
    starts: tuple[float, ...] = ()
    """Values from which a fit begins, in steps; empty where it begins at neutral. Of the torque-speed line: shares of
    the largest torque and speed of the log. Of a fixed parameter: its value."""
    spread: float = 100.0
    """How far from neutral is plausible (one standard deviation), in steps."""
    shape: bool = False
    """Says where or when the effect acts, not how much: at any value it is none while the others are neutral."""
    fixed: bool = False
    """Never fitted: it has its value from ``starts`` or from a person."""
    inverse: bool = False
    """One over it is fitted, with which the motion changes nearly in proportion; 0 is none."""

    tolerance: float = 0.0
    """By how much a drawing may be off, one standard deviation: a share of the model's number, or of the link for
    lengths; such numbers are free in every model, within that. 0: drawings say nothing of it."""
    spectral: bool = False
    """A fit begins at the peaks of what is left over position."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest of what is fitted."""
        return (1.0 / self.high, 1.0 / self.low) if self.inverse else (self.low, self.high)

    def turned(self, x: Any) -> Any:
        """Return what is fitted of a value, or the value of what is fitted."""
        return 1.0 / x if self.inverse else x


@dataclass(frozen=True, kw_only=True, slots=True)
class Effect:
    """One physical effect."""

    name: str
    title: str
    """How a sentence names it."""
    equation: str
    parameters: tuple[Parameter, ...]
    scope: Literal["joint", "machine"] = "joint"
    """Whether each joint has parameters of its own, or the machine has one set."""
    structural: bool = False
    """A threshold or an added state: a derivative at neutral does not see it, so that it begins at its own starts."""
    tip: bool = False
    """Only the last joint of a chain can have it."""
    chain_shared: bool = False
    """All joints of a chain have it or none.

    A factor common to these numbers, masses and friction hardly changes the motion, so that any one of them may seem to
    be none, and would fix that factor were it left out.
    """
    random: bool = False
    """Drawn anew for each target, so a replay needs what was drawn: it is read off the log, not fitted."""
    signature: str
    """What its residual looks like."""
    experiment: str
    """The motion that shows it best."""
    enters: str
    """How it enters MuJoCo."""
    source: str

    @property
    def read_off(self) -> bool:
        """Whether its size is read off the log, not fitted."""
        return self.random or all(p.fixed or p.shape for p in self.parameters)

    def parameter(self, name: str) -> Parameter:
        """Return a parameter by name.

        Raises:
            ConfigError: If there is none.
        """
        for p in self.parameters:
            if p.name == name:
                return p
        names = ", ".join(p.name for p in self.parameters)
        raise ConfigError(f"effect {self.name!r} has no parameter {name!r}; it has {names}")

"""When an effect counts as found, and when a joint counts as explained: all in one place, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class Thresholds:
    """What a calibration decides by.

    "Suite" is benchmarks/hidden_effects: these were chosen by its logs before one half of them was set apart.
    """

    z: float = 3.0
    """Gain over its standard error over blocks. Holm's correction over 25 candidates at 5 %."""
    promising: float = 2.0
    """The same of a fit of two steps, from which on it is fitted to the end: it may still gain."""
    gain: float = 0.01
    """Share by which the error of blocks judged without themselves must fall: less is of no use in a simulation."""
    improvement: float = 0.35
    """Error removed at some joint, in noise floors: smaller ones are differences between integrators (suite)."""
    share: float = 0.15
    """Share of what noise does not explain, on the joints where an effect acts; less is a wrong name (suite)."""
    deviations: float = 3.0
    """How far a number is from none, in standard deviations: as sure as ``z``."""
    apart: float = 2.0
    """Standard errors by which a set must be behind the best to be told from it: about 95 %."""
    negligible: float = 0.1
    """What an effect removes at a joint, in noise floors, as a share of the joint of its chain where it removes most,
    and of what is left in its chain; less is a crumb (suite)."""
    beyond: float = 2.0
    """Steps by which a number would cross its bound, from which on nothing is named in its chain (suite)."""
    explained: float = 1.2
    """Error over noise floor up to which a joint is explained; the right effects leave 1.02 to 1.13 (suite)."""
    shortlist: int = 8
    """Effects that torques ask for, by gain and as many by z, that are replayed; of what was hidden in closed-form arms
    the worst was fifth of either (benchmarks/torque_screen)."""
    finished: int = 4
    """Effects of each set that are fitted to the end, most of the cost of a search."""
    beam: int = 2
    """Sets that are kept of each size: one more than a search of one effect at a time, at twice its cost."""
    hopeless: float = 6.0
    """Standard errors behind the best from which on an effect is not fitted to the end (suite)."""
    stranger: float = 0.5
    """Error over the spread of the positions from which on log and model have nothing to do with each other."""


RULES = Thresholds()
"""Those in use."""

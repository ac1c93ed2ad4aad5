"""How a policy is evaluated."""

from __future__ import annotations

from dataclasses import field

from mimic.config.play import AS_DESCRIBED, EffectsSettings, Randomisation
from mimic.config.ranges import Limited, within
from mimic.frozen import frozen


@frozen
class EpisodeSettings(Limited):
    """What every evaluation has: episodes of one robot, drawn from seeds and played in parallel."""

    episodes: int
    """How many."""
    seconds: float
    """Length of each [s]."""
    seed: int = within(1, 0, 2**63)
    """Seed of the first episode; episode i uses seed + i."""
    workers: int = within(0, 0, 1024)
    """Processes; 0: one per core."""
    robot: EffectsSettings = AS_DESCRIBED
    """Which robot is simulated."""
    randomisation: Randomisation = field(default_factory=Randomisation)
    """Ranges that its variations are drawn from."""


@frozen
class EvaluateSettings(EpisodeSettings):
    """Evaluation of a policy that stands and tracks."""

    episodes: int = within(200, 1, 100_000)
    """Randomised episodes from the lying start."""
    seconds: float = within(20.0, 2.0, 600.0, "s")
    """Length of an episode [s]."""


@frozen
class SitDownEvaluateSettings(EpisodeSettings):
    """Evaluation of a policy that sits down."""

    episodes: int = within(500, 1, 100_000)
    """Randomised policy switches from a tracking policy."""
    seconds: float = within(10.0, 2.0, 600.0, "s")
    """Latest policy switch after the start [s]."""
    tracker: str | None = None
    """Policy that stands and tracks before the switch; by default the shipped one."""

"""How a policy is evaluated."""

from __future__ import annotations

from dataclasses import dataclass, field

from mimic.config.play import AS_DESCRIBED, EffectsSettings, Randomisation
from mimic.config.ranges import check_range


@dataclass(frozen=True, kw_only=True, slots=True)
class EpisodeSettings:
    """What every evaluation has: episodes of one robot, drawn from seeds and played in parallel."""

    episodes: int
    """How many."""
    seconds: float
    """Length of each [s]."""
    seed: int = 1
    """Seed of the first episode; episode i uses seed + i."""
    workers: int = 0
    """Processes; 0: one per core."""
    robot: EffectsSettings = AS_DESCRIBED
    """Which robot is simulated."""
    randomisation: Randomisation = field(default_factory=Randomisation)
    """Ranges that its variations are drawn from."""

    def check_episodes(self, shortest: float, longest: float = 600.0) -> None:
        """Raise a ConfigError unless these settings are in their ranges; the length from shortest to longest [s]."""
        check_range("episodes", self.episodes, 1, 100_000)
        check_range("seconds", self.seconds, shortest, longest, "s")
        check_range("workers", self.workers, 0, 1024)


@dataclass(frozen=True, kw_only=True, slots=True)
class EvaluateSettings(EpisodeSettings):
    """Evaluation of a policy that stands and tracks."""

    episodes: int = 200
    """Randomised episodes from the lying start."""
    seconds: float = 20.0
    """Length of an episode [s]."""

    def __post_init__(self) -> None:
        self.check_episodes(2.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class SitDownEvaluateSettings(EpisodeSettings):
    """Evaluation of a policy that sits down."""

    episodes: int = 500
    """Randomised policy switches from a tracking policy."""
    seconds: float = 10.0
    """Latest policy switch after the start [s]."""
    tracker: str | None = None
    """Policy that stands and tracks before the switch; by default the shipped one."""

    def __post_init__(self) -> None:
        self.check_episodes(2.0)

"""What each study of a policy plays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from mimic.config.evaluation import EpisodeSettings
from mimic.config.leading import LONGEST_WATCH, HandSettings, LeadingSettings
from mimic.config.play import Randomisation
from mimic.config.ranges import Limited, check_range, within

FRESH_SEED = 1_000_001
"""Seed of episodes that are for judging only; policies are chosen on seeds below 1 000 000."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TableSettings(EpisodeSettings):
    """Evaluation of a policy in the figures of the paper's Table III."""

    episodes: int = within(50, 1, 100_000)
    """Episodes of each evaluation seed; paper: 50."""
    seeds: int = within(3, 1, 1000)
    """Evaluation seeds. The paper's three are training seeds."""
    seconds: float = within(20.0, 2.0, 600.0, "s")
    """Length of an episode [s]; paper: 1000 control steps."""
    seed: int = FRESH_SEED
    """Seed of the first episode."""
    senses: tuple[str, ...] = ("the paper's noise", "a third of it", "no noise", "deaf to velocity")
    """What the policy senses; each is a row of its own. The first one counts."""
    walks: int = within(3, 0, 1000)
    """Walks at each asked speed, with still and with moving arms; no more than ``episodes``."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CalmSettings(EpisodeSettings):
    """Evaluation of standing without commands, and of pushes while standing."""

    episodes: int = within(20, 1, 100_000)
    """Randomised robots that stand."""
    seconds: float = within(60.0, 5.0, 3600.0, "s")
    """For how long [s]."""
    pushes: tuple[float, ...] = (0.5, 0.8)
    """Speeds of a push, fore and aft and sideways, at any phase of the gait [m/s]."""
    pulls: tuple[float, ...] = (7.5, 10.0)
    """Pulls at a front toe that grow within 1.5 s, forward, backward, left and right [N]."""
    pushed_episodes: int = within(50, 1, 100_000)
    """Robots that are pushed or pulled once, of each kind."""
    seed: int = FRESH_SEED
    """Seed of the first episode."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrunkSettings(EpisodeSettings):
    """Evaluation of crouching and leaning."""

    episodes: int = within(20, 1, 100_000)
    """Randomised robots for each case."""
    seconds: float = within(12.0, 8.0, 600.0, "s")
    """Length of each [s]."""
    cases: tuple[tuple[float, float, bool], ...] = (
        (0.0, 0.0, False),
        (-0.04, 0.0, False),
        (-0.07, 0.0, False),
        (0.0, 10.0, False),
        (0.0, 20.0, False),
        (-0.04, 10.0, False),
        (-0.07, 20.0, False),
        (-0.06, 0.0, True),
        (-0.05, 15.0, True),
    )
    """Height of the hips [m], lean [deg], and whether the robot goes down and up again and again."""
    pushes: tuple[float, ...] = (0.0, 0.5)
    """Speeds of a push [m/s] …"""
    push_interval: float = 4.0
    """… after so long, from any side [s]."""
    seed: int = FRESH_SEED
    """Seed of the first episode."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LeadSettings(EpisodeSettings):
    """Evaluation of being led by the hand, by either front toe in any direction."""

    episodes: int = within(40, 1, 100_000)
    """Randomised robots."""
    seconds: float = 32.0
    """Length of each [s]; what is left of it when the hand has let go is watched."""
    hand: HandSettings = field(default_factory=HandSettings)
    """The hand; its toe and its direction are drawn."""
    leading: LeadingSettings = field(default_factory=LeadingSettings)
    """How the robot answers."""
    seed: int = FRESH_SEED
    """Seed of the first episode."""

    def __post_init__(self) -> None:
        Limited.__post_init__(self)
        check_range("seconds", self.seconds, self.hand.end + 2.0, self.hand.end + LONGEST_WATCH, "s")
        object.__setattr__(self, "hand", replace(self.hand, after=self.seconds - self.hand.end))


STAND_UP_RANGES = Randomisation(
    ground_friction=(0.6, 3.0),
    base_mass=(-1.0, 1.0),
    delay=(0.0, 0.035),
    push=(0.0, 0.0),
    start_q=(-0.15, 0.15),
    start_height=(0.0, 0.03),
)
"""Lying starts that must end upright; gains as in Table II, +-20 %."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StandUpSettings(EpisodeSettings):
    """Evaluation of standing up and of standing still."""

    episodes: int = within(500, 1, 100_000)
    """Lying starts."""
    seconds: float = within(3.0, 2.5, 600.0, "s")
    """Length of each [s]; who stands up must still stand at its end."""
    still_episodes: int = 10
    """Nominal robots that stand still."""
    still_seconds: float = within(20.0, 1.0, 600.0, "s")
    """For how long [s], from the second second on."""
    randomisation: Randomisation = STAND_UP_RANGES


@dataclass(frozen=True, kw_only=True, slots=True)
class RobustnessSettings(EpisodeSettings):
    """How much disturbance a policy survives."""

    episodes: int = within(40, 1, 100_000)
    """Episodes at each point; the same starts and commands at every point."""
    seconds: float = within(10.0, 2.5, 600.0, "s")
    """Length of an episode [s]."""

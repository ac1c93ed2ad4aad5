"""What a person may change: one frozen dataclass for each flow. Facts about the robot are in assets/, not here."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from mimic.errors import ConfigError


def _check_range(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    if not low <= value <= high:
        suffix = f" {unit}" if unit else ""
        raise ConfigError(f"{name} is {value:g}{suffix}; it must be from {low:g} to {high:g}{suffix}")


@dataclass(frozen=True, kw_only=True, slots=True)
class PoseSettings:
    """How a video becomes landmarks."""

    min_visibility: float = 0.5
    """A landmark counts as seen from this visibility on."""
    min_person_share: float = 0.3
    """A clip is refused when fewer frames than this show both shoulders and a wrist. 0.60-1.00 on real clips, 0.02-0.11
    on clips without a person."""
    max_jump: float = 0.25
    """A hip or wrist that moves more than this in a frame jumped [m]."""
    max_jump_share: float = 0.05
    """More jumping frames than this mean a cut."""
    cutoff_hz: float = 6.0
    """Cut-off of the zero-phase Butterworth filter over the landmarks [Hz]."""

    def __post_init__(self) -> None:
        _check_range("min-visibility", self.min_visibility, 0.0, 1.0)
        _check_range("min-person-share", self.min_person_share, 0.0, 1.0)
        _check_range("cutoff-hz", self.cutoff_hz, 0.5, 30.0, "Hz")


@dataclass(frozen=True, kw_only=True, slots=True)
class RetargetSettings:
    """How landmarks become toe targets."""

    rate: float = 0.1
    """Seconds between two targets."""
    mirror: bool = False
    """Let the person's left arm drive the right front leg, as in a mirror."""
    turns: bool = False
    """Follow the slow turns of the person; otherwise one heading serves the whole clip."""
    keep_peaks: bool = True
    """Move each target to a turning point within half a step, so that slow rates do not lose a punch."""
    reach_quantile: float = 0.98
    """Quantile of the shoulder-wrist distance that counts as the person's reach."""
    scale: float = 1.0
    """Factor on the person's reach in the robot's workspace."""

    def __post_init__(self) -> None:
        _check_range("rate", self.rate, 0.05, 1.0, "s")
        _check_range("reach-quantile", self.reach_quantile, 0.5, 1.0)
        _check_range("scale", self.scale, 0.2, 2.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class RunSettings:
    """How targets are played."""

    policy: str | None = None
    """ONNX file; None takes the shipped one."""
    seed: int = 0
    """Seed of the simulated start."""
    stand_up: float = 2.0
    """Time from lying to the first target [s]; the policy stands up in about one."""
    blend: float = 0.5
    """Time over which the desired toes move from where they are to the first target [s]."""
    hold: float = 1.0
    """Time the last target is held before the end [s]."""

    def __post_init__(self) -> None:
        _check_range("stand-up", self.stand_up, 1.0, 10.0, "s")
        _check_range("blend", self.blend, 0.1, 5.0, "s")
        _check_range("hold", self.hold, 0.0, 30.0, "s")


@dataclass(frozen=True, kw_only=True, slots=True)
class Randomisation:
    """Ranges of the paper's Table II and of the start; a pair is uniform between its ends.

    Source: Li et al. 2024, Table II, and its public code (c2_common_config.py, c2_standdance_env.py).
    """

    joint_friction: tuple[float, float] = (0.03, 0.08)
    """Dry friction of each joint [N m]."""
    joint_damping: tuple[float, float] = (0.02, 0.06)
    """Viscous friction of each joint [N m s/rad]."""
    ground_friction: tuple[float, float] = (1.0, 3.0)
    """Sliding friction coefficient of the ground."""
    base_mass: tuple[float, float] = (-0.5, 0.5)
    """Added to the trunk [kg]."""
    abad_mass: tuple[float, float] = (0.0, 0.1)
    """Added to each abad link [kg]; the paper's 'hip'."""
    hip_mass: tuple[float, float] = (-0.05, 0.05)
    """Added to each hip link [kg]; the paper's 'thigh'."""
    knee_mass: tuple[float, float] = (-0.05, 0.05)
    """Added to each knee link [kg]; the paper's 'calf'."""
    toe_mass: tuple[float, float] = (0.0, 0.01)
    """Added at each toe [kg]; the paper's 'foot'."""
    com: tuple[float, float] = (-0.01, 0.01)
    """Shift of the trunk's centre of mass along each axis [m]."""
    kp: tuple[float, float] = (0.8, 1.2)
    """Factor on each joint's position gain."""
    kd: tuple[float, float] = (0.8, 1.2)
    """Factor on each joint's velocity gain."""
    delay: tuple[float, float] = (0.005, 0.030)
    """From a command's decision to its effect [s]; drawn anew for every episode, rounded to physics steps."""
    push: tuple[float, float] = (0.0, 0.2)
    """Speed of a horizontal push to the trunk every push_interval [m/s]."""
    push_interval: float = 5.0
    """Time between two pushes [s]."""
    start_q: tuple[float, float] = (-0.1, 0.1)
    """Added to each joint of the lying pose [rad]."""
    start_height: tuple[float, float] = (0.0, 0.02)
    """Added to the base height of the lying pose [m]."""
    heading: tuple[float, float] = (-3.141592653589793, 3.141592653589793)
    """Heading at the start [rad]."""


NOMINAL = Randomisation(
    joint_friction=(0.05, 0.05),
    joint_damping=(0.04, 0.04),
    ground_friction=(1.0, 1.0),
    base_mass=(0.0, 0.0),
    abad_mass=(0.0, 0.0),
    hip_mass=(0.0, 0.0),
    knee_mass=(0.0, 0.0),
    toe_mass=(0.0, 0.0),
    com=(0.0, 0.0),
    kp=(1.0, 1.0),
    kd=(1.0, 1.0),
    delay=(0.015, 0.015),
    push=(0.0, 0.0),
    start_q=(0.0, 0.0),
    start_height=(0.0, 0.0),
    heading=(0.0, 0.0),
)
"""Nothing is randomised: the model as the robot description gives it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class EvaluateSettings:
    """How a policy is judged."""

    episodes: int = 200
    """Randomised episodes from the lying start."""
    seconds: float = 20.0
    """Length of an episode [s]."""
    seed: int = 1
    """Seed of the first episode; episode i uses seed + i."""
    workers: int = 0
    """Processes; 0 takes one for each core."""
    randomisation: Randomisation = field(default_factory=Randomisation)

    def __post_init__(self) -> None:
        _check_range("episodes", self.episodes, 1, 100_000)
        _check_range("seconds", self.seconds, 2.0, 600.0, "s")
        _check_range("workers", self.workers, 0, 1024)


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewSettings:
    """What is shown of a run."""

    view: Literal["auto", "yes", "no"] = "auto"
    """Open Rerun; auto opens it where a display exists."""

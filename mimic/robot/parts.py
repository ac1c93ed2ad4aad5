"""The parts of a robot's description: typed records, each filled from a table of robot.toml."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mimic.records import LEGS, FloatArray

ROLES = ("trunk", "head", "abad", "shoulder", "thigh", "shank", "knee", "toe")
"""Roles of collision shapes: of the base (trunk, head), of the abad link (abad, shoulder: the hip motor at its end), of
the hip link (thigh), and of the knee link (shank, knee: a pad at the joint, toe: one ball)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelNames:
    """What the MJCF calls the robot's parts; see `mimic.robot.model`, which gives joints and links their roles.

    ``{leg}`` in a name stands for the model's name of a leg.
    """

    file: str
    """MJCF of the robot alone, in the folder of the description."""
    scene: str
    """MJCF of the robot on a floor; empty where there is none."""
    base: str
    """Body that carries the legs."""
    legs: tuple[str, ...]
    """The model's names of the legs, in the order of LEGS."""
    joints: tuple[str, ...]
    """Names of the abad, hip and knee joint of a leg."""
    links: tuple[str, ...]
    """Names of the bodies that these joints move."""
    toe_site: str
    """Site at the centre of a toe; empty where the model has none."""
    patterns: Mapping[str, tuple[str, ...]]
    """Role -> names of the collision shapes that have it."""

    def of_leg(self, name: str, leg: str) -> str:
        """Return a name with the model's name of a leg (FL, FR, RL or RR) put in."""
        return name.replace("{leg}", self.legs[LEGS.index(leg)])

    def shapes(self, *roles: str, legs: Sequence[str] = LEGS) -> tuple[str, ...]:
        """Return the names of the collision shapes with any of these roles, those of the given legs only.

        Args:
            roles: Of ROLES.
            legs: Of LEGS; shapes of the base belong to no leg and are always returned.
        """
        found: list[str] = []
        for pattern in (pattern for role in roles for pattern in self.patterns[role]):
            found += [self.of_leg(pattern, leg) for leg in legs] if "{leg}" in pattern else [pattern]
        return tuple(found)


@dataclass(frozen=True, kw_only=True, eq=False)
class Goals:
    """Boxes in which front-toe goals are drawn, left toe in base axes; the right toe mirrors y."""

    share: FloatArray
    """Probability of each box (B,)."""
    low: FloatArray
    """Lower corners (B, 3) [m]."""
    high: FloatArray
    """Upper corners (B, 3) [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LegGeometry:
    """Lengths of the front left leg; the other legs mirror it."""

    origin: FloatArray
    """Base -> abad axis (3,), base axes [m]; hind legs mirror x, right legs y."""
    offset: float
    """Abad axis -> plane of hip and knee, along y; right legs mirror it [m]."""
    thigh: float
    """Hip axis -> knee axis, along -z [m]."""
    toe: FloatArray
    """Knee axis -> centre of the toe (3,), knee axes [m]; y is 0."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """A box of the base, along its axes."""

    centre: FloatArray
    """Base -> centre (3,) [m]."""
    size: FloatArray
    """Full edge lengths (3,) [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Workspace:
    """Where and how fast the front toes may be sent."""

    margin: float
    """Distance kept from each joint limit [rad]."""
    clearance: float
    """Least gap between a front leg and what it must not touch [m]."""
    speed_share: float
    """Share of ``speed_flat`` that targets may ask of a joint."""
    torque_share: float
    """Share of ``torque_max`` that targets may ask for acceleration."""
    arm_scale: FloatArray
    """What the person's arm is multiplied by, forward, left and up (3,) [m per arm length]."""
    arm_forward: float
    """How far the scaled arm is moved forward [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandLimits:
    """The commands that policies for this robot are trained and evaluated with."""

    velocity: FloatArray
    """Fastest base velocity, forward and left (2,) [m/s]."""
    turn_rate: float
    """Fastest change of a desired heading [rad/s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ThermalNumbers:
    """Two first-order responses of the winding's temperature to the torque squared."""

    winding_share: float
    """Share of the fast response (winding over housing)."""
    winding_time: float
    """Time constant of the fast response [s]."""
    housing_time: float
    """Time constant of the slow response (housing over air) [s]."""
    overload_torque: FloatArray
    """Torques of the motor's overload table (N,) [N m]; none where the maker has no such table."""
    overload_time: FloatArray
    """How long each may last from 25 degC (N,) [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeRanges:
    """Where the joints of the suspended robot may go while its drives are measured."""

    low: FloatArray
    """(12,) [rad]"""
    high: FloatArray
    """(12,) [rad]"""
    centre: FloatArray
    """Where the motion begins (12,) [rad]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingNumbers:
    """Thresholds of rewards and terminations that follow from the size and the motors of the robot."""

    rise_from: float
    """Base height while lying [m]."""
    rise_to: float
    """Base height from which on the robot stands [m]."""
    height_low: float
    """Base height up to which tracking earns nothing [m]."""
    height_span: float
    """Further height over which the tracking rewards grow to their full weight [m]."""
    height_fallen: float
    """A robot that stood and whose base is lower than this has fallen [m]."""
    joint_speed: float
    """Joint speed above which a joint pays [rad/s]."""
    early_toe_height: float
    """Highest hind toe in the first control steps [m]."""
    early_joint_step: float
    """Largest joint motion of a control step in the first control steps [rad]."""
    lying_height: float
    """Base height of lying with powered motors [m]."""


@dataclass(frozen=True, kw_only=True)
class StartNumbers:
    """How the robot comes from lying without power into the crouch, and what it must be like there."""

    kp: float
    """Position gain of every joint meanwhile [N m/rad]."""
    kd: float
    """Velocity gain [N m s/rad]."""
    joints: float
    """Largest distance of a joint from the crouch [rad]."""
    height: float
    """Least height of the base, where it is measured [m]."""
    tilt: float
    """Largest tilt of the base [rad]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrunkNumbers:
    """How the robot stands by itself, and how far its trunk may be lowered and leant from there."""

    stance: FloatArray
    """Hind legs of a robot that stands by itself, left then right (6,) [rad]."""
    lean: float
    """Forward lean of base x from the vertical there [rad]."""
    height: tuple[float, float]
    """Lowest and highest hind hips, from how it stands by itself [m]."""
    pitch: tuple[float, float]
    """Farthest lean backward and forward, from how it stands by itself [rad]."""
    height_speed: float
    """Fastest change of the height [m/s]."""
    pitch_speed: float
    """Fastest change of the lean [rad/s]."""


@dataclass(frozen=True, kw_only=True)
class SafetyNumbers:
    """Limits of the safety rules that follow from the size and the motors of the robot."""

    temperature_warning: float
    """Motor temperature that is announced [degC]."""
    temperature: float
    """… at which the robot sits down [degC]."""
    low_voltage: float
    """Supply, median of five seconds, that is announced [V]."""
    lowest_voltage: float
    """… at which the robot sits down [V]."""
    jump: float
    """Change of a joint between two ticks that no motor can make [rad]."""
    overspeed: float
    """Velocity of a joint in two readings in a row that no motor drives [rad/s]."""
    turn_mismatch: float
    """Difference between turn of the orientation and rate of turn, per tick, that no motion makes [rad]."""
    toes_apart: float
    """Difference in height of the hind toes by legs and IMU while standing [m]."""
    toes_apart_moving: float
    """… while standing up and sitting down [m]."""
    front_above: float
    """Height of the lower front toe over the lower hind toe while standing, at least [m]."""
    upright: float
    """Cosine between base x and the upright direction; below, a standing robot is about to fall."""
    side_tilt: float
    """Sine of the base's roll while standing up, sitting down or lying."""
    backward: float
    """Up component of base z while standing up or sitting down; below, the robot falls onto its back."""
    rest_speed: float
    """A joint slower than this rests [rad/s]."""
    damp_seconds: float
    """Longest time that the robot is damped before it is switched off [s]."""

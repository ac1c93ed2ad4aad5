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
    scene: str = ""
    """MJCF of the robot on a floor; empty where there is none."""
    base: str
    """Body that carries the legs."""
    legs: tuple[str, ...]
    """The model's names of the legs, in the order of LEGS."""
    joints: tuple[str, ...]
    """Names of the abad, hip and knee joint of a leg."""
    links: tuple[str, ...]
    """Names of the bodies that these joints move."""
    toe_site: str = ""
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
    scale: FloatArray
    """What the person's arm is multiplied by, forward, left and up (3,) [m per arm length]."""
    forward: float
    """How far the scaled arm is moved forward [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandLimits:
    """The commands that policies for this robot are trained and evaluated with."""

    velocity_max: FloatArray
    """Fastest base velocity, forward and left (2,) [m/s]."""
    turn_rate_max: float
    """Fastest change of a desired heading [rad/s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ThermalNumbers:
    """Two first-order responses of the winding's temperature to the torque squared."""

    winding_share: float
    """Share of the fast response (winding over housing)."""
    winding_seconds: float
    """Time constant of the fast response [s]."""
    housing_seconds: float
    """Time constant of the slow response (housing over air) [s]."""


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
    """Left hind leg of a robot that stands by itself (3,) [rad]."""
    lean: float
    """Forward lean of base x from the vertical there [rad]."""
    height: FloatArray
    """Lowest and highest hind hips, from how it stands by itself (2,) [m]."""
    pitch: FloatArray
    """Farthest lean backward and forward, from how it stands by itself (2,) [rad]."""
    height_speed: float
    """Fastest change of the height [m/s]."""
    pitch_speed: float
    """Fastest change of the lean [rad/s]."""


@dataclass(frozen=True, kw_only=True)
class SafetyLimits:
    """Limits of the safety rules: first those that follow from the size and the motors of the robot, then those of any
    robot, each with its reason."""

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
    silent_ticks: int = 5
    """Control steps without an answer: 100 ms, after which robots without any bus still stood (8 of 8; 7 of 8 after
    150 ms)."""
    silent_seconds: float = 0.095
    """… and this long [s]: after an overrun, steps may follow each other too fast for an answer."""
    failed_motors: int = 1
    """With one failed motor the other eleven may still bring the robot down; with two this was never tried."""
    rise_warning: float = 0.85
    """Of the winding's limit, by the thermal model."""
    rise: float = 0.95
    """… at which it sits down, which takes 2.5 s."""
    outside: float = 0.2
    """Joint reading beyond its limit [rad]; healthy none, with an earlier policy 0.02. Such a pose does not exist: the
    zero is wrong."""
    imu_age: float = 0.12
    """[s] Six ticks; robots without an orientation for 300 ms still stood (8 of 8)."""
    doubt_ticks: int = 3
    """Orientations in a row that contradict the rate of turn; fewer are left out as if they had not come."""
    frozen_ticks: int = 16
    """Readings in a row of one joint that are equal to the last bit, …"""
    frozen_targets: float = 0.15
    """… while its target moved by this [rad]. In 30 minutes of standing, simulated, at most 0.024 over so many readings
    rounded as CyberGear rounds them (0.38 mrad), and 0.061 rounded to 1 mrad with noise of 0.3 mrad."""
    off_target: float = 0.8
    """Distance of a joint from its target [rad] …"""
    off_target_ticks: int = 25
    """… in so many steps in a row: half a second. Healthy at most 0.38 rad for so long."""
    imu_repeats: int = 3
    """Orientations in a row with the same content while a policy moves the robot; healthy at most 1."""
    legs_ticks: int = 3
    """Ticks in a row in which legs and IMU contradict each other: 60 ms; a foot may be lifted for one."""
    fallen: float = 0.3
    """Cosine between base x and up; below, a robot that should stand has fallen. The limit of the training."""
    overrun: float = 0.010
    """A step that ends this much later than planned [s]: half a control step."""
    overrun_ticks: int = 3
    """Overruns in a row."""
    small_overrun: float = 0.002
    """A smaller overrun [s]: a tenth of a control step."""
    small_overruns_logged: int = 3
    """Smaller overruns in a row that are logged."""
    small_overrun_ticks: int = 25
    """Smaller overruns in a row: half a second. The policy was trained with delays of up to 35 ms, so one of 2 ms does
    no harm; half a second of them shows that the computer cannot keep up."""
    longest_overrun: float = 0.1
    """One overrun this long [s]: five control steps without a command."""
    sender_age: float = 0.06
    """Age of the newest report of the process that sends [s]; one comes every 3 ms."""
    bus_errors: int = 12
    """Error frames within a tenth of a second: one for each motor."""
    slow_answers: float = 0.02
    """From a question to its answer, median of half a second, that is announced [s]; a quiet bus takes 1 to 5 ms."""
    slowest_answers: float = 0.06
    """… at which it sits down [s]: 30 ms each way, with which 8 of 8 robots still stood; with 40 ms it were 7."""
    foreign_storm: int = 12
    """Commands of another program within a tenth of a second: as many as the robot has motors. Sitting down needs
    motors that follow one program."""
    rest_seconds: float = 0.5
    """[s]"""

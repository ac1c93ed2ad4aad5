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
    min_duration: float = 0.1
    """A clip shorter than this is refused: it holds less than one sampling step [s]."""
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
class StoredSettings:
    """What a file with stored motion does not say itself; for .npz, .trc and .bvh."""

    names: tuple[str, ...] = ()
    """OURS=THEIRS for each point whose name no built-in table knows, such as left_wrist=LWRA+LWRB."""
    layout: str | None = None
    """Names of points that have none, such as coco17 or smpl24; by default by their number."""
    up: Literal["auto", "x", "y", "z", "-x", "-y", "-z"] = "auto"
    """Axis that points up; auto asks the file, then the person's trunk."""
    fps: float = 0.0
    """Rows a second; 0 takes the times of the file [1/s]."""

    def __post_init__(self) -> None:
        _check_range("fps", self.fps, 0.0, 10_000.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class LanguageSettings:
    """How a sentence becomes key frames."""

    planner: Literal["auto", "llm", "phrasebook"] = "auto"
    """Who reads the sentence; auto is llm where an endpoint or a model is named, else the phrasebook."""
    llm_url: str | None = None
    """Endpoint that speaks OpenAI's chat completions, such as http://127.0.0.1:11434/v1; the key is OPENAI_API_KEY."""
    llm_model: str | None = None
    """Name of the model at the endpoint."""
    llm_timeout: float = 120.0
    """Longest wait for an answer [s]."""
    longest: float = 60.0
    """Longest motion [s]."""

    def __post_init__(self) -> None:
        _check_range("llm-timeout", self.llm_timeout, 0.1, 3600.0, "s")
        _check_range("longest", self.longest, 1.0, 600.0, "s")


@dataclass(frozen=True, kw_only=True, slots=True)
class LiveSettings:
    """How a camera is followed while it looks."""

    follow: bool = False
    """Turn and walk as the person turns and walks, slowly; otherwise the robot stays where it is."""
    lost_hold: float = 0.5
    """How long a hand that is lost stays where it was, before it eases to neutral [s]."""
    steady_hz: float = 1.5
    """Cut-off of the causal filter for a hand at rest [Hz]; lower is calmer and later."""
    lively: float = 4.0
    """How much that cut-off rises with the speed of the hand [Hz s/m]."""
    camera_size: tuple[int, int] = (640, 480)
    """Width and height asked of the camera [px]."""

    def __post_init__(self) -> None:
        _check_range("lost-hold", self.lost_hold, 0.0, 10.0, "s")
        _check_range("steady-hz", self.steady_hz, 0.1, 30.0, "Hz")
        _check_range("lively", self.lively, 0.0, 100.0)


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
class EffectsSettings:
    """What a calibration found out about the robot that is simulated."""

    effects: str | None = None
    """effects.toml of a calibration; None simulates the robot as described."""
    timestep: float = 0.0025
    """Physics step with effects [s]; by default the step without effects."""

    def __post_init__(self) -> None:
        _check_range("timestep", self.timestep, 2.5e-4, 0.01, "s")


@dataclass(frozen=True, kw_only=True, slots=True)
class EmulateSettings:
    """How the emulated robot is."""

    hung: bool = False
    """Hang it up by its trunk, its feet free; otherwise it lies on the floor."""
    homed: bool = False
    """Its zeros are set; otherwise they are lost, as at every power-up."""
    placement: float = 0.05
    """Its joints are placed as far as this from the lying pose [rad]."""
    seed: int = 0
    """Draws where encoders are mounted, the placement, noise and losses."""
    position_range: float = 12.566370614359172
    """Position range that the motors really have [rad]; 12.5 is the other one in circulation."""
    can_timeout: bool = False
    """The motors' firmware honours CAN_TIMEOUT; otherwise writing it does nothing."""
    reply: float = 250e-6
    """From a command to its answer [s]; cybergear_m5, CYBERGEAR_RESPONSE_TIME."""
    imu_noise: float = 0.003
    """Standard deviation of the IMU's rates of turn [rad/s]."""

    def __post_init__(self) -> None:
        _check_range("placement", self.placement, 0.0, 0.4, "rad")
        _check_range("position-range", self.position_range, 1.0, 100.0, "rad")
        _check_range("reply", self.reply, 0.0, 0.01, "s")
        _check_range("imu-noise", self.imu_noise, 0.0, 1.0, "rad/s")


AS_DESCRIBED = EffectsSettings()
"""The robot without effects."""


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
    sit_down: float = 2.5
    """Time to sit down at the end [s]; the policy needs about half of it."""

    def __post_init__(self) -> None:
        _check_range("stand-up", self.stand_up, 1.0, 10.0, "s")
        _check_range("blend", self.blend, 0.1, 5.0, "s")
        _check_range("hold", self.hold, 0.0, 30.0, "s")
        _check_range("sit-down", self.sit_down, 1.5, 10.0, "s")


@dataclass(frozen=True, kw_only=True, slots=True)
class BusSettings:
    """How a robot on its bus is driven."""

    wiring: str | None = None
    """bus.toml of this robot; None takes the shipped one."""
    homed: bool = False
    """Take the zeros as the wiring has them, without looking whether mimic set them since the power came."""
    yes: bool = False
    """Do not wait for Enter; for rehearsals."""
    guardian: bool = True
    """Start the process that damps the robot when this one cannot."""
    torque_limit: float = 12.0
    """What each motor may give [N m]; written into the motors and read back."""
    ramp: float = 2.0
    """Time in which gains rise and the joints come into the lying pose [s]."""

    def __post_init__(self) -> None:
        _check_range("torque-limit", self.torque_limit, 1.0, 12.0, "N m")
        _check_range("ramp", self.ramp, 0.5, 30.0, "s")


@dataclass(frozen=True, kw_only=True, slots=True)
class ProbeSettings:
    """How a robot that hangs is moved to see what its drives are like."""

    seconds: float = 120.0
    """Length of the motion [s]."""
    rate: float = 200.0
    """Readings a second [Hz]; one bus carries twelve motors at 200 Hz, with 70 % of its time."""
    joints: Literal["all", "sides", "legs", "each"] = "all"
    """Joints that move at the same time: all, the six of one side, those of one leg, or one; legs that are held are asked
    less often, which takes load off the bus."""
    size: float = 0.5
    """Share of the joints' ranges that is used."""
    kind: Literal["probe", "random"] = "probe"
    """probe shows every effect; random is for a second log."""
    kp: float = 30.0
    """[N m/rad]"""
    kd: float = 1.0
    """[N m s/rad]"""
    approach: float = 3.0
    """Time in which the gains rise, and again in which the joints come to where the motion begins [s]."""
    seed: int = 0
    """Draws the motion."""

    def __post_init__(self) -> None:
        _check_range("seconds", self.seconds, 12.0, 3600.0, "s")
        _check_range("rate", self.rate, 50.0, 250.0, "Hz")
        _check_range("approach", self.approach, 0.2, 60.0, "s")
        _check_range("size", self.size, 0.05, 1.0)
        _check_range("kp", self.kp, 1.0, 100.0, "N m/rad")
        _check_range("kd", self.kd, 0.1, 5.0, "N m s/rad")


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
    restitution: tuple[float, float] = (0.0, 0.4)
    """Rebound speed over impact speed of the ground."""
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
    restitution=(0.0, 0.0),
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
    robot: EffectsSettings = AS_DESCRIBED
    """Which robot is simulated."""

    def __post_init__(self) -> None:
        _check_range("episodes", self.episodes, 1, 100_000)
        _check_range("seconds", self.seconds, 2.0, 600.0, "s")
        _check_range("workers", self.workers, 0, 1024)


@dataclass(frozen=True, kw_only=True, slots=True)
class SitDownEvaluateSettings:
    """How a policy that sits down is judged."""

    episodes: int = 500
    """Randomised hand-overs from a tracking policy."""
    seconds: float = 10.0
    """Latest hand-over after the start [s]."""
    seed: int = 1
    """Seed of the first episode; episode i uses seed + i."""
    workers: int = 0
    """Processes; 0 takes one for each core."""
    tracker: str | None = None
    """Policy that stands and tracks before; None takes the shipped one."""
    randomisation: Randomisation = field(default_factory=Randomisation)
    robot: EffectsSettings = AS_DESCRIBED
    """Which robot is simulated."""

    def __post_init__(self) -> None:
        _check_range("episodes", self.episodes, 1, 100_000)
        _check_range("seconds", self.seconds, 2.0, 600.0, "s")
        _check_range("workers", self.workers, 0, 1024)


@dataclass(frozen=True, kw_only=True, slots=True)
class TableSettings:
    """How a policy is judged in the figures of the paper's Table III."""

    episodes: int = 50
    """Episodes of each evaluation seed; paper: 50."""
    seeds: int = 3
    """Evaluation seeds. The paper's three are training seeds."""
    seconds: float = 20.0
    """Length of an episode [s]; paper: 1000 control steps."""
    seed: int = 1
    """Seed of the first episode."""
    workers: int = 0
    """Processes; 0 takes one for each core."""
    randomisation: Randomisation = field(default_factory=Randomisation)
    robot: EffectsSettings = AS_DESCRIBED
    """Which robot is simulated."""

    def __post_init__(self) -> None:
        _check_range("episodes", self.episodes, 1, 100_000)
        _check_range("seeds", self.seeds, 1, 1000)
        _check_range("seconds", self.seconds, 2.0, 600.0, "s")
        _check_range("workers", self.workers, 0, 1024)


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
class StandUpSettings:
    """How standing up and standing still are judged."""

    episodes: int = 500
    """Lying starts."""
    seconds: float = 3.0
    """Length of each [s]; who stands up must still stand at its end."""
    still_episodes: int = 10
    """Nominal robots that stand still."""
    still_seconds: float = 20.0
    """For how long [s], from the second second on."""
    seed: int = 1
    """Seed of the first episode."""
    workers: int = 0
    """Processes; 0 takes one for each core."""
    randomisation: Randomisation = STAND_UP_RANGES
    robot: EffectsSettings = AS_DESCRIBED
    """Which robot is simulated."""

    def __post_init__(self) -> None:
        _check_range("episodes", self.episodes, 1, 100_000)
        _check_range("seconds", self.seconds, 2.5, 600.0, "s")
        _check_range("still-seconds", self.still_seconds, 1.0, 600.0, "s")
        _check_range("workers", self.workers, 0, 1024)


@dataclass(frozen=True, kw_only=True, slots=True)
class Disturbance:
    """What happens to a simulated robot besides its variation; the default is nothing."""

    toe: Literal["left", "right"] = "left"
    """Front toe that carries and is dragged."""
    toe_payload: float = 0.0
    """Mass at that toe [kg]."""
    drag: float = 0.0
    """Horizontal force on that toe, in a direction drawn for each start [N]."""
    drag_from: float = 4.0
    """When the force begins [s]."""
    drag_seconds: float = 3.0
    """How long it lasts [s]."""
    slope: float = 0.0
    """Inclination of the ground, falling in a direction drawn for each start [deg]."""
    imu_tilt: float = 0.0
    """Mounting error of the IMU, about an axis drawn for each start [deg]."""
    noise_q: float = 0.0
    """Half width of the noise on measured joint positions, drawn at each control step [rad]."""
    noise_imu: float = 0.0
    """Half width of the noise on the measured orientation about each axis, drawn at each control step [rad]."""
    lost_share: float = 0.0
    """Probability that a command does not arrive; the one before stays in effect."""

    def __post_init__(self) -> None:
        _check_range("toe-payload", self.toe_payload, 0.0, 5.0, "kg")
        _check_range("drag", self.drag, 0.0, 100.0, "N")
        _check_range("slope", self.slope, 0.0, 30.0, "deg")
        _check_range("imu-tilt", self.imu_tilt, 0.0, 30.0, "deg")
        _check_range("noise-q", self.noise_q, 0.0, 1.0, "rad")
        _check_range("noise-imu", self.noise_imu, 0.0, 1.0, "rad")
        _check_range("lost-share", self.lost_share, 0.0, 1.0)


CALM = Disturbance()
"""Nothing happens."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Solver:
    """How the physics is integrated; the default is that of the robot description."""

    timestep: float = 0.0025
    """Physics step [s]; the control step must be a multiple of it."""
    integrator: Literal["implicitfast", "implicit", "Euler"] = "implicitfast"
    cone: Literal["elliptic", "pyramidal"] = "elliptic"
    """Shape of the friction cones."""

    def __post_init__(self) -> None:
        _check_range("timestep", self.timestep, 1e-4, 0.02, "s")


@dataclass(frozen=True, kw_only=True, slots=True)
class RobustnessSettings:
    """How far a policy can be disturbed."""

    episodes: int = 40
    """Episodes at each point; the same starts and commands at every point."""
    seconds: float = 10.0
    """Length of an episode [s]."""
    seed: int = 1
    """Seed of the first episode."""
    workers: int = 0
    """Processes; 0 takes one for each core."""
    robot: EffectsSettings = AS_DESCRIBED
    """Which robot is simulated."""

    def __post_init__(self) -> None:
        _check_range("episodes", self.episodes, 1, 100_000)
        _check_range("seconds", self.seconds, 2.5, 600.0, "s")
        _check_range("workers", self.workers, 0, 1024)


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewSettings:
    """What is shown of a run."""

    view: Literal["auto", "yes", "no"] = "auto"
    """Open Rerun; auto opens it where a display exists."""


TRAINING_RANDOMISATION = Randomisation(
    joint_friction=(0.0, 0.12),
    joint_damping=(0.0, 0.08),
    ground_friction=(0.4, 3.0),
    restitution=(0.0, 0.45),
    base_mass=(-1.0, 1.0),
    kp=(0.8, 1.2),
    kd=(0.8, 1.2),
    delay=(0.0, 0.035),
    push=(0.0, 0.5),
    push_interval=4.0,
    start_q=(-0.15, 0.15),
    start_height=(0.0, 0.03),
)
"""Wider than the paper's Table II, so that its ends are not the edge of what the policy has seen. Joints also share a
factor on their gains: DisturbanceRanges.kp and kd."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DisturbanceRanges:
    """What happens to a robot in training besides its randomisation; a pair is uniform between its ends.

    The paper has none of these. Each range holds what the real robot is expected to see, with a reason beside it.
    """

    kp: tuple[float, float] = (0.75, 1.25)
    """Factor on the position gain that all joints share, besides each joint's own: one firmware, one supply voltage."""
    kd: tuple[float, float] = (0.75, 1.25)
    """… and on the velocity gain."""
    contact_time: tuple[float, float] = (0.75, 1.5)
    """Factor on the time constant of the ground contact; nothing about a real floor's is known, and solvers differ."""
    slope: tuple[float, float] = (0.0, 4.0)
    """Inclination of the ground in any direction [deg]; pavements are built with 1-2, ramps with 3-5."""
    toe_payload: tuple[float, float] = (0.0, 0.2)
    """Mass at one front toe [kg]: a boxing glove, a flag."""
    imu_tilt: tuple[float, float] = (0.0, 3.0)
    """Mounting error of the IMU about any axis [deg]; screwed by hand, not calibrated."""
    lost_share: tuple[float, float] = (0.0, 0.08)
    """Probability that a command does not arrive; the one before stays in effect."""
    drag: tuple[float, float] = (0.0, 8.0)
    """Horizontal pull on one front toe [N]: a hand that holds it."""
    drag_share: float = 0.3
    """Share of episodes with such a pull."""
    drag_from: tuple[float, float] = (1.5, 8.0)
    """When it begins [s]."""
    drag_seconds: float = 3.0
    """How long it lasts [s]."""


UNDISTURBED = DisturbanceRanges(
    kp=(1.0, 1.0),
    kd=(1.0, 1.0),
    contact_time=(1.0, 1.0),
    slope=(0.0, 0.0),
    toe_payload=(0.0, 0.0),
    imu_tilt=(0.0, 0.0),
    lost_share=(0.0, 0.0),
    drag=(0.0, 0.0),
)
"""Nothing happens."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RewardWeights:
    """Weight of each reward term, per control step; see mimic.train.rewards for the terms."""

    alive: float = 0.5
    height: float = 0.6
    upright: float = 1.0
    velocity: float = 5.0
    heading: float = 2.0
    toes: float = 6.0
    toes_fine: float = 3.0
    gait: float = 12.0
    drift: float = 0.0
    """Off: not shown to be good for anything (docs/policy.md)."""
    slip: float = -4.0
    foot_shift: float = -8.0
    rules: float = -4.0
    flight: float = -0.5
    low: float = -0.3
    action_rate: float = -0.012
    torque: float = -2e-4
    overload: float = -0.005
    joint_velocity: float = -3e-4
    joint_speed: float = -0.02
    joint_acceleration: float = -1e-7
    limits: float = -6.0
    fall: float = -2.0


REGULARISERS = ("action_rate", "torque", "joint_velocity", "joint_acceleration")
"""Reward terms that grow during training, once the robot stands."""

TASKS = ("velocity", "toes", "toes_fine", "gait")
"""Reward terms of what a standing robot does."""

LATE = ("drift", "slip", "foot_shift", "rules", "flight", "overload", "joint_speed")
"""Reward terms that hardly count before the robot stands. With all of them from the beginning a world loses more by each
step than by falling, and a policy learns to fall at once; that was tried."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FinishFactors:
    """What the weights of a few reward terms are multiplied by at the end of a training."""

    velocity: float = 5.0
    heading: float = 2.5
    toes: float = 1.0
    toes_fine: float = 2.0
    slip: float = 7.0


@dataclass(frozen=True, kw_only=True, slots=True)
class SitDownWeights:
    """Weight of each reward term of sitting down, per control step; see mimic.train.sit_down for the terms."""

    height: float = 1.6
    level: float = 0.8
    roll: float = -1.0
    pose: float = 2.0
    pose_fine: float = 1.0
    still: float = 0.6
    sinking: float = -15.0
    fast: float = -2.0
    tumbling: float = -0.05
    jolt: float = -2.0
    landing: float = -5.0
    trunk: float = -1.0
    thighs: float = -0.2
    head_low: float = -4.0
    slip: float = -0.25
    beyond: float = -1.0
    action_rate: float = -0.008
    torque: float = -2e-4
    joint_velocity: float = -4e-4
    joint_speed: float = -0.02
    joint_acceleration: float = -1e-7
    limits: float = -2.0
    fail: float = -10.0


@dataclass(frozen=True, kw_only=True, slots=True)
class SitDownSettings:
    """The second task: from upright down to lying on four feet."""

    episode_steps: int = 150
    """Control steps of an episode."""
    seconds: float = 1.2
    """Time that going down should take [s]."""
    height: float = 0.11
    """Base height of lying with powered joints; the legs give way by 2 cm [m]."""
    clock_hz: float = 0.08
    """Frequency of the clock, which starts with the sitting down and tells the policy how far it should be [Hz]."""
    states: str = "handovers.npz"
    """File of recorded states in policies/, or a path; see benchmarks/handover_states.py."""
    steady_share: float = 0.45
    """Share of episodes that start from a state recorded while standing, walking and turning."""
    rising_share: float = 0.1
    """… while standing up."""
    falling_share: float = 0.15
    """… while falling after a push."""
    lying_share: float = 0.1
    """Share that start lying; the others start upright with random front legs and a random tilt and motion."""
    jitter_velocity: float = 0.15
    """Largest change of a recorded base velocity along each axis [m/s]."""
    crash_speed: float = 0.8
    """An episode ends where the trunk touches the ground faster than this [m/s]."""
    rewards: SitDownWeights = field(default_factory=SitDownWeights)


@dataclass(frozen=True, kw_only=True, slots=True)
class MdpSettings:
    """The worlds a policy is trained in."""

    task: Literal["stand_track", "sit_down"] = "stand_track"
    """What is trained: stand, track and walk, or sit down."""
    sit_down: SitDownSettings = field(default_factory=SitDownSettings)
    """What is different for sitting down."""
    worlds: int = 8192
    """Robots simulated at once."""
    effects: str = ""
    """effects.toml of a calibration, around which the robots are drawn; empty draws them around the description."""
    timestep: float = 0.0
    """Physics step [s]; 0 is that of the description."""
    episode_steps: int = 600
    """Control steps of an episode; shorter than the paper's 1000, so that more of them stand up."""
    stand_up_steps: int = 50
    """Control steps until goals and terminations begin; paper: 50."""
    rise_seconds: float = 0.7
    """Time that standing up should take [s]; faster and slower both cost."""
    upright_share: float = 0.25
    """Share of episodes that start upright, once the robot stands."""
    upright_share_at_first: float = 0.5
    """… and before: balance is what takes longest to learn."""
    command_seconds: tuple[float, float] = (3.0, 10.0)
    """Time between two velocity and heading commands [s]; paper: 10."""
    still_share: float = 0.3
    """Share of velocity commands that are zero; the same of heading commands that keep the heading."""
    goal_seconds: tuple[float, float] = (0.1, 3.0)
    """Time between two toe goals [s], log-uniform; paper: 3."""
    paper_goal_share: float = 0.35
    """Share of goals that take 3 s on a straight line, as in the paper."""
    hold_share: float = 0.15
    """Share of goals that stay where they are."""
    goal_speed: float = 2.0
    """Fastest mean speed of a toe goal [m/s]."""
    goals_anywhere: float = 0.35
    """Share of goals drawn over the whole reachable set instead of the paper's boxes."""
    clock_hz: float = 4.0
    """Frequency of the gait clock [Hz]. The feet stand 0.28 m apart, so that the robot rocks from foot to foot: 0.13 m/s to
    each side at 3 Hz, 0.09 at 4 (root mean square), which counts as velocity error."""
    action_scale: float = 0.5
    """Radians per unit of action."""
    action_clip: float = 6.0
    """Actions are clipped to plus and minus this."""
    history: int = 6
    """Frames in an observation; paper: 3. The speed of the base cannot be seen in 60 ms; 120 ms are half a gait cycle."""
    noise_q: float = 0.01
    """Half width of the noise on joint positions [rad]."""
    noise_axes: float = 0.015
    """Half width of the noise on the two world axes."""
    solver_iterations: int = 4
    """Newton iterations of the training physics; the judge uses MuJoCo's 100. After 0.6 s of standing up in steps of 2.5 ms
    nine of ten worlds are within 1e-2 rad of the judge and the worst 2e-2 away; 5 to 7: 7e-3 and 2e-2; 10: 8e-5 and 6e-3
    (benchmarks/solver_accuracy.py). Six take 13 % more time."""
    linesearch_iterations: int = 6
    """Line-search iterations of the training physics."""
    contacts: int = 8
    """Most contacts of a world on average, since all worlds share one store; robots that lie have 4."""
    rows: int = 64
    """Most constraint rows of a world; the most seen with wild random actions is 60, lying 32."""
    sparse: bool = False
    """Constraint Jacobians in sparse form; the same physics, other kernels."""
    randomisation: Randomisation = TRAINING_RANDOMISATION
    disturbances: DisturbanceRanges = field(default_factory=DisturbanceRanges)
    command_margin: float = 0.09
    """Commanded joint positions keep this far from the joint limits [rad]. With more than the 5 degrees at which the paper
    ends an episode no joint gets there by itself, but an almost straight knee is left without torque."""
    ease_falls: float = 0.008
    """While fewer robots than this fall in a control step, what makes the task hard grows: the paper's terminations, the
    LATE reward terms, disturbances. Imposed from the beginning, the terminations end every episode within the first tenth
    of a second, before anything is learned."""
    ease_steps: float = 9_600.0
    """Control steps of a world over which they grow; a termination ends an episode with a probability a step that grows
    with the square of the share done."""
    ease_latest: float = 16_800.0
    """From this control step of a world on they grow in any case."""
    task_share: float = 1.0
    """Share of their weight that the TASKS reward terms have before; it grows to 1."""
    late_share: float = 0.05
    """Share of their weight that the LATE reward terms have before; it grows to 1."""
    calm_share: float = 0.2
    """Share of the disturbances, pushes, gain factors and bounce of the ground that worlds see before; it grows to 1. On a
    ground that bounces fully from the beginning a policy learns to stand and step with almost straight legs, and keeps that
    (docs/policy.md)."""
    slip_height: float = 0.033
    """A toe whose centre is lower than this pays for moving [m]; paper: 0.03, here with a margin."""
    swing_height: float = 0.03
    """Wanted clearance of a swinging hind toe at mid-swing [m]."""
    swing_share: float = 0.7
    """Share of half a gait cycle in which a foot swings; in the rest both stand."""
    march: bool = True
    """Stepping is asked for also while standing still; False lets both feet stand then."""
    turn_threshold: float = 0.15
    """Without marching, a heading error from which on stepping is asked for [rad]."""
    scaled_tracking: bool = True
    """Scale the tracking terms by how far the robot stands, as the paper's dynamic factor does; False is its ablation."""
    rewards: RewardWeights = field(default_factory=RewardWeights)
    finish: FinishFactors = field(default_factory=FinishFactors)
    """Factors on the weights of ``rewards`` once everything is learned: walking straight and sliding little are polish,
    which, asked for with these weights from the beginning, keeps a policy from stepping and reaching."""
    finish_steps: tuple[float, float] = (12_000.0, 18_000.0)
    """Control steps of a world between which these factors grow from 1."""
    reward_scale: float = 0.008
    """Factor on all rewards. Returns are then of the order of ten, which the critic can follow. Unscaled they were 300, with PPO's limit of 0.2 on the change of a value in an update, and the
    critic was wrong by 20 to 27 throughout."""
    regularisation: float = 2.0
    """Factor on the weights of REGULARISERS at the end of the ramp."""
    ramp_steps: int = 12_000
    """Control steps of a world over which they grow."""

    def __post_init__(self) -> None:
        if self.task not in ("stand_track", "sit_down"):
            raise ConfigError(f"task is {self.task!r}; expected stand_track or sit_down")
        _check_range("worlds", self.worlds, 1, 1_000_000)
        _check_range("timestep", self.timestep, 0.0, 0.01, "s")
        _check_range("episode-steps", self.episode_steps, 100, 100_000)
        _check_range("solver-iterations", self.solver_iterations, 1, 200)
        begin, end = self.finish_steps
        if not begin < end:
            raise ConfigError(
                f"finish-steps is {begin:g}, {end:g}; expected the first to be smaller, such as 12000, 18000"
            )


ENDLESS = 100_000_000
"""Updates that no training makes."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LearnSettings:
    """PPO and the training run."""

    iterations: int = 0
    """Most policy updates; 0 does not limit them where ``minutes`` does, and takes 1500 otherwise."""
    minutes: float = 0.0
    """Stop after this wall-clock time [min]; 0 does not stop."""
    seed: int = 1
    device: str = "auto"
    """cuda, cpu, or auto."""
    steps: int = 12
    """Control steps of each world between two updates. With 24 a policy of the same time learnt to follow with 6.3 cm
    instead of 4.0."""
    epochs: int = 4
    minibatches: int = 4
    learning_rate: float = 1e-3
    desired_kl: float = 0.02
    """Divergence between two updates that the learning rate aims at, at the beginning."""
    desired_kl_end: float = 0.01
    """… and at the end; in between it falls geometrically."""
    entropy: float = 0.004
    """Weight of the entropy bonus at the beginning."""
    entropy_end: float = 0.0007
    """… and at the end; in between it falls geometrically, so that the spread of the actions narrows late."""
    gamma: float = 0.99
    lam: float = 0.95
    clip: float = 0.2
    clip_values: bool = False
    """Limit the change of a value in an update to ``clip`` too."""
    init_std: float = 1.0
    std_range: tuple[float, float] = (0.05, 1.2)
    resume_std: float = 0.0
    """Spread of the actions, at least, with which a checkpoint is taken up; 0 leaves it as it is."""
    hidden: tuple[int, ...] = (512, 256, 128)
    mirror: float = 0.2
    """Weight of the loss that asks for mirrored actions in mirrored states; 0 is none. With 0.5, the one tried, the loss
    was as large as PPO's own, and front toes did not learn to follow their goals."""
    reaching: float = 0.1
    """Weight, at the beginning, of the loss that shows the front legs the closed form of reaching a goal; 0 is none, and
    so it is for a training that is resumed. By reward alone some seeds stay at half the sideways reach."""
    reaching_share: float = 0.4
    """Share of a training after which that weight has fallen to 0; from then on only rewards count."""
    snapshots: tuple[float, ...] = ()
    """Times after which the policy is also written as policy_<minutes>min.onnx [min]."""
    save_every: int = 100
    """Updates between two checkpoints."""
    captured: bool = True
    """On a GPU, replay inference and update as captured graphs instead of launching them piece by piece."""
    mixed_precision: bool = False
    """Networks of the update in bfloat16."""

    def __post_init__(self) -> None:
        _check_range("iterations", self.iterations, 0, ENDLESS)
        _check_range("minutes", self.minutes, 0.0, 1e6)
        _check_range("reaching", self.reaching, 0.0, 100.0)
        _check_range("reaching-share", self.reaching_share, 0.001, 1.0)

    @property
    def updates(self) -> int:
        """Updates after which a training ends that its time does not end before."""
        return self.iterations or (ENDLESS if self.minutes > 0 else 1500)


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrateSettings:
    """How a log is explained."""

    method: Literal["least-squares", "random"] = "least-squares"
    """Least squares and diagnosis, or the paper's search: random samples of the declared numbers, the best wins."""
    declared: tuple[str, ...] = ("coulomb", "viscous", "link_mass", "delay")
    """Effects fitted before anything is looked for. Source: Li et al. 2024, section IV."""
    effects: tuple[str, ...] = ()
    """Effects that may be named; empty for the whole catalogue."""
    most_effects: int = 5
    """Most effects that are added."""
    torque: bool = True
    """Explain measured torque too, where the log has it."""
    samples: int = 8192
    """Samples of the random search; paper: 8192."""
    timestep: float = 0.0
    """Physics step of a replay [s]; 0 takes the longest up to 2.5 ms that divides the time between readings."""
    threads: int = 0
    """Threads; 0 takes one for each core."""
    device: str = "cpu"
    """Where replays run: cpu, or cuda (cuda:1, …) for MuJoCo Warp on a GPU, which needs the extra train."""
    seed: int = 0
    """Seed of the random search."""

    def __post_init__(self) -> None:
        for option, names in (("declared", self.declared), ("effects", self.effects)):
            if len(set(names)) < len(names):
                raise ConfigError(f"--{option} names an effect twice: {', '.join(names)}")
        _check_range("most-effects", self.most_effects, 0, 20)
        _check_range("samples", self.samples, 1, 10_000_000)
        _check_range("threads", self.threads, 0, 1024)
        _check_range("seed", self.seed, 0, 2**63)
        _check_range("timestep", self.timestep, 0.0, 0.005, "s")
        if self.device != "cpu" and not self.device.startswith("cuda"):
            raise ConfigError(f"device is {self.device}; it must be cpu, cuda or, of several GPUs, cuda:0, cuda:1, …")


@dataclass(frozen=True, kw_only=True, slots=True)
class LogSettings:
    """How a log is simulated."""

    noise: float = 0.00035
    """Standard deviation of a position reading [rad]."""
    resolution: float = 2 * 12.5 / 65535
    """Step of a position reading [rad]; 16 bits over +-12.5 rad as in a CyberGear frame."""
    torque_noise: float = 0.02
    """Standard deviation of a torque reading [N m]; a reading is the mean since the one before."""
    rate: float = 200.0
    """Readings a second [Hz]."""
    lost_samples: float = 0.0
    """Share of readings that are missing from the log."""
    jitter: float = 0.0
    """Standard deviation of the times of the readings [s]."""
    timestep: float = 0.0002
    """Physics step [s], 0.0001 to 0.005. A calibration finds what steps without length would leave: with long ones the log is off."""
    seed: int = 0
    """Seed of noise and losses."""

    def __post_init__(self) -> None:
        _check_range("noise", self.noise, 0.0, 0.1, "rad")
        _check_range("resolution", self.resolution, 0.0, 0.1, "rad")
        _check_range("torque-noise", self.torque_noise, 0.0, 100.0, "N m")
        _check_range("seed", self.seed, 0, 2**63)
        _check_range("rate", self.rate, 20.0, 2000.0, "Hz")
        _check_range("lost-samples", self.lost_samples, 0.0, 0.9)
        _check_range("jitter", self.jitter, 0.0, 0.01, "s")
        _check_range("timestep", self.timestep, 0.0001, 0.005, "s")

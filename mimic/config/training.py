"""How a policy is trained."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from mimic.config.play import Randomisation
from mimic.config.ranges import check_range
from mimic.config.rewards import FinishFactors, RewardWeights, SitDownWeights
from mimic.errors import ConfigError

TRAINING_RANDOMISATION = Randomisation(
    joint_friction=(0.0, 0.2),
    joint_damping=(0.0, 0.08),
    ground_friction=(0.4, 3.0),
    restitution=(0.0, 0.45),
    base_mass=(-1.5, 1.5),
    kp=(0.8, 1.2),
    kd=(0.8, 1.2),
    delay=(0.0, 0.04),
    push=(0.0, 0.9),
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
    contact_time: tuple[float, float] = (0.3, 2.0)
    """Factor on the time constant of the ground, which counts for half of a contact's (12 to 30 ms); nothing about a
    real floor's is known, and solvers differ. Quiet worlds have it too, and the next one."""
    friction_ratio: tuple[float, float] = (1.0, 100.0)
    """How much stiffer contacts are against sliding than against sinking, log-uniform: MuJoCo's impratio. At 1 a foot
    that bears weight creeps, and a policy learns to stand on what no floor does."""
    slope: tuple[float, float] = (0.0, 5.0)
    """Inclination of the ground in any direction [deg]; pavements are built with 1-2, ramps with 3-5."""
    toe_payload: tuple[float, float] = (0.0, 0.3)
    """Mass at one front toe [kg]: a boxing glove, a flag."""
    imu_tilt: tuple[float, float] = (0.0, 3.0)
    """Mounting error of the IMU about any axis, half of them pitch [deg]; screwed by hand, not calibrated."""
    gyro_bias: float = 0.03
    """Largest error of the gyro about each axis that lasts for an episode [rad/s]; what zeroing at rest leaves."""
    lost_share: tuple[float, float] = (0.0, 0.08)
    """Probability that a command does not arrive; the one before stays in effect."""
    drag: tuple[float, float] = (0.0, 16.0)
    """Horizontal pull on one front toe [N]: a hand that holds it. In any direction, backward twice as often."""
    drag_share: float = 0.3
    """Share of episodes with such a pull."""
    drag_from: tuple[float, float] = (1.5, 8.0)
    """When it begins [s]."""
    drag_ramp: tuple[float, float] = (0.2, 4.0)
    """Time in which it grows to that [s]."""
    drag_seconds: float = 3.0
    """How long it then lasts [s]."""
    lead_share: float = 0.2
    """Share of all episodes, quiet worlds' too, in which a hand takes a front toe instead and walks off with it in any
    direction, and the robot is asked to do what it is when it is led (`mimic.policy.leading`)."""
    lead_speed: tuple[float, float] = (0.0, 0.3)
    """How fast the hand walks [m/s]."""
    lead_most: tuple[float, float] = (4.0, 10.0)
    """Strongest pull of the hand [N]; what would take more slips through the fingers."""
    lead_stiffness: float = 60.0
    """Pull for each metre that the toe is behind the hand [N/m]."""
    lead_seconds: tuple[float, float] = (2.0, 10.0)
    """How long until it lets go [s]."""


UNDISTURBED = DisturbanceRanges(
    kp=(1.0, 1.0),
    kd=(1.0, 1.0),
    contact_time=(1.0, 1.0),
    friction_ratio=(1.0, 1.0),
    slope=(0.0, 0.0),
    toe_payload=(0.0, 0.0),
    imu_tilt=(0.0, 0.0),
    gyro_bias=0.0,
    lost_share=(0.0, 0.0),
    drag=(0.0, 0.0),
    lead_share=0.0,
)
"""Nothing happens."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SitDownSettings:
    """The second task: from upright down to lying on four feet."""

    episode_steps: int = 150
    """Control steps of an episode."""
    seconds: float = 1.2
    """Time that going down should take [s]."""
    clock_hz: float = 0.08
    """Frequency of the clock, which starts with the sitting down and tells the policy how far it should be [Hz]."""
    states: str = "handovers.npz"
    """File of recorded states in policies/, or a path; see lab/policies/handover_states.py."""
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
    stand_share: float = 0.35
    """Share of commands to stand: no velocity, and the heading as it is."""
    still_share: float = 0.2
    """Share of the other commands that have no velocity; the same that keep the heading."""
    fastest: float = 0.6
    """Fastest velocity command, forward and back [m/s]; paper: 0.3."""
    fast_share: float = 0.5
    """Share of velocities drawn evenly up to the fastest; the others are the paper's 0.1, 0.2 and 0.3 m/s."""
    turning_share: float = 0.4
    """Share of heading commands that turn steadily; the others jump by up to 90 degrees, as the paper's."""
    turn_rate: float = 1.2
    """Fastest steady turn [rad/s]."""
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
    """Frequency of the gait clock [Hz]. The feet stand 0.28 m apart, so that the robot rocks from foot to foot: 0.13
    m/s to each side at 3 Hz, 0.09 at 4 (root mean square), which counts as velocity error."""
    action_scale: float = 0.5
    """Radians per unit of action."""
    action_clip: float = 6.0
    """Actions are clipped to plus and minus this."""
    history: int = 6
    """Frames in an observation; paper: 3. The speed of the base cannot be seen in 60 ms; 120 ms are half a gait
    cycle."""
    noise_q: float = 0.01
    """Half width of the noise on joint positions [rad]."""
    noise_axes: float = 0.05
    """Half width of the noise on the two world axes; the paper's, as is that on joint positions."""
    noise_gyro: float = 0.2
    """Half width of the noise on the gyro [rad/s]; an MTi has 0.02, a motor board not much more."""
    noise_dq: float = 1.0
    """Half width of the noise on joint velocities [rad/s]; CyberGear drives step by 0.001, and lag by milliseconds."""
    noise_least: float = -0.3
    """Each episode has a share of the noise, drawn evenly from this to 1; less than 0 is none."""
    interpolate: bool = True
    """Commanded positions move linearly from one control step's to the next, instead of at once."""
    clock_fade: float = 0.2
    """Time in which the gait clock fades in and out as the robot is asked to step and to stand [s]; 0 never fades."""
    solver_iterations: int = 4
    """Newton iterations of the training physics; the evaluation uses MuJoCo's 100. After 0.6 s of standing up in steps
    of 2.5 ms nine of ten worlds are within 1e-2 rad of the evaluation's state and the worst 2e-2 away; 5 to 7: 7e-3 and
    2e-2; 10: 8e-5 and 6e-3. Six take 13 % more time."""
    linesearch_iterations: int = 6
    """Line-search iterations of the training physics."""
    friction_speed: float = 0.1
    """Joint speed at which half of the dry friction acts [rad/s]: f dq / (|dq| + this), implicit as damping
    is. 0 takes MuJoCo's own constraints, 12 of the 16 rows that the solver has on average, as the evaluation does."""
    contacts: int = 8
    """Most contacts of a world on average, since all worlds share one store; robots that lie have 4."""
    rows: int = 64
    """Most constraint rows of a world; the most seen with wild random actions is 60, lying 32."""
    quiet_share: float = 0.4
    """Share of the worlds that are quiet: a robot of the paper's Table II, its centre of mass up to 15 mm and its IMU
    up to 2 degrees off, on level ground of any stiffness that nobody pulls, with small pushes. Among disturbed worlds
    alone standing still is hardly seen, and not learned. The task sit_down has none."""
    randomisation: Randomisation = TRAINING_RANDOMISATION
    disturbances: DisturbanceRanges = field(default_factory=DisturbanceRanges)
    command_margin: float = 0.09
    """Commanded joint positions keep this far from the joint limits [rad]. With more than the 5 degrees at which the
    paper ends an episode no joint gets there by itself, but an almost straight knee is left without torque."""
    curriculum_ends: float = 0.003
    """While a smaller share of the robots than this falls or meets a termination in a control step, rising or standing,
    what makes the task hard grows: the paper's terminations, the REFINING_TERMS, disturbances. Imposed from the
    beginning, the terminations end every episode within the first tenth of a second, before anything is learned."""
    curriculum_steps: float = 9_600.0
    """Control steps of a world over which they grow; a termination ends an episode with a probability a step that grows
    with the square of the share done."""
    curriculum_latest: float = 16_800.0
    """From this control step of a world on they grow in any case."""
    refining_share_at_first: float = 0.05
    """Share of their weight that the REFINING_TERMS have before; it grows to 1."""
    rest_share_at_first: float = 0.0
    """Share of the worlds whose gait clock rests while the robot is asked to stand before; it grows to 1. A robot that
    may rest from the beginning does not learn to walk."""
    disturbance_share_at_first: float = 0.2
    """Share of the disturbances, pushes, gain factors and bounce of the ground that worlds see before; it grows to 1.
    On a ground that bounces fully from the beginning a policy learns to stand and step with almost straight legs, and
    keeps that (lab/results/training.md)."""
    slip_height: float = 0.033
    """A toe whose centre is lower than this pays for moving [m]; paper: 0.03, here with a margin."""
    swing_height: float = 0.045
    """Wanted clearance of a swinging hind toe at mid-swing [m]."""
    swing_share: float = 0.7
    """Share of half a gait cycle in which a foot swings; in the rest both stand."""
    catching: float = 0.6
    """Share of the reward for a planted foot that a foot in the air earns while the robot is asked to stand and its
    capture point has left its feet."""
    capture_reach: float = 0.05
    """How far before or behind the line between its feet that is [m]."""
    rewards: RewardWeights = field(default_factory=RewardWeights)
    finish: FinishFactors = field(default_factory=FinishFactors)
    """Factors on the weights of rewards once everything is learned: walking straight and sliding little are polish,
    which, asked for with these weights from the beginning, keeps a policy from stepping and reaching."""
    finish_steps: tuple[float, float] = (24_000.0, 40_000.0)
    """Control steps of a world between which these factors grow from 1."""
    reward_scale: float = 0.008
    """Factor on all rewards. Returns are then of the order of ten, which the critic can follow. Unscaled they were 300,
    with PPO's limit of 0.2 on the change of a value in an update, and the critic was wrong by 20 to 27 throughout."""
    regularisation: float = 2.0
    """Factor on the weights of REGULARISERS at the end of the ramp."""
    ramp_steps: int = 12_000
    """Control steps of a world over which they grow."""

    def __post_init__(self) -> None:
        if self.task not in ("stand_track", "sit_down"):
            raise ConfigError(f"task is {self.task!r}; expected stand_track or sit_down")
        check_range("worlds", self.worlds, 1, 1_000_000)
        check_range("timestep", self.timestep, 0.0, 0.01, "s")
        check_range("fastest", self.fastest, 0.1, 3.0, "m/s")
        check_range("friction-speed", self.friction_speed, 0.0, 10.0, "rad/s")
        check_range("quiet-share", self.quiet_share, 0.0, 1.0)
        check_range("clock-fade", self.clock_fade, 0.0, 5.0, "s")
        check_range("episode-steps", self.episode_steps, 100, 100_000)
        check_range("solver-iterations", self.solver_iterations, 1, 200)
        begin, end = self.finish_steps
        if not begin < end:
            raise ConfigError(
                f"finish-steps is {begin:g}, {end:g}; expected the first to be smaller, such as 12000, 18000"
            )


STD_SHARE = 0.8
"""Share of a training in which the largest spread of the actions falls to std_end."""

ENDLESS = 100_000_000
"""Updates that no training makes."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LearnSettings:
    """PPO and the training run."""

    iterations: int = 0
    """Most policy updates; 0 does not limit them where minutes does, and takes 1500 otherwise."""
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
    init_std: float = 1.0
    std_range: tuple[float, float] = (0.05, 1.2)
    resume_std: float = 0.0
    """Spread of the actions, at least, with which a checkpoint is taken up; 0 leaves it as it is."""
    std_end: float = 0.0
    """Largest spread of the actions at the end: it falls from resume_std, or else init_std, over the first
    80 % of the training; 0 leaves the spread to the learner."""
    critic_updates: int = 100
    """Updates in which only the critic learns, where a training goes on from a policy (.onnx), which has none."""
    hidden: tuple[int, ...] = (512, 256, 128)
    mirror: float = 0.2
    """Weight of the loss that asks for mirrored actions in mirrored states; 0 is none. With 0.5, the one tried, the
    loss was as large as PPO's own, and front toes did not learn to follow their goals."""
    reaching: float = 0.1
    """Weight, at the beginning, of the loss that shows the front legs the closed form of reaching a goal; 0 is none,
    and so it is for a training that is resumed. By reward alone some seeds stay at half the sideways reach."""
    reaching_share: float = 0.4
    """Share of a training after which that weight has fallen to 0; from then on only rewards count."""
    snapshots: tuple[float, ...] = ()
    """Times after which the policy is also written as policy_<minutes>min.onnx [min]."""
    save_every: int = 100
    """Updates between two checkpoints."""
    captured: bool = True
    """On a GPU, replay inference and update as captured graphs instead of launching them piece by piece."""

    def __post_init__(self) -> None:
        check_range("iterations", self.iterations, 0, ENDLESS)
        check_range("minutes", self.minutes, 0.0, 1e6)
        check_range("std-end", self.std_end, 0.0, 10.0)
        check_range("reaching", self.reaching, 0.0, 100.0)
        check_range("reaching-share", self.reaching_share, 0.001, 1.0)

    @property
    def updates(self) -> int:
        """Updates after which a training ends that its time does not end before."""
        return self.iterations or (ENDLESS if self.minutes > 0 else 1500)

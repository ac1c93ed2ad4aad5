"""How a policy is trained; the defaults are the recipe of stand_track.

Numbers that no recipe changes are constants beside the code that uses them, in mimic/train.
"""

from __future__ import annotations

from dataclasses import field
from typing import Literal

from mimic.config.play import Randomisation
from mimic.config.ranges import Limited, check_range, within
from mimic.config.rewards import FinishFactors, RewardWeights
from mimic.errors import ConfigError
from mimic.frozen import frozen

TRAINING_RANDOMISATION = Randomisation(
    dry_friction=(0.0, 4.0),
    viscous_friction=(0.0, 2.0),
    ground_friction=(0.4, 3.0),
    restitution=(0.0, 0.45),
    base_mass=(-1.5, 1.5),
    kp=(0.8, 1.2),
    kd=(0.8, 1.2),
    delay=(0.0, 0.04),
    push=(0.0, 1.0),
    push_interval=3.5,
    start_q=(-0.15, 0.15),
    start_height=(0.0, 0.03),
)
"""Wider than the paper's Table II, so that its ends are not the edge of what the policy has seen. Joints also share a
factor on their gains: DisturbanceRanges.kp and kd."""


@frozen
class DisturbanceRanges:
    """What happens to a robot in training besides its randomisation; a pair is uniform between its ends.

    The paper has none of these. Each range holds what the real robot is expected to see, with a reason beside it.
    """

    kp: tuple[float, float] = (0.75, 1.25)
    """Factor on the position gain that all joints share, besides each joint's own: one firmware, one supply voltage."""
    kd: tuple[float, float] = (0.75, 1.25)
    """… and on the velocity gain."""
    torque: tuple[float, float] = (0.7, 1.5)
    """Factor on the largest torque of all motors: nobody has measured them."""
    speed: tuple[float, float] = (0.7, 1.5)
    """… and on the speeds at which it falls and ends."""
    contact_time: tuple[float, float] = (0.3, 2.0)
    """Factor on the time constant of the ground, which counts for half of a contact's (12 to 30 ms); nothing about a
    real floor's is known, and solvers differ. Quiet worlds have it too, and the next one."""
    friction_ratio: tuple[float, float] = (30.0, 100.0)
    """MuJoCo's impratio, log-uniform; evaluations have 100."""
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
    drag: tuple[float, float] = (0.0, 11.0)
    """Horizontal pull on one front toe [N]: a hand that holds it. In any direction, backward twice as often."""
    drag_share: float = 0.5
    """Share of episodes with such a pull."""
    drag_from: tuple[float, float] = (1.5, 8.0)
    """When it begins [s]."""
    drag_ramp: tuple[float, float] = (0.2, 4.0)
    """Time in which it grows to that [s]."""
    lead_share: float = 0.2
    """Share of all episodes, quiet worlds' too, in which a hand takes a front toe instead and walks off with it in any
    direction, and the robot is asked to do what it is when it is led (`mimic.policy.leading`)."""


UNDISTURBED = DisturbanceRanges(
    kp=(1.0, 1.0),
    kd=(1.0, 1.0),
    torque=(1.0, 1.0),
    speed=(1.0, 1.0),
    contact_time=(1.0, 1.0),
    friction_ratio=(100.0, 100.0),
    slope=(0.0, 0.0),
    toe_payload=(0.0, 0.0),
    imu_tilt=(0.0, 0.0),
    gyro_bias=0.0,
    lost_share=(0.0, 0.0),
    drag=(0.0, 0.0),
    lead_share=0.0,
)
"""Nothing happens."""


@frozen
class MdpSettings(Limited):
    """The worlds a policy is trained in."""

    task: Literal["stand_track", "sit_down"] = "stand_track"
    """What is trained: stand, track and walk, or sit down."""
    worlds: int = within(16384, 1, 1_000_000)
    """Robots simulated at once, on all GPUs together."""
    effects: str = ""
    """effects.toml of a calibration, around which the robots are drawn; empty draws them around the description."""
    timestep: float = within(0.004, 0.0, 0.01, "s")
    """Physics step [s]; 0 is that of the description."""
    episode_steps: int = within(1000, 100, 100_000)
    """Control steps of an episode; the paper's."""
    upright_share: float = 0.25
    """Share of episodes that start upright, once the robot stands."""
    upright_share_at_first: float = 0.5
    """… and before: balance is what takes longest to learn."""
    limp_share: float = 0.15
    """Share of the other episodes that start as a robot without power lies; it is not brought into the crouch first."""
    ramped_share: float = 0.45
    """… and that start as the ramp leaves a robot; what is left starts a little above the crouch."""
    command_seconds: tuple[float, float] = (3.0, 12.0)
    """Time between two velocity and heading commands [s]; paper: 10."""
    stand_share: float = 0.45
    """Share of commands to stand: no velocity, and the heading as it is."""
    still_share: float = 0.2
    """Share of the other commands that have no velocity; the same that keep the heading."""
    fastest: float = within(0.7, 0.1, 3.0, "m/s")
    """Fastest velocity command, forward and back [m/s]; paper: 0.3."""
    hold_share: float = 0.3
    """Probability that an arm stays where it is while the other one may move."""
    unknown_share: float = 0.3
    """Share of the episodes in which a policy is not told where its arms will be; besides all in which it is led."""
    trunk_share: float = 0.5
    """Share of the trunk's ways that end lowered and leant; the others end as the robot stands by itself. 0 never moves
    it."""
    clock_hz: float = 4.0
    """Frequency of the gait clock [Hz]. The feet stand 0.28 m apart, so that the robot rocks from foot to foot: 0.13
    m/s to each side at 3 Hz, 0.09 at 4 (root mean square), which counts as velocity error."""
    action_scale: float = 0.5
    """Radians per unit of action."""
    history: int = 16
    """Frames in an observation; paper: 3. The speed of the base cannot be seen in 60 ms."""
    noise_q: float = 0.01
    """Half width of the noise on joint positions [rad]."""
    noise_axes: float = 0.05
    """Half width of the noise on the two world axes; the paper's, as is that on joint positions."""
    noise_gyro: float = 0.2
    """Half width of the noise on the gyro [rad/s]; an MTi has 0.02, a motor board not much more."""
    noise_dq: float = 1.0
    """Half width of the noise on joint velocities [rad/s]; CyberGear drives step by 0.001, and lag by milliseconds."""
    noise_least: float = -0.5
    """Each episode has a share of the noise, drawn evenly from this to 1; less than 0 is none."""
    solver_iterations: int = within(8, 1, 200)
    """Newton iterations of the training physics; the evaluation uses MuJoCo's 100. With an impratio of 100, after 0.2 s
    of a policy in steps of 4 ms, nine of ten of 16 worlds are within 4e-3 rad of the state that 100 iterations give and
    the worst 2e-2 away; 6: 1e-2 and 2e-2; 4: 4e-2 and 4e-2; 12: 1e-6 and 7e-6. With 6 instead of 20 line searches 8
    give 3e-2 and 5e-2."""
    friction_speed: float = within(0.1, 0.0, 10.0, "rad/s")
    """Joint speed at which half of the dry friction acts [rad/s]: f dq / (|dq| + this), implicit as damping
    is. 0 takes MuJoCo's own constraints, 12 of the 16 rows that the solver has on average, as the evaluation does."""
    quiet_share: float = within(0.4, 0.0, 1.0)
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
    the paper's terminations and the REFINING_TERMS grow. Imposed from the beginning, the terminations end every
    episode within the first tenth of a second, before anything is learned."""
    curriculum_steps: float = 6_000.0
    """Control steps of a world over which they grow; a termination ends an episode with a probability a step that grows
    with the square of the share done."""
    curriculum_latest: float = 9_000.0
    """From this control step of a world on they grow in any case."""
    disturbance_share_at_first: float = 0.4
    """Share of the disturbances, pushes, gain factors and bounce of the ground that worlds see before ``rest_steps``.
    On a ground that bounces fully from the beginning a policy learns to stand and step with almost straight legs, and
    keeps that (lab/results/training.md)."""
    rest_steps: tuple[float, float] = (22_000.0, 36_000.0)
    """Control steps of a world between which the share of the worlds grows from 0 to 1 whose gait clock rests while the
    robot is asked to stand, and with it the RESTING_TERMS and all disturbances. A policy that may rest, or is dragged,
    before it walks well does not learn to walk."""
    swing_height: float = 0.04
    """Wanted clearance of a swinging hind toe at mid-swing [m]."""
    rewards: RewardWeights = field(default_factory=RewardWeights)
    finish: FinishFactors = field(default_factory=FinishFactors)
    """Factors on the weights of rewards once everything is learned: walking straight and sliding little are polish,
    which, asked for with these weights from the beginning, keeps a policy from stepping and reaching."""
    finish_steps: tuple[float, float] = (12_000.0, 22_000.0)
    """Control steps of a world between which these factors grow from 1."""

    def __post_init__(self) -> None:
        Limited.__post_init__(self)
        if self.task not in ("stand_track", "sit_down"):
            raise ConfigError(f"task is {self.task!r}; expected stand_track or sit_down")
        check_range("limp-share and ramped-share together", self.limp_share + self.ramped_share, 0.0, 1.0)
        for name, (begin, end) in (("finish-steps", self.finish_steps), ("rest-steps", self.rest_steps)):
            if not begin < end:
                raise ConfigError(
                    f"{name} is {begin:g}, {end:g}; expected the first to be smaller, such as 10000, 15000"
                )


ENDLESS = 100_000_000
"""Updates that no training makes."""


@frozen
class LearnSettings(Limited):
    """PPO and the training run."""

    iterations: int = within(0, 0, ENDLESS)
    """Most policy updates, together with those before --resume; 0 does not limit them."""
    minutes: float = within(23.0, 0.0, 1e6)
    """Stop after this wall-clock time, together with that before --resume [min]; 0 does not stop."""
    session_minutes: float = within(0.0, 0.0, 1e6)
    """Stop this session after this time, for another one that resumes last.pt [min]; 0 does not stop."""
    seed: int = 1
    """Of worlds, commands, network and actions."""
    device: str = "auto"
    """cuda, cpu, or auto."""
    steps: int = within(12, 1, 10_000)
    """Control steps of each world between two updates. With 24 a policy of the same time learnt to follow with 6.3 cm
    instead of 4.0."""
    epochs: int = within(4, 1, 1000)
    """Passes over what was seen, in each update."""
    minibatches: int = within(4, 1, 10_000)
    """Parts of a pass, a step of the optimiser each."""
    learning_rate: float = within(1e-3, 1e-9, 1.0)
    """At the beginning; it then adapts to desired_kl."""
    desired_kl: float = 0.02
    """Divergence between two updates that the learning rate aims at, at the beginning."""
    desired_kl_end: float = 0.003
    """… and at the end; in between it falls geometrically."""
    entropy: float = 0.004
    """Weight of the entropy bonus at the beginning."""
    entropy_end: float = 0.0001
    """… and at the end; in between it falls geometrically, so that the spread of the actions narrows late."""
    std_range: tuple[float, float] = (0.03, 1.2)
    """Smallest and largest spread of the actions [units of action]."""
    resume_std: float = within(0.2, 1e-3, 10.0)
    """Spread of the actions with which a training goes on from a policy (.onnx)."""
    critic_updates: int = 250
    """Updates in which only the critic learns, where a training goes on from a policy (.onnx), which has none. After 40
    to 60 the toe error rose by up to 0.9 cm at first, after 250 by 0.2 (lab/results/training.md)."""
    hidden: tuple[int, ...] = (512, 256, 128)
    """Widths of the hidden layers, policy and critic alike."""
    mirror: float = 0.2
    """Weight of the loss that asks for mirrored actions in mirrored states; 0 is none. With 0.5, the one tried, the
    loss was as large as PPO's own, and front toes did not learn to follow their goals."""

    def __post_init__(self) -> None:
        Limited.__post_init__(self)
        if not self.iterations and not self.minutes:
            raise ConfigError("iterations and minutes are both 0; set one, or the training never ends")
        if not self.hidden or min(self.hidden) < 1:
            raise ConfigError(
                f"hidden is {list(self.hidden)}; expected the width of each layer, such as [512, 256, 128]"
            )
        if not 0.0 < self.std_range[0] <= self.std_range[1]:
            raise ConfigError(f"std-range is {list(self.std_range)}; expected two sizes above 0, the smaller one first")

    @property
    def updates(self) -> int:
        """Updates after which a training ends that its time does not end before."""
        return self.iterations or ENDLESS

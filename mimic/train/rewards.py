"""The reward terms of stand_track, a function each, one value a world (N,).

They follow the paper's intent (tracking scaled by standing, gait and slip terms) in forms that train in minutes:
bells instead of gates, so that a robot lying on the ground already feels which way is up. The paper's own forms are in
`mimic.evaluation.paper_reward`, the weights in `mimic.config.rewards`. Sources: Li et al. 2024 (the paper); Rudin et
al. 2022, "Learning to walk in minutes using massively parallel deep reinforcement learning" (legged_gym); where none
is named, the term was made here.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from mimic.geometry import smoothstep
from mimic.robot.parts import TrainingNumbers

HEIGHT_WIDTH = 0.1
"""Width of the bell of `height` [m]."""

LEAN_WIDTH = 0.4
"""Width of the bell of `upright` while rising [rad]."""

VELOCITY_BELLS = ((0.2, 0.15), (0.2, 0.02), (0.25, 0.004))
"""Height and squared width [m^2/s^2] of each bell over the averaged velocity; the wide one is felt while the robot does
not walk at all."""

STEP_BELL = (0.35, 0.05)
"""The same over the velocity of now."""

TURN_BELLS = ((0.35, 0.5), (0.35, 0.03))
"""Height and squared width [rad^2] of each bell over the heading error."""

TURN_COSINE = 0.15
"""Height of the cosine below them, which is felt at any error."""

SWING_SHARE = 0.7
"""Share of half a gait cycle in which a foot swings; in the rest both stand."""

LEAVING = 0.15
"""What a swinging foot earns by leaving the ground, or no foot is ever lifted."""

TOO_HIGH = 0.03
"""Width of the bell over a clearance beyond what is wanted and `FREE_CLEARANCE` [m]."""

FREE_CLEARANCE = 0.01
"""[m]"""

BEARS = 0.2
"""A foot is planted that bears this share of the robot's weight."""

FASTEST = 4.0
"""More than this squared speed of one toe is not counted in `slip` [m^2/s^2]."""

SLIP_HEIGHT = 0.033
"""A toe whose centre is lower than this pays for moving [m]; paper: 0.03, here with a margin."""

LIFTED = 0.01
"""A toe above this is in the air in `flight` [m]."""

LOW = 0.03
"""A shape under this is near the ground in `low` [m]."""

MOST_HEAT = 2.0
"""More is not counted in `heat`, since standing up and catching a push need it."""

MOST_UNREST = 6.0
"""More is not counted in `unrest` [(unit of action)^2], for the same reason."""

MOST_DRIFT = 0.3
"""More is not counted in `drift` [m], for the same reason."""

MOST_SHUFFLE = 0.3
"""More speed of a toe is not counted in `shuffle` [m/s], for the same reason."""


def bells(square: Tensor, *shapes: tuple[float, float]) -> Tensor:
    """Return the sum of bells over a squared error (N,), each of a height and a squared width."""
    return torch.stack([height * torch.exp(-square / width) for height, width in shapes]).sum(0)


def height(base: Tensor, rising: Tensor, numbers: TrainingNumbers) -> Tensor:
    """Return exp(-(error / HEIGHT_WIDTH)^2), 0 to 1; above the full height nothing is an error.

    Args:
        base: Height of the base (N,) [m].
        rising: How far the stand-up should be, 0 lying to 1 upright (N,); the wanted height follows it smoothly.
        numbers: Heights at both ends.
    """
    over = base - (numbers.rise_from + (numbers.rise_to - numbers.rise_from) * smoothstep(rising))
    over = torch.where((rising >= 1) & (over > 0), torch.zeros_like(over), over)
    return torch.exp(-((over / HEIGHT_WIDTH) ** 2))


def upright(up: Tensor, rising: Tensor, lying_angle: float) -> Tensor:
    """Return exp(-(error / LEAN_WIDTH)^2) of the trunk's angle while rising, then the paper's ((1 + up) / 2)^2; 0 to 1.

    Args:
        up: Cosine between base x and the wanted upright direction (N,).
        rising: How far the stand-up should be, 0 lying to 1 upright (N,); the wanted angle follows it smoothly.
        lying_angle: Between them where the robot lies [rad].
    """
    angle = torch.acos(torch.clamp(up, -1.0, 1.0))
    lean = angle - lying_angle * (1 - smoothstep(rising))
    return torch.where(rising >= 1, ((1 + up) / 2).square(), torch.exp(-((lean / LEAN_WIDTH) ** 2)))


def velocity(mean: Tensor, now: Tensor, standing: Tensor) -> Tensor:
    """Return VELOCITY_BELLS over the averaged error and STEP_BELL over that of now, where the robot stands; 0 to 1.

    Source: the paper has one bell, over the error of now.

    Args:
        mean: Error of the averaged base velocity, heading frame (N, 2) [m/s].
        now: Error of the base velocity (N, 2) [m/s].
        standing: 0 lying to 1 standing (N,).
    """
    averaged = bells(mean.square().sum(-1), *VELOCITY_BELLS)
    return (averaged + bells(now.square().sum(-1), STEP_BELL)) * standing


def heading(turn: Tensor, standing: Tensor) -> Tensor:
    """Return TURN_COSINE (1 + cos error) + TURN_BELLS over the error (N,) [rad], where the robot stands; 0 to 1.

    Source: the paper has one bell.
    """
    square = turn.square()
    wide, narrow = TURN_BELLS
    return (TURN_COSINE * (1 + torch.cos(turn)) + bells(square, wide) + bells(square, narrow)) * standing


def gait(stepping: Tensor, planted: Tensor, asked: Tensor, standing: Tensor) -> Tensor:
    """Return the mean of both hind feet where the robot stands: `stepping` if asked to step, else planted; 0 to 1.

    Args:
        stepping: What each foot earns by stepping (N, 2).
        planted: 1 where both feet bear weight (N, 1).
        asked: 1 where the robot is asked to step (N, 1).
        standing: 0 lying to 1 standing (N,).
    """
    return (asked * stepping + (1 - asked) * planted).mean(-1) * standing


def stepping(phase: Tensor, clearance: Tensor, planted: Tensor, swing_height: float) -> Tensor:
    """Return what each hind foot earns by stepping with the clock (N, 2).

    Args:
        phase: Of the gait (N,) [rad].
        clearance: Height of the hind toes above the ground (N, 2) [m].
        planted: 1 where they touch it (N, 2).
        swing_height: Asked of a toe at mid-swing [m].
    """
    sine = torch.sin(phase)
    both = math.sin(0.5 * math.pi * (1 - SWING_SHARE))  # below this sine both feet stand
    swing = (torch.stack([sine, -sine], -1) - both) / (1 - both)
    wanted = swing_height * torch.clamp(2 * swing, min=0.0, max=1.0)
    too_high = torch.clamp(clearance - wanted - FREE_CLEARANCE, min=0.0) / TOO_HIGH
    lifted = torch.clamp(clearance / wanted.clamp(min=0.01), 0, 1) * torch.exp(-too_high.square())
    lifted = (LEAVING + (1 - LEAVING) * lifted) * (1 - planted)
    return torch.where(swing > 0, lifted, planted)


def both_planted(load: Tensor) -> Tensor:
    """Return the smaller load over BEARS, at most 1 (N, 1), from the share of weight on each hind foot (N, 2)."""
    return (load.amin(-1, keepdim=True) / BEARS).clamp(0.0, 1.0)


def drift(way: Tensor, tracking: Tensor) -> Tensor:
    """Return the distance from the rest position (N,) [m], up to MOST_DRIFT, where the robot tracks (N,)."""
    return way.clamp(max=MOST_DRIFT) * tracking


def slip(height: Tensor, velocity: Tensor, turning: Tensor, below: float) -> Tensor:
    """Return the sum over low toes of |velocity|^2 + (turning / pi)^2, each up to FASTEST [m^2/s^2]. Source: the paper.

    Args:
        height: Of the toes' centres above the ground (N, 4) [m].
        velocity: Horizontal (N, 4, 2) [m/s].
        turning: Of the lower legs about the vertical (N, 4) [rad/s].
        below: Height under which a toe counts [m].
    """
    square = velocity.square().sum(-1) + (turning / math.pi).square()
    return (square.clamp(max=FASTEST) * (height < below)).sum(-1)


def foot_shift(way: Tensor, early: Tensor) -> Tensor:
    """Return the mean length of the ways of the hind toes (N, 2, 3) [m] while standing up (N,)."""
    return way.norm(dim=-1).mean(-1) * early


def flight(clearance: Tensor) -> Tensor:
    """Return 1 where both hind toes (N, 2) [m] are above LIFTED."""
    return (clearance.amin(-1) > LIFTED).float()


def low(shapes: Tensor) -> Tensor:
    """Return how many of the front legs' shapes and hind knees (N, shapes) [m] are below LOW."""
    return (shapes < LOW).float().sum(-1)


def squares(values: Tensor) -> Tensor:
    """Return the sum of squares over the joints (N, 12). Source: legged_gym, whose torques are in N m.

    Args:
        values: Changes of the action [units of action], velocities [rad/s], accelerations [rad/s^2], or torques, all or
            beyond the rated ones, each as a share of its motor's largest.
    """
    return values.square().sum(-1)


def unrest(change: Tensor, resting: Tensor) -> Tensor:
    """Return the sum of squared changes of the hind legs' action (N, 6), up to MOST_UNREST, while resting (N,)."""
    return squares(change).clamp(max=MOST_UNREST) * resting


def shuffle(speed: Tensor, contact: Tensor, resting: Tensor) -> Tensor:
    """Return the mean speed of the hind toes (N, 2) on the ground [m/s], up to MOST_SHUFFLE, while resting (N,)."""
    return (speed.clamp(max=MOST_SHUFFLE) * contact).mean(-1) * resting


def heat(torque: Tensor) -> Tensor:
    """Return the sum of squared torques (N,) up to MOST_HEAT: it heats the windings."""
    return torque.clamp(max=MOST_HEAT)


def joint_speed(dq: Tensor, limit: float) -> Tensor:
    """Return the sum of joint speeds (N, 12) beyond a limit [rad/s]. Source: legged_gym."""
    return torch.clamp(dq.abs() - limit, min=0.0).sum(-1)


def limits(q: Tensor, low: Tensor, high: Tensor, own: Tensor) -> Tensor:
    """Return how far joint positions (N, 12) are beyond low and high (12,) [rad], of own joints. Source: legged_gym."""
    excess = torch.clamp(low - q, min=0.0) + torch.clamp(q - high, min=0.0)
    return (own * excess).sum(-1)

"""Reward terms of the motion-conditioned MDP, one value a world (N,), and their names.

They follow the paper's intent (tracking scaled by standing, gait and slip terms) in forms that train in minutes:
bells instead of gates, so that a robot lying on the ground already feels which way is up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from mimic.config.rewards import REGULARISERS
from mimic.geometry import smoothstep
from mimic.robot.description import RobotDescription


@dataclass
class Facts:
    """What the rewards look at; one row a world."""

    height: torch.Tensor  # base height (N,) [m]
    up: torch.Tensor  # cosine between base x and the wanted upright direction (N,)
    velocity_error: torch.Tensor  # measured - desired base velocity in the heading frame (N, 2) [m/s]
    mean_velocity_error: torch.Tensor  # the same averaged over half a gait cycle, without the sway (N, 2) [m/s]
    drift: torch.Tensor  # how far the robot has strayed from where it was when it should have come to rest (N, 2) [m]
    gait: torch.Tensor  # how far stepping is asked for, 0 standing to 1 (N,)
    toppling: torch.Tensor  # true where the capture point has left the feet of a robot that may be pushed (N,)
    settled: torch.Tensor  # true where the robot should stand, whatever its heading (N,)
    heading_error: torch.Tensor  # wrapped (N,) [rad]
    rising: torch.Tensor  # how far the stand-up should be, 0 lying to 1 upright (N,)
    toe_error: torch.Tensor  # measured - desired base -> front toe (N, 2, 3) [m]
    tracking: torch.Tensor  # 1 where goals count (N,)
    contact: torch.Tensor  # true where a hind toe touches the ground, left then right (N, 2)
    load: torch.Tensor  # share of the robot's weight on each hind foot (N, 2)
    clearance: torch.Tensor  # height of the hind toes above the ground (N, 2) [m]
    slip: torch.Tensor  # the paper's slip (N,): see mimic.train.feet.sliding
    hind_speed: torch.Tensor  # horizontal speed of the hind toes (N, 2) [m/s]
    foot_shift: torch.Tensor  # mean way of the hind toes from where they began, while standing up (N,) [m]
    terminations_met: torch.Tensor  # number of the paper's terminations that hold (N,)
    phase: torch.Tensor  # gait phase (N,) [rad]
    low: torch.Tensor  # number of front legs and hind knees on or near the ground (N,)
    action_change: torch.Tensor  # action - action before (N, 12)
    torque: torch.Tensor  # share of the largest (N, 12)
    overload: torch.Tensor  # torque beyond the rated one, the same (N, 12)
    dq: torch.Tensor  # (N, 12) [rad/s]
    ddq: torch.Tensor  # (N, 12) [rad/s^2]
    limit_excess: torch.Tensor  # how far joints are beyond their limits with the margin (N, 12) [rad]
    fallen: torch.Tensor  # true where the episode ends in a fall (N,)


REWARD_SCALE = 0.008
"""Factor on all rewards. Returns are then of the order of ten, which the critic can follow. Unscaled they were 300,
with PPO's limit of 0.2 on the change of a value in an update, and the critic was wrong by 20 to 27 throughout."""

REGULARISATION, RAMP_STEPS = 2.0, 12_000
"""Factor on the weights of REGULARISERS at the end of a ramp of so many control steps of a world."""

SWING_SHARE = 0.7
"""Share of half a gait cycle in which a foot swings; in the rest both stand."""

MOST_HEAT = 1.0
"""More than this sum of squared shares is not counted: standing up and catching a push cost less."""

MOST_UNREST = 6.0
"""More than this sum of squared changes of the action is not counted: nobody catches a push with small ones."""

MOST_DRIFT = 0.3
"""More than this drift is not counted [m]: a step that catches a push costs less."""

BEARS = 0.2
"""A foot is planted that bears this share of the robot's weight."""

MOST_SHUFFLE = 0.3
"""A hind toe that moves faster than this on the ground costs no more [m/s]."""


def reward_terms(f: Facts, swing_height: float, description: RobotDescription) -> dict[str, torch.Tensor]:
    """Return each unweighted term (N,) in the order of RewardWeights; swing_height [m] is asked of a hind toe."""
    numbers = description.training
    lying_angle = math.asin(float(description.upright_direction[2]))  # between base x, level, and the upright direction
    angle = torch.acos(torch.clamp(f.up, -1.0, 1.0))
    smooth = smoothstep(f.rising)
    over = f.height - (numbers.rise_from + (numbers.rise_to - numbers.rise_from) * smooth)
    over = torch.where((f.rising >= 1) & (over > 0), torch.zeros_like(over), over)
    lean = angle - lying_angle * (1 - smooth)
    level = torch.where(f.rising >= 1, ((1 + f.up) / 2).square(), torch.exp(-((lean / 0.4) ** 2)))
    standing = (
        torch.clamp((f.height - numbers.height_low) / numbers.height_span, 0, 1) * torch.clamp(f.up, 0, 1) * f.rising
    )
    toes = f.toe_error.square().sum((-1, -2))
    sine = torch.sin(f.phase)
    both = math.sin(0.5 * math.pi * (1 - SWING_SHARE))  # below this sine both feet stand
    swing = (torch.stack([sine, -sine], -1) - both) / (1 - both)
    wanted = swing_height * torch.clamp(2 * swing, min=0.0, max=1.0)
    planted = f.contact.float()
    too_high = torch.clamp(f.clearance - wanted - 0.01, min=0.0) / 0.03
    lifted = torch.clamp(f.clearance / wanted.clamp(min=0.01), 0, 1) * torch.exp(-too_high.square())
    lifted = (0.15 + 0.85 * lifted) * (1 - planted)  # leaving the ground pays by itself, or no foot is ever lifted
    stepping = torch.where(swing > 0, lifted, planted)
    both_planted = (f.load.amin(-1, keepdim=True) / BEARS).clamp(0.0, 1.0)
    standing_still = torch.maximum(both_planted, f.toppling[:, None].float())  # a step that catches a fall is no fault
    asked = (f.gait * (1 - f.settled.float()))[:, None]  # or a robot turns away, so that its clock starts
    stepping = asked * stepping + (1 - asked) * standing_still
    # without the widest bell toes that are 20 cm off never came nearer
    reaching = 0.2 * torch.exp(-toes / 0.2) + 0.4 * torch.exp(-toes / 0.04) + 0.4 * torch.exp(-toes / 0.01)
    mean = f.mean_velocity_error.square().sum(-1)  # the wide bell is felt while the robot does not walk at all
    speed = 0.2 * torch.exp(-mean / 0.15) + 0.2 * torch.exp(-mean / 0.02) + 0.25 * torch.exp(-mean / 0.004)
    speed = speed + 0.35 * torch.exp(-f.velocity_error.square().sum(-1) / 0.05)
    square = f.heading_error.square()
    changes = f.action_change.square().sum(-1)
    # by the command, or a robot that turns away a little would be asked to step, and need not rest
    resting = torch.maximum(1 - f.gait, f.settled.float()) * f.rising.ge(1) * ~f.toppling
    turning = (
        0.15 * (1 + torch.cos(f.heading_error)) + 0.35 * torch.exp(-square / 0.5) + 0.35 * torch.exp(-square / 0.03)
    )
    return {
        "alive": torch.ones_like(f.height),
        "height": torch.exp(-((over / 0.1) ** 2)),
        "upright": level,
        "velocity": speed * standing,
        "heading": turning * standing,
        "toes": reaching * standing * f.tracking,
        # while the robot steps too, a policy that reaches within a centimetre would rather not walk
        "toes_fine": torch.exp(-toes / 0.001) * standing * f.tracking * (1 - asked[:, 0]),
        "gait": stepping.mean(-1) * standing,
        "drift": f.drift.norm(dim=-1).clamp(max=MOST_DRIFT) * f.tracking,
        "slip": f.slip,
        "foot_shift": f.foot_shift,
        "terminations": f.terminations_met,
        "flight": (f.clearance.amin(-1) > 0.01).float(),
        "low": f.low,
        "action_rate": changes,
        "unrest": f.action_change[:, 6:].square().sum(-1).clamp(max=MOST_UNREST) * resting,
        "shuffle": (f.hind_speed.clamp(max=MOST_SHUFFLE) * planted).mean(-1) * resting,
        "torque": f.torque.square().sum(-1),
        "heat": f.torque.square().sum(-1).clamp(max=MOST_HEAT),
        "overload": f.overload.square().sum(-1),
        "joint_velocity": f.dq.square().sum(-1),
        "joint_speed": torch.clamp(f.dq.abs() - numbers.joint_speed, min=0.0).sum(-1),
        "joint_acceleration": f.ddq.square().sum(-1),
        "limits": f.limit_excess.sum(-1),
        "fall": f.fallen.float(),
    }


def grown(weights: dict[str, float], steps: int) -> dict[str, float]:
    """Return the weights after so many control steps of a world, in which the REGULARISERS grow."""
    factor = 1 + (REGULARISATION - 1) * min(1.0, steps / RAMP_STEPS)
    return {name: value * (factor if name in REGULARISERS else 1.0) for name, value in weights.items()}

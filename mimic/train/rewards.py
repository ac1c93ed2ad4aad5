"""Shapes of the reward terms of the motion-conditioned MDP, one value a world (N,).

They follow the paper's intent (tracking scaled by standing, gait and slip terms) in forms that train in minutes:
bells instead of gates, so that a robot lying on the ground already feels which way is up.
"""

from __future__ import annotations

import math

import torch

from mimic.config.rewards import REGULARISERS
from mimic.geometry import smoothstep
from mimic.robot.description import RobotDescription

REWARD_SCALE = 0.008
"""Factor on all rewards. Returns are then of the order of ten, which the critic can follow. Unscaled they were 300,
with PPO's limit of 0.2 on the change of a value in an update, and the critic was wrong by 20 to 27 throughout."""

REGULARISATION, RAMP_STEPS = 2.0, 12_000
"""Factor on the weights of REGULARISERS at the end of a ramp of so many control steps of a world."""

SWING_SHARE = 0.7
"""Share of half a gait cycle in which a foot swings; in the rest both stand."""

FASTEST = 4.0
"""More than this squared speed of one toe is not counted [m^2/s^2]."""


def rising_terms(
    height: torch.Tensor, up: torch.Tensor, rising: torch.Tensor, description: RobotDescription
) -> dict[str, torch.Tensor]:
    """Return what height and lean of the trunk earn (N,).

    Args:
        height: Of the base (N,) [m].
        up: Cosine between base x and the wanted upright direction (N,).
        rising: How far the stand-up should be, 0 lying to 1 upright (N,).
        description: Of the robot.
    """
    numbers = description.training
    lying_angle = math.asin(float(description.upright_direction[2]))  # between base x, level, and the upright direction
    angle = torch.acos(torch.clamp(up, -1.0, 1.0))
    smooth = smoothstep(rising)
    over = height - (numbers.rise_from + (numbers.rise_to - numbers.rise_from) * smooth)
    over = torch.where((rising >= 1) & (over > 0), torch.zeros_like(over), over)
    lean = angle - lying_angle * (1 - smooth)
    level = torch.where(rising >= 1, ((1 + up) / 2).square(), torch.exp(-((lean / 0.4) ** 2)))
    return {"height": torch.exp(-((over / 0.1) ** 2)), "upright": level}


def stepping(phase: torch.Tensor, clearance: torch.Tensor, planted: torch.Tensor, swing_height: float) -> torch.Tensor:
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
    too_high = torch.clamp(clearance - wanted - 0.01, min=0.0) / 0.03
    lifted = torch.clamp(clearance / wanted.clamp(min=0.01), 0, 1) * torch.exp(-too_high.square())
    lifted = (0.15 + 0.85 * lifted) * (1 - planted)  # leaving the ground pays by itself, or no foot is ever lifted
    return torch.where(swing > 0, lifted, planted)


def sliding(height: torch.Tensor, velocity: torch.Tensor, turning: torch.Tensor, below: float) -> torch.Tensor:
    """Return the paper's slip (N,): squared speed and turning over pi of each toe whose centre is low.

    Args:
        height: Of the toes' centres above the ground (N, 4) [m].
        velocity: Horizontal (N, 4, 2) [m/s].
        turning: Of the lower legs about the vertical (N, 4) [rad/s].
        below: Height under which a toe counts [m]; paper: 0.03.
    """
    square = velocity.square().sum(-1) + (turning / math.pi).square()
    return (square.clamp(max=FASTEST) * (height < below)).sum(-1)


def bells(square: torch.Tensor, *shapes: tuple[float, float]) -> torch.Tensor:
    """Return the sum of bells over a squared error (N,), each of a height and a squared width."""
    return torch.stack([height * torch.exp(-square / width) for height, width in shapes]).sum(0)


def grown(weights: dict[str, float], steps: int) -> dict[str, float]:
    """Return the weights after so many control steps of a world, in which the REGULARISERS grow."""
    factor = 1 + (REGULARISATION - 1) * min(1.0, steps / RAMP_STEPS)
    return {name: value * (factor if name in REGULARISERS else 1.0) for name, value in weights.items()}

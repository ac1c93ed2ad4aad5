"""Random starts of an episode: lying on the ground, or balanced upright with the front legs anywhere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from mimic.config.training import MdpSettings
from mimic.robot.description import RobotDescription
from mimic.robot.goals import MARGIN

TILT = 0.12
"""Largest extra pitch of an upright start [rad]."""

UNEVEN = 0.05
"""Largest roll of any start, and pitch of a lying one [rad]."""

LIFTED = 0.01
"""Added to the heights of the poses, so that nothing starts inside the ground [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """One start for each world."""

    upright: torch.Tensor
    """True where the world starts upright (N,)."""
    heading: torch.Tensor
    """(N,) [rad]"""
    q: torch.Tensor
    """Joint positions (N, 12) [rad]."""
    command: torch.Tensor
    """Commanded joint positions in effect until the first command arrives (N, 12) [rad]."""
    qpos: torch.Tensor
    """MuJoCo's positions (N, 19)."""
    qvel: torch.Tensor
    """MuJoCo's velocities (N, 18)."""
    anytime: torch.Tensor
    """True where the start may be at any time of a task that has a clock (N,)."""


class Starts:
    """Draws starts on the device."""

    def __init__(self, description: RobotDescription, settings: MdpSettings, device: str) -> None:
        def tensor(values: object) -> torch.Tensor:
            return torch.as_tensor(values, dtype=torch.float32, device=device)

        self._settings, self._n, self._device = settings, settings.worlds, device
        self.upright_share = torch.full((1,), settings.upright_share, device=device)
        """Share of the starts that are upright (1,)."""
        self._q_min, self._q_max = tensor(description.q_min), tensor(description.q_max)
        self._lie, self._upright = tensor(description.poses["lie"]), tensor(description.poses["upright"])
        self._heights = description.pose_height
        self._pitch = math.asin(float(description.upright_direction[2]))
        self._is_front = torch.arange(12, device=device) < 6

    def draw(self) -> Start:
        """Return a start for every world."""
        r = self._settings.randomisation
        upright = self._uniform(0.0, 1.0) < self.upright_share
        heading = self._uniform(*r.heading)
        pitch = torch.where(upright, self._pitch + self._uniform(-TILT, TILT), self._uniform(-UNEVEN, UNEVEN))
        quat = quat_from_euler(self._uniform(-UNEVEN, UNEVEN), -pitch, heading)
        q = torch.where(upright[:, None], self._upright, self._lie) + self._uniform(*r.start_q, 12)
        low, high = self._q_min + MARGIN, self._q_max - MARGIN
        anywhere = low + (high - low) * self._uniform(0.0, 1.0, 12)
        q = torch.where(upright[:, None] & self._is_front, anywhere, q)
        q = torch.clamp(q, self._q_min + 0.01, self._q_max - 0.01)
        height = torch.where(upright, self._heights["upright"], self._heights["lie"])
        height = height + LIFTED + self._uniform(*r.start_height)
        zeros = torch.zeros_like(height)
        qvel = self._uniform(-0.1, 0.1, 18) * torch.where(upright, 1.0, 0.2)[:, None]
        qpos = torch.cat([torch.stack([zeros, zeros, height], -1), quat, q], -1)
        return Start(upright=upright, heading=heading, q=q, command=q, qpos=qpos, qvel=qvel, anytime=upright)

    def _uniform(self, low: float, high: float, *shape: int) -> torch.Tensor:
        return low + (high - low) * torch.rand(self._n, *shape, device=self._device)


def quat_from_euler(roll: torch.Tensor, pitch: torch.Tensor, yaw: torch.Tensor) -> torch.Tensor:
    """Return quaternions wxyz (N, 4) of R = Rz(yaw) Ry(pitch) Rx(roll), angles (N,) [rad]."""
    cr, sr = torch.cos(roll / 2), torch.sin(roll / 2)
    cp, sp = torch.cos(pitch / 2), torch.sin(pitch / 2)
    cy, sy = torch.cos(yaw / 2), torch.sin(yaw / 2)
    parts = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
    return torch.stack(parts, -1)

"""Starts of sitting down: recorded states of a tracking policy, random upright ones, and lying ones."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch

from mimic.config.training import MdpSettings
from mimic.errors import AssetError
from mimic.geometry import heading_sin_cos
from mimic.io.assets import shipped
from mimic.robot.description import RobotDescription
from mimic.train.starts import LIFTED, UNEVEN, Start, quat_from_euler

KINDS = ("steady", "rising", "falling")
"""Arrays of the file of recorded states: rows of qpos (19), qvel (18) and the command in effect (12)."""

TILT = 0.25
"""Largest pitch of a random upright start off the upright direction [rad]."""

ROLL = 0.1
"""Largest roll of a random upright start [rad]."""

STRIDE = 0.45
"""Largest change of the hind legs' joints of a random upright start [rad]."""

VELOCITY, TURN = 0.3, 1.0
"""Largest base velocity along each axis of a random upright start [m/s], and angular velocity [rad/s]."""

OFFSET = 0.15
"""Largest difference between command and position of a random start's joints [rad]."""


def recorded_states(name: str) -> dict[str, np.ndarray]:
    """Return rows (states, 49) for each of KINDS, from a file in policies/ or a path.

    Raises:
        AssetError: If there is no such file, or it holds something else.
    """
    path = Path(name) if Path(name).is_file() else shipped("policies", name)
    with np.load(path) as stored:
        kinds = {kind: stored[kind].astype(np.float32) for kind in KINDS if kind in stored}
    if set(kinds) != set(KINDS) or any(
        rows.ndim != 2 or rows.shape[1] != 49 or not len(rows) for rows in kinds.values()
    ):
        raise AssetError(f"{path} does not hold states of each of {', '.join(KINDS)}; make it anew")
    return kinds


class SitDownStarts:
    """Draws starts on the device."""

    def __init__(self, description: RobotDescription, settings: MdpSettings, device: str) -> None:
        def tensor(values: object) -> torch.Tensor:
            return torch.as_tensor(values, dtype=torch.float32, device=device)

        self._settings, self._n, self._device = settings, settings.worlds, device
        self._q_min, self._q_max = tensor(description.q_min) + 0.01, tensor(description.q_max) - 0.01
        self._lie, self._upright = tensor(description.poses["lie"]), tensor(description.poses["upright"])
        self._heights = description.pose_height
        self._pitch = math.asin(float(description.upright_direction[2]))
        self._is_front = torch.arange(12, device=device) < 6
        kinds = recorded_states(settings.sit_down.states)
        counts = [len(kinds[kind]) for kind in KINDS]
        self._recorded = tensor(np.concatenate([kinds[kind] for kind in KINDS]))
        self._first = tensor(np.concatenate([[0], np.cumsum(counts[:-1])]))
        self._count = tensor(counts)

    def draw(self) -> Start:
        """Return a start for every world."""
        s = self._settings.sit_down
        chance = self._uniform(0.0, 1.0)
        shares = (s.steady_share, s.rising_share, s.falling_share)
        is_recorded = chance < sum(shares)
        kind = (chance >= shares[0]).long() + (chance >= shares[0] + shares[1]).long()
        lying = ~is_recorded & (chance < sum(shares) + s.lying_share)
        row = self._first[kind.clamp(max=2)] + torch.floor(self._uniform(0.0, 1.0) * self._count[kind.clamp(max=2)])
        recorded = self._recorded[row.long().clamp(max=len(self._recorded) - 1)]

        heading = self._uniform(-math.pi, math.pi)
        pitch = torch.where(lying, self._uniform(-UNEVEN, UNEVEN), self._pitch + self._uniform(-TILT, TILT))
        quat = quat_from_euler(self._uniform(-ROLL, ROLL), -pitch, heading)
        around = torch.where(lying[:, None], self._lie + self._uniform(-0.15, 0.15, 12), self._upright)
        stride = torch.where(lying, torch.zeros_like(pitch), torch.full_like(pitch, STRIDE))[:, None]
        q = around + stride * self._uniform(-1.0, 1.0, 12)
        anywhere = self._q_min + (self._q_max - self._q_min) * self._uniform(0.0, 1.0, 12)
        q = torch.where(~lying[:, None] & self._is_front, anywhere, q)
        q = torch.minimum(torch.maximum(q, self._q_min), self._q_max)
        height = torch.where(lying, self._heights["lie"], self._heights["upright"]) + LIFTED
        height = height + self._uniform(0.0, 0.02)
        zeros = torch.zeros_like(height)
        moving = torch.where(lying, 0.2, 1.0)[:, None]
        linear = self._uniform(-VELOCITY, VELOCITY, 3) * moving
        qvel = torch.cat([linear, self._uniform(-TURN, TURN, 3) * moving, self._uniform(-0.5, 0.5, 12) * moving], -1)
        qpos = torch.cat([torch.stack([zeros, zeros, height], -1), quat, q], -1)
        command = q + self._uniform(-OFFSET, OFFSET, 12)

        jitter = torch.cat([self._uniform(-1.0, 1.0, 3) * s.jitter_velocity, self._uniform(-0.3, 0.3, 15)], -1)
        use = is_recorded[:, None]
        qpos = torch.where(use, recorded[:, :19], qpos)
        qvel = torch.where(use, recorded[:, 19:37] + jitter, qvel)
        command = torch.where(use, recorded[:, 37:], command)
        sine, cosine = heading_sin_cos(*(qpos[:, 3 + i] for i in range(4)))
        return Start(
            upright=torch.zeros_like(is_recorded),
            heading=torch.arctan2(sine, cosine),
            q=qpos[:, 7:],
            command=command,
            qpos=qpos,
            qvel=qvel,
            anytime=lying,
        )

    def _uniform(self, low: float, high: float, *shape: int) -> torch.Tensor:
        return low + (high - low) * torch.rand(self._n, *shape, device=self._device)

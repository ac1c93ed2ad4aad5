"""What happens to each training world besides its robot: the same disturbances as in mimic.simulation.disturbances.

Slope and payload belong to a world and are made with it (`mimic.train.worlds`); what is here is drawn anew for
every episode. Element-wise over static buffers.
"""

from __future__ import annotations

import math

import torch

from mimic.config.training import DisturbanceRanges

QUIET_PUSH = 0.25
"""Factor on the pushes of quiet worlds."""


def quat_multiply(one: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    """Return the product of quaternions wxyz (..., 4)."""
    a, v, b, u = one[..., :1], one[..., 1:], other[..., :1], other[..., 1:]
    return torch.cat([a * b - (v * u).sum(-1, keepdim=True), a * u + b * v + torch.linalg.cross(v, u)], -1)


def quat_rotate(quat: torch.Tensor, vector: torch.Tensor, *, inverse: bool = False) -> torch.Tensor:
    """Return vectors (..., 3) turned by unit quaternions wxyz (..., 4), or back."""
    w, axis = quat[..., :1], quat[..., 1:]
    axis = -axis if inverse else axis
    twice = 2 * torch.linalg.cross(axis, vector)
    return vector + w * twice + torch.linalg.cross(axis, twice)


class Disturbances:
    """Mounting error of the IMU, lost commands, and a pull on a front toe, for each world and episode."""

    def __init__(self, ranges: DisturbanceRanges, worlds: int, dt: float, device: str, quiet: torch.Tensor) -> None:
        """Take the ranges; ``quiet`` (N,) is True for worlds in which nothing happens but small pushes."""
        self._ranges, self._dt, self._n, self._device = ranges, dt, worlds, device
        self.mount = torch.zeros(worlds, 4, device=device)
        """Rotation from the IMU as it should be to the IMU as it is mounted, wxyz (N, 4)."""
        self.lost_share = torch.zeros(worlds, 1, device=device)
        """Probability that a command does not arrive (N, 1)."""
        self.force = torch.zeros(worlds, 3, device=device)
        """Pull of this episode, world axes (N, 3) [N]."""
        self.toe = torch.zeros(worlds, 2, device=device)
        """1 for the front toe that is pulled, left or right (N, 2)."""
        self._from = torch.zeros(worlds, device=device)
        self._part = 1.0 - quiet.float()
        self._push_part = torch.where(quiet, QUIET_PUSH, 1.0)
        self.share, self.push_share = torch.ones(worlds, device=device), torch.ones(worlds, device=device)
        """Factors on whatever is drawn here, and on pushes (N,)."""
        self.set_share(1.0)
        self.mount[:, 0] = 1.0

    def set_share(self, share: float) -> None:
        """Let worlds that are not quiet see this share of everything."""
        self.share.copy_(share * self._part)
        self.push_share.copy_(share * self._push_part)

    def reset(self, mask: torch.Tensor) -> None:
        """Draw anew where ``mask``."""
        r = self._ranges

        def put(buffer: torch.Tensor, value: torch.Tensor) -> None:
            buffer.copy_(torch.where(mask.view(-1, *[1] * (buffer.dim() - 1)), value, buffer))

        axis = torch.randn(self._n, 3, device=self._device)
        axis = axis / axis.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        half = (self.share * self._uniform(*r.imu_tilt))[:, None] * (math.pi / 360)
        put(self.mount, torch.cat([torch.cos(half), torch.sin(half) * axis], -1))
        put(self.lost_share, (self.share * self._uniform(*r.lost_share))[:, None])
        angle = self._uniform(-math.pi, math.pi)
        size = self.share * self._uniform(*r.drag) * (self._uniform(0.0, 1.0) < r.drag_share)
        put(self.force, torch.stack([size * torch.cos(angle), size * torch.sin(angle), torch.zeros_like(size)], -1))
        left = (self._uniform(0.0, 1.0) < 0.5).float()
        put(self.toe, torch.stack([left, 1 - left], -1))
        put(self._from, self._uniform(*r.drag_from))

    def arrives(self) -> torch.Tensor:
        """Return whether the command of this control step arrives (N, 1)."""
        return torch.rand_like(self.lost_share) >= self.lost_share

    def pull(self, step: torch.Tensor) -> torch.Tensor:
        """Return the force on each front toe (N, 2, 3) [N] at a control step of the episode (N,)."""
        since = step * self._dt - self._from
        now = (since >= 0) & (since < self._ranges.drag_seconds)
        return self.toe[..., None] * (self.force * now[:, None])[:, None, :]

    def _uniform(self, low: float, high: float) -> torch.Tensor:
        return low + (high - low) * torch.rand(self._n, device=self._device)

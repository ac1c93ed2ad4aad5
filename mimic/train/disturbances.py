"""What happens to each training world besides its robot: the same disturbances as in mimic.simulation.disturbances.

Slope and payload belong to a world and are made with it (`mimic.train.worlds`); what is here is drawn anew for
every episode. Element-wise over static buffers.
"""

from __future__ import annotations

import math

import torch

from mimic.config.training import MdpSettings

QUIET_PUSH = 0.25
"""Factor on the pushes of quiet worlds."""

QUIET_TILT = 2.0
"""Largest mounting error of the IMU in quiet worlds [deg]."""

BACKWARD = 0.2
"""Share of the pulls that come from within 45 degrees of straight behind, besides those that come from anywhere."""


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

    def __init__(self, settings: MdpSettings, dt: float, device: str, quiet: torch.Tensor) -> None:
        """Take the settings; ``quiet`` (N,) is True for worlds in which nothing happens but small pushes and hands."""
        n = settings.worlds
        self._ranges, self._dt, self._n, self._device = settings.disturbances, dt, n, device
        self._pitch_axis = torch.tensor([0.0, 1.0, 0.0], device=device)
        most = settings.disturbances.imu_tilt[1]
        self._quiet_tilt = min(QUIET_TILT / most, 1.0) if most else 0.0
        self.mount = torch.zeros(n, 4, device=device)
        """Rotation from the IMU as it should be to the IMU as it is mounted, wxyz (N, 4)."""
        self.gyro_bias = torch.zeros(n, 3, device=device)
        """Added to the gyro's reading (N, 3) [rad/s]."""
        self.lost_share = torch.zeros(n, 1, device=device)
        """Probability that a command does not arrive (N, 1)."""
        self.force = torch.zeros(n, device=device)
        """Steady pull of this episode (N,) [N]."""
        self._angle, self._way = torch.zeros(n, device=device), torch.zeros(n, device=device)
        self._ramp = torch.ones(n, device=device)
        self.toe = torch.zeros(n, 2, device=device)
        """1 for the front toe that is pulled, left or right (N, 2)."""
        self.led = torch.zeros(n, dtype=torch.bool, device=device)
        """True where a hand comes in this episode instead of the steady pull (N,)."""
        self.hand_velocity = torch.zeros(n, 2, device=device)
        """How the hand walks, world axes (N, 2) [m/s]."""
        self.pull = torch.zeros(n, 2, 3, device=device)
        """Force on each front toe now, world axes (N, 2, 3) [N]."""
        self._most, self._hand = torch.zeros(n, device=device), torch.zeros(n, 2, device=device)
        self._from, self._seconds = torch.zeros(n, device=device), torch.zeros(n, device=device)
        self.held = torch.zeros(n, dtype=torch.bool, device=device)
        """True while the hand holds the toe (N,)."""
        self.came = torch.zeros(n, dtype=torch.bool, device=device)
        """True from when it has taken the toe to the end of the episode (N,)."""
        self.behind = torch.zeros(n, device=device)
        """How far the toe is from the hand (N,) [m]."""
        self._leads = settings.disturbances.lead_share * (settings.task == "stand_track")
        self._quiet = quiet
        self._grown = torch.ones((), device=device)
        self.set_share(1.0)
        self.mount[:, 0] = 1.0

    def set_share(self, share: float) -> None:
        """Let worlds see this share of everything."""
        self._grown.fill_(share)

    @property
    def share(self) -> torch.Tensor:
        """Factor on whatever is drawn here (N,)."""
        return self._grown * (~self._quiet).float()

    @property
    def push_share(self) -> torch.Tensor:
        """Factor on pushes (N,)."""
        return self._grown * torch.where(self._quiet, QUIET_PUSH, 1.0)

    def reset(self, mask: torch.Tensor) -> None:
        """Draw anew where ``mask`` (N,)."""
        r = self._ranges

        def put(buffer: torch.Tensor, value: torch.Tensor) -> None:
            buffer.copy_(torch.where(mask.view(-1, *[1] * (buffer.dim() - 1)), value, buffer))

        axis = torch.randn(self._n, 3, device=self._device)
        axis = axis / axis.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        pitch = self._pitch_axis * torch.sign(axis[:, 1:2])
        axis = torch.where(self._uniform(-1.0, 1.0)[:, None] > 0, axis, pitch)
        tilt = torch.where(self._quiet, self._quiet_tilt, 1.0) * self._grown
        half = (tilt * self._uniform(*r.imu_tilt))[:, None] * (math.pi / 360)
        put(self.mount, torch.cat([torch.cos(half), torch.sin(half) * axis], -1))
        put(self.gyro_bias, r.gyro_bias * (2 * torch.rand(self._n, 3, device=self._device) - 1))
        put(self.lost_share, (self.share * self._uniform(*r.lost_share))[:, None])
        led = self._uniform(0.0, 1.0) < self._leads
        put(self.led, led)
        size = self.share * self._uniform(*r.drag) * (self._uniform(0.0, 1.0) < r.drag_share)
        put(self.force, torch.where(led, 0.0, size))
        behind = self._uniform(0.0, 1.0) < BACKWARD
        put(self._angle, torch.where(behind, math.pi + 0.25 * self._any_angle(), self._any_angle()))
        put(self._ramp, self._uniform(*r.drag_ramp))
        put(self.hand_velocity, self._any_direction() * self._uniform(*r.lead_speed)[:, None])
        put(self._most, self._grown * self._uniform(*r.lead_most))
        put(self._seconds, torch.where(led, self._uniform(*r.lead_seconds), self._ramp + r.drag_seconds))
        left = (self._uniform(0.0, 1.0) < 0.5).float()
        put(self.toe, torch.stack([left, 1 - left], -1))
        put(self._from, self._uniform(*r.drag_from))
        for flag in (self.held, self.came):
            put(flag, torch.zeros_like(flag))

    def arrives(self) -> torch.Tensor:
        """Return whether the command of this control step arrives (N, 1)."""
        return torch.rand_like(self.lost_share) >= self.lost_share

    def advance(self, step: torch.Tensor, toes: torch.Tensor, heading: torch.Tensor) -> None:
        """Let the pull be that of a control step.

        Args:
            step: Control step of the episode (N,).
            toes: Front toes, world axes (N, 2, 3) [m].
            heading: Of the robot (N,) [rad]; a pull keeps the direction in which it begins.
        """
        since = step * self._dt - self._from
        now = (since >= 0) & (since < self._seconds)
        toe = (toes[..., :2] * self.toe[..., None]).sum(1)
        moved = self._hand + self.hand_velocity * self._dt
        self._hand.copy_(torch.where(self.held[:, None], moved, toe))
        self.held.copy_(now & self.led)
        self.came.logical_or_(self.held)
        away = self._hand - toe
        self.behind.copy_(away.norm(dim=-1))
        hand = away * (self._most / self.behind.clamp(min=1e-6)).clamp(max=self._ranges.lead_stiffness)[:, None]
        hand = torch.cat([hand, torch.zeros_like(hand[:, :1])], -1)
        self._way.copy_(torch.where(since <= 0, heading + self._angle, self._way))
        size = self.force * ((since + self._dt) / self._ramp.clamp(min=1e-3)).clamp(0.0, 1.0)
        pull = torch.stack([size * torch.cos(self._way), size * torch.sin(self._way), torch.zeros_like(size)], -1)
        force = torch.where(self.led[:, None], hand, pull) * now[:, None]
        self.pull.copy_(self.toe[..., None] * torch.nan_to_num(force)[:, None, :])

    def _uniform(self, low: float, high: float) -> torch.Tensor:
        return low + (high - low) * torch.rand(self._n, device=self._device)

    def _any_angle(self) -> torch.Tensor:
        return self._uniform(-math.pi, math.pi)

    def _any_direction(self) -> torch.Tensor:
        angle = self._any_angle()
        return torch.stack([torch.cos(angle), torch.sin(angle)], -1)

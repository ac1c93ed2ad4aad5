"""What happens to each training world besides its robot: slope, payload, pulls and pushes, and lost commands.

Slope and payload belong to a world and are made with it (`mimic.train.worlds`); what is here is drawn anew for
every episode. Element-wise over static buffers.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from mimic.config.training import MdpSettings
from mimic.train.tensors import Chance, put

QUIET_PUSH = 0.25
"""Factor on the pushes of quiet worlds …"""

HARD_PUSH = 0.25
"""… but for this share of them, which are as hard as anywhere: a robot at rest has to catch itself, too."""

QUIET_TILT = 2.0
"""Largest mounting error of the IMU in quiet worlds [deg]."""

BACKWARD = 0.2
"""Share of the pulls that come from within 45 degrees of straight behind, besides those that come from anywhere."""

DRAG_SECONDS = 3.0
"""How long a steady pull lasts once it has grown [s]."""

LEAD_SPEED = (0.0, 0.3)
"""How fast a hand walks [m/s]."""

LEAD_MOST = (4.0, 10.0)
"""Strongest pull of the hand [N]; what would take more slips through the fingers."""

LEAD_STIFFNESS = 60.0
"""Pull for each metre that the toe is behind the hand [N/m]."""

LEAD_SECONDS = (2.0, 10.0)
"""How long until it lets go [s]."""


class Disturbances(Chance):
    """Mounting error of the IMU, lost commands, and a pull on a front toe, for each world and episode."""

    def __init__(self, settings: MdpSettings, dt: float, device: str, quiet: Tensor) -> None:
        """Take the settings; ``quiet`` (N,) is True for worlds in which nothing happens but small pushes and hands."""
        super().__init__(settings.worlds, device)
        self._ranges = settings.disturbances
        self._dt = dt
        self._quiet = quiet
        self._leads = settings.disturbances.lead_share * (settings.task == "stand_track")
        most = settings.disturbances.imu_tilt[1]
        self._quiet_tilt = min(QUIET_TILT / most, 1.0) if most else 0.0
        zeros = self._zeros
        self.mount = zeros(4)
        """Rotation from the IMU as it should be to the IMU as it is mounted, wxyz (N, 4)."""
        self.mount[:, 0] = 1.0
        self.gyro_bias = zeros(3)
        """Added to the gyro's reading (N, 3) [rad/s]."""
        self.lost_share = zeros(1)
        """Probability that a command does not arrive (N, 1)."""
        self.force = zeros()
        """Steady pull of this episode (N,) [N]."""
        self.toe = zeros(2)
        """1 for the front toe that is pulled, left or right (N, 2)."""
        self.led = zeros(dtype=torch.bool)
        """True where a hand comes in this episode instead of the steady pull (N,)."""
        self.hand_velocity = zeros(2)
        """How the hand walks, world axes (N, 2) [m/s]."""
        self.pull = zeros(2, 3)
        """Force on each front toe now, world axes (N, 2, 3) [N]."""
        self.held = zeros(dtype=torch.bool)
        """True while the hand holds the toe (N,)."""
        self.came = zeros(dtype=torch.bool)
        """True from then to the end of the episode (N,)."""
        self.behind = zeros()
        """How far the toe is from the hand (N,) [m]."""
        self._pitch_axis = torch.tensor([0.0, 1.0, 0.0], device=device)
        self._angle = zeros()
        self._way = zeros()
        self._ramp = zeros()
        self._most = zeros()
        self._hand = zeros(2)
        self._from = zeros()
        self._seconds = zeros()
        self._grown = torch.ones((), device=device)

    def set_share(self, share: float) -> None:
        """Let worlds see this share of everything."""
        self._grown.fill_(share)

    @property
    def share(self) -> Tensor:
        """Factor on whatever is drawn here (N,)."""
        return self._grown * (~self._quiet).float()

    @property
    def push_share(self) -> Tensor:
        """Factor on pushes (N,), drawn anew at each call."""
        gently = self._quiet & (self._rand() >= HARD_PUSH)
        return self._grown * torch.where(gently, QUIET_PUSH, 1.0)

    def reset(self, mask: Tensor) -> None:
        """Draw anew where ``mask`` (N,)."""
        r = self._ranges
        axis = torch.randn(self._n, 3, device=self._device)
        axis = axis / axis.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        pitch = self._pitch_axis * torch.sign(axis[:, 1:2])
        axis = torch.where(self._uniform(-1.0, 1.0)[:, None] > 0, axis, pitch)
        tilt = torch.where(self._quiet, self._quiet_tilt, 1.0) * self._grown
        half = (tilt * self._uniform(*r.imu_tilt))[:, None] * (math.pi / 360)
        put(self.mount, mask, torch.cat([torch.cos(half), torch.sin(half) * axis], -1))
        put(self.gyro_bias, mask, r.gyro_bias * (2 * self._rand(3) - 1))
        put(self.lost_share, mask, (self.share * self._uniform(*r.lost_share))[:, None])
        led = self._rand() < self._leads
        put(self.led, mask, led)
        size = self.share * self._uniform(*r.drag) * (self._rand() < r.drag_share)
        put(self.force, mask, torch.where(led, 0.0, size))
        behind = self._rand() < BACKWARD
        put(self._angle, mask, torch.where(behind, math.pi + 0.25 * self._any_angle(), self._any_angle()))
        put(self._ramp, mask, self._uniform(*r.drag_ramp))
        walks = self._any_angle()
        walks = torch.stack([torch.cos(walks), torch.sin(walks)], -1)
        put(self.hand_velocity, mask, walks * self._uniform(*LEAD_SPEED)[:, None])
        put(self._most, mask, self._grown * self._uniform(*LEAD_MOST))
        put(self._seconds, mask, torch.where(led, self._uniform(*LEAD_SECONDS), self._ramp + DRAG_SECONDS))
        left = (self._rand() < 0.5).float()
        put(self.toe, mask, torch.stack([left, 1 - left], -1))
        put(self._from, mask, self._uniform(*r.drag_from))
        for flag in (self.held, self.came):
            flag.logical_and_(~mask)

    @property
    def pulled(self) -> Tensor:
        """True while a steady pull lasts (N,); a robot that is led follows its hand."""
        return (self.pull.abs().sum((1, 2)) > 0.0) & ~self.led

    def arrives(self) -> Tensor:
        """Return whether the command of this control step arrives (N, 1)."""
        return torch.rand_like(self.lost_share) >= self.lost_share

    def advance(self, step: Tensor, toes: Tensor, heading: Tensor) -> None:
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
        hand = away * (self._most / self.behind.clamp(min=1e-6)).clamp(max=LEAD_STIFFNESS)[:, None]
        hand = torch.cat([hand, torch.zeros_like(hand[:, :1])], -1)
        self._way.copy_(torch.where(since <= 0, heading + self._angle, self._way))
        size = self.force * ((since + self._dt) / self._ramp.clamp(min=1e-3)).clamp(0.0, 1.0)
        pull = torch.stack([size * torch.cos(self._way), size * torch.sin(self._way), torch.zeros_like(size)], -1)
        force = torch.where(self.led[:, None], hand, pull) * now[:, None]
        self.pull.copy_(self.toe[..., None] * torch.nan_to_num(force)[:, None, :])

    def _any_angle(self) -> Tensor:
        return self._uniform(-math.pi, math.pi)

"""Starts of an episode: lying, or upright with the front legs anywhere; for sitting down, recorded states too."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from mimic.config.training import MdpSettings
from mimic.errors import AssetError
from mimic.geometry import heading_sin_cos
from mimic.io.assets import shipped
from mimic.policy.runtime import robot_file
from mimic.robot.description import RobotDescription
from mimic.robot.goals import MARGIN
from mimic.train.tensors import Chance, quat_from_euler

TILT, SIT_DOWN_TILT = 0.12, 0.25
"""Largest extra pitch of an upright start [rad]."""

UNEVEN, SIT_DOWN_ROLL = 0.05, 0.1
"""Largest roll of any start and pitch of a lying one; largest roll of a random start of sitting down [rad]."""

LIFTED = 0.01
"""Added to the heights of the poses, so that nothing starts inside the ground [m]."""

KINDS = ("steady", "rising", "falling")
"""Recorded states: while standing, walking and turning; while standing up; while falling after a push."""

STRIDE = 0.45
"""Sitting down: largest change of the hind legs' joints of a random upright start [rad]."""

VELOCITY, TURN = 0.3, 1.0
"""… largest base velocity along each axis [m/s], and angular velocity [rad/s]."""

OFFSET = 0.15
"""… largest difference between command and position of its joints [rad]."""

JITTER = 0.15
"""… largest change of a recorded base velocity along each axis [m/s]."""


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


class Starts(Chance):
    """Draws starts on the device."""

    def __init__(self, description: RobotDescription, settings: MdpSettings, device: str) -> None:
        super().__init__(settings.worlds, device)
        self._ranges = settings.randomisation
        self.upright_share = torch.full((1,), settings.upright_share, device=device)
        """Share of the starts that are upright (1,)."""
        self._q_min, self._q_max = self._tensor(description.q_min), self._tensor(description.q_max)
        self._lie, self._upright = self._tensor(description.poses["lie"]), self._tensor(description.poses["upright"])
        self._heights = description.pose_height
        self._pitch = math.asin(float(description.upright_direction[2]))
        self._is_front = torch.arange(12, device=device) < 6

    def draw(self) -> Start:
        """Return a start for every world."""
        r = self._ranges
        upright = self._uniform(0.0, 1.0) < self.upright_share
        heading = self._uniform(*r.heading)
        pitch = torch.where(upright, self._pitch + self._uniform(-TILT, TILT), self._uniform(-UNEVEN, UNEVEN))
        quat = quat_from_euler(self._uniform(-UNEVEN, UNEVEN), -pitch, heading)
        q = torch.where(upright[:, None], self._upright, self._lie) + self._uniform(*r.start_q, 12)
        low, high = self._q_min + MARGIN, self._q_max - MARGIN
        anywhere = low + (high - low) * self._uniform(0.0, 1.0, 12)
        q = torch.where(upright[:, None] & self._is_front, anywhere, q)
        q = torch.clamp(q, self._q_min + 0.01, self._q_max - 0.01)
        qpos = self._at(upright, self._uniform(*r.start_height), quat, q)
        qvel = self._uniform(-0.1, 0.1, 18) * torch.where(upright, 1.0, 0.2)[:, None]
        return Start(upright=upright, heading=heading, q=q, command=q, qpos=qpos, qvel=qvel, anytime=upright)

    def _at(self, upright: torch.Tensor, above: torch.Tensor, quat: torch.Tensor, q: torch.Tensor) -> torch.Tensor:
        """Return positions (N, 19) in the pose's height and a little above (N,) [m]."""
        height = torch.where(upright, self._heights["upright"], self._heights["lie"]) + LIFTED + above
        zeros = torch.zeros_like(height)
        return torch.cat([torch.stack([zeros, zeros, height], -1), quat, q], -1)

    def _tensor(self, values: object) -> torch.Tensor:
        return torch.as_tensor(values, dtype=torch.float32, device=self._device)


@dataclass(frozen=True, kw_only=True)
class StartShares:
    """How often sitting down starts how; what is left starts upright with random front legs, tilt and motion."""

    steady: float = 0.45
    rising: float = 0.1
    falling: float = 0.15
    lying: float = 0.1


def recorded_states(file: str | Path) -> dict[str, np.ndarray]:
    """Return rows (states, 49) for each of KINDS: qpos (19), qvel (18) and the command in effect (12).

    Args:
        file: A file in policies/ or a path; lab/policies/handover_states.py makes it.

    Raises:
        AssetError: If there is no such file, or it holds something else.
    """
    try:
        path = Path(file) if Path(file).is_file() else shipped("policies", str(file))
    except AssetError as reason:
        raise AssetError(
            f"there is no {file}, neither here nor in policies/; python -m lab.policies.handover_states POLICY "
            f"--robot ROBOT --write {file} records it from a policy that stands"
        ) from reason
    with np.load(path) as stored:
        kinds = {kind: stored[kind].astype(np.float32) for kind in KINDS if kind in stored}
    if set(kinds) != set(KINDS) or any(
        rows.ndim != 2 or rows.shape[1] != 49 or not len(rows) for rows in kinds.values()
    ):
        raise AssetError(f"{path} does not hold states of each of {', '.join(KINDS)}; make it anew")
    return kinds


class SitDownStarts(Starts):
    """Draws starts of sitting down."""

    shares = StartShares()

    def __init__(self, description: RobotDescription, settings: MdpSettings, device: str) -> None:
        super().__init__(description, settings, device)
        self._q_min, self._q_max = self._q_min + 0.01, self._q_max - 0.01
        kinds = recorded_states(robot_file("handovers.npz", description.name))
        counts = [len(kinds[kind]) for kind in KINDS]
        self._recorded = self._tensor(np.concatenate([kinds[kind] for kind in KINDS]))
        self._first = self._tensor(np.concatenate([[0], np.cumsum(counts[:-1])]))
        self._count = self._tensor(counts)

    def draw(self) -> Start:
        """Return a start for every world."""
        s = self.shares
        chance = self._uniform(0.0, 1.0)
        is_recorded = chance < sum((s.steady, s.rising, s.falling))
        kind = (chance >= s.steady).long() + (chance >= s.steady + s.rising).long()
        lying = ~is_recorded & (chance < sum((s.steady, s.rising, s.falling)) + s.lying)
        row = self._first[kind.clamp(max=2)] + torch.floor(self._uniform(0.0, 1.0) * self._count[kind.clamp(max=2)])
        recorded = self._recorded[row.long().clamp(max=len(self._recorded) - 1)]

        heading = self._uniform(-math.pi, math.pi)
        tilt = self._uniform(-UNEVEN, UNEVEN), self._pitch + self._uniform(-SIT_DOWN_TILT, SIT_DOWN_TILT)
        quat = quat_from_euler(self._uniform(-SIT_DOWN_ROLL, SIT_DOWN_ROLL), -torch.where(lying, *tilt), heading)
        around = torch.where(lying[:, None], self._lie + self._uniform(-0.15, 0.15, 12), self._upright)
        q = around + torch.where(lying, 0.0, STRIDE)[:, None] * self._uniform(-1.0, 1.0, 12)
        anywhere = self._q_min + (self._q_max - self._q_min) * self._uniform(0.0, 1.0, 12)
        q = torch.where(~lying[:, None] & self._is_front, anywhere, q)
        q = torch.minimum(torch.maximum(q, self._q_min), self._q_max)
        qpos = self._at(~lying, self._uniform(0.0, 0.02), quat, q)
        moving = torch.where(lying, 0.2, 1.0)[:, None]
        linear = self._uniform(-VELOCITY, VELOCITY, 3) * moving
        qvel = torch.cat([linear, self._uniform(-TURN, TURN, 3) * moving, self._uniform(-0.5, 0.5, 12) * moving], -1)
        command = q + self._uniform(-OFFSET, OFFSET, 12)

        jitter = torch.cat([self._uniform(-1.0, 1.0, 3) * JITTER, self._uniform(-0.3, 0.3, 15)], -1)
        use = is_recorded[:, None]
        qpos = torch.where(use, recorded[:, :19], qpos)
        qvel = torch.where(use, recorded[:, 19:37] + jitter, qvel)
        command = torch.where(use, recorded[:, 37:], command)
        sine, cosine = heading_sin_cos(*qpos[:, 3:7].unbind(-1))
        never = torch.zeros_like(is_recorded)
        heading = torch.arctan2(sine, cosine)
        return Start(
            upright=never, heading=heading, q=qpos[:, 7:], command=command, qpos=qpos, qvel=qvel, anytime=lying
        )

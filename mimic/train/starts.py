"""Starts of an episode: lying in the crouch, as the ramp leaves a robot, or without power; upright with the front legs
anywhere; for sitting down, recorded states too."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from mimic.config.play import RAMP, Randomisation
from mimic.config.training import MdpSettings
from mimic.control.start import Ramp
from mimic.errors import AssetError
from mimic.geometry import heading_sin_cos
from mimic.io.assets import shipped
from mimic.policy.runtime import robot_file
from mimic.robot.description import RobotDescription
from mimic.robot.goals import MARGIN
from mimic.simulation.plant import SimulatedPlant
from mimic.train.tensors import Chance, quat_from_euler, quat_multiply

TILT = 0.12
"""Largest extra pitch of an upright start [rad]."""

SIT_DOWN_TILT = 0.25
"""The same of sitting down [rad]."""

UNEVEN = 0.05
"""Largest roll of any start and pitch of a lying one [rad]."""

SIT_DOWN_ROLL = 0.1
"""Largest roll of a random start of sitting down [rad]."""

LIFTED = 0.01
"""Added to the heights of the poses, so that nothing starts inside the ground [m]."""

NEAREST = 0.01
"""Least distance of a joint from its limits [rad]."""

KINDS = ("steady", "rising", "falling")
"""Recorded states: while standing, walking and turning; while standing up; while falling after a push."""

STRIDE = 0.45
"""Sitting down: largest change of the hind legs' joints of a random upright start [rad]."""

LYING = 32
"""Robots whose lying without power, and whose ramp into the crouch, is computed for training."""

VELOCITY = 0.3
"""Sitting down: largest base velocity along each axis [m/s]."""

TURN = 1.0
"""Sitting down: largest angular velocity of the base about each axis [rad/s]."""

OFFSET = 0.15
"""Sitting down: largest difference between command and position of a joint [rad]."""

JITTER = 0.15
"""Sitting down: largest change of a recorded base velocity along each axis [m/s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """One start for each world."""

    upright: Tensor
    """True where the world starts upright (N,)."""
    heading: Tensor
    """(N,) [rad]"""
    command: Tensor
    """Commanded joint positions in effect until the first command arrives (N, 12) [rad]."""
    qpos: Tensor
    """MuJoCo's positions (N, 19)."""
    qvel: Tensor
    """MuJoCo's velocities (N, 18)."""
    anytime: Tensor
    """True where the start may be at any time of a task that has a clock (N,)."""


@cache
def lying_states(description: RobotDescription, ranges: Randomisation) -> tuple[np.ndarray, np.ndarray]:
    """Return MuJoCo's positions (LYING, 19) of robots that lie without power, and after the ramp into the crouch."""
    limp = []
    ramped = []
    level = replace(ranges, push=(0.0, 0.0), heading=(0.0, 0.0))
    for seed in range(LYING):
        plant = SimulatedPlant(description, ranges=level, seed=seed, samples=False)
        state = plant.start()
        limp.append(plant.data.qpos.copy())
        ramp = Ramp(state.q, description, RAMP)
        for tick in range(ramp.ticks):
            state = plant.step(ramp.command(tick, state.q)).state
        ramped.append(plant.data.qpos.copy())
    return np.array(limp), np.array(ramped)


class Starts(Chance):
    """Draws starts on the device."""

    ramps = True
    """Whether robots may lie without power, or as the ramp leaves them."""

    def __init__(self, description: RobotDescription, settings: MdpSettings, device: str) -> None:
        super().__init__(settings.worlds, device)
        self._ranges = settings.randomisation
        self.upright_share = torch.full((1,), settings.upright_share, device=device)
        """Share of the starts that are upright (1,)."""
        self._q_min = self._tensor(description.q_min)
        self._q_max = self._tensor(description.q_max)
        self._lie = self._tensor(description.poses["lie"])
        self._upright = self._tensor(description.poses["upright"])
        self._heights = description.pose_height
        self._pitch = math.asin(float(description.upright_direction[2]))
        self._is_front = torch.arange(12, device=device) < 6
        self._shares = settings.limp_share, settings.limp_share + settings.ramped_share
        if self.ramps and self._shares[1] > 0.0:
            limp, ramped = lying_states(description, settings.randomisation)
            self._limp = self._tensor(limp)
            self._ramped = self._tensor(ramped)

    def draw(self) -> Start:
        """Return a start for every world."""
        r = self._ranges
        upright = self._uniform(0.0, 1.0) < self.upright_share
        heading = self._uniform(*r.heading)
        pitch = torch.where(upright, self._pitch + self._uniform(-TILT, TILT), self._uniform(-UNEVEN, UNEVEN))
        quat = quat_from_euler(self._uniform(-UNEVEN, UNEVEN), -pitch, heading)
        q = torch.where(upright[:, None], self._upright, self._lie) + self._uniform(*r.start_q, 12)
        qpos = self._placed(upright, quat, q, MARGIN, r.start_height)
        qvel = self._uniform(-0.1, 0.1, 18) * torch.where(upright, 1.0, 0.2)[:, None]
        command = qpos[:, 7:]
        if self._shares[1] > 0.0:
            kind = self._uniform(0.0, 1.0)
            row = torch.floor(self._uniform(0.0, 1.0) * LYING).long()
            limp = (~upright & (kind < self._shares[0]))[:, None]
            ramped = (~upright & (kind >= self._shares[0]) & (kind < self._shares[1]))[:, None]
            level = torch.zeros_like(heading)
            lying = torch.where(limp, self._limp[row], self._ramped[row])
            quat = quat_multiply(quat_from_euler(level, level, heading), lying[:, 3:7])
            lying = torch.cat([lying[:, :3], quat, lying[:, 7:]], -1)
            qpos = torch.where(limp | ramped, lying, qpos)
            qvel = torch.where(limp | ramped, 0.0, qvel)
            command = torch.where(ramped, self._lie, qpos[:, 7:])
        return Start(upright=upright, heading=heading, command=command, qpos=qpos, qvel=qvel, anytime=upright)

    def _placed(self, upright: Tensor, quat: Tensor, q: Tensor, margin: float, above: tuple[float, float]) -> Tensor:
        """Return positions (N, 19) a little above the poses' heights; upright robots have front legs anywhere."""
        low = self._q_min + margin
        high = self._q_max - margin
        anywhere = low + (high - low) * self._uniform(0.0, 1.0, 12)
        q = torch.where(upright[:, None] & self._is_front, anywhere, q)
        q = torch.clamp(q, self._q_min + NEAREST, self._q_max - NEAREST)
        height = torch.where(upright, self._heights["upright"], self._heights["lie"]) + LIFTED + self._uniform(*above)
        return torch.cat([self._zeros(2), height[:, None], quat, q], -1)


SHARES = {"steady": 0.45, "rising": 0.1, "falling": 0.15, "lying": 0.1}
"""How often sitting down starts how; what is left starts upright with random front legs, tilt and motion."""


def recorded_states(file: str | Path) -> dict[str, np.ndarray]:
    """Return rows (states, 49) for each of KINDS: qpos (19), qvel (18) and the command in effect (12).

    Args:
        file: A file in policies/ or a path; lab/policies/handover_states.py makes it.

    Raises:
        AssetError: If there is no such file.
    """
    try:
        path = Path(file) if Path(file).is_file() else shipped("policies", str(file))
    except AssetError as reason:
        raise AssetError(
            f"there is no {file}, neither here nor in policies/; python -m lab.policies.handover_states POLICY "
            f"--robot ROBOT --write {file} records it from a policy that stands"
        ) from reason
    with np.load(path) as stored:
        return {kind: stored[kind].astype(np.float32) for kind in KINDS}


class SitDownStarts(Starts):
    """Draws starts of sitting down."""

    ramps = False

    def __init__(self, description: RobotDescription, settings: MdpSettings, device: str) -> None:
        super().__init__(description, settings, device)
        kinds = recorded_states(robot_file("handovers.npz", description.name)).values()
        counts = [len(rows) for rows in kinds]
        self._recorded = self._tensor(np.concatenate(list(kinds)))
        self._first = self._tensor(np.cumsum([0, *counts[:-1]]))
        self._count = self._tensor(counts)
        self._kind_ends = self._tensor(np.cumsum(list(SHARES.values())))

    def draw(self) -> Start:
        """Return a start for every world."""
        kind = torch.bucketize(self._uniform(0.0, 1.0), self._kind_ends, right=True)
        is_recorded = kind < len(KINDS)
        lying = kind == len(KINDS)
        kind = kind.clamp(max=len(KINDS) - 1)
        row = self._first[kind] + torch.floor(self._uniform(0.0, 1.0) * self._count[kind])
        recorded = self._recorded[row.long().clamp(max=len(self._recorded) - 1)]

        heading = self._uniform(-math.pi, math.pi)
        tilt = self._uniform(-UNEVEN, UNEVEN), self._pitch + self._uniform(-SIT_DOWN_TILT, SIT_DOWN_TILT)
        quat = quat_from_euler(self._uniform(-SIT_DOWN_ROLL, SIT_DOWN_ROLL), -torch.where(lying, *tilt), heading)
        around = torch.where(lying[:, None], self._lie + self._uniform(-0.15, 0.15, 12), self._upright)
        q = around + torch.where(lying, 0.0, STRIDE)[:, None] * self._uniform(-1.0, 1.0, 12)
        qpos = self._placed(~lying, quat, q, NEAREST, (0.0, 0.02))
        moving = torch.where(lying, 0.2, 1.0)[:, None]
        linear = self._uniform(-VELOCITY, VELOCITY, 3) * moving
        qvel = torch.cat([linear, self._uniform(-TURN, TURN, 3) * moving, self._uniform(-0.5, 0.5, 12) * moving], -1)
        command = qpos[:, 7:] + self._uniform(-OFFSET, OFFSET, 12)

        jitter = torch.cat([self._uniform(-1.0, 1.0, 3) * JITTER, self._uniform(-0.3, 0.3, 15)], -1)
        use = is_recorded[:, None]
        qpos = torch.where(use, recorded[:, :19], qpos)
        qvel = torch.where(use, recorded[:, 19:37] + jitter, qvel)
        command = torch.where(use, recorded[:, 37:], command)
        heading = torch.arctan2(*heading_sin_cos(*qpos[:, 3:7].unbind(-1)))
        never = torch.zeros_like(is_recorded)
        return Start(upright=never, heading=heading, command=command, qpos=qpos, qvel=qvel, anytime=lying)

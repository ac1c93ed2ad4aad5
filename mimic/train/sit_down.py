"""The second task: from upright, in any pose and motion, down to lying on four feet, gently and never on the head."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from mimic.config.training import MdpSettings
from mimic.geometry import smoothstep, up_cosine
from mimic.records import LEGS
from mimic.robot.description import RobotDescription
from mimic.robot.goals import MARGIN
from mimic.train.stand_track import Judged, StandTrackEnv, mean
from mimic.train.starts import SitDownStarts, Start
from mimic.train.tensors import put

EPISODE_STEPS = 150
"""Control steps of an episode."""

SECONDS = 1.2
"""Time that going down should take [s]."""

CRASH_SPEED = 0.8
"""An episode ends where the trunk touches the ground faster than this [m/s]."""

SINKING = 0.45
"""Free speed of the base downward [m/s]; more costs, as with the next three."""

MOVING = 0.7
"""Free speed of the base in any direction [m/s]."""

TUMBLING = 3.0
"""Free angular speed of the base [rad/s]."""

JOLT = 15.0
"""Free acceleration of the base over a control step [m/s^2]."""

ELBOW = 0.6
"""Free angle of a front hip backward from the lying pose [rad]; beyond it the elbow rises beside the head."""

NEAR = 0.004
"""What is lower than this touches the ground [m]."""

HEAD_ROOM = 0.05
"""The lowest point of the head should stay this high [m]."""

ON_ITS_BACK = -0.6
"""An episode fails where the base's z axis points less up than this (cosine)."""

ON_ITS_SIDE = 0.85
"""An episode fails where the base's y axis points more up or down than this (cosine)."""


class SitDownEnv(StandTrackEnv):
    """Worlds in which an upright robot lowers itself to lie on its four feet; nothing else is asked of it."""

    soft_margin = MARGIN  # the weight of a lying robot bends its knees to within 6 degrees of their limits

    def __init__(self, description: RobotDescription, settings: MdpSettings, device: str, seed: int) -> None:
        super().__init__(description, settings, device, seed)
        self.max_episode_length = EPISODE_STEPS
        self.episode_length_buf.remainder_(self.max_episode_length)

    def _constants(self) -> None:
        super()._constants()
        self._starts = SitDownStarts(self.description, self.settings, str(self.device))
        self._lie = self._tensor(self.description.poses["lie"])
        w = self.worlds
        self._head = w.columns("head")
        self._belly = w.columns("trunk", "shoulder", "abad")
        self._thighs = w.columns("thigh")
        self._landing = torch.cat([w.columns("toe", legs=LEGS[:2]), w.columns("knee", legs=LEGS[2:])])

    def _buffers(self) -> None:
        super()._buffers()
        self._height_at_start = self._zeros()
        self._pitch_at_start = self._zeros()
        self._velocity_before = self._zeros(3)
        self._front_before = self._zeros(2, 3)
        self._clearance_before = self._zeros(len(self._landing))

    def _set_difficulty(self) -> None:
        """Everything from the beginning: this task begins where the other one ends."""

    def _first_phase(self, start: Start) -> Tensor:
        return torch.where(start.anytime, self._uniform(0.0, 2 * math.pi), torch.zeros_like(start.heading))

    def _command(self) -> None:
        """Nothing is asked for but neutral toes, no velocity and the heading at the start."""

    def _pitch(self) -> Tensor:
        return torch.asin(torch.clamp(up_cosine(*self._quat()), -1.0, 1.0))

    def _evaluate(self, finite: Tensor, low: Tensor) -> Judged:
        w = self.worlds
        dt = self.contract.dt
        toes = self._toes_now(low)
        progress = torch.clamp(self.episode_length_buf * (dt / SECONDS), max=1.0)
        there = (progress >= 1).float()
        smooth = smoothstep(progress)
        lying = self.description.training.lying_height
        height_error = w.qpos[:, 2] - (self._height_at_start + (lying - self._height_at_start) * smooth)
        pitch_error = self._pitch() - self._pitch_at_start * (1 - smooth)  # of base x above the horizontal
        pose_error = w.qpos[:, 7:] - self._lie
        velocity = w.qvel[:, :3]
        speed = velocity.norm(dim=-1)
        turning = w.qvel[:, 3:6].norm(dim=-1)
        later = self.episode_length_buf > 1
        acceleration = torch.where(later, (velocity - self._velocity_before).norm(dim=-1) / dt, 0.0)
        front = w.toes[:, :2]
        front_speed = ((front - self._front_before) / dt)[..., :2].norm(dim=-1)
        down = front[..., 2] < self.description.toe_radius + NEAR
        front_slip = torch.where(down & later[:, None], front_speed, 0.0)
        clearance = low[:, self._landing]
        landed = (clearance < NEAR) & (self._clearance_before > NEAR) & later[:, None]
        landing = (((self._clearance_before - clearance) / dt).clamp(0.0, 4.0) * landed).square().sum(-1)
        trunk = low[:, self._belly].amin(-1) < 0.002
        head = low[:, self._head].amin(-1)
        qw, qx, qy, qz = self._quat()
        left_up = 2 * (qy * qz + qw * qx)  # cosine between base y and up
        overturned = (1 - 2 * (qx * qx + qy * qy) < ON_ITS_BACK) | (left_up.abs() > ON_ITS_SIDE)
        asked = self._default_q + self.settings.action_scale * self._last_action
        beyond = torch.relu(self._q_min - asked) + torch.relu(asked - self._q_max)  # the limits of commands
        failed = finite & ((head < 0.002) | overturned | (trunk & (speed > CRASH_SPEED)))
        self._velocity_before.copy_(velocity)
        self._front_before.copy_(front)
        self._clearance_before.copy_(clearance)
        off = pose_error.square().mean(-1)
        elbows = torch.relu(pose_error[:, 1:5:3] - ELBOW)
        near = torch.exp(-((pose_error / 0.12) ** 2)).mean(-1)
        at_rest = torch.exp(-speed.square() / 0.02 - turning.square() / 0.3)
        terms = self._efforts() | {
            "height": torch.exp(-((height_error / 0.06) ** 2)),
            "level": torch.exp(-((pitch_error / 0.4) ** 2)),
            "roll": left_up.square(),
            "pose": 0.5 * (torch.exp(-off / 0.6) + torch.exp(-off / 0.1)) * progress,
            "pose_fine": near * there,
            "still": at_rest * there * torch.exp(-((height_error / 0.08) ** 2)),
            "sinking": torch.clamp(-velocity[:, 2] - SINKING, 0.0, 3.0).square(),
            "fast": torch.clamp(speed - MOVING, 0.0, 3.0).square(),
            "tumbling": torch.clamp(turning - TUMBLING, 0.0, 10.0).square(),
            "jolt": torch.clamp((acceleration - JOLT) / 20.0, 0.0, 5.0),
            "landing": landing,
            "trunk": trunk.float() * (0.3 + speed.clamp(max=3.0)),
            "thighs": (low[:, self._thighs] < 0.002).float().sum(-1),
            "head_low": torch.clamp((HEAD_ROOM - head) / HEAD_ROOM, 0.0, 1.0),
            "slip": (toes.speed.clamp(max=2.0) * toes.contact).sum(-1) + front_slip.clamp(max=2.0).sum(-1),
            "beyond": beyond.square().sum(-1),
            "elbows": elbows.square().sum(-1),
            "fail": failed.float(),
        }
        lies = (height_error.abs() < 0.03) & (pitch_error.abs() < 0.15) & (pose_error.abs().amax(-1) < 0.25)
        figures = {
            "sit_down/lying": mean(lies.float(), there),
            "sit_down/pose_error": mean(pose_error.abs().mean(-1), there),
            "sit_down/failed": failed.float().mean() * self.max_episode_length,
        }
        return terms, failed, figures

    def _reset(self, mask: Tensor) -> None:
        super()._reset(mask)
        w = self.worlds
        put(self._height_at_start, mask, w.qpos[:, 2])
        put(self._pitch_at_start, mask, self._pitch())
        put(self._velocity_before, mask, w.qvel[:, :3])

"""How the toes move over the ground, in closed form over all worlds: what the paper's slip term looks at."""

from __future__ import annotations

import math

import numpy as np
import torch

from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import all_legs


class Feet:
    """Horizontal velocity of each toe and turning of each lower leg, from joint and base velocities."""

    def __init__(self, description: RobotDescription, device: str) -> None:
        legs = all_legs(description)
        self._origin, self._offset = (
            torch.as_tensor(np.array(rows), dtype=torch.float32, device=device)
            for rows in ([leg.origin for leg in legs], [leg.offset for leg in legs])
        )
        self._thigh = legs[0].thigh
        self._toe_x, _, self._toe_z = (float(v) for v in legs[0].toe)

    def motion(self, qpos: torch.Tensor, qvel: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return horizontal toe velocities (N, 4, 2) [m/s] and turning of the lower legs about the vertical (N, 4).

        Args:
            qpos: MuJoCo's positions (N, 19).
            qvel: MuJoCo's velocities (N, 18).
        """
        quat_WB, q, v_WB, omega_B, dq = qpos[:, 3:7], qpos[:, 7:], qvel[:, :3], qvel[:, 3:6], qvel[:, 6:]
        abad, hip, knee = (q[:, k::3] for k in range(3))
        d_abad, d_hip, d_knee = (dq[:, k::3] for k in range(3))
        bend, d_bend = hip + knee, d_hip + d_knee
        ca, sa = torch.cos(abad), torch.sin(abad)
        ch, sh, cb, sb = torch.cos(hip), torch.sin(hip), torch.cos(bend), torch.sin(bend)
        x = -self._thigh * sh + self._toe_x * cb + self._toe_z * sb
        z = -self._thigh * ch - self._toe_x * sb + self._toe_z * cb
        dx = -self._thigh * ch * d_hip + (-self._toe_x * sb + self._toe_z * cb) * d_bend
        dz = self._thigh * sh * d_hip + (-self._toe_x * cb - self._toe_z * sb) * d_bend
        across, up = self._offset * ca - z * sa, self._offset * sa + z * ca
        position = self._origin + torch.stack([x, across, up], -1)
        inside = torch.stack([dx, -up * d_abad - dz * sa, across * d_abad + dz * ca], -1)
        turning = omega_B[:, None, :].expand_as(position)
        velocity_B = torch.linalg.cross(turning, position) + inside
        w, x, y, z = (quat_WB[:, k] for k in range(4))
        rows = (  # of R_WB, each (N, 3)
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        )
        horizontal = [(rows[k][:, None, :] * velocity_B).sum(-1) + v_WB[:, k, None] for k in range(2)]
        shank = torch.stack(
            [omega_B[:, 0:1] + d_abad, omega_B[:, 1:2] + ca * d_bend, omega_B[:, 2:3] + sa * d_bend], -1
        )
        return torch.stack(horizontal, -1), (rows[2][:, None, :] * shank).sum(-1)


FASTEST = 4.0
"""More than this squared speed of one toe is not counted [m^2/s^2]."""


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

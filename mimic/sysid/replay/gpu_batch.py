"""Worlds of MuJoCo Warp of one machine, and what a replay writes into them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import mujoco
import mujoco_warp as mjw
import torch
import warp as wp

from mimic.dynamics.cuda_graphs import ReplayedWarp
from mimic.dynamics.servo import Servo
from mimic.records import FloatArray

STATIC = (
    "dof_damping",
    "dof_armature",
    "dof_invweight0",
    "body_mass",
    "body_inertia",
    "body_ipos",
    "body_iquat",
    "body_subtreemass",
)
"""Model fields that differ between parameter sets, and stay during a replay."""

DRIVEN = ("dof_frictionloss", "actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
"""Those that the law writes at every step."""


class WorldBatch:
    """So many worlds of a machine, and what is written into them."""

    def __init__(self, model: mujoco.MjModel, count: int, device: str) -> None:
        data = mujoco.MjData(model)
        with wp.ScopedDevice(device):
            self.model = mjw.put_model(model, batch_sizes=dict.fromkeys((*STATIC, *DRIVEN), count))
            self.model.opt.warn_overflow = 0
            self.data = mjw.put_data(model, data, nworld=count, nconmax=1, njmax=2 * model.nv)
            self.q, self.dq = wp.to_torch(self.data.qpos), wp.to_torch(self.data.qvel)
            self.servo = Servo(
                ctrl=wp.to_torch(self.data.ctrl),
                applied=wp.to_torch(self.data.qfrc_applied),
                gain=wp.to_torch(self.model.actuator_gainprm),
                bias=wp.to_torch(self.model.actuator_biasprm),
                limits=wp.to_torch(self.model.actuator_forcerange),
                friction=wp.to_torch(self.model.dof_frictionloss),
                needed=wp.to_torch(self.data.qfrc_bias),
            )
            self._warmstart = wp.to_torch(self.data.qacc_warmstart)
            self._static = {name: wp.to_torch(getattr(self.model, name)) for name in STATIC}
            self._gravity = torch.zeros(count, 3, device=device)
            self.model.opt.gravity = wp.from_torch(self._gravity, dtype=wp.vec3)
            wp.synchronize_device()  # all is there, whatever stream steps it first
        self.step = ReplayedWarp(partial(mjw.step, self.model, self.data), device)

    def begin(self, fields: Mapping[str, FloatArray], segments: int, q: torch.Tensor, dq: torch.Tensor) -> None:
        """Write the fields of each parameter set (N, ...) to its worlds, and put all into their first positions."""
        for name, values in fields.items():
            there = self._gravity if name == "opt.gravity" else self._static[name]
            rows = torch.as_tensor(values, dtype=there.dtype, device=there.device).repeat_interleave(segments, 0)
            there.copy_(rows.reshape(there.shape))
        self.q.copy_(q)
        self.dq.copy_(dq)
        self._warmstart.zero_()
        self.servo.needed.zero_()

"""Many randomised robots in MuJoCo Warp, stepped together; the same MJCF and actuator law as the simulation.

Each world keeps its own friction, masses, gains, slope and payload for the whole training; with thousands of worlds
that covers the ranges. Delay, start pose, pushes and the rest are drawn anew for every episode by the environment.

On a slope the ground stays level and gravity is inclined: ``slope_quat`` turns the axes of the ground into those of the
true world, whose z is up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from mimic.config.play import Randomisation
from mimic.config.training import UNDISTURBED, MdpSettings
from mimic.dynamics.machine import SOLREF_STEPS
from mimic.dynamics.robot_model import bouncing, carry, draw_variation, load_model, vary_model
from mimic.dynamics.servo import Servo, read_standing
from mimic.records import LEGS
from mimic.robot.description import RobotDescription
from mimic.robot.model import BASE, FLOOR, TOES
from mimic.train.cuda_graphs import Replayed, ReplayedWarp
from mimic.train.motors import WorldMotors
from mimic.train.tensors import quat_apply_inverse

RANDOMISED = (
    "dof_frictionloss",
    "dof_damping",
    "geom_friction",
    "geom_solref",
    "actuator_gainprm",
    "actuator_forcerange",
    "body_mass",
    "body_inertia",
    "body_ipos",
    "body_iquat",
    "body_subtreemass",
    "body_invweight0",
    "dof_invweight0",
)
"""Model fields that differ from world to world."""

DRIVEN = ("dof_armature",)
"""… and what else, where a law drives the joints."""

_KINDS = mujoco.mjtGeom
BOX = int(_KINDS.mjGEOM_BOX)
CYLINDER = int(_KINDS.mjGEOM_CYLINDER)
CAPSULE = int(_KINDS.mjGEOM_CAPSULE)

QUIET_ROBOT = Randomisation(com=(-0.015, 0.015))
"""The robots of quiet worlds."""

LINE_SEARCHES = 20
"""Line-search iterations of the training physics; see MdpSettings.solver_iterations."""

CONTACTS = 8
"""Most contacts of a world on average, since all worlds share one store; robots that lie have 4."""

SPARE_CONTACTS = 64
"""Room beyond that, which few worlds do not keep."""

ROWS = 64
"""Most constraint rows of a world; the most seen with wild random actions is 60, lying 32."""

VARIANTS = 1024
"""Different robots; world i is variant i modulo this."""


@wp.kernel
def _smooth_friction(  # type: ignore[no-untyped-def]
    qvel: wp.array2d(dtype=float),  # type: ignore[valid-type]
    friction: wp.array2d(dtype=float),  # type: ignore[valid-type]
    damping: wp.array2d(dtype=float),  # type: ignore[valid-type]
    speed: float,
    total: wp.array2d(dtype=float),  # type: ignore[valid-type]
):
    """Write the damping with which a joint's viscous torque is that of its dry friction too, at its speed of now."""
    world, dof = wp.tid()  # type: ignore[misc]
    total[world, dof] = damping[world, dof] + friction[world, dof] / (wp.abs(qvel[world, dof]) + speed)  # type: ignore[operator]


class Worlds:
    """The physics of all worlds; its tensors are views of Warp's memory, written in place."""

    def __init__(self, description: RobotDescription, settings: MdpSettings, device: str, seed: int) -> None:
        wp.config.log_level = wp.LOG_ERROR
        wp.init()
        self.device = device
        self._description = description
        self.decimation = description.decimation
        effects = read_standing(Path(settings.effects)) if settings.effects else None
        n = settings.worlds
        count = min(settings.worlds, VARIANTS)
        self.motors = None if effects is None else WorldMotors(description, effects, n, device, count, seed)
        """The law of the drives, where a calibration's effects take the place of the native motors."""
        model = self._training_model(settings)
        self.mj_model = model
        data = mujoco.MjData(model)
        data.qpos[:7] = 0.0, 0.0, description.pose_height["lie"], 1.0, 0.0, 0.0, 0.0
        data.qpos[7:] = data.ctrl[:] = description.poses["lie"]
        mujoco.mj_forward(model, data)
        with wp.ScopedDevice(device):
            fields = RANDOMISED if self.motors is None else (*RANDOMISED, *DRIVEN)
            self.model = mjw.put_model(model, batch_sizes=dict.fromkeys(fields, n))
            self.model.opt.warn_overflow = 0
            contacts = CONTACTS + math.ceil(SPARE_CONTACTS / n)
            self.data = mjw.put_data(model, data, nworld=n, nconmax=contacts, njmax=ROWS)
            self._randomise(description, settings, count, seed, fields)
            self._own_damping = wp.clone(self.model.dof_damping)
            self._view()
        self.substep_ctrl = torch.zeros(self.decimation, n, 12, device=device)
        self._substep_ctrl: list[Any] = [wp.from_torch(self.substep_ctrl[k]) for k in range(self.decimation)]
        self._find_shapes()
        self._parts = self._step_parts()
        """What a control step is made of; with effects the law and the physics take turns."""

    def _training_model(self, settings: MdpSettings) -> mujoco.MjModel:
        """Return the robot's model with the time step and the solver of the training."""
        model = load_model(self._description, visuals=False, driven=self.motors is not None)
        model.opt.timestep = self._description.timestep
        if self.motors is not None:
            model.dof_solref[6:] = [SOLREF_STEPS * self._description.timestep, 1.0]
        model.opt.iterations = settings.solver_iterations
        model.opt.ls_iterations = LINE_SEARCHES
        self._friction_speed = settings.friction_speed if self.motors is None else 0.0
        if self._friction_speed:
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
        return model

    def _view(self) -> None:
        """Keep tensors of what is read and written in every control step."""
        model = self.mj_model
        data = self.data
        self.qpos = wp.to_torch(data.qpos)
        self.qvel = wp.to_torch(data.qvel)
        self.warmstart = wp.to_torch(data.qacc_warmstart)
        self.actuator_force = wp.to_torch(data.actuator_force)
        self.site_xpos = wp.to_torch(data.site_xpos)
        self.geom_xpos = wp.to_torch(data.geom_xpos)
        self.geom_xmat = wp.to_torch(data.geom_xmat)
        self.xipos = wp.to_torch(data.xipos)
        self.com = wp.to_torch(data.subtree_com)[:, model.body(BASE).id]
        self._cvel = wp.to_torch(data.cvel)  # turning and velocity, at the centre of mass
        self.xfrc_applied = wp.to_torch(data.xfrc_applied)
        c = data.contact
        contacts = (data.nacon, c.geom, c.worldid, c.efc_address, data.efc.force)
        self._contacts = tuple(wp.to_torch(array) for array in contacts)
        gravity = abs(float(model.opt.gravity[2]))
        self.weight = gravity * wp.to_torch(self.model.body_subtreemass)[:, model.body(BASE).id]
        """Of each robot (N,) [N]."""

    def _find_shapes(self) -> None:
        """Keep which sites and collision shapes of the model are what."""
        model = self.mj_model
        feet = np.zeros((2, model.ngeom), dtype=np.float32)
        for side, leg in enumerate(LEGS[2:]):
            names = self._description.names.shapes("toe", "shank", legs=(leg,))
            feet[side, [model.geom(name).id for name in names]] = 1
        self._feet = torch.as_tensor(feet, device=self.device)
        self._toe_sites = torch.tensor([model.site(name).id for name in TOES], device=self.device)
        self._toe_bodies = torch.tensor([model.site(name).bodyid.item() for name in TOES], device=self.device)
        ids = [g for g in range(model.ngeom) if model.geom(g).name != FLOOR]
        self._shapes = [model.geom(g).name for g in ids]
        self._geoms = torch.tensor(ids, device=self.device)
        self._kinds = torch.tensor([int(model.geom_type[g]) for g in ids], device=self.device)
        self._sizes = torch.tensor(model.geom_size[ids], dtype=torch.float32, device=self.device)

    def _step_parts(self) -> list[Replayed | ReplayedWarp]:
        if self.motors is None:
            return [ReplayedWarp(self._run, self.device)]
        physics = ReplayedWarp(partial(mjw.step, self.model, self.data), self.device)
        drives = [Replayed(partial(self._drive, k), self.device) for k in range(self.decimation + 1)]
        between = [part for drive in drives[:-1] for part in (drive, physics)]
        return [*between, drives[-1], ReplayedWarp(self.see, self.device)]

    def _randomise(
        self, description: RobotDescription, settings: MdpSettings, count: int, seed: int, names: Sequence[str]
    ) -> None:
        n = settings.worlds
        d = settings.disturbances
        rng, other = (np.random.default_rng([seed, stream]) for stream in (17, 18))
        calm = replace(UNDISTURBED, contact_time=d.contact_time, friction_ratio=d.friction_ratio)
        quiet = round(settings.quiet_share * count) if settings.task == "stand_track" else 0
        driven = self.motors is not None
        nominal, varied = (load_model(description, visuals=False, driven=driven) for _ in range(2))
        rows: dict[str, list[np.ndarray]] = {name: [] for name in names}
        features = []
        slopes = []
        variations = []
        grounds = []
        ratios = []
        for i in range(count):
            d = calm if i < quiet else settings.disturbances
            ranges = QUIET_ROBOT if i < quiet else settings.randomisation
            v = draw_variation(ranges, description.timestep, rng)
            v = replace(v, kp=v.kp * other.uniform(*d.kp), kd=v.kd * other.uniform(*d.kd))
            v = replace(v, torque=other.uniform(*d.torque), speed=other.uniform(*d.speed))
            vary_model(varied, nominal, v)
            if self.motors is not None:
                self.motors.write_static(varied, i)
            variations.append(v)
            side = int(other.integers(2))
            payload = other.uniform(*d.toe_payload)
            carry(varied, f"{LEGS[side]}_knee", payload, description.leg.toe)
            ratios.append(math.exp(other.uniform(*np.log(d.friction_ratio))))
            grounds.append((v.restitution, other.uniform(*d.contact_time)))
            angle = other.uniform(-np.pi, np.pi)
            half = np.deg2rad(other.uniform(*d.slope)) / 2
            slopes.append([np.cos(half), np.sin(half) * np.cos(angle), np.sin(half) * np.sin(angle), 0.0])
            for name in names:
                rows[name].append(np.array(getattr(varied, name)))
            kp = v.kp.mean() - 1
            kd = v.kd.mean() - 1
            rubs = 0.5 * v.dry_friction.mean()
            carried = [10 * payload * (side == k) for k in range(2)]
            features.append(
                [v.ground_friction - 1.5, v.restitution, v.base_mass, kp, kd, *(10 * v.com), rubs, *carried]
            )
        index = np.arange(n) % count
        for name, values in rows.items():
            tensor = wp.to_torch(getattr(self.model, name))
            tensor.copy_(torch.as_tensor(np.stack(values)[index], dtype=tensor.dtype).reshape(tensor.shape))
        if self.motors is not None:
            m = self.model
            d = self.data
            servo = Servo(
                ctrl=wp.to_torch(d.ctrl),
                applied=wp.to_torch(d.qfrc_applied)[:, 6:],
                inertia=wp.to_torch(m.dof_armature)[:, 6:],
                friction=wp.to_torch(m.dof_frictionloss)[:, 6:],
                needed=wp.to_torch(d.qfrc_bias)[:, 6:],
            )
            self.motors.fit(variations, index, servo, settings.randomisation.delay[1])
        self.quiet = torch.as_tensor(index < quiet, device=self.device)
        """True for the worlds of MdpSettings.quiet_share (N,)."""
        self._gains = wp.to_torch(self.model.actuator_gainprm)
        self._own_gains = self._gains.clone()
        self._solref = wp.to_torch(self.model.geom_solref)
        self._grounds = grounds
        self._ground_of = torch.as_tensor(index, device=self.device)
        self._ratio = torch.tensor(ratios, device=self.device)[self._ground_of]
        self._stiffer = torch.ones_like(self._ratio)
        self.model.opt.impratio_invsqrt = wp.from_torch(self._stiffer)
        self._floor = nominal.geom(FLOOR).id
        self._contact_time = float(nominal.geom_solref[self._floor, 0])
        usual = torch.as_tensor(nominal.actuator_gainprm, dtype=torch.float32, device=self.device)
        self._usual_gains = usual.expand_as(self._gains)
        self.features = torch.as_tensor(np.array(features, dtype=np.float32)[index], device=self.device)
        self._own_slope = torch.as_tensor(np.array(slopes, dtype=np.float32)[index], device=self.device)
        self.slope_quat = self._own_slope.clone()
        self._level = torch.tensor(self.mj_model.opt.gravity, dtype=torch.float32, device=self.device).expand(n, 3)
        self._gravity = self._level.clone()  # Warp's array is a view of it
        self.model.opt.gravity = wp.from_torch(self._gravity, dtype=wp.vec3)
        self.set_share(1.0)

    def set_share(self, share: float) -> None:
        """Give each world this share of its own gains, slope and ground, and the usual ones for the rest."""
        time = self._contact_time
        grounds = [bouncing((1 + share * (slower - 1)) * time, share * bounce) for bounce, slower in self._grounds]
        solref = torch.tensor(grounds, device=self.device)
        self._solref[:, self._floor] = solref[self._ground_of]
        self._stiffer.copy_(self._ratio**-0.5)
        if self.motors is None:
            self._gains.copy_(self._usual_gains + share * (self._own_gains - self._usual_gains))
        else:
            self.motors.set_share(share)
        level = torch.tensor([1.0, 0.0, 0.0, 0.0], device=self.device)
        mixed = level + share * (self._own_slope - level)
        self.slope_quat.copy_(mixed / mixed.norm(dim=-1, keepdim=True))
        self._gravity.copy_(quat_apply_inverse(self.slope_quat, self._level))

    @property
    def motor_torque(self) -> Tensor:
        """Torque that each motor gives (N, 12) [N m]."""
        return self.actuator_force if self.motors is None else self.motors.tau

    @property
    def read_q(self) -> Tensor:
        """Joint positions as the encoders read them (N, 12) [rad]."""
        q = self.qpos[:, 7:]
        return q if self.motors is None else self.motors.reading(q)

    def columns(self, *roles: str, legs: Sequence[str] = LEGS) -> Tensor:
        """Return the columns of `lowest` of the collision shapes with these roles (mimic.robot.parts.ROLES)."""
        wanted = self._description.names.shapes(*roles, legs=legs)
        found = [i for i, name in enumerate(self._shapes) if name in wanted]
        return torch.tensor(found, dtype=torch.long, device=self.device)

    def lowest(self) -> Tensor:
        """Return the height of the lowest point of each collision shape (worlds, shapes) [m]."""
        up = self.geom_xmat[:, self._geoms, 2, :]
        size = self._sizes
        box = (up.abs() * size).sum(-1)
        round_ = size[:, 1] * up[..., 2].abs() + size[:, 0] * torch.sqrt(torch.clamp(1 - up[..., 2] ** 2, min=0.0))
        capsule = size[:, 1] * up[..., 2].abs() + size[:, 0]
        drop = torch.where(self._kinds == BOX, box, size[:, 0])
        drop = torch.where(self._kinds == CYLINDER, round_, drop)
        drop = torch.where(self._kinds == CAPSULE, capsule, drop)
        return self.geom_xpos[:, self._geoms, 2] - drop

    @property
    def toes(self) -> Tensor:
        """Positions of the toes in the order of LEGS, world axes (N, 4, 3) [m]."""
        return self.site_xpos[:, self._toe_sites]

    def toe_motion(self) -> tuple[Tensor, Tensor]:
        """Return horizontal toe velocities (N, 4, 2) [m/s] and turning of the lower legs about the vertical (N, 4)."""
        turning, velocity = torch.nan_to_num(self._cvel[:, self._toe_bodies]).split(3, -1)
        velocity = velocity + torch.linalg.cross(turning, self.toes - self.com[:, None])
        return velocity[..., :2], turning[..., 2]

    def load(self) -> Tensor:
        """Return the share of its weight on each robot's left and right hind foot (N, 2), in the last physics step."""
        count, geom, world, row, force = self._contacts
        row = row[:, 0]
        world = world.long().clamp(0, len(force) - 1)
        counts = (torch.arange(len(row), device=self.device) < count) & (row >= 0) & (row < force.shape[1])
        normal = force[world, row.long().clamp(0, force.shape[1] - 1)] * counts  # of elliptic cones
        under = self._feet[:, geom.long().clamp(0, self._feet.shape[1] - 1)].amax(-1)
        newtons = torch.zeros_like(self.weight).repeat(2, 1).index_add_(1, world, normal * under)
        return newtons.T / self.weight[:, None]

    def _run(self) -> None:
        for k in range(self.decimation):
            wp.copy(self.data.ctrl, self._substep_ctrl[k])
            if self._friction_speed:
                self._rub()
            mjw.step(self.model, self.data)
        self.see()

    def see(self) -> None:
        """Bring what is seen of the bodies to the positions and velocities after the last physics step."""
        for update in (mjw.kinematics, mjw.com_pos, mjw.com_vel):
            update(self.model, self.data)

    def _rub(self) -> None:
        """Set the damping of all joints so that it holds their dry friction."""
        m = self.model
        d = self.data
        inputs = [d.qvel, m.dof_frictionloss, self._own_damping, self._friction_speed]
        wp.launch(_smooth_friction, dim=d.qvel.shape, inputs=inputs, outputs=[m.dof_damping])

    def step(self) -> None:
        """Advance all worlds by a control step.

        The commands are in ``substep_ctrl`` (decimation, worlds, 12) [rad], with effects in the motors.
        """
        for part in self._parts:
            part()

    def _drive(self, substep: int) -> None:
        """Finish the physics step just made, and hand over the inputs of the next one, if there is one."""
        assert self.motors is not None
        q = self.qpos[:, 7:]
        dq = self.qvel[:, 6:]
        if substep > 0:
            self.motors.settle(dq)
        if substep < self.decimation:
            self.motors.drive(q, dq, substep)

"""Replays in MuJoCo Warp: every segment of every parameter set is a world, all stepped together on a GPU.

The law of the drives is that of the other replays, in PyTorch and in double precision; the physics is in single
precision, which moves a position by less than a microradian. Nothing leaves the device between the first step and the
last. Longer than 350 lines: one class, whose methods share what is on the device.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from mujoco.batch import Batch

from mimic.dynamics.cuda_graphs import Replayed, ReplayedWarp
from mimic.dynamics.law import Drives, Law, Parameters
from mimic.dynamics.machine import MachineModel
from mimic.dynamics.servo import Servo, static_fields, target_shift
from mimic.errors import ConfigError
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray
from mimic.sysid.logs import Part
from mimic.sysid.replay import Job, Prediction, Replay, Targets, acting
from mimic.sysid.timing import SendingTimes

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


T = TypeVar("T")
Values = dict[tuple[str, str], FloatArray]
Turns = Generator[None, None, T]
"""Gives others a turn between two steps, returns what was asked for."""

MOST_WORLDS = 65536
"""Worlds stepped together."""

MEMORY = 0.25
"""Share of the free memory of a GPU that the positions of a replay may take."""

SEGMENT, FINE_SEGMENT = 0.8, 0.2
"""Length of a segment [s], and that of a replay in fine steps: the time of a replay goes with its steps, hardly with
its worlds.
"""

TURN = 8
"""Steps that are begun before another replay that runs side by side has its turn."""

HOST = 256
"""Parameter sets whose masses are worked out together."""

RESIDUALS = 64
"""Parameter sets whose residuals are worked out together."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Outside:
    """What comes from outside during a replay, at each physics step."""

    targets: Targets
    """Tensors (V, ...)."""
    target_of: torch.Tensor
    """Which targets each world has (n,)."""
    forces: torch.Tensor | None
    """Put in by all drives (steps, J)."""


class WorldReplay(Replay):
    """Replays of one log in one model, on the worlds of a device."""

    longest_fine = FINE_SEGMENT
    shorter_is_faster = False

    def __init__(
        self,
        machine: MachineModel,
        log: JointLog,
        *,
        device: str = "cuda",
        timestep: float = 0.001,
        segment: float = SEGMENT,
        threads: int = 0,
        torque: bool = False,
        sending: SendingTimes | None = None,
        parts: Sequence[Part] = (),
    ) -> None:
        """Cut the log into segments (see `mimic.sysid.replay.cpu.Replay`).

        Args:
            machine: The model, with the gains of the log.
            log: Readings of the machine's joints, in its order.
            device: ``cuda``, ``cuda:1``, …; ``cpu`` steps worlds on the processor, slowly, for tests.
            timestep: Physics step [s].
            segment: Length of a segment [s].
            threads: For what is worked out on the processor; 0 takes one for each core.
            torque: Also predict the torque.
            sending: When targets were sent.
            parts: Logs that this one is made of: one, whose drives were never off.

        Raises:
            ConfigError: If there is no such device.
        """
        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigError(f"device is {device}, but PyTorch sees no GPU; use --device cpu or install a CUDA build")
        super().__init__(
            machine,
            log,
            timestep=timestep,
            segment=segment,
            threads=threads,
            torque=torque,
            sending=sending,
            parts=parts,
        )
        if len(self.parts) > 1 or self._most is not None or any(part.payload.any() for part in self.parts):
            raise ConfigError(
                f"device is {device}, which replays one log without payload whose drives stay on; use --device cpu"
            )
        if ":" in device:
            torch.cuda.set_device(device)  # streams and graphs are those of the current device
        wp.config.log_level = wp.LOG_ERROR
        wp.init()
        self._device, self._elsewhere = device, {"device": device}
        self._together = self._room()
        d = machine.drives
        names = ("kp", "kd", "torque", "flat", "speed", "friction", "armature")
        rows = {name: self._tensor(getattr(d, name)) for name in names}
        self._drives = Drives(**rows, neighbour=self._tensor(d.neighbour, torch.int64))
        self._worlds: dict[tuple[int, int], WorldBatch] = {}
        self._hosts: dict[int, Batch] = {}
        self._streams: list[torch.cuda.Stream] = []
        r = self.readings
        self._at = tuple(self._tensor(x, torch.int64) for x in (r.segment, r.step, r.since))
        self._share = self._tensor(r.part)[:, None, None]
        self._measured = self._tensor(log.q[r.row])[:, None]
        self._uploaded: tuple[Targets, Targets] | None = None

    def _tensor(self, values: object, dtype: torch.dtype = torch.float64) -> torch.Tensor:
        return torch.as_tensor(np.asarray(values), dtype=dtype, device=self._device)

    @property
    def sets_per_batch(self) -> int:
        """How many parameter sets are best replayed at once: a power of two."""
        return self._together

    def _room(self) -> int:
        most = MOST_WORLDS // self.segments
        if self._device.startswith("cuda"):
            row = 4 * (self.length + 1) * len(self.machine.joints) * self.segments * (6 if self.torque else 2)
            most = min(most, int(MEMORY * torch.cuda.mem_get_info(self._device)[0]) // row)
        return 1 << max(most.bit_length() - 1, 0)

    # ------------------------------------------------------------------ running

    def side_by_side(self, jobs: Sequence[Job]) -> list[Prediction]:
        """Return the predictions of several replays, on a GPU each on a stream of its own.

        The steps of a few worlds are many short kernels one after another, which leave a GPU nearly idle.
        """
        if len(jobs) == 1:
            return super().side_by_side(jobs)
        running: dict[int, Turns[Prediction]] = {}
        for lane, job in enumerate(jobs):
            assert isinstance(job.replay, WorldReplay)
            running[lane] = job.replay._running(job, lane)
        found: dict[int, Prediction] = {}
        while running:
            for lane, turns in list(running.items()):
                with self._stream(lane):
                    try:
                        next(turns)
                    except StopIteration as end:
                        found[lane] = end.value
                        del running[lane]
        return [found[lane] for lane in range(len(jobs))]

    def _stream(self, lane: int) -> AbstractContextManager[object]:
        if not self._device.startswith("cuda"):
            return nullcontext()
        while len(self._streams) <= lane:
            self._streams.append(torch.cuda.Stream(self._device))
        return torch.cuda.stream(self._streams[lane])

    def _running(self, job: Job, lane: int) -> Turns[Prediction]:
        parts = []
        for parameters, targets in self._parts(job.parameters, job.count, None):
            parts.append((yield from self._predicting(parameters, targets, lane=lane)))
        return self._joined(parts, job.count)

    def _run(self, parameters: Values, targets: Targets, square: bool = False) -> Prediction:
        return _ended(self._predicting(parameters, targets, square))

    def _predicting(
        self, parameters: Values, targets: Targets, square: bool = False, lane: int = 0
    ) -> Turns[Prediction]:
        sets = _count(parameters)
        path, torques = yield from self._simulate(parameters, targets, self.torque or square, lane)
        made = np.full((sets, len(self.log.t), len(self.machine.joints)), np.nan, dtype=np.float32)
        torque = np.full_like(made, np.nan) if torques is not None else None
        for begin in range(0, sets, RESIDUALS):
            some = slice(begin, min(begin + RESIDUALS, sets))
            self._put(made[some], self._residual(path[:, some]))
            if torque is not None and torques is not None:
                self._put(torque[some], self._torque_residual(torques[:, some], square))
        return Prediction(residual=made, torque_residual=torque)

    def _squares(self, parameters: Values, rows: BoolArray, noise: FloatArray) -> FloatArray:
        sets = _count(parameters)
        path, _ = _ended(self._simulate(parameters, self._grid, False))
        weight = self._tensor(rows[self.readings.row])[:, None, None] / self._tensor(noise) ** 2
        found = []
        for begin in range(0, sets, RESIDUALS):
            residual = self._residual(path[:, begin : min(begin + RESIDUALS, sets)])
            found.append((residual**2 * weight).sum(0))
        squares = torch.cat(found).cpu().numpy()
        return np.where(np.isfinite(squares), squares, np.inf)

    def _put(self, out: FloatArray, residual: torch.Tensor) -> None:
        """Write residuals (R, N, J) to the rows of the log (N, T, J), NaN where the simulation blew up."""
        values = residual.to(torch.float32).transpose(0, 1).cpu().numpy()
        out[:, self.readings.row] = np.where(np.isfinite(values), values, np.nan)

    def _residual(self, path: torch.Tensor) -> torch.Tensor:
        """Return the position residuals (R, N, J) of positions (steps + 1, N, segments, J)."""
        segment, step, _ = self._at
        before, after = path[step.clamp(min=0), :, segment], path[step + 1, :, segment]
        return self._measured - (before * (1 - self._share) + after * self._share)

    def _torque_residual(self, torques: torch.Tensor, square: bool) -> torch.Tensor:
        """Return measured - predicted torque of each reading (R, N, J), from torques (steps, N, segments, J).

        With ``square`` minus the mean of their squares.
        """
        torques = torques**2 if square else torques
        segment, step, since = self._at
        total = torch.cumsum(torques, 0, dtype=torch.float64)
        begun = torch.where((since > 0)[:, None, None], total[(since - 1).clamp(min=0), :, segment], 0.0)
        mean = (total[step.clamp(min=0), :, segment] - begun) / (step + 1 - since).clamp(min=1)[:, None, None]
        mean = torch.where((since > 0)[:, None, None], mean, torques[step.clamp(min=0), :, segment].double())
        measured = 0.0 if square or self.log.tau is None else self._tensor(self.log.tau[self.readings.row])[:, None]
        residual = measured - mean
        return torch.where((step >= 0)[:, None, None], residual, 0.0)

    def _simulate(
        self, parameters: Values, targets: Targets, torque: bool, lane: int = 0
    ) -> Turns[tuple[torch.Tensor, torch.Tensor | None]]:
        """Return positions (steps + 1, N, segments, J) and torques (steps, N, segments, J) of N or more parameter sets.

        What runs at the same time has another ``lane``, and worlds of its own.
        """
        segments, joints, sets = self.segments, len(self.machine.joints), _count(parameters)
        padded = 1 << (sets - 1).bit_length()  # few sizes, so that few are captured
        index = np.minimum(np.arange(padded), sets - 1)
        p = {key: value[index] for key, value in parameters.items()}
        n = padded * segments
        law = Law(
            self._drives,
            {key: self._tensor(value).repeat_interleave(segments, 0) for key, value in p.items()},
            self.dt,
            (n, joints),
            torch,
        )
        if (n, lane) not in self._worlds:
            self._worlds[n, lane] = WorldBatch(self._model(), n, self._device)
        worlds = self._worlds[n, lane]
        q, dq = (self._tensor(np.tile(x, (padded, 1))) for x in self._starts(self._begin))
        heat = self._heat_at(p)
        law.reset(q, dq, None if heat is None else self._tensor(heat))
        worlds.begin(self._fields(p), segments, law.unread(q), dq)
        law.needed = worlds.servo.needed
        path = torch.zeros(self.length + 1, n, joints, device=self._device)
        torques = torch.zeros(self.length, n, joints, device=self._device) if torque else None
        path[0] = law.reading(worlds.q)
        forces = None if self._force is None else self._tensor(self._force)
        there = self._on_device(targets)
        outside = _Outside(
            targets=there,
            target_of=self._tensor(np.repeat(index % len(there.held), segments), torch.int64),
            forces=forces,
        )
        yield from self._go(law, worlds, outside, target_shift(p, self.dt), path, torques)
        shape = (padded, segments, joints)
        return path.view(-1, *shape), None if torques is None else torques.view(-1, *shape)

    def _go(
        self,
        law: Law,
        worlds: WorldBatch,
        outside: _Outside,
        shift: FloatArray,
        path: torch.Tensor,
        torques: torch.Tensor | None,
    ) -> Turns[None]:
        """Let law and physics take turns; on a GPU each is a captured graph. Yields between two steps."""
        held, begun, which = outside.targets.held, outside.targets.begun, outside.target_of[:, None]
        begin = self._tensor(np.tile(self._begin, len(which) // self.segments), torch.int64)
        late = self._tensor(shift).expand(len(which) // self.segments, -1).repeat_interleave(self.segments, 0)
        whole = torch.floor(late)
        part, whole = late - whole, whole.to(torch.int64)
        column = torch.arange(held.shape[2], device=self._device)[None]
        k = torch.zeros(1, dtype=torch.int64, device=self._device)
        kept = dict(law.states)  # where captured steps read them

        def keep() -> None:
            for name, buffer in kept.items():
                if law.states[name] is not buffer:
                    law.states[name] = buffer.copy_(law.states[name])

        def drive() -> None:
            now = begin + k
            rows = [(now[:, None] - whole - back).clamp(0, held.shape[1] - 1) for back in (2, 1, 0)]
            before, older, newer = (held[which, row, column] for row in rows)
            target, shares = acting(before, older, newer, (begun[which, rows[1]], begun[which, rows[2]]), part, torch)
            force = None if outside.forces is None else outside.forces[now.clamp(max=self.total - 1)]
            time = now[:, None].double() * self.dt
            inputs = law.step(worlds.q, worlds.dq, target, time, force, shares)
            worlds.servo.write(inputs)
            if torques is not None:
                torques.index_copy_(0, k, inputs.tau[None].to(torques.dtype))
            keep()

        def finish() -> None:
            law.settle(worlds.dq)
            keep()
            k.add_(1)
            path.index_copy_(0, k, law.reading(worlds.q)[None].to(path.dtype))

        def between() -> None:
            finish()
            drive()

        turn = Replayed(between, self._device)
        drive()
        for step in range(self.length - 1):
            worlds.step()
            turn()
            if step % TURN == 0:
                yield
        worlds.step()
        finish()

    def _on_device(self, targets: Targets) -> Targets:
        """Return targets as tensors (V, ...); those of the log are kept."""
        if targets is self._grid and self._uploaded is not None and self._uploaded[0] is targets:
            return self._uploaded[1]
        one = targets if targets.held.ndim > 2 else Targets.stacked([targets])
        there = Targets(held=self._tensor(one.held), begun=self._tensor(one.begun))
        if targets is self._grid:
            self._uploaded = (targets, there)
        return there

    def _fields(self, p: Parameters) -> dict[str, FloatArray]:
        """Return the model fields of each parameter set (N, ...), worked out by MuJoCo on the processor."""
        count, names = _count(p), (*STATIC, "opt.gravity")
        size = min(count, HOST)
        if size not in self._hosts:
            self._hosts[size] = Batch(self._model(), size, self.threads)
        batch, found = self._hosts[size], {name: [] for name in names}
        for begin in range(0, count, size):  # both are powers of two
            some = {key: value[begin : begin + size] for key, value in p.items()}
            law = Law(self.machine.drives, some, self.dt, (size, len(self.machine.joints)), np)
            static_fields(batch, self.machine, law, some)
            for name in names:
                values = batch.expanded(name)
                if values is None:
                    values = np.repeat(np.asarray(getattr(self.machine.model, name))[None], size, 0)
                found[name].append(np.array(values))
        return {name: np.concatenate(values) for name, values in found.items()}


def _ended(turns: Turns[T]) -> T:
    """Return what a replay returns once all its steps are made."""
    while True:
        try:
            next(turns)
        except StopIteration as end:
            return end.value


def _count(parameters: Parameters) -> int:
    return len(next(iter(parameters.values())))

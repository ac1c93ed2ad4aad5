"""Motors of the training worlds as a calibration found them: the law of every other flow, in PyTorch on the device.

Everything that changes from step to step is in tensors that stay where they are, so that a step can be captured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields

import mujoco
import numpy as np
import torch
from torch import Tensor

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.law import Drives, Law
from mimic.dynamics.machine import MachineModel, hung_robot
from mimic.dynamics.robot_model import Variation
from mimic.dynamics.servo import (
    Servo,
    moving_targets,
    parameters_of,
    shares_in_effect,
    static_model,
    target_in_effect,
    target_shift,
)
from mimic.records import FloatArray, IntArray
from mimic.robot.description import RobotDescription
from mimic.train.tensors import Chance, put

MARGIN = 0.1
"""Where a value has no interval, worlds are drawn within this share of it."""


def drawn_parameters(
    effects: EffectSet, machine: MachineModel, count: int, rng: np.random.Generator
) -> dict[tuple[str, str], FloatArray]:
    """Return ``count`` machines around the calibrated one: (count, J), or (count, 1) for the whole machine.

    Uniform over the 95 % interval of each value, or within MARGIN of it where it has none; inside the catalogue's
    bounds.
    """
    found: dict[tuple[str, str], FloatArray] = {}
    for (name, parameter), row in parameters_of(effects, machine).items():
        e = next(e for e in effects.applied if e.name == name)
        spec = CATALOGUE[name].parameter(parameter)
        low = row[0].copy()
        high = row[0].copy()
        if parameter in e.values and not spec.fixed:
            at = [machine.joints.index(j) for j in e.joints] if e.joints else [0]
            value = np.asarray(e.values[parameter])
            around = np.stack([value - MARGIN * np.abs(value), value + MARGIN * np.abs(value)], -1)
            ends = np.clip(e.intervals.get(parameter, around), spec.low, spec.high)
            low[at] = ends[:, 0]
            high[at] = ends[:, 1]
        found[name, parameter] = rng.uniform(low, high, (count, len(low)))
    return found


class WorldMotors(Chance):
    """The drives of all worlds, from the command as it is sent to the force at the joint.

    What the effects declare, such as friction or the delay, replaces what training draws; gains are multiplied.
    """

    def __init__(
        self, description: RobotDescription, effects: EffectSet, worlds: int, device: str, robots: int, seed: int
    ) -> None:
        """Draw the robots.

        Args:
            description: The robot, at the physics step of the worlds.
            effects: What a calibration found.
            worlds: Their number.
            device: Where the tensors are.
            robots: Number of different ones.
            seed: Of their effects.

        Raises:
            ConfigError: If an effect names an unknown joint.
        """
        super().__init__(worlds, device)
        self._d = description
        self._machine = hung_robot(description)
        self._p = drawn_parameters(effects, self._machine, robots, np.random.default_rng([seed, 19]))
        self.time = self._zeros(1)
        """Since the beginning of each world's episode, at the start of the control step (N, 1) [s]."""
        self.tau = self._zeros(12)
        """Torque of each motor at the start of the last physics step (N, 12) [N m]."""

    def write_static(self, model: mujoco.MjModel, i: int) -> None:
        """Write what the effects of robot i change once into its model."""
        static_model(model, self._machine, {key: value[i : i + 1] for key, value in self._p.items()})

    def fit(self, variations: Sequence[Variation], index: IntArray, servo: Servo, latest: float) -> None:
        """Put the motors in; world i has robot index[i] (N,); no drawn delay is longer than ``latest`` [s]."""
        h = self._d.timestep
        count = len(variations)
        shift = np.broadcast_to(target_shift(self._p, h), (count, 12))
        self._delayed = ("delay", "time") in self._p
        spread = self._p.get(("delay_jitter", "spread"), np.zeros((count, 1))) / h
        most = shift.max() + spread.max() + (0.0 if self._delayed else latest / h)
        kept = max(math.ceil(most / self._d.decimation), 1) + 2  # one to move from
        p = {key: self._tensor(value[index]) for key, value in self._p.items() if not CATALOGUE[key[0]].random}
        self._shift = self._tensor(shift[index])
        self._spread = self._tensor(spread[index])
        self._lost = self._tensor(self._p.get(("lost_commands", "share"), np.zeros((count, 1)))[index])
        self._targets = [self._zeros(12) for _ in range(kept)]
        self._late = [self._zeros(1) for _ in range(kept)]
        self._shifts = [self._zeros(12) for _ in range(kept)]
        drives = self._machine.drives
        usual_kp = self._tensor(drives.kp)
        usual_kd = self._tensor(drives.kd)
        factor_kp = self._tensor(np.array([v.kp for v in variations])[index])
        factor_kd = self._tensor(np.array([v.kd for v in variations])[index])
        self._usual = usual_kp, usual_kd
        self._own = usual_kp * factor_kp, usual_kd * factor_kd
        dry = drives.friction * np.array([v.dry_friction for v in variations])
        p.setdefault(("coulomb", "level"), self._tensor(dry[index]))
        given = {f.name: getattr(drives, f.name) for f in fields(Drives) if f.name != "neighbour"}
        rows = {name: self._tensor(value) for name, value in given.items() if value is not None}
        neighbour = torch.as_tensor(np.asarray(drives.neighbour), device=self._device)
        self._law = Law(Drives(**rows, neighbour=neighbour), p, h, (self._n, 12), torch)
        self._states = dict(self._law.states)
        self._servo = servo
        self._law.needed = servo.needed
        self.set_share(1.0)

    def set_share(self, share: float) -> None:
        """Give each world this share of its own gains, and the usual ones for the rest."""
        self._law.set_gains(*(u + share * (own - u) for u, own in zip(self._usual, self._own, strict=True)))

    def reset(self, mask: Tensor, q: Tensor, dq: Tensor, command: Tensor) -> None:
        """Begin an episode where ``mask`` (N,), at link positions q, commanded to hold ``command`` (N, 12)."""
        self._law.begin(q, dq, where=mask[:, None])
        self._keep()
        for target, late in zip(self._targets, self._late, strict=True):
            put(target, mask, command)
            put(late, mask, 0.0)

    def arrives(self) -> Tensor:
        """Return whether the command of this control step arrives (N, 1)."""
        return torch.rand_like(self._lost) >= self._lost

    def send(self, target: Tensor, drawn: Tensor) -> None:
        """Take the command of a control step (N, 12), which acts after its delay; see `delay` for ``drawn``."""
        for row in (self._targets, self._late):
            for age in reversed(range(1, len(row))):
                row[age].copy_(row[age - 1])
        self._targets[0].copy_(target)
        self._late[0].copy_(self._spread * torch.rand_like(self._spread))
        for shift, late in zip(self._shifts, self._late, strict=True):
            shift.copy_(torch.clip(self.delay(drawn) + late, 0.0, None))

    def delay(self, drawn: Tensor) -> Tensor:
        """Return the physics steps from a command to its effect (N, 12), where drawn ones are (N, 1)."""
        return self._shift if self._delayed else self._shift + drawn

    def drive(self, q: Tensor, dq: Tensor, substep: int) -> None:
        """Hand over the inputs of the next physics step, from link positions and velocities (N, 12)."""
        shares = shares_in_effect(substep, self._d.decimation, self._shifts, torch)
        targets = moving_targets(substep, self._d.decimation, self._shifts, self._targets, torch)
        target = target_in_effect(shares, targets)
        inputs = self._law.step(q, dq, target, self.time + substep * self._d.timestep)
        self._servo.write(inputs)
        self.tau.copy_(inputs.tau)
        self._keep()

    def settle(self, dq: Tensor) -> None:
        """Bring lags and rotors to the end of the physics step just made."""
        self._law.settle(dq)
        self._keep()

    def reading(self, q: Tensor) -> Tensor:
        """Return what the encoders read at link positions (N, 12)."""
        return self._law.reading(q)

    def _keep(self) -> None:
        """Copy the states to where they are read by captured steps."""
        for name, buffer in self._states.items():
            if self._law.states[name] is not buffer:
                self._law.states[name] = buffer.copy_(self._law.states[name])

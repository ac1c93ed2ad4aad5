"""Is it the base that moves? One motion of the base against a force of its own in each joint.

A base that swings shakes all joints at its few frequencies, each as strongly as the masses behind it and its pose
demand. That pattern has six numbers for each phase of a frequency, however many joints there are; forces in the joints
have as many as they like. No effect of the catalogue moves the base: where its motion explains no less than forces do,
the rest is not explained, and the report says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mimic.dynamics.machine import MachineModel
from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.least_squares import Fit, prior, scaled_solution
from mimic.sysid.fit.point import Point
from mimic.sysid.fit.residuals import Problem
from mimic.sysid.selection.evidence import TriedEffect, paired, pays
from mimic.sysid.thresholds import RULES

AXES = 6
"""Accelerations along x, y, z and about x, y, z of the base."""

POSES_HZ = 50.0
"""How often the pattern is computed; the legs hardly move in between [Hz]."""

MOST_FREQUENCIES = 3
"""Most frequencies that a base is taken to swing at."""

STEPS = 3
"""Steps of the fit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BaseMotion:
    """A motion of the base as an explanation."""

    frequencies: tuple[float, ...]
    """[Hz]"""
    numbers: int
    """How many it has."""
    residual: FloatArray
    """Whitened residuals that it leaves (T, C)."""
    squares: FloatArray
    """Each fitted block judged without itself (B_train, C)."""

    def instead_of(self, squares: FloatArray) -> str:
        """Return why this explains the residual better than an effect that leaves these squares, or an empty string."""
        gain, z = paired(squares, self.squares)
        if gain >= RULES.gain and z >= RULES.apart:
            return ""
        at = " and ".join(f"{f:.2f}" for f in self.frequencies)
        explains = "as much" if z > -RULES.apart else "more"
        return f"one motion of the base at {at} Hz explains {explains}, with {self.numbers} parameters"


def behind_forces(
    problem: Problem, incumbent: Fit, before: FloatArray, shaken: TriedEffect, tick: Callable[[str], None]
) -> BaseMotion | None:
    """Return the base motion that explains periodic forces in the joints at least as well, or None.

    Args:
        problem: Log and model.
        incumbent: The fit without forces.
        before: What it leaves of blocks judged without themselves (B_train, C).
        shaken: The effect of forces.
        tick: Called with what is being done.
    """
    if shaken.joints.sum() < 2 or shaken.gain < RULES.gain or shaken.z < RULES.z:
        return None
    tick("testing for a moving base")
    cosine, sine, frequency = (shaken.fitted.point.values[shaken.name, p] for p in ("cosine", "sine", "frequency"))
    base = moving_base(problem, incumbent, frequency, np.hypot(cosine, sine), shaken.joints)
    if base is None or (len(np.unique(problem.machine.chain)) == 1 and base.numbers >= 3 * shaken.joints.sum()):
        return None
    if not pays(base.squares, before) or pays(shaken.squares, base.squares, RULES.apart):
        return None
    return base


def base_torques(machine: MachineModel, q: FloatArray, factor: FloatArray) -> FloatArray:
    """Return the torque on each joint of a unit acceleration of the base along and about its axes (T, J, 6).

    In [N m] for [m/s^2] and [rad/s^2], in a frame that moves with the base; slow enough that the legs' own speed does
    not matter.

    Args:
        machine: The model, its base at the origin.
        q: Positions (T, J) [rad].
        factor: Of the mass of each joint's link (J,).
    """
    model, data = machine.model, mujoco.MjData(machine.model)
    scale = np.ones(model.nbody)
    scale[machine.body] = factor
    linear, turning = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    out = np.zeros((len(q), model.nv, AXES))
    for row, pose in zip(out, q, strict=True):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for b in range(1, model.nbody):
            if not model.body_mass[b]:
                continue
            mujoco.mj_jacBodyCom(model, data, linear, turning, b)
            axes = data.ximat[b].reshape(3, 3)
            inertia = scale[b] * axes @ np.diag(model.body_inertia[b]) @ axes.T
            x, y, z = data.xipos[b]
            across = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # of alpha x r
            mass = scale[b] * model.body_mass[b]
            row[:, :3] -= mass * linear.T
            row[:, 3:] -= mass * linear.T @ across + turning.T @ inertia
    return out


class _Pattern:
    """Torques on the joints over the log, by frequency, phase and axis of the base's motion."""

    def __init__(self, problem: Problem, factor: FloatArray) -> None:
        replay = problem.replay
        t = replay.log.t - replay.log.t[0]
        at = np.arange(0.0, t[-1] + 1.0 / POSES_HZ, 1.0 / POSES_HZ)
        q = np.stack([np.interp(at, t, column) for column in replay.log.q.T], -1)
        poses = base_torques(problem.machine, q, factor)
        self.t = (np.arange(replay.total) + 0.5) * replay.dt
        row = np.clip(self.t * POSES_HZ, 0.0, len(at) - 1.001)
        part = (row % 1.0)[:, None, None]
        self._torque = poses[row.astype(int)] * (1 - part) + poses[row.astype(int) + 1] * part
        self.strongest = np.sqrt((poses**2).mean(0)).max(0)
        """Torque of a unit acceleration on the joint that feels it most, by axis (6,)."""
        self.shift = 0.1 / replay.log.duration
        """Difference of frequencies that matters [Hz]."""

    def torques(self, frequencies: FloatArray, amplitude: FloatArray) -> FloatArray:
        """Return the torques of each physics step (steps, J) of cosine and sine amplitudes (F, 2, 6)."""
        out = np.zeros(self._torque.shape[:2])
        for frequency, (cosine, sine) in zip(frequencies, amplitude, strict=True):
            angle = 2 * np.pi * frequency * self.t[:, None]
            out += self._torque @ cosine * np.cos(angle) + self._torque @ sine * np.sin(angle)
        return out


def shared_frequencies(
    frequency: FloatArray, size: FloatArray, there: BoolArray, resolution: float
) -> tuple[float, ...]:
    """Return the frequencies that two joints or more share, that of most joints first.

    Args:
        frequency: Of the force in each joint (J,) [Hz].
        size: How strong it is (J,).
        there: Joints that have one (J,).
        resolution: Frequencies closer than this are one [Hz].
    """
    left, found = there.copy(), []
    while left.any():
        near = [left & (np.abs(frequency - f) < resolution) for f in frequency]
        best = max(np.flatnonzero(left), key=lambda j: (int(near[j].sum()), float(size[j])))
        if near[best].sum() < 2:
            break
        found.append(float(np.average(frequency[near[best]], weights=size[near[best]] ** 2)))
        left &= ~near[best]
    return tuple(found[:MOST_FREQUENCIES])


def moving_base(
    problem: Problem, incumbent: Fit, frequency: FloatArray, size: FloatArray, there: BoolArray
) -> BaseMotion | None:
    """Return the motion of the base that explains most of what a fit leaves; None where no joints share a frequency.

    The numbers of the fit move with it.

    Args:
        problem: Log and model.
        incumbent: The fit.
        frequency: Of a periodic force fitted to each joint (J,) [Hz].
        size: How strong it is (J,) [N m].
        there: Joints that have one (J,).
    """
    shared = np.array(shared_frequencies(frequency, size, there, 1.0 / problem.replay.log.duration))
    if not len(shared):
        return None
    factor = incumbent.point.values.get(("link_mass", "factor"), np.ones(len(problem.machine.joints)))
    pattern = _Pattern(problem, factor)
    fitted = _FittedMotion(problem, incumbent, pattern, shared, float(np.sqrt(np.mean(size[there] ** 2))))
    for _ in range(STEPS):
        if not fitted.step():
            break
    return BaseMotion(
        frequencies=tuple(sorted(fitted.frequencies.tolist())),
        numbers=fitted.amplitude.size + len(shared),
        residual=fitted.residual,
        squares=fitted.left_out(),
    )


class _FittedMotion:
    """A motion of the base and the numbers of a fit, improved together."""

    def __init__(
        self, problem: Problem, incumbent: Fit, pattern: _Pattern, frequencies: FloatArray, torque: float
    ) -> None:
        """Begin without a motion; ``torque`` [N m] is what it should come to, about."""
        self._problem, self._pattern, self._incumbent = problem, pattern, incumbent
        self.frequencies, self.amplitude = frequencies, np.zeros((len(frequencies), 2, AXES))
        self._point = incumbent.point
        self._unit = torque / np.maximum(pattern.strongest, 1e-12)
        low, high = (np.array([k.bounds[i] for k in incumbent.free_parameters]) for i in (0, 1))
        at = incumbent.point.read(incumbent.free_parameters)
        self._free = np.flatnonzero((at > low + 1e-12) & (at < high - 1e-12))
        self._free_parameters = [incumbent.free_parameters[i] for i in self._free]
        self._own = [incumbent.columns[i] for i in self._free]
        self.residual = incumbent.residual
        self._columns = np.zeros((0, *self.residual.shape))
        self._cost = self._cost_of(self._point, self.residual)

    def _cost_of(self, point: Point, residual: FloatArray) -> float:
        away = point.read(self._free_parameters) - np.array([k.centre for k in self._free_parameters])
        squares = self._problem.block_squares(residual)[self._problem.blocks.train].sum()
        return float(squares + np.sum(prior(self._free_parameters) * away**2))

    def _moved(self, by: FloatArray) -> tuple[Point, FloatArray, FloatArray]:
        """Return point, frequencies and amplitudes after a step of all numbers."""
        count, waves = len(self._free_parameters), self.amplitude.size
        amplitude = self.amplitude + by[count : count + waves].reshape(self.amplitude.shape)
        return self._point.moved(self._free_parameters, by[:count]), self.frequencies + by[count + waves :], amplitude

    def _replayed(self, states: Sequence[tuple[Point, FloatArray, FloatArray]]) -> FloatArray:
        pushed = np.stack([self._pattern.torques(f, a) for _, f, a in states])
        return self._problem.residuals([p for p, _, _ in states], pushed)

    def step(self) -> bool:
        """Improve all numbers once and return whether that helped."""
        count, waves = len(self._free_parameters), self.amplitude.size
        sizes = np.concatenate(
            [np.tile(self._unit, waves // AXES), np.full(len(self.frequencies), self._pattern.shift)]
        )
        turning = waves if self.amplitude.any() else 0  # without a motion its frequency says nothing
        use = np.arange(waves + (len(self.frequencies) if turning else 0))
        steps = np.diag(np.concatenate([np.zeros(count), sizes]))[count:]
        trials = [self._moved(steps[i]) for i in use]
        replayed = self._replayed([(self._point, self.frequencies, self.amplitude), *trials])
        base = replayed[0]
        made = [(base - r) / np.float32(sizes[i]) for i, r in zip(use, replayed[1:], strict=True)]
        self._columns = np.nan_to_num(np.stack([*self._own, *made]))
        hessian, gradient = self._normal(base)
        rest = gradient[:count] - prior(self._free_parameters) * (
            self._point.read(self._free_parameters) - np.array([k.centre for k in self._free_parameters])
        )
        by = np.zeros(count + len(sizes))
        by[: count + len(use)] = scaled_solution(
            hessian.sum(0) + self._prior(len(use)), np.concatenate([rest, gradient[count:]]), 1e-10
        )
        moved = self._moved(by)
        after = self._replayed([moved])[0]
        cost = self._cost_of(moved[0], after)
        if not cost < self._cost:
            return False
        self._point, self.frequencies, self.amplitude = moved
        self.residual, self._cost = after, cost
        return True

    def _prior(self, more: int) -> FloatArray:
        return np.diag(np.concatenate([prior(self._free_parameters), np.zeros(more)]))

    def _normal(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return Hessian of each fitted block (B_train, P, P), and the gradient of all (P,)."""
        hessian, gradient = [], np.zeros(len(self._columns))
        for b in self._problem.blocks.train:
            rows = self._problem.blocks.index == b
            a = self._columns[:, rows].reshape(len(self._columns), -1).astype(np.float64)
            hessian.append(a @ a.T)
            gradient += a @ residual[rows].reshape(-1).astype(np.float64)
        return np.array(hessian), gradient

    def left_out(self) -> FloatArray:
        """Return the squares of each fitted block under a fit without it (B_train, C), by the jackknife."""
        problem = self._problem
        squares = problem.block_squares(self.residual)[problem.blocks.train]
        if not len(self._columns):
            return squares
        hessian, _ = self._normal(self.residual)
        total = hessian.sum(0) + self._prior(len(self._columns) - len(self._free_parameters))
        for row, b in enumerate(problem.blocks.train):
            rows = problem.blocks.index == b
            a = self._columns[:, rows].astype(np.float64)
            gradient = a.reshape(len(a), -1) @ self.residual[rows].reshape(-1)
            change = scaled_solution(total - hessian[row], gradient, 1e-10)
            squares[row] = ((self.residual[rows] + np.tensordot(change, a, 1)) ** 2).sum(0)
        return squares

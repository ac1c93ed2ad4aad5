"""Logs of torque controlled joints as a regression sees them: what the motors gave less what the declared links need.

A log is first put on an even clock. Everything that is compared passes the same low-pass filter, so that what the
filter takes away is missing on both sides of the equation (Janot, Gautier, Brunot 2019; Khalil and Dombre 2002, section
12).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from mimic.dynamics.machine import MachineModel, as_logged
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray
from mimic.sysid.log.noise import noise_floor
from mimic.sysid.log.pool import enabled
from mimic.sysid.log.timing import at_rows

DELAYS = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04)
"""Delays of the targets that are tried before anything else [s]; the best is refined from there."""

REFINED = 4
"""Steps towards the best delay from there."""

BANDWIDTH = 1.2
"""Bandwidth of a comparison over the frequency of the fastest drive: beyond, an acceleration has more noise than the
torque, and a soft joint swings on its own.
"""

LEAST, WITHOUT_GAINS = 3.0, 25.0
"""Least bandwidth of a comparison, and that without gains or with measured torque [Hz]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """One log at even times; arrays (T, J) but for t."""

    t: FloatArray
    """(T,) [s]"""
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    tau: FloatArray
    """Torque of the motor: measured, or what the declared gains ask for [N m]."""
    later: FloatArray
    """What it would be with 1 ms more delay, less what it is [N m]; zeros where it was measured."""
    need: FloatArray
    """Torque that the declared links need, without friction [N m]."""
    moving: BoolArray
    """Where friction is not that of a joint at rest."""
    slow: FloatArray
    """Speed below which a sign cannot be told (J,)."""
    cut_off: float
    """Of the filter that all passes [Hz]."""
    every: int
    """Rows of this motion for one that is compared."""
    machine: MachineModel
    """With the gains of this log."""

    def filtered(self, x: FloatArray) -> FloatArray:
        """Return columns (T, …) as they are compared: filtered and thinned out."""
        return _low_pass(x, self.cut_off, 1.0 / (self.t[1] - self.t[0]))[:: self.every]


def motions_of(logs: Sequence[tuple[JointLog, MachineModel]]) -> tuple[float, list[Motion]]:
    """Return the delay of the targets with which inertia and friction of each joint leave least, and the motions."""
    by_target = any(log.tau is None and log.q_des is not None for log, _ in logs)
    found = {d: _plain(logs, d) for d in (DELAYS if by_target else (0.0,))}
    delay = min(found, key=lambda d: found[d][0])
    for _ in range(REFINED if by_target else 0):
        nearer = float(np.clip(delay + found[delay][1], 0.0, 2 * DELAYS[-1]))
        if nearer not in found:
            found[nearer] = _plain(logs, nearer)
        if found[nearer][0] >= found[delay][0]:
            break
        delay = nearer
    return delay, found[delay][2]


def _plain(logs: Sequence[tuple[JointLog, MachineModel]], delay: float) -> tuple[float, float, list[Motion]]:
    """Return the log error of each joint's own inertia and friction, summed, by how much later is better, the motions.

    The error is that of a torque in units of the declared one, since all torques scale with inertia and friction.
    """
    motions = [motion_of(log.of(m.joints), m, delay) for log, m in logs]
    left, later, weight = 0.0, 0.0, 0.0
    for j in range(motions[0].q.shape[1]):
        x, tau = [], []
        for m in motions:
            t, edge = m.t[:: m.every], 2.0 / m.cut_off
            keep = m.moving[:: m.every, j] & (t > edge) & (t < t[-1] - edge)
            own = [np.tanh(m.dq / m.slow), m.dq, m.ddq, m.need, np.ones_like(m.q), -m.later]
            x.append(m.filtered(np.stack([c[:, j] for c in own], -1))[keep])
            tau.append(m.filtered(m.tau[:, j])[keep])
        a, b = np.concatenate(x), np.concatenate(tau)
        if len(b) < 10:
            continue
        found = np.linalg.lstsq(a, b, rcond=None)[0]
        error = np.mean((b - a[:, :-1] @ found[:-1]) ** 2) + 1e-30
        left += float(np.log(error))
        there = np.mean(a[:, -1] ** 2) / error
        later, weight = later + there * 1e-3 * float(found[-1]), weight + there
    return left, float(later / max(weight, 1e-12)), motions


def _cut_off_of(log: JointLog, machine: MachineModel) -> float:
    """Return the bandwidth in which a log is compared [Hz].

    An eighth of the rate of the log at most, and 25 Hz where torque was measured or the drives have no gains.
    """
    kp = np.asarray(machine.drives.kp)
    most = min(log.rate / 8.0, WITHOUT_GAINS)
    if log.tau is not None or not kp.any():
        return most
    fastest = np.sqrt(np.max(kp * machine.model.dof_invweight0)) / (2 * np.pi)
    return float(np.clip(BANDWIDTH * fastest, min(LEAST, most), log.rate / 8.0))


def motion_of(log: JointLog, model: MachineModel, delay: float) -> Motion:
    """Return a log of the joints of a model at even times, its targets acting so much later [s]."""
    machine = as_logged(model, log.metadata, by_force=log.q_des is None)
    rate, t0 = log.rate, log.t[0]
    t = np.arange(0.0, log.duration, 1.0 / rate)
    q_read = _at(t, log.t - t0, log.q)
    cut_off = _cut_off_of(log, machine)
    q = _low_pass(q_read, min(2.0 * cut_off, 0.45 * rate), rate)
    dq = _slope(q, t)
    ddq = _slope(dq, t)
    sending = at_rows(log)
    targets = np.zeros_like(log.q[sending.rows]) if log.q_des is None else log.q_des[sending.rows]
    target = q_read if log.q_des is None else _held(t - delay, sending.at, targets)
    kp, kd = np.asarray(machine.drives.kp), np.asarray(machine.drives.kd)
    force = 0.0 if log.force is None else _held(t, log.t - t0, log.force)
    most, flat, speed = (np.asarray(getattr(machine.drives, name)) for name in ("torque", "flat", "speed"))
    slope_down = most / (speed - flat)
    low, high = (-np.clip((speed + dq) * slope_down, 0.0, most), np.clip((speed - dq) * slope_down, 0.0, most))
    on = (_held(t, log.t - t0, enabled(log).astype(float)) > 0.5).astype(float)

    def asked(u: FloatArray) -> FloatArray:
        return on * np.clip(kp * (u - q_read) - kd * dq + force, low, high)

    if log.tau is not None:
        tau, later = on * _at(t, log.t - t0, log.tau), np.zeros_like(q)
    else:
        tau = asked(target)
        further = tau if log.q_des is None else asked(_held(t - delay - 1e-3, sending.at, targets))
        later = _low_pass(further - tau, cut_off, rate)
    noise = noise_floor(log.q, rate)
    slow = 2.0 * noise * 2 * np.pi * cut_off * np.sqrt(2 * cut_off / rate)
    slow = np.maximum(slow, 0.01 * np.sqrt(np.mean(dq**2, axis=0)) + 1e-9)
    return Motion(
        t=t,
        q=q,
        dq=dq,
        ddq=ddq,
        tau=tau,
        later=later,
        need=_needed(machine, q, dq, ddq),
        moving=_low_pass((np.abs(dq) > slow).astype(float), cut_off, rate) > 0.9,
        slow=slow,
        cut_off=cut_off,
        every=max(1, round(rate / (2.5 * cut_off))),
        machine=machine,
    )


def _needed(machine: MachineModel, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """Return the torque (T, J) [N m] that a motion needs without friction, contacts and limits."""
    model = copy(machine.model)
    model.dof_damping[:] = 0.0
    model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, out = mujoco.MjData(model), np.empty_like(q)
    mujoco.mj_setConst(model, data)
    for i in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], dq[i], ddq[i]
        mujoco.mj_inverse(model, data)
        out[i] = data.qfrc_inverse
    return out


def _slope(x: FloatArray, t: FloatArray) -> FloatArray:
    """Return the derivative of columns (T, …), of fourth order in the time between rows."""
    return CubicSpline(t, x, axis=0)(t, 1)


def _at(t: FloatArray, rows: FloatArray, x: FloatArray) -> FloatArray:
    return np.stack([np.interp(t, rows, column) for column in x.T], -1)


def _held(t: FloatArray, rows: FloatArray, x: FloatArray) -> FloatArray:
    """Return the mean over an interval around each time of what is held from each row to the next."""
    whole = np.concatenate([np.zeros_like(x[:1]), np.cumsum(x[:-1] * np.diff(rows)[:, None], axis=0)])
    half = (t[1] - t[0]) / 2
    ends = [_at(np.clip(t + h, rows[0], rows[-1]), rows, whole) + _beyond(t + h, rows, x) for h in (half, -half)]
    return (ends[0] - ends[1]) / (2 * half)


def _beyond(t: FloatArray, rows: FloatArray, x: FloatArray) -> FloatArray:
    return np.minimum(t - rows[0], 0.0)[:, None] * x[:1] + np.maximum(t - rows[-1], 0.0)[:, None] * x[-1:]


def _low_pass(x: FloatArray, cut_off: float, rate: float) -> FloatArray:
    """Return columns (T, …) without what is faster, and without a lag."""
    return sosfiltfilt(butter(4, cut_off, fs=rate, output="sos"), x, axis=0)

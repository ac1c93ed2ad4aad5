"""A log on an even clock: positions and their derivatives, what the drive gave, and what the declared links need.

Everything that is compared passes the same low-pass filter, so that what the filter takes away is missing on both sides
of the equation (Janot, Gautier, Brunot 2019; Khalil and Dombre 2002, section 12).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from mimic.dynamics.machine import MachineModel, as_logged
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray
from mimic.sysid.logs import enabled
from mimic.sysid.noise import noise_floor
from mimic.sysid.timing import SendingTimes, at_rows

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
    target: FloatArray
    """Target in effect: that of the log, `delay` later."""
    tau: FloatArray
    """Torque of the motor: measured, or what the declared gains ask for [N m]."""
    later: FloatArray
    """What it would be with 1 ms more delay, less what it is [N m]; zeros where it was measured."""
    on: FloatArray
    """1 where a drive is switched on, else 0 (the column ``enabled`` of the log)."""
    need: FloatArray
    """Torque that the declared links need, without friction [N m]."""
    bias: FloatArray
    """Part of it that is there without acceleration: gravity, Coriolis, springs [N m]."""
    moving: BoolArray
    """Where friction is not that of a joint at rest, in rows that may be looked at."""
    slow: FloatArray
    """Speed below which a sign cannot be told (J,)."""
    cut_off: float
    """Of the filter that all passes [Hz]."""
    every: int
    """Rows of this motion for one that is compared."""
    machine: MachineModel
    """With the gains of this log."""

    def through_gear(self) -> FloatArray:
        """Return what the motor gives beyond its own rotor, without noise, at all times (T, J) [N m]."""
        given = self.tau - self.machine.model.dof_armature * self.ddq
        return _low_pass(given, self.cut_off, 1.0 / (self.t[1] - self.t[0]))

    def filtered(self, x: FloatArray) -> FloatArray:
        """Return columns (T, …) as they are compared: filtered and thinned out."""
        return _low_pass(x, self.cut_off, 1.0 / (self.t[1] - self.t[0]))[:: self.every]


def cut_off_of(log: JointLog, machine: MachineModel) -> float:
    """Return the bandwidth in which a log is compared [Hz].

    An eighth of the rate of the log at most, and 25 Hz where torque was measured or the drives have no gains.
    """
    kp = np.asarray(machine.drives.kp)
    most = min(log.rate / 8.0, WITHOUT_GAINS)
    if log.tau is not None or not kp.any():
        return most
    fastest = np.sqrt(np.max(kp * machine.model.dof_invweight0)) / (2 * np.pi)
    return float(np.clip(BANDWIDTH * fastest, min(LEAST, most), log.rate / 8.0))


def motion_of(
    log: JointLog,
    model: MachineModel,
    delay: float,
    rows: BoolArray | None = None,
    sending: SendingTimes | None = None,
) -> Motion:
    """Return a log at even times.

    Args:
        log: Of the joints of the model.
        model: What it should have done.
        delay: Of the targets [s].
        rows: Rows of the log that may be looked at (T,), all by default.
        sending: When targets were sent; with the rows that first show them by default.
    """
    machine = as_logged(model, log.metadata, by_force=log.q_des is None)
    rate, t0 = log.rate, log.t[0]
    t = np.arange(0.0, log.duration, 1.0 / rate)
    q_read = _at(t, log.t - t0, log.q)
    cut_off = cut_off_of(log, machine)
    q = _low_pass(q_read, min(2.0 * cut_off, 0.45 * rate), rate)
    dq = slope(q, t)
    ddq = slope(dq, t)
    sending = sending or at_rows(log)
    targets = np.zeros_like(log.q[sending.rows]) if log.q_des is None else log.q_des[sending.rows]
    target = q_read if log.q_des is None else _held(t - delay, sending.at, targets)
    kp, kd = np.asarray(machine.drives.kp), np.asarray(machine.drives.kd)
    force = 0.0 if log.force is None else _held(t, log.t - t0, log.force)
    most, flat, speed = (np.asarray(getattr(machine.drives, name)) for name in ("torque", "flat", "speed"))
    slope_down = most / (speed - flat)
    low, high = (-np.clip((speed + dq) * slope_down, 0.0, most), np.clip((speed - dq) * slope_down, 0.0, most))
    on = (_held(t, log.t - t0, enabled(log).astype(float)) > 0.5).astype(float)
    seen = np.ones((len(t), 1), dtype=bool)
    if rows is not None:
        seen = np.interp(t, log.t - t0, rows.astype(float))[:, None] > 0.99

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
    motion = Motion(
        t=t,
        q=q,
        dq=dq,
        ddq=ddq,
        target=target,
        tau=tau,
        later=later,
        on=on,
        need=np.zeros_like(q),
        bias=np.zeros_like(q),
        moving=(_low_pass((np.abs(dq) > slow).astype(float), cut_off, rate) > 0.9) & seen,
        slow=slow,
        cut_off=cut_off,
        every=max(1, round(rate / (2.5 * cut_off))),
        machine=machine,
    )
    links = Links(machine)
    object.__setattr__(motion, "need", links.torque(q, dq, ddq))
    object.__setattr__(motion, "bias", links.torque(q, dq, np.zeros_like(q)))
    return motion


class Links:
    """Inverse dynamics of a machine without friction."""

    def __init__(self, machine: MachineModel) -> None:
        """Take a copy of its model, without friction, contacts and limits."""
        self.model = copy(machine.model)
        self.model.dof_damping[:] = 0.0
        self.model.dof_frictionloss[:] = 0.0
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self._data = mujoco.MjData(self.model)

    def torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the torque (T, J) [N m] that this motion needs."""
        mujoco.mj_setConst(self.model, self._data)
        out, data, model = np.empty_like(q), self._data, self.model
        for i in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[i], dq[i], ddq[i]
            mujoco.mj_inverse(model, data)
            out[i] = data.qfrc_inverse
        return out


def slope(x: FloatArray, t: FloatArray) -> FloatArray:
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

"""An arm of two links in closed form, logged by a clock of its own: a machine that shares no code with mimic's replay.

The targets are sent every 20 ms. The rows are written by one of several clocks, each with the newest target beside the
reading, as loggers do. ``python -m lab.hidden_effects.planar_arm`` calibrates one log for each clock and effect and
prints what was found.

Equations of motion: Spong, Hutchinson, Vidyasagar 2006, section 7.4 (planar elbow manipulator). Midpoint rule, with dry
friction as a set-valued law solved for the velocity at the end of a step, so that a joint at rest does not creep.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.io.joint_log import JointLog
from mimic.records import FloatArray

try:
    from numba import njit
except ImportError:  # slower, same numbers

    def njit(*args, **options):
        return args[0] if args and callable(args[0]) else lambda f: f


GRAVITY, LENGTH = 9.81, 0.15
MASS, CENTRE, INERTIA = (0.6, 0.35), (0.07, 0.08), (1.2e-3, 8e-4)
ROTOR, KP, KD = 0.004, 25.0, 0.9
DRY, VISCOUS, DELAY = (0.07, 0.05), (0.05, 0.03), 0.008
NOISE = 0.3e-3
SENT_EVERY, STEP, SETTLE = 0.02, 1e-4, 1.0
JOINTS = ("shoulder", "elbow")

MJCF = f"""<mujoco><worldbody><body pos="0 0 1">
<joint name="shoulder" axis="0 1 0" armature="{ROTOR}" damping="0.04" frictionloss="0.05"/>
<inertial pos="0 0 -{CENTRE[0]}" mass="{MASS[0] * 0.95}" diaginertia="{INERTIA[0]} {INERTIA[0]} 1e-4"/>
<body pos="0 0 -{LENGTH}"><joint name="elbow" axis="0 1 0" armature="{ROTOR}" damping="0.04" frictionloss="0.04"/>
<inertial pos="0 0 -{CENTRE[1]}" mass="{MASS[1] * 1.06}" diaginertia="{INERTIA[1]} {INERTIA[1]} 1e-4"/>
<site pos="0 0 -{LENGTH}"/></body></body></worldbody></mujoco>"""

EFFECTS: dict[str, dict[str, float]] = {
    "clean": {},
    "load_friction": {"load": 0.12},
    "spring": {"spring": 0.6, "moment": 0.1},
    "stribeck": {"stribeck": 0.12, "stribeck_speed": 0.12},
    "compliance": {"stiffness": 60.0},
    "backlash": {"stiffness": 2500.0, "gap": 0.015},
    "stribeck_and_backlash": {"stribeck": 0.12, "stribeck_speed": 0.12, "stiffness": 2500.0, "gap": 0.015},
    "asymmetric_friction": {"asymmetric": 0.05},
    "drag": {"drag": 0.02},
    "torque_lag": {"lag": 0.005},
}
"""Hidden in both joints, in the units of SI."""

PARAMETERS = ("load", "spring", "moment", "stribeck", "stribeck_speed", "stiffness", "asymmetric", "drag", "lag", "gap")


@dataclass(frozen=True, kw_only=True)
class Clock:
    """When rows are written."""

    rate_hz: float
    beside: float = 0.0
    """First row after the first target [s]."""
    jitter: float = 0.0
    """Standard deviation of the time of a row, which the row tells [s]."""


CLOCKS = {
    "grid": Clock(rate_hz=200.0),
    "beside": Clock(rate_hz=200.0, beside=0.004, jitter=0.0003),
    "187": Clock(rate_hz=187.0, beside=0.001),
    "50": Clock(rate_hz=50.0, beside=0.004),
}


@njit
def _accelerate(q, v, f0, f1):
    """Inverse of the mass matrix (a, b, c) of the links with rotors, and the acceleration without friction."""
    c2, s2 = math.cos(q[1]), math.sin(q[1])
    h = MASS[1] * LENGTH * CENTRE[1]
    m22 = INERTIA[1] + MASS[1] * CENTRE[1] ** 2
    m12 = m22 + h * c2
    m11 = INERTIA[0] + MASS[0] * CENTRE[0] ** 2 + MASS[1] * LENGTH**2 + m22 + 2.0 * h * c2
    g2 = GRAVITY * MASS[1] * CENTRE[1] * math.sin(q[0] + q[1])
    g1 = GRAVITY * (MASS[0] * CENTRE[0] + MASS[1] * LENGTH) * math.sin(q[0]) + g2
    b1 = -h * s2 * (2.0 * v[0] * v[1] + v[1] ** 2) + g1
    b2 = h * s2 * v[0] ** 2 + g2
    return m11, m12, m22, f0 - b1, f1 - b2


@njit
def _run(steps, dt, arrival, target, p, out):
    """Step from rest; out (steps, 2) gets what the encoders, on the motors, read at the end of each step."""
    load, spring, moment, level, width, stiffness, lopsided, drag, lag, gap = p
    q, v, theta, omega = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    torque, f, limit, push = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    elastic = stiffness > 0.0
    at = 0
    for k in range(steps):
        t = k * dt
        while at + 1 < len(arrival) and arrival[at + 1] <= t:
            at += 1
        share = 0.0
        if at + 1 < len(arrival) and arrival[at + 1] < t + dt:
            share = (t + dt - arrival[at + 1]) / dt
        for j in range(2):
            x, w = (theta[j] + 0.5 * dt * omega[j], omega[j]) if elastic else (q[j] + 0.5 * dt * v[j], v[j])
            u = target[at, j]
            if share > 0.0:
                u += share * (target[at + 1, j] - u)
            asked = KP * (u - x) - KD * w
            torque[j] = asked if lag <= 0.0 else torque[j] + (asked - torque[j]) * (1.0 - math.exp(-dt / lag))
            link = q[j] + 0.5 * dt * v[j]
            drive = torque[j]
            if elastic:
                twist = x - link
                beyond = twist - min(max(twist, -0.5 * gap), 0.5 * gap)
                drive = stiffness * beyond + (0.05 * (w - v[j]) if beyond != 0.0 or gap == 0.0 else 0.0)
                omega[j] += dt * (torque[j] - drive) / ROTOR
                theta[j] += dt * omega[j]
            f[j] = drive - spring * link + (moment if spring > 0.0 else 0.0)
            f[j] -= VISCOUS[j] * v[j] + drag * v[j] * abs(v[j])
            limit[j] = DRY[j] + load * abs(torque[j])
            if level > 0.0:
                limit[j] += level * math.exp(-((v[j] / width) ** 2))
        mid = q + 0.5 * dt * v
        m11, m12, m22, r0, r1 = _accelerate(mid, v, f[0], f[1])
        if not elastic:
            m11, m22 = m11 + ROTOR, m22 + ROTOR
        d = m11 * m22 - m12 * m12
        a, b, c = m22 / d, -m12 / d, m11 / d
        old0, old1 = v[0], v[1]
        v[0] = old0 + dt * (a * r0 + b * r1)
        v[1] = old1 + dt * (b * r0 + c * r1)
        push[0], push[1] = 0.0, 0.0
        for _ in range(50):
            before = push[0] + push[1]
            for j in range(2):
                own = a if j == 0 else c
                high, low = dt * (limit[j] - lopsided), -dt * (limit[j] + lopsided)
                new = min(max(push[j] - v[j] / own, low), high)
                change, push[j] = new - push[j], new
                v[0] += (a if j == 0 else b) * change
                v[1] += (b if j == 0 else c) * change
            if abs(push[0] + push[1] - before) < 1e-15:
                break
        q += 0.5 * dt * (v + np.array([old0, old1]))
        out[k, 0] = theta[0] if elastic else q[0]
        out[k, 1] = theta[1] if elastic else q[1]


def targets(seconds: float, seed: int) -> FloatArray:
    """Return sines, steps, slow triangles and holds (K, 2) [rad], one every 20 ms."""
    rng = np.random.default_rng((seed, 7))
    t = np.arange(0.0, seconds, SENT_EVERY)
    phase = rng.uniform(0, 2 * np.pi, (6, 2))
    sines = sum(
        0.45 / (1 + k) * np.sin(2 * np.pi * f * t[:, None] + phase[k])
        for k, f in enumerate((0.2, 0.5, 1.1, 1.9, 3.1, 5))
    )
    steps = np.repeat(rng.uniform(-0.7, 0.7, (len(t) // 25 + 1, 2)), 25, axis=0)[: len(t)]
    slow = 0.8 * np.abs((t[:, None] * np.array([0.3, 0.23]) + phase[0] / 6) % 2.0 - 1.0) - 0.4
    part = (t % 12.0)[:, None]
    return np.where(part < 6.0, sines, np.where(part < 9.0, slow, steps))


def arm_log(
    clock: Clock, hidden: Mapping[str, float] | None = None, *, seconds: float = 36.0, seed: int = 0
) -> JointLog:
    """Return what a logger writes of an arm with these hidden effects."""
    q_des = targets(seconds, seed)
    sent = np.arange(len(q_des)) * SENT_EVERY
    rng = np.random.default_rng((seed, 8))
    steps = round((seconds + SETTLE) / STEP)
    out = np.zeros((steps, 2))
    arrival = np.concatenate([[-1.0], sent[1:] + SETTLE + DELAY])
    p = tuple(float((hidden or {}).get(name, 0.0)) for name in PARAMETERS)
    _run(steps, STEP, arrival, q_des, p, out)
    t = clock.beside + np.arange(0.0, seconds - clock.beside - 0.01, 1.0 / clock.rate_hz)
    t = np.maximum.accumulate(np.maximum(t + clock.jitter * rng.standard_normal(len(t)), 0.0))
    when = (np.arange(steps) + 1.0) * STEP - SETTLE
    q = np.stack([np.interp(t, when, column) for column in out.T], axis=-1)
    q = q + NOISE * rng.standard_normal(q.shape)
    newest = np.searchsorted(sent, t + 1e-9, side="right") - 1
    return JointLog(joints=JOINTS, t=t, q=q, q_des=q_des[newest], metadata={"kp": KP, "kd": KD})


def arm_model(folder) -> MachineModel:
    """Return the arm as its maker gives it: masses and friction are off by some per cent."""
    path = folder / "planar_arm.xml"
    path.write_text(MJCF, encoding="utf-8")
    return read_machine(path, {"kp": KP, "kd": KD})


def main() -> None:
    """Print one line for each clock and effect."""
    import tempfile
    from pathlib import Path

    from mimic.sysid.calibrate import calibrate

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clocks", nargs="*", default=list(CLOCKS), choices=list(CLOCKS))
    parser.add_argument("--effects", nargs="*", default=list(EFFECTS), choices=list(EFFECTS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=36.0)
    a = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        model = arm_model(Path(folder))
        for effect in a.effects:
            for clock in a.clocks:
                for seed in range(a.seeds):
                    log = arm_log(CLOCKS[clock], EFFECTS[effect], seconds=a.seconds, seed=seed)
                    began = time.monotonic()
                    made = calibrate(log, model, CalibrateSettings(threads=1))
                    delay = next(e for e in made.effects if e.name == "delay")
                    low, high = delay.intervals["time"][0]
                    left = made.final.held_out / made.noise
                    also = [n for one in made.alternatives for n, _ in one.effects]
                    print(
                        f"{effect:20} {clock:7} {seed} found {', '.join(made.names) or '-'}"
                        f"{' (or ' + ', '.join(also) + ')' if also else ''}; left {left.max():.2f} floors"
                        f" ({1e3 * (left * made.noise).max():.2f} mrad); delay {1e3 * delay.values['time'][0]:.2f}"
                        f" ({1e3 * low:.2f} to {1e3 * high:.2f}) ms {made.metadata['sending_times']};"
                        f" {'explained' if made.explained else 'not explained'};"
                        f" {time.monotonic() - began:.0f} s",
                        flush=True,
                    )


if __name__ == "__main__":
    main()

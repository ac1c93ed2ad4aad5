"""The laws of the catalogue as compiled code: what drives, gears, bearings and encoders do in one step.

Numbers are a table (S, J): a row for each parameter of the catalogue, the same in all joints for those of the whole
machine. States are a table too. `mimic.dynamics.law` has the same laws for a physics engine, but for heat: there the
torque limits do not fall with it, and what is left of the torque heats.
"""

from __future__ import annotations

import math

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.sysid.engine.tree import inlined

KEYS = tuple((e.name, p.name) for e in CATALOGUE.values() for p in e.parameters)
"""Rows of the table of numbers."""

ROW = {key: i for i, key in enumerate(KEYS)}

COULOMB = ROW["coulomb", "level"]
VISCOUS = ROW["viscous", "coefficient"]
FACTOR = ROW["link_mass", "factor"]
SHIFT = ROW["com_shift", "distance"]
LOAD = ROW["payload", "mass"]
ROLL = ROW["base_tilt", "roll"]
PITCH = ROW["base_tilt", "pitch"]
DELAY = ROW["delay", "time"]
JOINT_DELAY = ROW["joint_delay", "time"]
GOAL_TIME = ROW["target_filter", "time"]
ROTOR = ROW["armature", "inertia"]
KP = ROW["gains", "kp"]
KD = ROW["gains", "kd"]
KT = ROW["motor", "kt"]
OHM = ROW["motor", "resistance"]
TORQUE, SPEED, FLAT = (ROW["torque_speed", name] for name in ("torque", "speed", "flat"))
DROP = ROW["supply_sag", "drop"]
CONSTANT = ROW["kt_gain", "factor"]
DRIFT = ROW["kt_drift", "rate"]
LOSS = ROW["kt_heat", "loss"]
HEAT_TIME = ROW["kt_heat", "time"]
TORQUE_TIME = ROW["torque_lag", "time"]
SPEED_TIME = ROW["velocity_lag", "time"]
STRIBECK = ROW["stribeck", "level"]
STRIBECK_SPEED = ROW["stribeck", "speed"]
OF_LOAD = ROW["load_friction", "ratio"]
OF_GEAR = ROW["gear_load_friction", "ratio"]
ONE_WAY = ROW["asymmetric_friction", "level"]
ONE_WAY_SLOPE = ROW["asymmetric_friction", "coefficient"]
DRAG = ROW["quadratic_drag", "coefficient"]
COUPLING = ROW["coupling", "coefficient"]
GAP = ROW["backlash", "gap"]
TOUCH = ROW["backlash", "compliance"]
SOFT = ROW["compliance", "compliance"]
SOFT_DAMPING = ROW["compliance", "damping"]
OFFSET = ROW["encoder_offset", "angle"]
SCALE = ROW["encoder_scale", "factor"]
COSINE = ROW["encoder_eccentricity", "cosine"]
SINE = ROW["encoder_eccentricity", "sine"]
ENCODER_STEP = ROW["encoder_step", "angle"]
COG_COSINE, COG_SINE, COG_ORDER = (ROW["cogging", name] for name in ("cosine", "sine", "order"))
SPRING = ROW["spring", "stiffness"]
MOMENT = ROW["spring", "moment"]

STATES = 15
(Q, V, QM, VM, W, GOAL, SLOW, LAGGED, HEAT, CHANGE, TAU, PUSH, AIM, GAINED, GIVEN) = range(STATES)
"""Rows of the table of states: position and velocity of the link and of the motor, unknown torque, filtered target,
filtered speed, lagged torque, mean square of the current, acceleration of the motor in the last step, torque of the
motor, the friction impulse of the last step, which target is followed, acceleration of the link in the last step, and
the impulse of the motor since the row before."""

ACTS = 11
(ON_MOTOR, ON_LINK, DAMPING, MEAN, OTHERS, ASKED, LOW, HIGH, SLOWING, CHANGING, PLACE) = range(ACTS)
"""Rows of what drives do in a step: torque on the shaft, on the link beside, implicit damping, the motor's mean
torque, torque on the shaft beside it, torque asked for at the first speed, its limits, damping that changes it
within the step, the change of speed for which all this is, and the place of the shaft in the chain's equations."""

LEAST = 0.05
"""Least share of the torque constant, and of the supply, that is left."""


@inlined
def reads(p, j, angle):  # type: ignore[no-untyped-def]
    """Return what the encoder of a joint reads where its motor is at an angle."""
    read = angle
    if p[COSINE, j] != 0.0 or p[SINE, j] != 0.0:
        read += p[COSINE, j] * np.cos(angle) + p[SINE, j] * np.sin(angle)
    read = read * p[SCALE, j] + p[OFFSET, j]
    if p[ENCODER_STEP, j] > 0.0:
        read = np.round(read / p[ENCODER_STEP, j]) * p[ENCODER_STEP, j]
    return read


@inlined
def unread(p, j, reading):  # type: ignore[no-untyped-def]
    """Return the angle at which the encoder reads this."""
    turned = (reading - p[OFFSET, j]) / p[SCALE, j]
    angle = turned
    for _ in range(4):  # each leaves a fifth of the error or less
        angle = turned - p[COSINE, j] * np.cos(angle) - p[SINE, j] * np.sin(angle)
    return angle


@inlined
def elastic(p, j):  # type: ignore[no-untyped-def]
    """Return whether something gives between motor and link."""
    return p[SOFT, j] > 0.0 or p[GAP, j] > 0.0


@inlined
def slowed(state, first, change, time, h):  # type: ignore[no-untyped-def]
    """Return a first-order lag's state after a step in which what it follows changes evenly, and its mean during it."""
    ratio = time / h
    over = 1.0 - np.exp(-h / time)
    end = first + (state - first) * (1.0 - over) + change * (1.0 - ratio * over)
    return end, first + (state - first) * over * ratio + change * (0.5 - ratio * (1.0 - ratio * over))


@inlined
def limits(p, j, speed, supply, sagged):  # type: ignore[no-untyped-def]
    """Return the least and greatest torque of a motor at a speed: its line moves with a share of the supply, and where
    that sags also the torque that it is limited to.
    """
    most = p[TORQUE, j] * sagged
    none = p[SPEED, j] * supply
    slope = p[TORQUE, j] / max(p[SPEED, j] - p[FLAT, j], 1e-9)
    high = min(max((none - speed) * slope, 0.0), most)
    return -min(max((none + speed) * slope, 0.0), most), high


@inlined
def drive(p, s, acts, j, h, time, target, kp, kd, force, supply, sagged, volts):  # type: ignore[no-untyped-def]
    """Write what a motor does in a step.

    Args:
        p: Numbers (S, J).
        s: States (STATES, J), positions in the middle of the step; a filtered target is brought to its end.
        acts: What drives do (ACTS, J).
        j: Joint.
        h: Step [s].
        time: Since the beginning of the log [s].
        target: Followed throughout the step.
        kp: Gain of the log [N m/rad].
        kd: [N m s/rad]
        force: Torque asked for beside the targets [N m].
        supply: Share of the supply.
        sagged: That part of it which the motors' work leaves.
        volts: Supply of a voltage drive [V], 0 for a drive of torque.
    """
    constant = p[CONSTANT, j] * max(1.0 + p[DRIFT, j] * time / 100.0, LEAST)
    stiff = kp * constant * p[KP, j]
    damp = kd * constant * p[KD, j] * p[SCALE, j]
    stall = np.inf
    if volts > 0.0:
        stall = volts * supply * p[KT, j] / p[OHM, j]
        stiff *= supply
    if p[GOAL_TIME, j] > 0.0:
        s[GOAL, j], target = slowed(s[GOAL, j], target, 0.0, p[GOAL_TIME, j], h)
    seen = s[VM, j]
    share = 0.5
    if p[SPEED_TIME, j] > 0.0:
        seen = slowed(s[SLOW, j], seen, 0.0, p[SPEED_TIME, j], h)[1]
        share = slowed(0.0, 0.0, 1.0, p[SPEED_TIME, j], h)[1]
    middle = s[VM, j] + 0.5 * h * s[CHANGE, j]
    low, high = limits(p, j, middle, 1.0, 1.0) if volts > 0.0 else limits(p, j, middle, supply, sagged)
    left = heat_leaves(p, s, j)
    asked = min(max(stiff * (target - reads(p, j, s[QM, j])), -stall), stall) - damp * seen + force
    acts[ASKED, j] = left * asked
    acts[LOW, j] = left * low
    acts[HIGH, j] = left * high
    acts[SLOWING, j] = left * 2.0 * share * damp


@inlined
def heat_leaves(p, s, j):  # type: ignore[no-untyped-def]
    """Return the share of the torque that a hot motor makes of its current, which its drive limits."""
    return max(1.0 - p[LOSS, j] * s[HEAT, j], LEAST) if p[LOSS, j] != 0.0 else 1.0


@inlined
def driven(p, s, acts, j, h, change):  # type: ignore[no-untyped-def]
    """Bring lags, heat and torque of a motor to the end of a step in which its speed changed by so much."""
    if p[SPEED_TIME, j] > 0.0:
        s[SLOW, j] = slowed(s[SLOW, j], s[VM, j], change, p[SPEED_TIME, j], h)[0]
    if p[TORQUE_TIME, j] > 0.0:
        first = min(max(acts[ASKED, j], acts[LOW, j]), acts[HIGH, j])
        last = min(max(acts[ASKED, j] - acts[SLOWING, j] * change, acts[LOW, j]), acts[HIGH, j])
        s[LAGGED, j] = slowed(s[LAGGED, j], first, last - first, p[TORQUE_TIME, j], h)[0]
    if p[LOSS, j] != 0.0:
        current = acts[MEAN, j] / heat_leaves(p, s, j)
        s[HEAT, j] += h * (current * current - s[HEAT, j]) / p[HEAT_TIME, j]
    s[TAU, j] = acts[MEAN, j]
    s[GIVEN, j] += h * acts[MEAN, j]


@inlined
def below(asked, low, high):  # type: ignore[no-untyped-def]
    """Return the integral of a torque within its limits up to what is asked for."""
    within = min(max(asked, low), high)
    return 0.5 * within * within + (asked - within) * within


@inlined
def limited(p, s, acts, j, h, change):  # type: ignore[no-untyped-def]
    """Return the mean torque of a motor over a step in which its speed changes evenly by so much, and its damping by
    half of that: what is asked for may reach a limit, or leave it, within the step.
    """
    slowing = acts[SLOWING, j]
    low = acts[LOW, j]
    high = acts[HIGH, j]
    first = acts[ASKED, j]
    last = first - slowing * change
    begin = min(max(first, low), high)
    end = min(max(last, low), high)
    if p[TORQUE_TIME, j] > 0.0:
        mean = slowed(s[LAGGED, j], begin, end - begin, p[TORQUE_TIME, j], h)[1]
        share = slowed(0.0, 0.0, 1.0, p[TORQUE_TIME, j], h)[1]
        return mean, 2.0 * share * slowing if low < last < high else 0.0
    if abs(last - first) < 1e-9:
        return begin, slowing if low < first < high else 0.0
    mean = (below(last, low, high) - below(first, low, high)) / (last - first)
    return mean, 2.0 * slowing * (end - mean) / (last - first)


@inlined
def friction(p, s, j, torque, needed, change):  # type: ignore[no-untyped-def]
    """Return the dry friction of a joint against forward and against backward motion, under a torque of its motor and
    the one that its link needs, a mean over a step in which its speed changes evenly by so much.
    """
    level = p[COULOMB, j] + p[OF_LOAD, j] * abs(torque)
    if p[STRIBECK, j] != 0.0:
        first = s[VM, j] / p[STRIBECK_SPEED, j]
        by = change / p[STRIBECK_SPEED, j]
        share = np.exp(-((first + 0.5 * by) ** 2))
        if abs(by) > 1e-3:
            share = 0.5 * np.sqrt(np.pi) * (math.erf(first + by) - math.erf(first)) / by
        level += p[STRIBECK, j] * share
    if p[OF_GEAR, j] != 0.0:
        level += p[OF_GEAR, j] * abs(torque + needed)
    return max(level + p[ONE_WAY, j], 0.0), max(level - p[ONE_WAY, j], 0.0)


@inlined
def resisting(p, s, j, h, neighbour):  # type: ignore[no-untyped-def]
    """Return the torque on a motor's shaft that depends on its speed, beside viscous friction."""
    torque = 0.0
    middle = s[VM, j] + 0.5 * h * s[CHANGE, j]
    if p[DRAG, j] != 0.0:
        torque -= p[DRAG, j] * middle * abs(middle)
    if p[ONE_WAY_SLOPE, j] != 0.0:
        torque -= p[ONE_WAY_SLOPE, j] * abs(middle)
    if p[COUPLING, j] != 0.0:
        torque -= p[COUPLING, j] * (s[V, neighbour] + 0.5 * h * s[CHANGE, neighbour])
    return torque


@inlined
def placed(p, s, j):  # type: ignore[no-untyped-def]
    """Return the torques on a motor's shaft and on a link that depend on where they are."""
    on_motor = 0.0
    if p[COG_COSINE, j] != 0.0 or p[COG_SINE, j] != 0.0:
        turn = p[COG_ORDER, j] * s[QM, j]
        on_motor = p[COG_COSINE, j] * np.cos(turn) + p[COG_SINE, j] * np.sin(turn)
    return on_motor, p[MOMENT, j] - p[SPRING, j] * s[Q, j]


@inlined
def gear(p, s, j, h):  # type: ignore[no-untyped-def]
    """Return the torque of a transmission on its link at the old speeds, and what it gains with their change.

    Implicit midpoint rule: the twist in the middle of the step is that of constant speeds and a quarter of what their
    change adds, so that stiff gears are stable; with backlash the twist at its end, so that a contact that is noticed
    late gives nothing away.
    """
    apart = s[QM, j] - s[Q, j]
    half = 0.5 * p[GAP, j]
    over = apart - min(max(apart, -half), half)
    if over == 0.0 and half > 0.0:
        return 0.0, 0.0
    stiffness = 1.0 / (p[SOFT, j] if p[SOFT, j] > 0.0 else p[TOUCH, j])
    damping = 2.0 * p[SOFT_DAMPING, j] * np.sqrt(stiffness * max(p[ROTOR, j], 1e-5))
    against = s[VM, j] - s[V, j]
    if half > 0.0:
        return stiffness * (over + 0.5 * h * against) + damping * against, 0.5 * (stiffness * h + damping)
    return stiffness * over + damping * against, 0.25 * stiffness * h + 0.5 * damping

"""The laws of the catalogue as compiled code: what drives, gears, bearings and encoders do in one step.

Numbers are a table (S, J): a row for each parameter of the catalogue, the same in all joints for those of the whole
machine. States are a table too. `mimic.dynamics.law` has the same laws for a physics engine, but for heat: there the
torque limits do not fall with it, and what is left of the torque heats.
"""

from __future__ import annotations

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
filtered speed, lagged torque, mean square of the current, last change of the motor's speed, torque of the motor, the
friction impulse of the last step, which target is followed, the last change of the link's speed, and the impulse of the
motor since the row before."""

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
def slowed(state, wanted, time, h):  # type: ignore[no-untyped-def]
    """Return a first-order lag's state after a step, and its mean during the step."""
    left = np.exp(-h / time)
    return wanted + (state - wanted) * left, wanted + (state - wanted) * (1.0 - left) * time / h


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
def drive(p, s, j, h, time, first, second, share, kp, kd, force, supply, sagged, volts):  # type: ignore[no-untyped-def]
    """Return the mean torque of a motor over a step, its mean size, and the damping that is implicit in it.

    Args:
        p: Numbers (S, J).
        s: States (STATES, J), positions in the middle of the step; lags and heat are brought to its end.
        j: Joint.
        h: Step [s].
        time: Since the beginning of the log [s].
        first: Target at the beginning of the step.
        second: Target at its end.
        share: Share of the step that has the first.
        kp: Gain of the log [N m/rad].
        kd: [N m s/rad]
        force: Torque asked for beside the targets [N m].
        supply: Share of the supply.
        sagged: That part of it which the motors' work leaves.
        volts: Supply of a voltage drive [V], 0 for a drive of torque.
    """
    speed = s[VM, j]
    middle = s[VM, j] + 0.5 * s[CHANGE, j]
    constant = p[CONSTANT, j] * max(1.0 + p[DRIFT, j] * time / 100.0, LEAST)
    stiff = kp * constant * p[KP, j]
    damp = kd * constant * p[KD, j] * p[SCALE, j]
    stall = np.inf
    if volts > 0.0:
        stall = volts * supply * p[KT, j] / p[OHM, j]
        stiff *= supply
    if p[GOAL_TIME, j] > 0.0:
        wanted = share * first + (1.0 - share) * second
        s[GOAL, j], first = slowed(s[GOAL, j], wanted, p[GOAL_TIME, j], h)
        share = 1.0
    seen = speed
    implicit = True
    if p[SPEED_TIME, j] > 0.0:
        s[SLOW, j], seen = slowed(s[SLOW, j], middle, p[SPEED_TIME, j], h)
        implicit = False
    if p[TORQUE_TIME, j] > 0.0:
        implicit = False
        if p[SPEED_TIME, j] <= 0.0:
            seen = middle
    low, high = limits(p, j, middle, 1.0, 1.0) if volts > 0.0 else limits(p, j, middle, supply, sagged)
    read = reads(p, j, s[QM, j])
    mean = 0.0
    size = 0.0
    kept = 0.0
    for part in range(2):
        weight = share if part == 0 else 1.0 - share
        if weight <= 0.0:
            continue
        asked = min(max(stiff * ((first if part == 0 else second) - read), -stall), stall) - damp * seen + force
        given = min(max(asked, low), high)
        mean += weight * given
        size += weight * abs(given)
        if given == asked and implicit:
            kept += weight * damp
    if p[TORQUE_TIME, j] > 0.0:
        s[LAGGED, j], mean = slowed(s[LAGGED, j], mean, p[TORQUE_TIME, j], h)
        size = abs(mean)
    if p[LOSS, j] != 0.0:  # a drive limits the current, which heats; what it makes of that is less
        left = max(1.0 - p[LOSS, j] * s[HEAT, j], LEAST)
        s[HEAT, j] += h * (mean * mean - s[HEAT, j]) / p[HEAT_TIME, j]
        mean *= left
        size *= left
        kept *= left
    s[TAU, j] = mean
    s[GIVEN, j] += h * mean
    return mean, size, kept


@inlined
def friction(p, s, j, size, needed):  # type: ignore[no-untyped-def]
    """Return the dry friction of a joint against forward and against backward motion."""
    level = p[COULOMB, j] + p[OF_LOAD, j] * size
    if p[STRIBECK, j] != 0.0:
        level += p[STRIBECK, j] * np.exp(-((s[VM, j] / p[STRIBECK_SPEED, j]) ** 2))
    if p[OF_GEAR, j] != 0.0:
        level += p[OF_GEAR, j] * abs(s[TAU, j] + needed)
    return max(level + p[ONE_WAY, j], 0.0), max(level - p[ONE_WAY, j], 0.0)


@inlined
def resisting(p, s, j, neighbour):  # type: ignore[no-untyped-def]
    """Return the torque on a motor's shaft that depends on its speed, beside viscous friction."""
    torque = 0.0
    middle = s[VM, j] + 0.5 * s[CHANGE, j]
    if p[DRAG, j] != 0.0:
        torque -= p[DRAG, j] * middle * abs(middle)
    if p[ONE_WAY_SLOPE, j] != 0.0:
        torque -= p[ONE_WAY_SLOPE, j] * abs(middle)
    if p[COUPLING, j] != 0.0:
        torque -= p[COUPLING, j] * (s[V, neighbour] + 0.5 * s[CHANGE, neighbour])
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

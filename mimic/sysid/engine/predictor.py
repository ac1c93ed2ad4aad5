"""One pass over logs: a machine with a drive in each joint, predicted to the end of each block.

Leapfrog steps with damping and transmissions in the middle of the step (second order, stable at any stiffness of them);
dry friction is exact, so that what sticks does not creep; steps end where targets arrive, and torques reach their
limits within a step, so that a prediction is smooth in all numbers. Before a block ends, a second state follows the
readings by constant gains, with an unknown torque in each joint that decays, and is where the next block begins.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from mimic.records import BoolArray, FloatArray, IntArray
from mimic.sysid.engine.laws import (
    ACTS,
    AIM,
    ASKED,
    CHANGE,
    CHANGING,
    DAMPING,
    DELAY,
    DROP,
    FACTOR,
    GAINED,
    GAP,
    GIVEN,
    GOAL,
    JOINT_DELAY,
    KT,
    LEAST,
    LOAD,
    MEAN,
    OF_GEAR,
    OF_LOAD,
    OHM,
    ON_LINK,
    ON_MOTOR,
    OTHERS,
    PITCH,
    PUSH,
    QM,
    ROLL,
    ROTOR,
    SHIFT,
    STATES,
    STRIBECK,
    TAU,
    TOUCH,
    VISCOUS,
    VM,
    Q,
    V,
    W,
    drive,
    driven,
    elastic,
    friction,
    gear,
    limited,
    placed,
    reads,
    resisting,
    unread,
)
from mimic.sysid.engine.tree import (
    AT,
    BIAS,
    END,
    FAST_MATH,
    MOVING,
    REST,
    ROOM,
    STIFFNESS,
    Tree,
    dynamics,
    inlined,
    links_of,
    packed,
)

LOST = 1e3
"""What a pass says where the machine flew apart: speeds beyond it, and predictions from there on [rad/s, rad]."""

RING = 0.6
"""Share of a radian of the ringing of a contact in a step of `USUAL` at which contacts are met in time."""

USUAL = 1.25e-3
"""Step to which that refers [s]."""

TRIES = 4
"""Most solutions of a step: until torques are those of the speeds that they lead to."""

NEARLY = 1e-3
"""Share of friction by which it may be off where it depends on speed or torque."""

SAME = 1e-9
"""Times that are the same [s]."""

SWEEPS = 40
"""Most sweeps over the joints to find which stick; each leaves a part of the error that masses couple."""

EXACT = 1e-6
"""Share of the dry friction, and of the torque asked for, by which they may be off."""


class Record(NamedTuple):
    """Logs one after another, on one clock."""

    t: FloatArray
    """Time of each reading (T,) [s]."""
    y: FloatArray
    """Reading (T, J), not a number where there is none."""
    log: IntArray
    """Log of each row (T,)."""
    since: FloatArray
    """Time of each row since its log began (T,) [s]."""
    fresh: BoolArray
    """Rows at which a pass begins anew (T,)."""
    settled: BoolArray
    """Rows at which the start is forgotten (T,)."""
    lead: IntArray
    """1 where a second state leaves that of the prediction, 2 while it follows the readings, 3 where the prediction
    begins anew from it (T,)."""
    sent: FloatArray
    """When each target was sent (K,) [s]."""
    goal: FloatArray
    """Targets (K, J)."""
    force: FloatArray
    """Torque beside the targets, from each row to the next (T, J)."""
    on: FloatArray
    """1 where a drive is switched on (T, J)."""
    supply: FloatArray
    """Share of the supply (T,)."""
    kp: FloatArray
    """Of each log (L, J)."""
    kd: FloatArray
    """(L, J)"""
    payload: FloatArray
    """At the end of each link (L, J) [kg]."""
    volts: FloatArray
    """Supply of voltage drives, 0 for drives of torque (J,) [V]."""
    kt: FloatArray
    """That the gains of voltage drives were computed with (J,)."""
    ohm: FloatArray
    """(J,)"""
    neighbour: IntArray
    """(J,)"""


def gravity_of(gravity: FloatArray, roll: float, pitch: float) -> FloatArray:
    """Return gravity in the axes of a base turned by roll about x, then pitch about y."""
    cr = np.cos(roll)
    sr = np.sin(roll)
    cp = np.cos(pitch)
    sp = np.sin(pitch)
    across = sp * gravity[0] + cp * gravity[2]
    return np.array([cp * gravity[0] - sp * gravity[2], cr * gravity[1] + sr * across, cr * across - sr * gravity[1]])


@inlined
def inverted(a, m):  # type: ignore[no-untyped-def]
    """Invert the first m rows and columns of a symmetric positive matrix in place."""
    for k in range(m):
        pivot = 1.0 / a[k, k]
        for i in range(m):
            if i != k:
                by = a[i, k] * pivot
                for c in range(m):
                    if c != k:
                        a[i, c] -= by * a[k, c]
                a[i, k] = -by
        for c in range(m):
            if c != k:
                a[k, c] *= pivot
        a[k, k] = pivot


@inlined
def braked(a, m, solve):  # type: ignore[no-untyped-def]
    """Let dry friction act on velocities for a step: impulses within bounds that stop what they can.

    Args:
        a: Inverse of the masses (m, m).
        m: Joints and rotors.
        solve: Velocities without friction, bounds, and the impulses of the last step, with which the search begins
            (m, 5); velocities and impulses are changed.
    """
    most = 0.0
    for i in range(m):
        push = min(max(solve[i, LAST], -solve[i, FORWARD]), solve[i, BACKWARD])
        solve[i, LAST] = push
        most = max(most, solve[i, FORWARD], solve[i, BACKWARD])
        if push != 0.0:
            for c in range(m):
                solve[c, FAST] += a[c, i] * push
    for _ in range(SWEEPS):
        moved = 0.0
        for i in range(m):
            push = solve[i, LAST]
            new = min(max(push - solve[i, FAST] / a[i, i], -solve[i, FORWARD]), solve[i, BACKWARD])
            by = new - push
            if by != 0.0:
                solve[i, LAST] = new
                for c in range(m):
                    solve[c, FAST] += a[c, i] * by
                moved = max(moved, abs(by))
        if moved <= EXACT * most:
            break


FAST, FORWARD, BACKWARD, LAST, PUSHED, SOLVE = range(6)
"""Columns of the equations of a step: velocity, largest friction impulses against forward and backward motion, the last
impulse, and that of all other forces."""

READING, ADDED, STIFF, DAMP, INPUTS = range(5)
"""Columns of a row of a log: reading, torque beside the targets, gains, which are 0 where the drive is off."""

TIME, SINCE, SUPPLY, CLOCK = range(4)

LOG, FRESH, SETTLED, LEAD, MARKS = range(5)

VOLTS, OWN_KT, OWN_OHM, NEIGHBOUR, MOTOR = range(5)


class Arrays(NamedTuple):
    """A record and a tree as a pass takes them: few arrays, since compiled code counts references to each."""

    joints: IntArray
    shape: FloatArray
    clock: FloatArray
    """(T, 3)"""
    inputs: FloatArray
    """(T, J, 4)"""
    marks: IntArray
    """(T, 4)"""
    sent: FloatArray
    goal: FloatArray
    motors: FloatArray
    """(J, 4)"""
    payload: FloatArray
    own: tuple[FloatArray, ...]
    """Masses, centres, inertias, directions and tips of the links."""
    gravity: FloatArray


def arrays_of(tree: Tree, record: Record) -> Arrays:
    """Return a tree and a record as a pass takes them."""
    joints, shape = packed(tree)
    kp = record.kp[record.log] * record.on
    kd = record.kd[record.log] * record.on
    return Arrays(
        joints=joints,
        shape=shape,
        clock=np.stack([record.t, record.since, record.supply], -1),
        inputs=np.stack([record.y, record.force, kp, kd], -1),
        marks=np.stack([record.log, record.fresh, record.settled, record.lead], -1).astype(np.int64),
        sent=record.sent,
        goal=record.goal,
        motors=np.stack([record.volts, record.kt, record.ohm, record.neighbour.astype(float)], -1),
        payload=record.payload,
        own=(tree.mass, tree.centre, tree.inertia, tree.toward, tree.tip),
        gravity=tree.gravity,
    )


def part_of(whole: Arrays, own: slice) -> Arrays:
    """Return one chain of a machine and its logs."""
    before = np.array([own.start, 0, own.start, own.start])
    joints = whole.joints[own] - before
    joints[:, 0] = np.maximum(joints[:, 0], -1)
    motors = whole.motors[own].copy()
    motors[:, NEIGHBOUR] -= own.start
    return whole._replace(
        joints=joints,
        shape=whole.shape[own],
        inputs=np.ascontiguousarray(whole.inputs[:, own]),
        goal=np.ascontiguousarray(whole.goal[:, own]),
        motors=motors,
        payload=np.ascontiguousarray(whole.payload[:, own]),
        own=tuple(one[own] for one in whole.own),
    )


@inlined
def supply_left(p, s):  # type: ignore[no-untyped-def]
    """Return the share of the supply that is left while motors do the work of the last step."""
    if p[DROP, 0] == 0.0:
        return 1.0
    drawn = 0.0
    for j in range(s.shape[1]):
        drawn += max(s[TAU, j] * s[VM, j], 0.0)
    return max(1.0 - p[DROP, 0] * drawn, LEAST)


@inlined
def until(sent, p, s, begin, end):  # type: ignore[no-untyped-def]
    """Let all drives follow the targets that have arrived; return when the next one does, or the end of a step."""
    for j in range(s.shape[1]):
        late = p[DELAY, j] + p[JOINT_DELAY, j]
        aim = int(s[AIM, j])
        while aim + 1 < len(sent) and sent[aim + 1] + late <= begin + SAME:
            aim += 1
        s[AIM, j] = aim
        if aim + 1 < len(sent) and sent[aim + 1] + late < end - SAME:
            end = sent[aim + 1] + late
    return end


@inlined
def act(p, s, acts, j, h, change):  # type: ignore[no-untyped-def]
    """Let a motor act in a step in which its speed changes by so much."""
    torque, slowing = limited(p, s, acts, j, h, change)
    acts[CHANGING, j] = change
    acts[MEAN, j] = torque
    acts[ON_MOTOR, j] = acts[OTHERS, j] + torque + 0.5 * slowing * change
    acts[DAMPING, j] = p[VISCOUS, j] + slowing


@inlined
def ask(clock, inputs, goal, motors, p, s, acts, i, begin, h):  # type: ignore[no-untyped-def]
    """Let all drives and outer torques act for a step on the way to row i."""
    sagged = supply_left(p, s)
    left = sagged * clock[i, SUPPLY]
    since = clock[i - 1, SINCE] + begin - clock[i - 1, TIME]
    for j in range(s.shape[1]):
        target = goal[int(s[AIM, j]), j]
        kp = inputs[i - 1, j, STIFF]
        kd = inputs[i - 1, j, DAMP]
        volts = motors[j, VOLTS]
        if volts > 0.0:
            more = p[KT, j] / motors[j, OWN_KT] * motors[j, OWN_OHM] / p[OHM, j]
            kp = kp * more
            kd = kd * more * p[KT, j] / motors[j, OWN_KT]
        drive(p, s, acts, j, h, since, target, kp, kd, inputs[i - 1, j, ADDED], left, sagged, volts)
        on_motor, acts[ON_LINK, j] = placed(p, s, j)
        others = on_motor + resisting(p, s, j, h, int(motors[j, NEIGHBOUR])) - p[VISCOUS, j] * s[VM, j] + s[W, j]
        acts[OTHERS, j] = others
        act(p, s, acts, j, h, h * s[CHANGE, j])


@inlined
def equations(joints, shape, p, s, acts, room, mass, a, solve, begin, h):  # type: ignore[no-untyped-def]
    """Write the masses (C, C), forces and friction of a chain with its rotors; return how many there are."""
    end = joints[begin, END]
    m = end - begin
    count = m
    for j in range(begin, end):
        count += 1 if elastic(p, j) else 0
    for i in range(count):
        for c in range(count):
            a[i, c] = mass[begin + i, begin + c] if i < m and c < m else 0.0
    row = m
    for j in range(begin, end):
        i = j - begin
        spring = shape[j, STIFFNESS] * (s[Q, j] - shape[j, REST])
        forward, backward = friction(p, s, j, acts[MEAN, j], room[j, BIAS], acts[CHANGING, j])
        inertia = p[ROTOR, j] + 0.5 * h * acts[DAMPING, j]
        link = acts[ON_LINK, j] - room[j, BIAS] - spring
        at = i
        if elastic(p, j):
            at = row
            row += 1
            torque, implicit = gear(p, s, j, h)
            a[i, i] += h * implicit
            a[i, at] -= h * implicit
            a[at, i] -= h * implicit
            a[at, at] = inertia + h * implicit
            solve[i, PUSHED] = h * (torque + link)
            solve[at, PUSHED] = h * (acts[ON_MOTOR, j] - torque)
            solve[i, FORWARD] = solve[i, BACKWARD] = solve[i, LAST] = 0.0
        else:
            a[i, i] += inertia
            solve[i, PUSHED] = h * (acts[ON_MOTOR, j] + link)
        solve[at, FORWARD] = h * forward
        solve[at, BACKWARD] = h * backward
        solve[at, LAST] = s[PUSH, j]
        solve[i, FAST] = s[V, j]
        solve[at, FAST] = s[VM, j]
    return count


@inlined
def changed(p, s, acts, room, solve, begin, end, h):  # type: ignore[no-untyped-def]
    """Let the motors and the friction of a chain act as they do at the speeds found; return whether that is other than
    it was.
    """
    other = False
    row = end - begin
    for j in range(begin, end):
        at = j - begin
        if elastic(p, j):
            at = row
            row += 1
        change = solve[at, FAST] - s[VM, j]
        before = acts[ON_MOTOR, j] - acts[OTHERS, j] - 0.5 * (acts[DAMPING, j] - p[VISCOUS, j]) * change
        act(p, s, acts, j, h, change)
        other = other or abs(acts[MEAN, j] - before) > EXACT * abs(acts[ASKED, j])
        if p[STRIBECK, j] != 0.0 or p[OF_LOAD, j] != 0.0 or p[OF_GEAR, j] != 0.0:
            forward, backward = friction(p, s, j, acts[MEAN, j], room[j, BIAS], change)
            off = max(abs(h * forward - solve[at, FORWARD]), abs(h * backward - solve[at, BACKWARD]))
            other = other or off > NEARLY * h * (forward + backward)
    return other


@inlined
def move(joints, shape, p, s, acts, room, mass, a, solve, h):  # type: ignore[no-untyped-def]
    """Bring the velocities of all joints and rotors to the end of a step."""
    n = s.shape[1]
    begin = 0
    while begin < n:
        end = joints[begin, END]
        for _ in range(TRIES):
            count = equations(joints, shape, p, s, acts, room, mass, a, solve, begin, h)
            inverted(a, count)
            for i in range(count):
                change = 0.0
                for c in range(count):
                    change += a[i, c] * solve[c, PUSHED]
                solve[i, FAST] += change
            braked(a, count, solve)
            if not changed(p, s, acts, room, solve, begin, end, h):
                break
        row = end - begin
        for j in range(begin, end):
            at = j - begin
            s[GAINED, j] = (solve[at, FAST] - s[V, j]) / h
            s[V, j] = solve[at, FAST]
            if elastic(p, j):
                at = row
                row += 1
            change = solve[at, FAST] - s[VM, j]
            driven(p, s, acts, j, h, change)
            s[CHANGE, j] = change / h
            s[VM, j] = solve[at, FAST]
            s[PUSH, j] = solve[at, LAST]
        begin = end


@inlined
def begin_at(clock, inputs, sent, goal, p, s, i):  # type: ignore[no-untyped-def]
    """Let a pass begin at rest at the readings of a row."""
    for j in range(s.shape[1]):
        for k in range(STATES):
            s[k, j] = 0.0
        row = i
        while row + 1 < len(clock) and not np.isfinite(inputs[row, j, READING]):
            row += 1
        s[Q, j] = unread(p, j, inputs[row, j, READING])
        s[QM, j] = s[Q, j]
        aim = 0
        while aim + 1 < len(sent) and sent[aim + 1] <= clock[i, TIME] - p[DELAY, j] - p[JOINT_DELAY, j]:
            aim += 1
        s[AIM, j] = aim
        s[GOAL, j] = goal[aim, j]


@inlined
def write(p, s, out, i, gap):  # type: ignore[no-untyped-def]
    """Write what is predicted of a row, a time after the one before."""
    for j in range(s.shape[1]):
        out[0, i, j] = reads(p, j, s[QM, j])
        out[1, i, j] = s[W, j]
        out[2, i, j] = s[GIVEN, j] / gap
        s[GIVEN, j] = 0.0


@inlined
def correct(p, s, inputs, gains, i, log, block):  # type: ignore[no-untyped-def]
    """Correct a state by what was read in a row."""
    for j in range(s.shape[1]):
        on = 1 if inputs[i, j, STIFF] > 0.0 else 0
        off = inputs[i, j, READING] - reads(p, j, s[QM, j])
        if np.isfinite(off):
            s[Q, j] += gains[log, block, on, j, 0] * off
            s[QM, j] += gains[log, block, on, j, 0] * off
            s[V, j] += gains[log, block, on, j, 1] * off
            s[VM, j] += gains[log, block, on, j, 1] * off
            s[W, j] += gains[log, block, on, j, 2] * off
        s[GIVEN, j] = 0.0


@inlined
def copied(s, other):  # type: ignore[no-untyped-def]
    """Copy a table of states to another."""
    for k in range(STATES):
        for j in range(s.shape[1]):
            other[k, j] = s[k, j]


@inlined
def half(p, s, h):  # type: ignore[no-untyped-def]
    """Bring positions half of a step on; return whether the machine holds together."""
    whole = True
    for j in range(s.shape[1]):
        s[Q, j] += 0.5 * h * s[V, j]
        s[QM, j] += 0.5 * h * s[VM, j]
        whole = whole and abs(s[V, j]) < LOST and abs(s[VM, j]) < LOST
    return whole


@njit(cache=True, error_model="numpy", fastmath=FAST_MATH, _nrt=False)  # type: ignore[call-overload]
def advanced(machine, logs, p, s, rooms, i, steps, h, kept):  # type: ignore[no-untyped-def]
    """Bring a state to row i; return whether the machine holds together."""
    joints, shape, loads, pull = machine
    clock, inputs, marks, sent, goal, motors = logs
    room, mass, acts, a, solve = rooms
    for k in range(steps):
        now = clock[i - 1, TIME] + k * h
        end = now + h
        while now < end:
            then = until(sent, p, s, now, end)
            part = then - now
            half(p, s, part)
            for j in range(s.shape[1]):
                room[j, AT] = s[Q, j]
                room[j, MOVING] = s[V, j] + 0.5 * part * s[GAINED, j]
            dynamics(joints, shape, loads, marks[i, LOG], pull, room, mass)
            ask(clock, inputs, goal, motors, p, s, acts, i, now, part)
            move(joints, shape, p, s, acts, room, mass, a, solve, part)
            if not half(p, s, part):
                return False
            now = then
        for j in range(s.shape[1]):
            s[W, j] *= kept
    return True


def predict(arrays: Arrays, p: FloatArray, gains: FloatArray, decay: float, step: float, follow: bool) -> FloatArray:
    """Return what a machine with some numbers is predicted to do: to the end of each block, or reading by reading.

    Args:
        arrays: The machine and its logs.
        p: Numbers (S, J).
        gains: Corrections of position, velocity and unknown torque for each radian (L, 2, 2, J, 3): of the first
            start, which also follow every reading, and of those of blocks; of drives that are off, and on.
        decay: Time constant of the unknown torque [s].
        step: Longest step [s].
        follow: Whether every reading corrects the state, and not only those before a block.

    Returns:
        Predicted readings, unknown torques, and those of the motors, means since the row before (3, T, J); `LOST` from
        where the machine flew apart to the end of a block.
    """
    n = p.shape[1]
    mass, centre, inertia, toward, tip = arrays.own
    factor = p[FACTOR]
    shift = p[SHIFT]
    loads = [links_of(mass, centre, inertia, toward, tip, factor, shift, p[LOAD] + load) for load in arrays.payload]
    pull = gravity_of(arrays.gravity, p[ROLL, 0], p[PITCH, 0])
    touching = p[GAP] > 0.0
    ring = np.sqrt(1.0 / (p[TOUCH] * np.maximum(p[ROTOR], 1e-5)))[touching].max(initial=0.0) * USUAL
    step *= min(1.0, RING / max(ring, 1e-9))
    out = np.zeros((3, *arrays.inputs.shape[:2]))
    shapes = (n, ROOM), (n, n), (ACTS, n), (2 * n, 2 * n), (2 * n, SOLVE)
    rooms = tuple(np.zeros(shape) for shape in shapes)
    both = np.zeros((STATES, n)), np.zeros((STATES, n))
    machine = arrays.joints, arrays.shape, np.stack(loads), pull
    logs = arrays.clock, arrays.inputs, arrays.marks, arrays.sent, arrays.goal, arrays.motors
    _pass(machine, logs, p, gains, (decay, step, follow), rooms, both, out)
    return out


@njit(cache=True, error_model="numpy", fastmath=FAST_MATH, nogil=True, _nrt=False)  # type: ignore[call-overload]
def _pass(machine, logs, p, gains, how, rooms, both, out):  # type: ignore[no-untyped-def]
    """Write a pass to `out` with the room that it needs."""
    clock, inputs, marks, sent, goal, _ = logs
    states, beside = both
    decay, step, follow = how
    n = inputs.shape[1]
    lost = False
    for i in range(len(clock)):
        log = marks[i, LOG]
        lead = marks[i, LEAD]
        if marks[i, FRESH]:
            lost = False
            begin_at(clock, inputs, sent, goal, p, states, i)
            write(p, states, out, i, 1.0)
            correct(p, states, inputs, gains, i, log, 0)
            continue
        gap = clock[i, TIME] - clock[i - 1, TIME]
        steps = max(int(np.ceil(gap / step - 1e-3)), 1)
        h = gap / steps
        kept = np.exp(-h / decay)
        if not lost:
            lost = not advanced(machine, logs, p, states, rooms, i, steps, h, kept)
        if lead > 1 and not advanced(machine, logs, p, beside, rooms, i, steps, h, kept):
            begin_at(clock, inputs, sent, goal, p, beside, i)
        if lost:
            for j in range(n):
                out[0, i, j] = LOST
        else:
            write(p, states, out, i, gap)
        if not lost and (follow or not marks[i, SETTLED]):
            correct(p, states, inputs, gains, i, log, 0)
        if lead == 1 and lost:
            begin_at(clock, inputs, sent, goal, p, beside, i)
        elif lead == 1:
            copied(states, beside)
        if lead > 0:
            correct(p, beside, inputs, gains, i, log, 1)
        if lead == 3:
            copied(beside, states)
            lost = False


def compiled() -> bool:
    """Return whether a pass was compiled before, which takes half a minute, and is kept on disk."""
    made: Any = _pass
    return any(Path(made.stats.cache_path).glob("predictor._pass-*.nbi"))

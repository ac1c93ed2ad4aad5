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

from mimic.dynamics.machine import tilted_gravity
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
    PLACE,
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
from mimic.sysid.engine.tree import AT, BIAS, FAST_MATH, MOVING, Tree, dynamics, inlined, links_of, room_of

DECAY = 0.1
"""Time constant of the unknown torque [s]: slower than a reading, faster than a motion."""

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
    gravity: FloatArray
    """In base axes (3,) [m/s^2]."""

    def part(self, own: slice) -> Record:
        """Return the rows of some chains."""
        names = ("y", "goal", "force", "on", "kp", "kd", "payload", "volts", "kt", "ohm", "neighbour")
        made = self._replace(**{name: np.array(getattr(self, name)[..., own], order="C") for name in names})
        return made._replace(neighbour=made.neighbour - own.start)


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
def ask(record, p, s, acts, i, begin, h):  # type: ignore[no-untyped-def]
    """Let all drives and outer torques act for a step on the way to row i."""
    sagged = supply_left(p, s)
    left = sagged * record.supply[i]
    since = record.since[i - 1] + begin - record.t[i - 1]
    log = record.log[i]
    for j in range(s.shape[1]):
        target = record.goal[int(s[AIM, j]), j]
        kp = record.kp[log, j] * record.on[i - 1, j]
        kd = record.kd[log, j] * record.on[i - 1, j]
        volts = record.volts[j]
        if volts > 0.0:
            more = p[KT, j] / record.kt[j] * record.ohm[j] / p[OHM, j]
            kp = kp * more
            kd = kd * more * p[KT, j] / record.kt[j]
        drive(p, s, acts, j, h, since, target, kp, kd, record.force[i - 1, j], left, sagged, volts)
        on_motor, acts[ON_LINK, j] = placed(p, s, j)
        others = on_motor + resisting(p, s, j, h, record.neighbour[j]) - p[VISCOUS, j] * s[VM, j] + s[W, j]
        acts[OTHERS, j] = others
        act(p, s, acts, j, h, h * s[CHANGE, j])


@inlined
def equations(tree, p, s, acts, room, mass, a, solve, begin, end, h):  # type: ignore[no-untyped-def]
    """Write the masses (C, C), forces and friction of a chain with its rotors; return how many there are."""
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
        spring = tree.stiffness[j] * (s[Q, j] - tree.rest[j])
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
        acts[PLACE, j] = at
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
    for j in range(begin, end):
        at = int(acts[PLACE, j])
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
def move(tree, p, s, acts, room, mass, a, solve, h):  # type: ignore[no-untyped-def]
    """Bring the velocities of all joints and rotors to the end of a step, one chain after another."""
    n = s.shape[1]
    begin = 0
    while begin < n:
        end = begin + 1
        while end < n and tree.parent[end] >= 0:
            end += 1
        for _ in range(TRIES):
            count = equations(tree, p, s, acts, room, mass, a, solve, begin, end, h)
            inverted(a, count)
            for i in range(count):
                change = 0.0
                for c in range(count):
                    change += a[i, c] * solve[c, PUSHED]
                solve[i, FAST] += change
            braked(a, count, solve)
            if not changed(p, s, acts, room, solve, begin, end, h):
                break
        for j in range(begin, end):
            s[GAINED, j] = (solve[j - begin, FAST] - s[V, j]) / h
            s[V, j] = solve[j - begin, FAST]
            at = int(acts[PLACE, j])
            change = solve[at, FAST] - s[VM, j]
            driven(p, s, acts, j, h, change)
            s[CHANGE, j] = change / h
            s[VM, j] = solve[at, FAST]
            s[PUSH, j] = solve[at, LAST]
        begin = end


@inlined
def begin_at(record, p, s, i):  # type: ignore[no-untyped-def]
    """Let a pass begin at rest at the readings of a row."""
    for j in range(s.shape[1]):
        for k in range(STATES):
            s[k, j] = 0.0
        row = i
        while row + 1 < len(record.t) and not np.isfinite(record.y[row, j]):
            row += 1
        s[Q, j] = unread(p, j, record.y[row, j])
        s[QM, j] = s[Q, j]
    until(record.sent, p, s, record.t[i], record.t[i])
    for j in range(s.shape[1]):
        s[GOAL, j] = record.goal[int(s[AIM, j]), j]


@inlined
def write(p, s, out, i, gap):  # type: ignore[no-untyped-def]
    """Write what is predicted of a row, a time after the one before."""
    for j in range(s.shape[1]):
        out[0, i, j] = reads(p, j, s[QM, j])
        out[1, i, j] = s[W, j]
        out[2, i, j] = s[GIVEN, j] / gap
        s[GIVEN, j] = 0.0


@inlined
def correct(record, p, s, gains, i, block):  # type: ignore[no-untyped-def]
    """Correct a state by what was read in a row."""
    log = record.log[i]
    for j in range(s.shape[1]):
        on = 1 if record.kp[log, j] * record.on[i, j] > 0.0 else 0
        off = record.y[i, j] - reads(p, j, s[QM, j])
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
def advanced(tree, record, loads, p, s, rooms, i, steps, h, kept):  # type: ignore[no-untyped-def]
    """Bring a state to row i; return whether the machine holds together."""
    room, mass, acts, a, solve = rooms
    for k in range(steps):
        now = record.t[i - 1] + k * h
        end = now + h
        while now < end:
            then = until(record.sent, p, s, now, end)
            part = then - now
            half(p, s, part)
            for j in range(s.shape[1]):
                room[j, AT] = s[Q, j]
                room[j, MOVING] = s[V, j] + 0.5 * part * s[GAINED, j]
            dynamics(tree, loads, record.log[i], room, mass)
            ask(record, p, s, acts, i, now, part)
            move(tree, p, s, acts, room, mass, a, solve, part)
            if not half(p, s, part):
                return False
            now = then
        for j in range(s.shape[1]):
            s[W, j] *= kept
    return True


def predict(
    tree: Tree, record: Record, p: FloatArray, gains: FloatArray, step: float, follow: bool = False
) -> FloatArray:
    """Return what a machine with some numbers is predicted to do: to the end of each block, or reading by reading.

    Args:
        tree: The machine.
        record: Its logs.
        p: Numbers (S, J).
        gains: Corrections of position, velocity and unknown torque for each radian (L, 2, 2, J, 3): of the first
            start, which also follow every reading, and of those of blocks; of drives that are off, and on.
        step: Longest step [s].
        follow: Whether every reading corrects the state, and not only those before a block.

    Returns:
        Predicted readings, unknown torques, and those of the motors, means since the row before (3, T, J); `LOST` from
        where the machine flew apart to the end of a block.
    """
    n = p.shape[1]
    loads = np.stack([links_of(tree, p[FACTOR], p[SHIFT], p[LOAD] + load) for load in record.payload])
    touching = p[GAP] > 0.0
    ring = np.sqrt(1.0 / (p[TOUCH] * np.maximum(p[ROTOR], 1e-5)))[touching].max(initial=0.0) * USUAL
    step *= min(1.0, RING / max(ring, 1e-9))
    out = np.zeros((3, *record.y.shape))
    shapes = (n, n), (ACTS, n), (2 * n, 2 * n), (2 * n, SOLVE)
    room = room_of(n, tilted_gravity(p[ROLL, 0], p[PITCH, 0], record.gravity))
    rooms = (room, *(np.zeros(shape) for shape in shapes))
    both = np.zeros((STATES, n)), np.zeros((STATES, n))
    _pass(tree, record, loads, p, gains, step, follow, rooms, both, out)
    return out


@njit(cache=True, error_model="numpy", fastmath=FAST_MATH, nogil=True, _nrt=False)  # type: ignore[call-overload]
def _pass(tree, record, loads, p, gains, step, follow, rooms, both, out):  # type: ignore[no-untyped-def]
    """Write a pass to `out` with the room that it needs."""
    states, beside = both
    lost = False
    for i in range(len(record.t)):
        lead = record.lead[i]
        if record.fresh[i]:
            lost = False
            begin_at(record, p, states, i)
            write(p, states, out, i, 1.0)
            correct(record, p, states, gains, i, 0)
            continue
        gap = record.t[i] - record.t[i - 1]
        steps = max(int(np.ceil(gap / step - 1e-3)), 1)
        h = gap / steps
        kept = np.exp(-h / DECAY)
        if not lost:
            lost = not advanced(tree, record, loads, p, states, rooms, i, steps, h, kept)
        if lead > 1 and not advanced(tree, record, loads, p, beside, rooms, i, steps, h, kept):
            begin_at(record, p, beside, i)
        if lost:
            for j in range(p.shape[1]):
                out[0, i, j] = LOST
        else:
            write(p, states, out, i, gap)
        if not lost and (follow or not record.settled[i]):
            correct(record, p, states, gains, i, 0)
        if lead == 1 and lost:
            begin_at(record, p, beside, i)
        elif lead == 1:
            copied(states, beside)
        if lead > 0:
            correct(record, p, beside, gains, i, 1)
        if lead == 3:
            copied(beside, states)
            lost = False


def compiled() -> bool:
    """Return whether a pass was compiled before, which takes half a minute, and is kept on disk."""
    made: Any = _pass
    return any(Path(made.stats.cache_path).glob("predictor._pass-*.nbi"))

"""One pass over logs: a machine with a drive in each joint, corrected at every reading by constant gains.

Leapfrog steps with damping and transmissions in the middle of the step (second order, stable at any stiffness of them);
dry friction is exact, so that what sticks does not creep; a step in which a target arrives has the torque of each
target for its share of the time. The unknown torque of each joint decays and is known by the corrections only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from mimic.records import BoolArray, FloatArray, IntArray
from mimic.sysid.innovations.laws import (
    CHANGE,
    DELAY,
    DROP,
    FACTOR,
    GOAL,
    JOINT_DELAY,
    KT,
    LEAST,
    LOAD,
    OHM,
    PITCH,
    PUSH,
    QM,
    ROLL,
    ROTOR,
    SHIFT,
    SLOW,
    STATES,
    TAU,
    VISCOUS,
    VM,
    Q,
    V,
    W,
    drive,
    elastic,
    friction,
    gear,
    placed,
    reads,
    resisting,
    unread,
)
from mimic.sysid.innovations.tree import dynamics, links_of, scratch_of

LOST = 1e3
"""What a pass says where the machine flew apart: speeds beyond it, and predictions from there on [rad/s, rad]."""

SWEEPS = 40
"""Most sweeps over the joints to find which stick; each leaves a part of the error that masses couple."""

EXACT = 1e-6
"""Share of the dry friction by which it may be off."""


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


@njit(cache=True, error_model="numpy")
def gravity_of(gravity, roll, pitch):  # type: ignore[no-untyped-def]
    """Return gravity in the axes of a base turned by roll about x, then pitch about y."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    out = np.empty(3)
    out[0] = cp * gravity[0] - sp * gravity[2]
    across = sp * gravity[0] + cp * gravity[2]
    out[1] = cr * gravity[1] + sr * across
    out[2] = cr * across - sr * gravity[1]
    return out


@njit(cache=True, error_model="numpy")
def inverted(a, m):  # type: ignore[no-untyped-def]
    """Invert the first m rows and columns of a symmetric positive matrix in place."""
    if m == 1:
        a[0, 0] = 1.0 / a[0, 0]
        return
    if m == 2:
        d = 1.0 / (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0])
        x, y, z = a[0, 0], a[0, 1], a[1, 1]
        a[0, 0], a[1, 1] = z * d, x * d
        a[0, 1] = a[1, 0] = -y * d
        return
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


@njit(cache=True, error_model="numpy")
def braked(a, m, dv, forward, backward, push):  # type: ignore[no-untyped-def]
    """Let dry friction act on velocities dv (m,) for a step: impulses within bounds that stop what they can.

    Args:
        a: Inverse of the masses (m, m).
        m: Joints and rotors.
        dv: Velocities without friction; changed.
        forward: Largest impulse against forward motion (m,).
        backward: Against backward motion (m,).
        push: Impulses of the last step, with which the search begins; changed.
    """
    most = 0.0
    for i in range(m):
        push[i] = min(max(push[i], -forward[i]), backward[i])
        most = max(most, forward[i], backward[i])
        if push[i] != 0.0:
            for c in range(m):
                dv[c] += a[c, i] * push[i]
    for _ in range(SWEEPS):
        moved = 0.0
        for i in range(m):
            new = min(max(push[i] - dv[i] / a[i, i], -forward[i]), backward[i])
            by = new - push[i]
            if by != 0.0:
                push[i] = new
                for c in range(m):
                    dv[c] += a[c, i] * by
                moved = max(moved, abs(by))
        if moved <= EXACT * most:
            break


class Room(NamedTuple):
    """What one step computes on the way, by joint, and the equations of one chain with its rotors."""

    torque: FloatArray
    """On the motor's shaft (J,)."""
    link: FloatArray
    """On the link beside (J,)."""
    damping: FloatArray
    """Implicit (J,)."""
    size: FloatArray
    """Mean size of the motor's torque (J,)."""
    a: FloatArray
    dv: FloatArray
    forward: FloatArray
    backward: FloatArray
    push: FloatArray
    pushed: FloatArray
    """Friction impulses of the last step, of links and rotors (2 J,)."""
    at: IntArray
    """Target in effect in each joint (J,)."""


@njit(cache=True, error_model="numpy")
def room_of(n):  # type: ignore[no-untyped-def]
    """Return room for so many joints."""
    return Room(
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros((2 * n, 2 * n)),
        np.zeros(2 * n),
        np.zeros(2 * n),
        np.zeros(2 * n),
        np.zeros(2 * n),
        np.zeros(2 * n),
        np.zeros(n, dtype=np.int64),
    )


@njit(cache=True, error_model="numpy")
def ask(record, p, s, room, i, now, h, since):  # type: ignore[no-untyped-def]
    """Let all drives and outer torques act for a step from a time on, which ends before row i."""
    n, log = len(room.torque), record.log[i]
    left = 1.0
    if p[DROP, 0] != 0.0:
        drawn = 0.0
        for j in range(n):
            drawn += max(s[TAU, j] * s[VM, j], 0.0)
        left = max(1.0 - p[DROP, 0] * drawn, LEAST)
    for j in range(n):
        begin = now - p[DELAY, j] - p[JOINT_DELAY, j]
        k = room.at[j]
        while k + 1 < len(record.sent) and record.sent[k + 1] <= begin:
            k += 1
        first = second = record.goal[k, j]
        share = 1.0
        if k + 1 < len(record.sent) and record.sent[k + 1] < begin + h:
            share = (record.sent[k + 1] - begin) / h
            second = record.goal[k + 1, j]
        room.at[j] = k
        kp, kd = record.kp[log, j] * record.on[i - 1, j], record.kd[log, j] * record.on[i - 1, j]
        if record.volts[j] > 0.0:
            more = p[KT, j] / record.kt[j] * record.ohm[j] / p[OHM, j]
            kp, kd = kp * more, kd * more * p[KT, j] / record.kt[j]
        supply = record.supply[i] * left
        torque, size, kept = drive(
            p, s, j, h, since, first, second, share, kp, kd, record.force[i - 1, j], supply, record.volts[j]
        )
        on_motor, on_link = placed(p, s, j)
        torque += on_motor + resisting(p, s, j, record.neighbour[j]) - p[VISCOUS, j] * s[VM, j] + s[W, j]
        room.torque[j], room.link[j], room.size[j] = torque, on_link, size
        room.damping[j] = p[VISCOUS, j] + kept


@njit(cache=True, error_model="numpy")
def move(tree, p, s, room, dyn, h):  # type: ignore[no-untyped-def]
    """Bring the velocities of all joints and rotors to the end of a step."""
    n = len(room.torque)
    a, dv = room.a, room.dv
    begin = 0
    while begin < n:
        end = tree.end[begin]
        m = end - begin
        count = m
        for j in range(begin, end):
            if elastic(p, j):
                count += 1
        a[:count, :count] = 0.0
        row = m
        for j in range(begin, end):
            i = j - begin
            for c in range(m):
                a[i, c] = dyn.mass[j, begin + c]
            spring = tree.stiffness[j] * (s[Q, j] - tree.rest[j])
            forward, backward = friction(p, s, j, room.size[j], dyn.bias[j])
            inertia = p[ROTOR, j] + 0.5 * h * room.damping[j]
            at = i
            if elastic(p, j):
                at = row
                row += 1
                torque, implicit = gear(p, s, j, h)
                a[i, i] += h * implicit
                a[i, at] -= h * implicit
                a[at, i] -= h * implicit
                a[at, at] = inertia + h * implicit
                dv[i] = torque + room.link[j] - dyn.bias[j] - spring
                dv[at] = room.torque[j] - torque
                room.forward[i] = room.backward[i] = 0.0
                room.push[i] = 0.0
            else:
                a[i, i] += inertia
                dv[i] = room.torque[j] + room.link[j] - dyn.bias[j] - spring
            room.forward[at], room.backward[at] = h * forward, h * backward
            room.push[at] = s[PUSH, j]
        inverted(a, count)
        impulse = room.pushed
        for i in range(count):
            impulse[i] = h * dv[i]
        row = m
        for i in range(count):
            change = 0.0
            for c in range(count):
                change += a[i, c] * impulse[c]
            if i < m:
                dv[i] = s[V, begin + i] + change
            else:
                dv[i] = change
        for j in range(begin, end):
            if elastic(p, j):
                dv[row] += s[VM, j]
                row += 1
        braked(a, count, dv, room.forward, room.backward, room.push)
        row = m
        for j in range(begin, end):
            s[V, j] = dv[j - begin]
            before = s[VM, j]
            at = j - begin
            if elastic(p, j):
                at = row
                row += 1
            s[VM, j] = dv[at]
            s[CHANGE, j] = dv[at] - before
            s[PUSH, j] = room.push[at]
        begin = end


@njit(cache=True, error_model="numpy")
def begin_at(record, p, s, room, i):  # type: ignore[no-untyped-def]
    """Let a pass begin at rest at the readings of a row."""
    s[:] = 0.0
    k = 0
    for j in range(len(room.torque)):
        row = i
        while row + 1 < len(record.t) and not np.isfinite(record.y[row, j]):
            row += 1
        s[Q, j] = s[QM, j] = unread(p, j, record.y[row, j])
        while k + 1 < len(record.sent) and record.sent[k + 1] <= record.t[i] - p[DELAY, j] - p[JOINT_DELAY, j]:
            k += 1
        room.at[j] = 0
        s[GOAL, j] = record.goal[k, j]


@njit(cache=True, error_model="numpy")
def correct(p, s, y, gains, predicted, unknown, torque):  # type: ignore[no-untyped-def]
    """Write what is predicted of a row (J,), and correct the state by what was read."""
    for j in range(len(y)):
        predicted[j] = reads(p, j, s[QM, j])
        unknown[j], torque[j] = s[W, j], s[TAU, j]
        off = y[j] - predicted[j]
        if np.isfinite(off):
            s[Q, j] += gains[j, 0] * off
            s[QM, j] += gains[j, 0] * off
            s[V, j] += gains[j, 1] * off
            s[VM, j] += gains[j, 1] * off
            s[W, j] += gains[j, 2] * off


@njit(cache=True, error_model="numpy")
def advance(tree, record, p, s, links, gravity, i, step, decay, room, dyn):  # type: ignore[no-untyped-def]
    """Step from row i - 1 to row i; return whether the machine holds together."""
    n = len(room.torque)
    gap = record.t[i] - record.t[i - 1]
    steps = max(int(np.ceil(gap / step - 1e-3)), 1)
    h = gap / steps
    kept = np.exp(-h / decay)
    mid = np.empty(n)
    for k in range(steps):
        now = record.t[i - 1] + k * h
        for j in range(n):
            s[Q, j] += 0.5 * h * s[V, j]
            s[QM, j] += 0.5 * h * s[VM, j]
            mid[j] = s[V, j] + 0.5 * s[CHANGE, j] if not elastic(p, j) else s[V, j]
        dynamics(tree, links, gravity, s[Q], mid, dyn)
        ask(record, p, s, room, i, now, h, record.since[i - 1] + k * h)
        move(tree, p, s, room, dyn, h)
        for j in range(n):
            s[Q, j] += 0.5 * h * s[V, j]
            s[QM, j] += 0.5 * h * s[VM, j]
            s[W, j] *= kept
            if not abs(s[V, j]) < LOST or not abs(s[VM, j]) < LOST:
                return False
    return True


@njit(cache=True, error_model="numpy", nogil=True)
def predict(tree, record, p, gains, decay, step, predicted, unknown, torque):  # type: ignore[no-untyped-def]
    """Write what a machine with these numbers is predicted to do, reading by reading.

    Args:
        tree: The machine.
        record: Its logs.
        p: Numbers (S, J).
        gains: Corrections of position, velocity and unknown torque for each radian (L, 2, J, 3): while the start is
            sought, and after.
        decay: Time constant of the unknown torque [s].
        step: Longest step [s].
        predicted: Takes the readings (T, J).
        unknown: Takes the unknown torque (T, J).
        torque: Takes that of the motors (T, J).

    Returns:
        Whether the machine held together.
    """
    n = record.y.shape[1]
    s = np.zeros((STATES, n))
    room, dyn = room_of(n), scratch_of(n)
    gravity = gravity_of(tree.gravity, p[ROLL, 0], p[PITCH, 0])
    links = links_of(tree, p[FACTOR], p[SHIFT], p[LOAD])
    for i in range(len(record.t)):
        if record.fresh[i]:
            links = links_of(tree, p[FACTOR], p[SHIFT], p[LOAD] + record.payload[record.log[i]])
            begin_at(record, p, s, room, i)
        elif not advance(tree, record, p, s, links, gravity, i, step, decay, room, dyn):
            predicted[i:] = LOST
            unknown[i:] = 0.0
            torque[i:] = 0.0
            return False
        own = gains[record.log[i], 1 if record.settled[i] else 0]
        correct(p, s, record.y[i], own, predicted[i], unknown[i], torque[i])
    return True

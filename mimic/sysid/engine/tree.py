"""A tree of hinge and slide joints on a fixed base: mass matrix and bias forces, compiled.

All spatial vectors are in world axes about the world's origin, so that nothing is transformed on the way to the base.
Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 5 and 6.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numba import njit

from mimic.dynamics.machine import MachineModel
from mimic.records import BoolArray, FloatArray, IntArray

FAST_MATH = {"contract", "reassoc", "arcp", "nsz"}
"""What compiled code may do to sums and products; it keeps what is not a number."""

inlined = njit(  # type: ignore[call-overload]
    cache=True, error_model="numpy", fastmath=FAST_MATH, forceinline=True, _nrt=False
)
"""Compiles parts of a pass. Nothing in them makes an array, so that none counts references, half of the time;
what is compiled into another module is not made anew when it changes here: delete ``__pycache__`` then."""


class Tree(NamedTuple):
    """A machine in the frames of its joints: origin on the axis, z along it. Arrays begin with the joints (J,)."""

    parent: IntArray
    """Joint before, -1 at the base."""
    slide: BoolArray
    rotation: FloatArray
    """Axes of the frame in those of the joint before, at position zero (J, 3, 3)."""
    offset: FloatArray
    """Its origin there (J, 3) [m]."""
    zero: FloatArray
    """Position at which the model was drawn [rad or m]."""
    mass: FloatArray
    """[kg]"""
    centre: FloatArray
    """Centre of mass (J, 3) [m]."""
    inertia: FloatArray
    """About the centre of mass (J, 3, 3) [kg m^2]."""
    toward: FloatArray
    """Unit vector to the end of the link (J, 3)."""
    tip: FloatArray
    """End of the link (J, 3) [m]."""
    gravity: FloatArray
    """In base axes (3,) [m/s^2]."""
    stiffness: FloatArray
    """Of the model's springs [N m/rad]."""
    rest: FloatArray
    """Where these are slack [rad]."""
    first: IntArray
    """First joint of the chain."""
    end: IntArray
    """One beyond its last."""


def tree_of(machine: MachineModel) -> Tree:
    """Return the tree of a machine; links without a joint of their own belong to the one that carries them."""
    model = machine.model
    count = len(machine.joints)
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    owner = _owners(model)
    axes = np.stack([_axes_along(data.xaxis[j]) for j in range(count)])
    anchor = np.array(data.xanchor)
    parent = np.array([_joint_before(model, owner, j) for j in range(count)])
    mass = np.zeros(count)
    centre = np.zeros((count, 3))
    inertia = np.zeros((count, 3, 3))
    for j in range(count):
        links = [b for b in range(1, model.nbody) if owner[b] == j]
        mass[j], whole, about = _joined(model, data, links)
        centre[j] = axes[j].T @ (whole - anchor[j])
        inertia[j] = axes[j].T @ about @ axes[j]
    rotation = axes.copy()
    offset = anchor.copy()
    for j in np.flatnonzero(parent >= 0):
        rotation[j] = axes[parent[j]].T @ axes[j]
        offset[j] = axes[parent[j]].T @ (anchor[j] - anchor[parent[j]])
    link = np.array(data.xmat).reshape(-1, 3, 3)[machine.body]
    ends = np.array(data.xpos)[machine.body] + np.einsum("jab,jb->ja", link, machine.tip)
    toward = np.einsum("jab,jb->ja", link, machine.toward)
    chain = np.asarray(machine.chain)
    return Tree(
        parent=parent,
        slide=np.array(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE),
        rotation=rotation,
        offset=offset,
        zero=np.array(model.qpos0),
        mass=mass,
        centre=centre,
        inertia=inertia,
        toward=np.einsum("jba,jb->ja", axes, toward),
        tip=np.einsum("jba,jb->ja", axes, ends - anchor),
        gravity=np.array(model.opt.gravity),
        stiffness=np.array(model.jnt_stiffness, dtype=float).reshape(count, -1)[:, 0].copy(),
        rest=np.array(model.qpos_spring),
        first=np.array([int(np.flatnonzero(chain == c)[0]) for c in chain]),
        end=np.array([int(np.flatnonzero(chain == c)[-1]) + 1 for c in chain]),
    )


def _owners(model: Any) -> IntArray:
    """Return the last joint that moves each body (B,), -1 where none does."""
    owner = np.full(model.nbody, -1)
    for b in range(1, model.nbody):
        own = model.body_jntadr[b] + model.body_jntnum[b] - 1
        owner[b] = own if model.body_jntnum[b] else owner[model.body_parentid[b]]
    return owner


def _joint_before(model: Any, owner: IntArray, j: int) -> int:
    b = int(model.jnt_bodyid[j])
    return j - 1 if j > model.body_jntadr[b] else int(owner[model.body_parentid[b]])


def _axes_along(axis: FloatArray) -> FloatArray:
    """Return axes as columns, the third along a unit vector (3, 3)."""
    across = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(across, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], -1)


def _joined(model: Any, data: Any, links: list[int]) -> tuple[float, FloatArray, FloatArray]:
    """Return mass, centre of mass and inertia about it of some bodies together, world axes."""
    mass = float(sum(model.body_mass[b] for b in links))
    if mass <= 0.0:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    centre = sum(model.body_mass[b] * data.xipos[b] for b in links) / mass
    about = np.zeros((3, 3))
    for b in links:
        turned = np.array(data.ximat[b]).reshape(3, 3)
        away = data.xipos[b] - centre
        about += turned @ np.diag(model.body_inertia[b]) @ turned.T
        about += model.body_mass[b] * (away @ away * np.eye(3) - np.outer(away, away))
    return mass, np.asarray(centre), about


LINK = 10
"""Numbers of a rigid body: mass, mass times centre (3), inertia about the origin xx xy xz yy yz zz."""

FRAME = 0
ORIGIN = 9
SCREW = 12
BODY = 18
SPEED = 28
RATE = 34
FORCE = 40
BIAS = 46
AT = 47
MOVING = 48
ROOM = 49
"""Columns of the room of a joint: axes (row by row), origin, unit motion, composite body, spatial velocity,
acceleration and force, bias force, position, velocity; one array for all, since compiled code counts references to
every array that it touches."""

PARENT, SLIDE, FIRST, END = range(4)
"""Columns of the joints as whole numbers."""

OFFSET = 9
ZERO = 12
STIFFNESS = 13
REST = 14
SHAPE = 15
"""Columns of their geometry, after the rotation row by row."""


def packed(tree: Tree) -> tuple[IntArray, FloatArray]:
    """Return a tree as whole numbers (J, 4) and geometry (J, 15)."""
    whole = np.stack([tree.parent, tree.slide, tree.first, tree.end], -1).astype(np.int64)
    turned = tree.rotation.reshape(len(whole), 9)
    rest = np.stack([tree.zero, tree.stiffness, tree.rest], -1)
    return whole, np.ascontiguousarray(np.concatenate([turned, tree.offset, rest], axis=1))


@inlined
def cross(a, b, c, x, y, z):  # type: ignore[no-untyped-def]
    """Return the cross product of two vectors given by their components."""
    return b * z - c * y, c * x - a * z, a * y - b * x


@inlined
def place(joints, shape, room):  # type: ignore[no-untyped-def]
    """Write axes, origins and unit motions of all joints at their positions."""
    for i in range(len(joints)):
        before = joints[i, PARENT]
        turn = room[i, AT] - shape[i, ZERO]
        for a in range(3):
            r = FRAME + 3 * a
            if before < 0:
                x = shape[i, r]
                y = shape[i, r + 1]
                z = shape[i, r + 2]
                at = shape[i, OFFSET + a]
            else:
                u = room[before, r]
                v = room[before, r + 1]
                w = room[before, r + 2]
                x = u * shape[i, 0] + v * shape[i, 3] + w * shape[i, 6]
                y = u * shape[i, 1] + v * shape[i, 4] + w * shape[i, 7]
                z = u * shape[i, 2] + v * shape[i, 5] + w * shape[i, 8]
                at = room[before, ORIGIN + a]
                at += u * shape[i, OFFSET] + v * shape[i, OFFSET + 1] + w * shape[i, OFFSET + 2]
            room[i, r] = x
            room[i, r + 1] = y
            room[i, r + 2] = z
            room[i, ORIGIN + a] = at
        if joints[i, SLIDE]:
            for a in range(3):
                along = room[i, FRAME + 3 * a + 2]
                room[i, ORIGIN + a] += along * turn
                room[i, SCREW + a] = 0.0
                room[i, SCREW + 3 + a] = along
        else:
            c = np.cos(turn)
            s = np.sin(turn)
            for a in range(3):
                r = FRAME + 3 * a
                x = room[i, r]
                y = room[i, r + 1]
                room[i, r] = c * x + s * y
                room[i, r + 1] = c * y - s * x
                room[i, SCREW + a] = room[i, r + 2]
            x = room[i, ORIGIN]
            y = room[i, ORIGIN + 1]
            z = room[i, ORIGIN + 2]
            u, v, w = cross(x, y, z, room[i, SCREW], room[i, SCREW + 1], room[i, SCREW + 2])
            room[i, SCREW + 3] = u
            room[i, SCREW + 4] = v
            room[i, SCREW + 5] = w


@inlined
def weigh(loads, log, room):  # type: ignore[no-untyped-def]
    """Write each link's numbers about the world's origin in world axes, from those in its own frame (L, J, 10)."""
    for i in range(loads.shape[1]):
        m = loads[log, i, 0]
        cx = loads[log, i, 1]
        cy = loads[log, i, 2]
        cz = loads[log, i, 3]
        hx = room[i, 0] * cx + room[i, 1] * cy + room[i, 2] * cz
        hy = room[i, 3] * cx + room[i, 4] * cy + room[i, 5] * cz
        hz = room[i, 6] * cx + room[i, 7] * cy + room[i, 8] * cz
        k = BODY + 4
        for a in range(3):
            u = room[i, 3 * a]
            v = room[i, 3 * a + 1]
            w = room[i, 3 * a + 2]
            x = u * loads[log, i, 4] + v * loads[log, i, 5] + w * loads[log, i, 6]
            y = u * loads[log, i, 5] + v * loads[log, i, 7] + w * loads[log, i, 8]
            z = u * loads[log, i, 6] + v * loads[log, i, 8] + w * loads[log, i, 9]
            for b in range(a, 3):
                room[i, k] = x * room[i, 3 * b] + y * room[i, 3 * b + 1] + z * room[i, 3 * b + 2]
                k += 1
        px = room[i, ORIGIN]
        py = room[i, ORIGIN + 1]
        pz = room[i, ORIGIN + 2]
        gx = 2.0 * hx + m * px
        gy = 2.0 * hy + m * py
        gz = 2.0 * hz + m * pz
        trace = px * gx + py * gy + pz * gz
        room[i, BODY + 4] += trace - px * gx
        room[i, BODY + 5] -= px * hy + py * hx + m * px * py
        room[i, BODY + 6] -= px * hz + pz * hx + m * px * pz
        room[i, BODY + 7] += trace - py * gy
        room[i, BODY + 8] -= py * hz + pz * hy + m * py * pz
        room[i, BODY + 9] += trace - pz * gz
        room[i, BODY] = m
        room[i, BODY + 1] = hx + m * px
        room[i, BODY + 2] = hy + m * py
        room[i, BODY + 3] = hz + m * pz


@inlined
def momentum(room, i, s):  # type: ignore[no-untyped-def]
    """Return angular and linear momentum about the origin of a joint's body at the spatial velocity in column s."""
    b = BODY
    a = s
    wx = room[i, a]
    wy = room[i, a + 1]
    wz = room[i, a + 2]
    vx = room[i, a + 3]
    vy = room[i, a + 4]
    vz = room[i, a + 5]
    hx = room[i, b + 1]
    hy = room[i, b + 2]
    hz = room[i, b + 3]
    x, y, z = cross(hx, hy, hz, vx, vy, vz)
    u, v, w = cross(wx, wy, wz, hx, hy, hz)
    m = room[i, b]
    return (
        room[i, b + 4] * wx + room[i, b + 5] * wy + room[i, b + 6] * wz + x,
        room[i, b + 5] * wx + room[i, b + 7] * wy + room[i, b + 8] * wz + y,
        room[i, b + 6] * wx + room[i, b + 8] * wy + room[i, b + 9] * wz + z,
        m * vx + u,
        m * vy + v,
        m * vz + w,
    )


@inlined
def forces(joints, gravity, room):  # type: ignore[no-untyped-def]
    """Write the spatial force that each link needs at the velocities, without acceleration of the joints."""
    for i in range(len(joints)):
        before = joints[i, PARENT]
        dq = room[i, MOVING]
        for k in range(6):
            room[i, SPEED + k] = room[i, SCREW + k] * dq
            room[i, RATE + k] = 0.0 if k < 3 else -gravity[k - 3]
        if before >= 0:
            for k in range(6):
                room[i, SPEED + k] += room[before, SPEED + k]
                room[i, RATE + k] = room[before, RATE + k]
        s0 = room[i, SCREW] * dq
        s1 = room[i, SCREW + 1] * dq
        s2 = room[i, SCREW + 2] * dq
        s3 = room[i, SCREW + 3] * dq
        s4 = room[i, SCREW + 4] * dq
        s5 = room[i, SCREW + 5] * dq
        w0 = room[i, SPEED]
        w1 = room[i, SPEED + 1]
        w2 = room[i, SPEED + 2]
        v0 = room[i, SPEED + 3]
        v1 = room[i, SPEED + 4]
        v2 = room[i, SPEED + 5]
        x, y, z = cross(w0, w1, w2, s0, s1, s2)
        room[i, RATE] += x
        room[i, RATE + 1] += y
        room[i, RATE + 2] += z
        x, y, z = cross(w0, w1, w2, s3, s4, s5)
        u, g, w = cross(v0, v1, v2, s0, s1, s2)
        room[i, RATE + 3] += x + u
        room[i, RATE + 4] += y + g
        room[i, RATE + 5] += z + w
        f0, f1, f2, f3, f4, f5 = momentum(room, i, RATE)
        l0, l1, l2, p0, p1, p2 = momentum(room, i, SPEED)
        x, y, z = cross(w0, w1, w2, l0, l1, l2)
        u, g, w = cross(v0, v1, v2, p0, p1, p2)
        room[i, FORCE] = f0 + x + u
        room[i, FORCE + 1] = f1 + y + g
        room[i, FORCE + 2] = f2 + z + w
        x, y, z = cross(w0, w1, w2, p0, p1, p2)
        room[i, FORCE + 3] = f3 + x
        room[i, FORCE + 4] = f4 + y
        room[i, FORCE + 5] = f5 + z


@inlined
def gather(joints, room, mass):  # type: ignore[no-untyped-def]
    """Write mass matrix (J, J) and bias forces, from the last joint to the base; bodies become composite ones."""
    for i in range(len(joints) - 1, -1, -1):
        before = joints[i, PARENT]
        bias = 0.0
        for k in range(6):
            bias += room[i, SCREW + k] * room[i, FORCE + k]
        room[i, BIAS] = bias
        if before >= 0:
            for k in range(6):
                room[before, FORCE + k] += room[i, FORCE + k]
            for k in range(LINK):
                room[before, BODY + k] += room[i, BODY + k]
        a, b, c, x, y, z = momentum(room, i, SCREW)
        j = i
        while j >= 0:
            own = room[j, SCREW] * a + room[j, SCREW + 1] * b + room[j, SCREW + 2] * c
            own += room[j, SCREW + 3] * x + room[j, SCREW + 4] * y + room[j, SCREW + 5] * z
            mass[i, j] = own
            mass[j, i] = own
            j = joints[j, PARENT]


@inlined
def dynamics(joints, shape, loads, log, gravity, room, mass):  # type: ignore[no-untyped-def]
    """Write mass matrix and bias forces (gravity, Coriolis, centrifugal) at the positions and velocities in the room.

    Args:
        joints: Whole numbers of the tree (J, 4).
        shape: Its geometry (J, 15).
        loads: Numbers of its links in their frames (L, J, 10) with the load of each log: mass, mass times centre,
            inertia about the frame's origin.
        log: Which of these.
        gravity: In base axes (3,) [m/s^2].
        room: Positions and velocities, and takes the bias forces (J, 49).
        mass: Takes the mass matrix (J, J).
    """
    place(joints, shape, room)
    weigh(loads, log, room)
    forces(joints, gravity, room)
    gather(joints, room, mass)


@njit(cache=True, error_model="numpy")
def links_of(mass, centre, inertia, toward, tip, factor, shift, load):  # type: ignore[no-untyped-def]
    """Return the numbers of all links (J, 10), as `Tree` has them but with masses scaled by a factor, centres shifted
    toward the tip and tips loaded, each (J,).
    """
    count = len(mass)
    out = np.zeros((count, LINK))
    for j in range(count):
        m = mass[j] * factor[j]
        square = 0.0
        k = 4
        for a in range(3):
            c = centre[j, a] + shift[j] * toward[j, a]
            out[j, 1 + a] = m * c + load[j] * tip[j, a]
            square += m * c * c + load[j] * tip[j, a] * tip[j, a]
            for b in range(a, 3):
                other = centre[j, b] + shift[j] * toward[j, b]
                out[j, k] = inertia[j, a, b] * factor[j] - m * c * other - load[j] * tip[j, a] * tip[j, b]
                k += 1
        out[j, 4] += square
        out[j, 7] += square
        out[j, 9] += square
        out[j, 0] = m + load[j]
    return out

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
    model, count = machine.model, len(machine.joints)
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    owner = _owners(model)
    axes = np.stack([_axes_along(data.xaxis[j]) for j in range(count)])
    anchor = np.array(data.xanchor)
    parent = np.array([_joint_before(model, owner, j) for j in range(count)])
    mass, centre, inertia = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))
    for j in range(count):
        links = [b for b in range(1, model.nbody) if owner[b] == j]
        mass[j], whole, about = _joined(model, data, links)
        centre[j] = axes[j].T @ (whole - anchor[j])
        inertia[j] = axes[j].T @ about @ axes[j]
    rotation, offset = axes.copy(), anchor.copy()
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
    mass = sum(float(model.body_mass[b]) for b in links)
    if mass <= 0.0:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    centre = sum(model.body_mass[b] * data.xipos[b] for b in links) / mass
    about = np.zeros((3, 3))
    for b in links:
        turned = np.array(data.ximat[b]).reshape(3, 3)
        away = data.xipos[b] - centre
        about += turned @ np.diag(model.body_inertia[b]) @ turned.T
        about += model.body_mass[b] * (away @ away * np.eye(3) - np.outer(away, away))
    return mass, centre, about


LINK = 10
"""Numbers of a rigid body: mass, mass times centre (3), inertia about the origin xx xy xz yy yz zz."""


@njit(cache=True, error_model="numpy")
def cross(a, b, c, x, y, z):  # type: ignore[no-untyped-def]
    """Return the cross product of two vectors given by their components."""
    return b * z - c * y, c * x - a * z, a * y - b * x


@njit(cache=True, error_model="numpy")
def place(tree, q, frame, origin, screw):  # type: ignore[no-untyped-def]
    """Write the axes (J, 3, 3), origins (J, 3) and unit motions (J, 6) of all joints at positions q (J,)."""
    for i in range(len(q)):
        r, before = tree.rotation[i], tree.parent[i]
        turn = q[i] - tree.zero[i]
        for a in range(3):
            if before < 0:
                x, y, z = r[a, 0], r[a, 1], r[a, 2]
                at = tree.offset[i, a]
            else:
                u = frame[before]
                x = u[a, 0] * r[0, 0] + u[a, 1] * r[1, 0] + u[a, 2] * r[2, 0]
                y = u[a, 0] * r[0, 1] + u[a, 1] * r[1, 1] + u[a, 2] * r[2, 1]
                z = u[a, 0] * r[0, 2] + u[a, 1] * r[1, 2] + u[a, 2] * r[2, 2]
                at = origin[before, a] + (
                    u[a, 0] * tree.offset[i, 0] + u[a, 1] * tree.offset[i, 1] + u[a, 2] * tree.offset[i, 2]
                )
            frame[i, a, 0], frame[i, a, 1], frame[i, a, 2] = x, y, z
            origin[i, a] = at
        f = frame[i]
        if tree.slide[i]:
            for a in range(3):
                origin[i, a] += f[a, 2] * turn
                screw[i, a], screw[i, 3 + a] = 0.0, f[a, 2]
        else:
            c, s = np.cos(turn), np.sin(turn)
            for a in range(3):
                x, y = f[a, 0], f[a, 1]
                f[a, 0], f[a, 1] = c * x + s * y, c * y - s * x
                screw[i, a] = f[a, 2]
            o = origin[i]
            screw[i, 3], screw[i, 4], screw[i, 5] = cross(o[0], o[1], o[2], f[0, 2], f[1, 2], f[2, 2])


@njit(cache=True, error_model="numpy")
def weigh(links, frame, origin, body):  # type: ignore[no-untyped-def]
    """Write each link's numbers (J, 10) about the world's origin in world axes, from those in its own frame."""
    for i in range(len(links)):
        f, o, own, out = frame[i], origin[i], links[i], body[i]
        m = own[0]
        hx = f[0, 0] * own[1] + f[0, 1] * own[2] + f[0, 2] * own[3]
        hy = f[1, 0] * own[1] + f[1, 1] * own[2] + f[1, 2] * own[3]
        hz = f[2, 0] * own[1] + f[2, 1] * own[2] + f[2, 2] * own[3]
        k = 4
        for a in range(3):
            x = f[a, 0] * own[4] + f[a, 1] * own[5] + f[a, 2] * own[6]
            y = f[a, 0] * own[5] + f[a, 1] * own[7] + f[a, 2] * own[8]
            z = f[a, 0] * own[6] + f[a, 1] * own[8] + f[a, 2] * own[9]
            for b in range(a, 3):
                out[k] = x * f[b, 0] + y * f[b, 1] + z * f[b, 2]
                k += 1
        px, py, pz = o[0], o[1], o[2]
        gx, gy, gz = 2.0 * hx + m * px, 2.0 * hy + m * py, 2.0 * hz + m * pz
        trace = px * gx + py * gy + pz * gz
        out[4] += trace - px * gx
        out[5] -= px * hy + py * hx + m * px * py
        out[6] -= px * hz + pz * hx + m * px * pz
        out[7] += trace - py * gy
        out[8] -= py * hz + pz * hy + m * py * pz
        out[9] += trace - pz * gz
        out[0], out[1], out[2], out[3] = m, hx + m * px, hy + m * py, hz + m * pz


@njit(cache=True, error_model="numpy")
def momentum(b, s):  # type: ignore[no-untyped-def]
    """Return angular and linear momentum about the origin of a body (10,) that moves by a spatial velocity (6,)."""
    x, y, z = cross(b[1], b[2], b[3], s[3], s[4], s[5])
    u, v, w = cross(s[0], s[1], s[2], b[1], b[2], b[3])
    return (
        b[4] * s[0] + b[5] * s[1] + b[6] * s[2] + x,
        b[5] * s[0] + b[7] * s[1] + b[8] * s[2] + y,
        b[6] * s[0] + b[8] * s[1] + b[9] * s[2] + z,
        b[0] * s[3] + u,
        b[0] * s[4] + v,
        b[0] * s[5] + w,
    )


@njit(cache=True, error_model="numpy")
def forces(tree, gravity, dq, screw, body, speed, rate, force):  # type: ignore[no-untyped-def]
    """Write the force (J, 6) that each link needs at velocities dq (J,) without acceleration of the joints."""
    for i in range(len(dq)):
        s, before, v, a = screw[i], tree.parent[i], speed[i], rate[i]
        for k in range(6):
            v[k] = s[k] * dq[i]
            a[k] = 0.0
        if before >= 0:
            for k in range(6):
                v[k] += speed[before, k]
                a[k] = rate[before, k]
        else:
            for k in range(3):
                a[3 + k] = -gravity[k]
        x, y, z = cross(v[0], v[1], v[2], s[0], s[1], s[2])
        a[0] += x * dq[i]
        a[1] += y * dq[i]
        a[2] += z * dq[i]
        x, y, z = cross(v[0], v[1], v[2], s[3], s[4], s[5])
        u, g, w = cross(v[3], v[4], v[5], s[0], s[1], s[2])
        a[3] += (x + u) * dq[i]
        a[4] += (y + g) * dq[i]
        a[5] += (z + w) * dq[i]
        f = force[i]
        f[0], f[1], f[2], f[3], f[4], f[5] = momentum(body[i], a)
        l0, l1, l2, p0, p1, p2 = momentum(body[i], v)
        x, y, z = cross(v[0], v[1], v[2], l0, l1, l2)
        u, g, w = cross(v[3], v[4], v[5], p0, p1, p2)
        f[0] += x + u
        f[1] += y + g
        f[2] += z + w
        x, y, z = cross(v[0], v[1], v[2], p0, p1, p2)
        f[3] += x
        f[4] += y
        f[5] += z


@njit(cache=True, error_model="numpy")
def gather(tree, screw, body, force, mass, bias):  # type: ignore[no-untyped-def]
    """Write mass matrix (J, J) and bias forces (J,), from the last joint to the base; bodies become composite ones."""
    for i in range(len(bias) - 1, -1, -1):
        s, f, before = screw[i], force[i], tree.parent[i]
        bias[i] = s[0] * f[0] + s[1] * f[1] + s[2] * f[2] + s[3] * f[3] + s[4] * f[4] + s[5] * f[5]
        if before >= 0:
            for k in range(6):
                force[before, k] += f[k]
            for k in range(10):
                body[before, k] += body[i, k]
        a, b, c, x, y, z = momentum(body[i], s)
        j = i
        while j >= 0:
            r = screw[j]
            mass[i, j] = r[0] * a + r[1] * b + r[2] * c + r[3] * x + r[4] * y + r[5] * z
            mass[j, i] = mass[i, j]
            j = tree.parent[j]


class Scratch(NamedTuple):
    """Room for the dynamics of one simulation."""

    frame: FloatArray
    origin: FloatArray
    screw: FloatArray
    body: FloatArray
    speed: FloatArray
    rate: FloatArray
    force: FloatArray
    mass: FloatArray
    bias: FloatArray


@njit(cache=True, error_model="numpy")
def scratch_of(count):  # type: ignore[no-untyped-def]
    """Return room for so many joints."""
    six = np.zeros((4, count, 6))
    return Scratch(
        np.zeros((count, 3, 3)),
        np.zeros((count, 3)),
        six[0],
        np.zeros((count, LINK)),
        six[1],
        six[2],
        six[3],
        np.zeros((count, count)),
        np.zeros(count),
    )


@njit(cache=True, error_model="numpy")
def dynamics(tree, links, gravity, q, dq, room):  # type: ignore[no-untyped-def]
    """Write mass matrix and bias forces (gravity, Coriolis, centrifugal) at a state into a scratch.

    Args:
        tree: The machine.
        links: Numbers of its links in their frames (J, 10): mass, mass times centre, inertia about the frame's origin.
        gravity: In base axes (3,) [m/s^2].
        q: Positions (J,).
        dq: Velocities (J,).
        room: Takes what is found.
    """
    place(tree, q, room.frame, room.origin, room.screw)
    weigh(links, room.frame, room.origin, room.body)
    forces(tree, gravity, dq, room.screw, room.body, room.speed, room.rate, room.force)
    gather(tree, room.screw, room.body, room.force, room.mass, room.bias)


@njit(cache=True, error_model="numpy")
def links_of(tree, factor, shift, load):  # type: ignore[no-untyped-def]
    """Return the numbers of all links (J, 10) with masses scaled, centres shifted and tips loaded, each (J,)."""
    count = len(tree.mass)
    out = np.zeros((count, LINK))
    for j in range(count):
        m = tree.mass[j] * factor[j]
        c = tree.centre[j] + shift[j] * tree.toward[j]
        whole = tree.inertia[j] * factor[j]
        k = 4
        for a in range(3):
            out[j, 1 + a] = m * c[a] + load[j] * tree.tip[j, a]
            for b in range(a, 3):
                out[j, k] = whole[a, b] - m * c[a] * c[b] - load[j] * tree.tip[j, a] * tree.tip[j, b]
                k += 1
        square = m * (c @ c) + load[j] * (tree.tip[j] @ tree.tip[j])
        out[j, 4] += square
        out[j, 7] += square
        out[j, 9] += square
        out[j, 0] = m + load[j]
    return out

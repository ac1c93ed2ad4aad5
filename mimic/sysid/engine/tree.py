"""A tree of hinge and slide joints on a fixed base: mass matrix and bias forces, compiled.

All spatial vectors are in world axes about the world's origin, so that nothing is transformed on the way to the base.
Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 5 and 6.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numba import njit

from mimic.dynamics.machine import MachineModel
from mimic.records import BoolArray, FloatArray, IntArray

FAST_MATH = {"contract", "reassoc", "arcp", "nsz"}
"""What compiled code may do to sums and products; it keeps what is not a number."""


def drop_outdated(folder: Path) -> None:
    """Delete what was compiled before a source in a folder changed; Numba looks at the file of each function alone."""
    newest = max(source.stat().st_mtime for source in folder.glob("*.py"))
    for compiled in folder.glob("__pycache__/*.nb?"):
        with suppress(OSError):  # gone, or of somebody else
            if compiled.stat().st_mtime < newest:
                compiled.unlink()


drop_outdated(Path(__file__).parent)

inlined = njit(  # type: ignore[call-overload]
    cache=True, error_model="numpy", fastmath=FAST_MATH, forceinline=True, _nrt=False
)
"""Compiles parts of a pass. Nothing in them makes an array, so that none counts references, half of the time."""


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
    stiffness: FloatArray
    """Of the model's springs [N m/rad]."""
    rest: FloatArray
    """Where these are slack [rad]."""

    def part(self, own: slice) -> Tree:
        """Return some chains."""
        made = Tree._make(np.array(each[own]) for each in self)
        return made._replace(parent=np.maximum(made.parent - own.start, -1))


FULL = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]
"""Where MuJoCo has each number of an inertia."""

HALF = np.triu_indices(3)
"""Where the numbers of a link have them: xx xy xz yy yz zz."""


def tree_of(machine: MachineModel) -> Tree:
    """Return the tree of a machine; links without a joint of their own belong to the one that carries them."""
    model = machine.model
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    axes = np.stack([_axes_along(axis) for axis in data.xaxis])
    anchor = np.array(data.xanchor)
    parent = model.dof_parentid.astype(int)
    last = model.body_dofadr + model.body_dofnum - 1
    owner = last[model.body_weldid]
    whole = np.stack([data.cinert[owner == j].sum(axis=0) for j in range(model.nv)])  # about the centre of the chain
    mass = whole[:, 9]
    away = whole[:, 6:9] / np.maximum(mass, 1e-30)[:, None]
    about = whole[:, FULL] - _points(mass, away)
    centre = away + data.subtree_com[model.body_rootid[model.dof_bodyid]] - anchor
    rotation = axes.copy()
    offset = anchor.copy()
    for j in np.flatnonzero(parent >= 0):
        rotation[j] = axes[parent[j]].T @ axes[j]
        offset[j] = axes[parent[j]].T @ (anchor[j] - anchor[parent[j]])
    link = np.array(data.xmat).reshape(-1, 3, 3)[machine.body]
    ends = np.array(data.xpos)[machine.body] + np.einsum("jab,jb->ja", link, machine.tip)
    toward = np.einsum("jab,jb->ja", link, machine.toward)
    return Tree(
        parent=parent,
        slide=np.array(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE),
        rotation=rotation,
        offset=offset,
        zero=np.array(model.qpos0),
        mass=mass,
        centre=np.einsum("jba,jb->ja", axes, centre),
        inertia=np.einsum("jba,jbc,jcd->jad", axes, about, axes),
        toward=np.einsum("jba,jb->ja", axes, toward),
        tip=np.einsum("jba,jb->ja", axes, ends - anchor),
        stiffness=np.array(model.jnt_stiffness, dtype=float).reshape(model.nv, -1)[:, 0].copy(),
        rest=np.array(model.qpos_spring),
    )


def _points(mass: FloatArray, at: FloatArray) -> FloatArray:
    """Return the inertia of point masses (J,) at places (J, 3) about the origin (J, 3, 3)."""
    square = (at**2).sum(axis=1)[:, None, None] * np.eye(3)
    return mass[:, None, None] * (square - at[:, :, None] * at[:, None, :])


def links_of(tree: Tree, factor: FloatArray, shift: FloatArray, load: FloatArray) -> FloatArray:
    """Return the numbers of all links (J, 10) in their frames: mass, mass times centre, inertia about the origin.

    Args:
        tree: Links.
        factor: On their masses (J,).
        shift: Of their centres toward the tips (J,) [m].
        load: At the tips (J,) [kg].
    """
    mass = tree.mass * factor
    centre = tree.centre + shift[:, None] * tree.toward
    moment = mass[:, None] * centre + load[:, None] * tree.tip
    inertia = tree.inertia * factor[:, None, None] + _points(mass, centre) + _points(load, tree.tip)
    return np.column_stack([mass + load, moment, inertia[:, *HALF]])


def _axes_along(axis: FloatArray) -> FloatArray:
    """Return axes as columns, the third along a unit vector (3, 3)."""
    across = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(across, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], -1)


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
MOMENTUM = 49
ROOM = 55
"""Columns of the room of a joint: axes (row by row), origin, unit motion, composite body, spatial velocity,
acceleration and force, bias force, position, velocity, momentum."""


def room_of(joints: int, gravity: FloatArray) -> FloatArray:
    """Return room for joints on a base (J + 1, ROOM); the last row is that of the base, which falls up."""
    room = np.zeros((joints + 1, ROOM))
    room[-1, FRAME:ORIGIN] = np.eye(3).ravel()
    room[-1, RATE + 3 : FORCE] = -gravity
    return room


@inlined
def add_cross(room, i, a, b, to):  # type: ignore[no-untyped-def]
    """Add the cross product of the vectors of a joint in columns a and b to those from a column on."""
    room[i, to] += room[i, a + 1] * room[i, b + 2] - room[i, a + 2] * room[i, b + 1]
    room[i, to + 1] += room[i, a + 2] * room[i, b] - room[i, a] * room[i, b + 2]
    room[i, to + 2] += room[i, a] * room[i, b + 1] - room[i, a + 1] * room[i, b]


@inlined
def place(tree, room):  # type: ignore[no-untyped-def]
    """Write axes, origins and unit motions of all joints at their positions."""
    for i in range(len(tree.parent)):
        before = tree.parent[i]
        turn = room[i, AT] - tree.zero[i]
        for a in range(3):
            r = FRAME + 3 * a
            x = room[before, r]
            y = room[before, r + 1]
            z = room[before, r + 2]
            for b in range(3):
                turned = x * tree.rotation[i, 0, b] + y * tree.rotation[i, 1, b] + z * tree.rotation[i, 2, b]
                room[i, r + b] = turned
            away = x * tree.offset[i, 0] + y * tree.offset[i, 1] + z * tree.offset[i, 2]
            room[i, ORIGIN + a] = room[before, ORIGIN + a] + away
        if tree.slide[i]:
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
                room[i, SCREW + 3 + a] = 0.0
            add_cross(room, i, ORIGIN, SCREW, SCREW + 3)


@inlined
def weigh(loads, log, room):  # type: ignore[no-untyped-def]
    """Write each link's numbers about the world's origin in world axes, from those in its own frame (L, J, 10)."""
    for i in range(loads.shape[1]):
        m = loads[log, i, 0]
        trace = 0.0
        for a in range(3):
            h = 0.0
            for k in range(3):
                h += room[i, 3 * a + k] * loads[log, i, 1 + k]
            room[i, BODY + 1 + a] = h
            trace += room[i, ORIGIN + a] * (2.0 * h + m * room[i, ORIGIN + a])
        k = BODY + 4
        for a in range(3):
            u = room[i, 3 * a]
            v = room[i, 3 * a + 1]
            w = room[i, 3 * a + 2]
            x = u * loads[log, i, 4] + v * loads[log, i, 5] + w * loads[log, i, 6]
            y = u * loads[log, i, 5] + v * loads[log, i, 7] + w * loads[log, i, 8]
            z = u * loads[log, i, 6] + v * loads[log, i, 8] + w * loads[log, i, 9]
            for b in range(a, 3):
                own = x * room[i, 3 * b] + y * room[i, 3 * b + 1] + z * room[i, 3 * b + 2]
                own -= room[i, ORIGIN + a] * (room[i, BODY + 1 + b] + m * room[i, ORIGIN + b])
                own -= room[i, ORIGIN + b] * room[i, BODY + 1 + a]
                room[i, k] = own + (trace if a == b else 0.0)
                k += 1
        room[i, BODY] = m
        for a in range(3):
            room[i, BODY + 1 + a] += m * room[i, ORIGIN + a]


@inlined
def momentum(room, i, s, to):  # type: ignore[no-untyped-def]
    """Write angular and linear momentum about the origin of a joint's body at the spatial velocity in column s."""
    x = room[i, s]
    y = room[i, s + 1]
    z = room[i, s + 2]
    room[i, to] = room[i, BODY + 4] * x + room[i, BODY + 5] * y + room[i, BODY + 6] * z
    room[i, to + 1] = room[i, BODY + 5] * x + room[i, BODY + 7] * y + room[i, BODY + 8] * z
    room[i, to + 2] = room[i, BODY + 6] * x + room[i, BODY + 8] * y + room[i, BODY + 9] * z
    for a in range(3):
        room[i, to + 3 + a] = room[i, BODY] * room[i, s + 3 + a]
    add_cross(room, i, BODY + 1, s + 3, to)
    add_cross(room, i, s, BODY + 1, to + 3)


@inlined
def forces(tree, room):  # type: ignore[no-untyped-def]
    """Write the spatial force that each link needs at the velocities, without acceleration of the joints."""
    for i in range(len(tree.parent)):
        before = tree.parent[i]
        for k in range(6):
            own = room[i, SCREW + k] * room[i, MOVING]
            room[i, FORCE + k] = own
            room[i, SPEED + k] = room[before, SPEED + k] + own
            room[i, RATE + k] = room[before, RATE + k]
        add_cross(room, i, SPEED, FORCE, RATE)
        add_cross(room, i, SPEED, FORCE + 3, RATE + 3)
        add_cross(room, i, SPEED + 3, FORCE, RATE + 3)
        momentum(room, i, RATE, FORCE)
        momentum(room, i, SPEED, MOMENTUM)
        add_cross(room, i, SPEED, MOMENTUM, FORCE)
        add_cross(room, i, SPEED + 3, MOMENTUM + 3, FORCE)
        add_cross(room, i, SPEED, MOMENTUM + 3, FORCE + 3)


@inlined
def gather(tree, room, mass):  # type: ignore[no-untyped-def]
    """Write mass matrix (J, J) and bias forces, from the last joint to the base; bodies become composite ones."""
    for i in range(len(tree.parent) - 1, -1, -1):
        before = tree.parent[i]
        bias = 0.0
        for k in range(6):
            bias += room[i, SCREW + k] * room[i, FORCE + k]
        room[i, BIAS] = bias
        if before >= 0:
            for k in range(6):
                room[before, FORCE + k] += room[i, FORCE + k]
            for k in range(LINK):
                room[before, BODY + k] += room[i, BODY + k]
        momentum(room, i, SCREW, MOMENTUM)
        j = i
        while j >= 0:
            own = 0.0
            for k in range(6):
                own += room[j, SCREW + k] * room[i, MOMENTUM + k]
            mass[i, j] = own
            mass[j, i] = own
            j = tree.parent[j]


@inlined
def dynamics(tree, loads, log, room, mass):  # type: ignore[no-untyped-def]
    """Write mass matrix and bias forces (gravity, Coriolis, centrifugal) at the positions and velocities in the room.

    Args:
        tree: The machine.
        loads: Numbers of its links in their frames (L, J, 10) with the load of each log, see `links_of`.
        log: Which of these.
        room: Positions and velocities, and takes the bias forces (J + 1, 55).
        mass: Takes the mass matrix (J, J).
    """
    place(tree, room)
    weigh(loads, log, room)
    forces(tree, room)
    gather(tree, room, mass)

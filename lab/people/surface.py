"""Solids as signed distances, and the triangle mesh of their surface.

A body part is a function from points (n, 3) [m] to distances (n,) [m], negative inside. Parts are blended into one
smooth solid and meshed with naive surface nets: one vertex per grid cell that the surface crosses.

Source: S. Gibson, "Constrained Elastic Surface Nets", MICCAI 1998; smooth minimum after I. Quilez, "Smooth minimum".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Field = Callable[[Array], Array]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A closed triangle mesh, outward side counter-clockwise."""

    vertices: Array
    """(n, 3) [m]."""
    faces: NDArray[np.int32]
    """(m, 3) vertex indices."""


def ellipsoid(centre: ArrayLike, radii: ArrayLike) -> Field:
    """Ellipsoid with axes along x, y, z; the distance is exact on the surface and approximate elsewhere."""
    c, r = np.asarray(centre, float), np.broadcast_to(np.asarray(radii, float), (3,))

    def field(p: Array) -> Array:
        q = p - c
        k0 = np.linalg.norm(q / r, axis=1)
        k1 = np.linalg.norm(q / r**2, axis=1)
        return np.where(k1 > 1e-9, k0 * (k0 - 1.0) / np.maximum(k1, 1e-9), -r.min())

    return field


def cone(start: ArrayLike, end: ArrayLike, r_start: float, r_end: float) -> Field:
    """Capsule whose radius changes linearly from one end to the other."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    axis = b - a

    def field(p: Array) -> Array:
        s = np.clip((p - a) @ axis / (axis @ axis), 0.0, 1.0)
        return np.linalg.norm(p - a - s[:, None] * axis, axis=1) - (r_start + s * (r_end - r_start))

    return field


def below(point: ArrayLike, normal: ArrayLike) -> Field:
    """Half-space on the side of the plane that its normal points away from."""
    q, n = np.asarray(point, float), np.asarray(normal, float)
    n = n / np.linalg.norm(n)
    return lambda p: (p - q) @ n


def blend(parts: Sequence[Field], k: float) -> Field:
    """Union whose creases are rounded over about `k` [m]."""

    def field(p: Array) -> Array:
        d = parts[0](p)
        for part in parts[1:]:
            e = part(p)
            h = np.maximum(k - np.abs(d - e), 0.0) / k
            d = np.minimum(d, e) - h * h * k / 4.0
        return d

    return field


def both(parts: Sequence[Field]) -> Field:
    """Intersection with sharp edges."""
    return lambda p: np.max([part(p) for part in parts], axis=0)


def carve(solid: Field, tool: Field, k: float) -> Field:
    """`solid` without `tool`, the edge rounded over about `k` [m]."""

    def field(p: Array) -> Array:
        d, e = solid(p), -tool(p)
        h = np.maximum(k - np.abs(d - e), 0.0) / k
        return np.maximum(d, e) + h * h * k / 4.0

    return field


def grown(solid: Field, by: float | Field) -> Field:
    """`solid` made thicker by a length [m], the same everywhere or a function of the point."""
    if callable(by):
        return lambda p: solid(p) - by(p)
    return lambda p: solid(p) - by


def mesh_of(solid: Field, low: ArrayLike, high: ArrayLike, step: float) -> Mesh:
    """Return the surface of `solid` inside the box from `low` to `high` [m].

    Args:
        solid: Signed distance; must be positive on the box's faces.
        low: Smallest corner (3,) [m].
        high: Largest corner (3,) [m].
        step: Grid spacing [m].
    """
    lo, hi = np.asarray(low, float), np.asarray(high, float)
    n = np.ceil((hi - lo) / step).astype(int) + 1
    axes = [lo[i] + step * np.arange(n[i]) for i in range(3)]
    value = _sampled(solid, axes, step)
    inside = value < 0.0

    total = np.zeros((*(n - 1), 3))
    count = np.zeros(tuple(n - 1), int)
    quads: list[NDArray[np.int64]] = []
    cell_index = np.arange(int(np.prod(n - 1))).reshape(tuple(n - 1))
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        here = [slice(None)] * 3
        there = [slice(None)] * 3
        here[axis], there[axis] = slice(None, -1), slice(1, None)
        f0, f1 = value[tuple(here)], value[tuple(there)]
        crossed = inside[tuple(here)] != inside[tuple(there)]
        index = np.argwhere(crossed)
        share = f0[crossed] / (f0[crossed] - f1[crossed])
        crossing = lo + step * index
        crossing[:, axis] += step * share
        outward = inside[tuple(here)][crossed]
        corner = []
        for du, dv in ((0, 0), (-1, 0), (-1, -1), (0, -1)):
            cell = index.copy()
            cell[:, u] += du
            cell[:, v] += dv
            corner.append(cell)
            np.add.at(total, tuple(cell.T), crossing)
            np.add.at(count, tuple(cell.T), 1)
        quad = np.stack([cell_index[tuple(c.T)] for c in corner], axis=1)
        quads.append(np.where(outward[:, None], quad, quad[:, ::-1]))

    used = count.reshape(-1) > 0
    vertices = total.reshape(-1, 3)[used] / count.reshape(-1)[used][:, None]
    renumber = np.cumsum(used) - 1
    quad = renumber[np.concatenate(quads)]
    faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]).astype(np.int32)
    for _ in range(2):
        vertices = vertices - _newton_step(solid, vertices, step)
    return Mesh(vertices, faces)


def _sampled(solid: Field, axes: list[Array], step: float) -> Array:
    """Values on the grid: exact near the surface, those of the nearest fourth grid point elsewhere."""
    coarse = [np.append(axis[::4], axis[-1] + 4 * step) for axis in axes]
    at = np.stack(np.meshgrid(*coarse, indexing="ij"), axis=-1)
    rough = solid(at.reshape(-1, 3)).reshape(at.shape[:3])
    near = np.abs(rough) < 9.0 * step
    block = np.zeros(tuple(np.array(rough.shape) - 1), bool)
    for i in range(8):
        a, b, c = ((slice(None, -1), slice(1, None))[i >> k & 1] for k in range(3))
        block |= near[a, b, c]
    index = np.ix_(*(np.minimum(np.arange(len(axis)) // 4, len(c) - 2) for axis, c in zip(axes, coarse, strict=True)))
    value = rough[index]
    i, j, k = np.nonzero(block[index])
    value[i, j, k] = solid(np.stack([axes[0][i], axes[1][j], axes[2][k]], axis=1))
    return value


def _newton_step(solid: Field, p: Array, step: float) -> Array:
    eps = 0.1 * step
    f = solid(p)
    gradient = np.stack([solid(p + eps * e) - solid(p - eps * e) for e in np.eye(3)], axis=1) / (2 * eps)
    move = f[:, None] * gradient / np.maximum((gradient**2).sum(axis=1), 0.25)[:, None]
    length = np.linalg.norm(move, axis=1, keepdims=True)
    return move * np.minimum(1.0, 0.5 * step / np.maximum(length, 1e-12))

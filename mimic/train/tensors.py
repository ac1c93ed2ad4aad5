"""What the worlds' code shares: chance, masked writes into static buffers, quaternions wxyz (..., 4)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor


class Chance:
    """Numbers drawn for each of N worlds, and where they go."""

    def __init__(self, worlds: int, device: str) -> None:
        self._n = worlds
        self._device = device

    def _rand(self, *shape: int) -> Tensor:
        return torch.rand(self._n, *shape, device=self._device)

    def _uniform(self, low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * self._rand(*shape)

    def _zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.zeros(self._n, *shape, device=self._device, dtype=dtype)

    def _tensor(self, values: Any) -> Tensor:
        return torch.as_tensor(np.asarray(values), dtype=torch.float32, device=self._device)


def put(buffer: Tensor, where: Tensor, value: Tensor | float) -> None:
    """Write into the rows of a buffer (N, ...) for which ``where`` (N,) is true."""
    rows = where.view(-1, *[1] * (buffer.dim() - 1))
    buffer.copy_(torch.where(rows, value, buffer))


def in_heading_frame(vectors: Tensor, heading: Tensor) -> Tensor:
    """Return horizontal vectors of the world (N, 2) forward and left, for headings (N,) [rad]."""
    cosine = torch.cos(heading)
    sine = torch.sin(heading)
    x, y = vectors.unbind(-1)
    return torch.stack([cosine * x + sine * y, cosine * y - sine * x], -1)


def quat_multiply(one: Tensor, other: Tensor) -> Tensor:
    """Return the product of quaternions."""
    a = one[..., :1]
    v = one[..., 1:]
    b = other[..., :1]
    u = other[..., 1:]
    return torch.cat([a * b - (v * u).sum(-1, keepdim=True), a * u + b * v + torch.linalg.cross(v, u)], -1)


def quat_apply_inverse(quat: Tensor, vector: Tensor) -> Tensor:
    """Return vectors (..., 3) turned back by unit quaternions."""
    w = quat[..., :1]
    axis = -quat[..., 1:]
    twice = 2 * torch.linalg.cross(axis, vector)
    return vector + w * twice + torch.linalg.cross(axis, twice)


def quat_from_euler(roll: Tensor, pitch: Tensor, yaw: Tensor) -> Tensor:
    """Return quaternions (N, 4) of R = Rz(yaw) Ry(pitch) Rx(roll), angles (N,) [rad]."""
    cr = torch.cos(roll / 2)
    sr = torch.sin(roll / 2)
    cp = torch.cos(pitch / 2)
    sp = torch.sin(pitch / 2)
    cy = torch.cos(yaw / 2)
    sy = torch.sin(yaw / 2)
    parts = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
    return torch.stack(parts, -1)

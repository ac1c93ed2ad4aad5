"""A chequered floor, which makes height, distance and motion visible."""

from __future__ import annotations

import numpy as np
import rerun as rr

from mimic.records import FloatArray

_MARGIN = 1.25
"""Margin of the floor around the path [m]."""
_FARTHEST = 6.0
"""Largest extent of the floor from the start of the path, without the margin [m]."""
_COLOURS = np.array([[198, 205, 213], [210, 216, 223]], dtype=np.uint8)


def draw_floor(scene: rr.RecordingStream, entity: str, path: FloatArray, *, tile: float) -> None:
    """Draw floor tiles of side length ``tile`` [m] around a path (T, 2) [m]; their top is at z = 0."""
    low = np.maximum(path.min(axis=0), path[0] - _FARTHEST) - _MARGIN
    high = np.minimum(path.max(axis=0), path[0] + _FARTHEST) + _MARGIN
    x, y = (np.arange(np.floor(a / tile), np.ceil(b / tile)) for a, b in zip(low, high, strict=True))
    columns, rows = (grid.ravel() for grid in np.meshgrid(x, y))
    thick = 0.005
    centers = np.column_stack([(columns + 0.5) * tile, (rows + 0.5) * tile, np.full(len(rows), -thick)])
    colours = _COLOURS[((columns + rows) % 2).astype(int)]
    half_sizes = np.tile([tile / 2, tile / 2, thick], (len(rows), 1))
    floor = rr.Boxes3D(centers=centers, half_sizes=half_sizes, colors=colours, fill_mode="Solid")
    scene.log(entity, floor, static=True)

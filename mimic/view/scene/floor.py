"""A chequered floor, so that height, distance and motion are seen."""

from __future__ import annotations

import numpy as np
import rerun as rr

from mimic.types import FloatArray

_MARGIN = 1.25
"""The floor reaches this far beyond where someone goes [m]."""
_FARTHEST = 6.0
"""… but no farther than this from where they begin [m]."""
_COLOURS = np.array([[198, 205, 213], [210, 216, 223]], dtype=np.uint8)


def draw_floor(scene: rr.RecordingStream, entity: str, path: FloatArray, *, tile: float) -> None:
    """Lay tiles of a side [m] under and around a path (T, 2) [m]; their upper side is at z = 0."""
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

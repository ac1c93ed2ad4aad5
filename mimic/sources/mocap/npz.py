"""NPZ: times, points and visibilities from another pose estimator; docs/manual/motion-formats.md has the layout."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.pose import MocapSettings
from mimic.errors import SourceError
from mimic.sources.mocap.points import Points, clock
from mimic.sources.mocap.skeletons import layout_of
from mimic.sources.mocap.smpl import KEYS, RATES, has_rotations, points_of_rotations

POINTS = ("points", "joints", "xyz", "keypoints_3d", "pred_keypoints_3d")
"""Names of the array of positions; the first that is there counts."""
VISIBILITY = ("visibility", "score", "scores", "confidence")
_READ = {*POINTS, *VISIBILITY, *KEYS, "t", "names", "layout"}
"""Arrays that are read; others are left where they are."""
_NONE = (ValueError, OSError, EOFError, KeyError, MemoryError, zlib.error, zipfile.BadZipFile)


def read_npz(path: Path, settings: MocapSettings) -> Points:
    """Return the points of an NPZ file. Pickled objects in it are refused.

    Raises:
        SourceError: If an array is missing or has another shape.
    """
    arrays = _arrays(path)
    if not any(name in arrays for name in POINTS) and has_rotations(arrays):
        return points_of_rotations(arrays, settings, path)
    name = next((name for name in POINTS if name in arrays), None)
    if name is None:
        raise SourceError(
            f"{path.name} holds {', '.join(arrays) or 'nothing'}; expected an array 'points' (T, N, 3), "
            "or rotations of the SMPL family ('poses', or 'global_orient' and 'body_pose')"
        )
    given = arrays[name]
    if given.dtype.kind not in "fiu" or given.ndim != 3 or given.shape[2] != 3 or not len(given):
        raise SourceError(f"'{name}' in {path.name} has shape {given.shape}; expected numbers (T, N, 3)")
    xyz = np.array(given, dtype=np.float64)
    rows = len(xyz)
    count = xyz.shape[1]
    names = _names(arrays, count, settings, path)
    score = next((arrays[key] for key in VISIBILITY if key in arrays), np.ones((rows, count)))
    if score.shape != (rows, count):
        raise SourceError(f"the visibilities in {path.name} have shape {score.shape}; expected ({rows}, {count})")
    return Points(
        t=_times(arrays, rows, settings, path),
        xyz=xyz,
        score=np.nan_to_num(np.array(score, dtype=np.float64)),
        names=names,
    )


def _arrays(path: Path) -> dict[str, Any]:
    try:
        with np.load(path, allow_pickle=False) as file:
            return {key: file[key] if key in _READ else None for key in file.files}
    except _NONE:  # NumPy's own words advise to load pickles, which is not safe
        raise SourceError(
            f"{path.name} cannot be read as NPZ: it is no archive of plain arrays; write it with numpy.savez, without "
            "Python objects"
        ) from None


def _names(arrays: dict[str, Any], count: int, settings: MocapSettings, path: Path) -> tuple[str, ...]:
    if "names" in arrays and settings.layout is None:
        names = tuple(str(name) for name in np.atleast_1d(arrays["names"]))
        if len(names) != count:
            raise SourceError(f"{path.name} has {len(names)} names for {count} points")
        return names
    layout = settings.layout or (str(arrays["layout"]) if "layout" in arrays else None)
    return layout_of(count, layout)


def _times(arrays: dict[str, Any], rows: int, settings: MocapSettings, path: Path) -> np.ndarray:
    if "t" not in arrays or settings.fps:
        return clock(rows, next((arrays[name] for name in RATES if name in arrays), None), settings, path)
    t = arrays["t"]
    if t.shape != (rows,):
        raise SourceError(f"'t' in {path.name} has shape {t.shape}; expected ({rows},), a time for each row")
    stamps = t.dtype.kind == "M"
    return t.astype("datetime64[ns]").astype(np.int64) / 1e9 if stamps else np.array(t, dtype=np.float64)

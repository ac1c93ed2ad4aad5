"""C3D: markers of a motion capture system, read by ezc3d (extra ``c3d``).

Source: "The C3D File Format User Guide", Motion Lab Systems, 2008: groups POINT (LABELS, RATE, UNITS).
"""

from __future__ import annotations

from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.pose import MocapSettings
from mimic.errors import MissingExtra, SourceError
from mimic.sources.mocap.points import UNITS, Points, clock


def read_c3d(path: Path, settings: MocapSettings) -> Points:
    """Return the markers of a C3D file; what was not seen is NaN.

    Raises:
        SourceError: If the file is no C3D or has no markers.
        MissingExtra: If ezc3d is not installed.
    """
    try:
        import ezc3d
    except ModuleNotFoundError as missing:
        raise MissingExtra(str(missing.name), "c3d") from None
    with open(path, "rb") as file:
        start = file.read(512)
    if len(start) < 512 or start[1] != 0x50:
        raise SourceError(f"{path.name} is not a C3D file (its second byte must be 50 hex)")
    try:
        data = ezc3d.c3d(str(path))
        point = data["parameters"]["POINT"]
        xyz = np.array(data["data"]["points"], dtype=np.float64)[:3].transpose(2, 1, 0)
        names = tuple(str(name).strip() for name in _labels(point))
    except Exception as error:  # ezc3d raises what its C++ throws
        raise SourceError(f"{path.name} cannot be read as C3D: {' '.join(str(error).split())[:120]}") from None
    if not len(xyz) or xyz.shape[1] == 0 or len(names) < xyz.shape[1]:
        raise SourceError(f"{path.name} has {len(names)} labels for {xyz.shape[1]} markers in {len(xyz)} frames")
    unit = str(_value(point, "UNITS") or "").strip().lower()
    return Points(
        t=clock(len(xyz), _value(point, "RATE"), settings, path),
        xyz=xyz,
        score=np.ones(xyz.shape[:2]),
        names=names[: xyz.shape[1]],
        unit=unit if unit in UNITS else None,
    )


def _value(group: Any, name: str) -> Any:
    """Return the first value of a parameter, None if there is none."""
    values: list[Any] = list(group[name]["value"]) if name in group else []
    return values[0] if values else None


def _labels(group: Any) -> list[str]:
    """Return the labels of all markers; beyond 255 they go on in LABELS2, LABELS3, …"""
    names = takewhile(group.__contains__, ("LABELS", *(f"LABELS{n}" for n in range(2, 1000))))
    return [label for name in names for label in group[name]["value"]]

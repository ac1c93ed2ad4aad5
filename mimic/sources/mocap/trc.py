"""TRC: positions of markers over time, as OpenSim, Pose2Sim and OpenCap write them.

Source: OpenSim documentation, "Marker (.trc) Files".
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mimic.config.pose import MocapSettings
from mimic.config.text_file import read_text
from mimic.errors import SourceError
from mimic.sources.mocap.points import UNITS, Points, clock

SEPARATORS = {"\t": "tabs", ",": "commas", ";": "semicolons"}
"""What stands between cells; where it is no comma, a comma is the decimal point."""
_HEADER = 5
"""Lines before the table; an empty one may follow them."""


def read_trc(path: Path, settings: MocapSettings) -> Points:
    """Return the markers of a TRC file; empty cells and markers at exactly (0, 0, 0) were not seen.

    Raises:
        SourceError: If the file is no TRC.
    """
    lines = read_text(path).splitlines()
    if len(lines) < _HEADER + 1 or not lines[0].startswith("PathFileType"):
        raise SourceError(f"{path.name}, line 1: not a TRC file (it must start with PathFileType)")
    separator = max(SEPARATORS, key=lines[3].count)
    if separator != ",":
        lines = [line.replace(",", ".") for line in lines]
    facts = dict(zip(lines[1].split(separator), lines[2].split(separator), strict=False))
    unit = facts.get("Units", "").strip().lower()
    if unit not in UNITS:
        raise SourceError(f"{path.name} gives lengths in {unit or 'no unit'}; expected one of {', '.join(UNITS)}")
    cells = lines[3].rstrip().split(separator)
    names = tuple(name.strip() for name in cells[2::3])
    if not names or cells[0].strip().lower() != "frame#":
        raise SourceError(
            f"{path.name}, line 4: expected Frame#, Time and the markers' names, separated by "
            f"{' or '.join(SEPARATORS.values())}"
        )
    table = _table(lines, path, separator, 2 + 3 * len(names))
    xyz = table[:, 2:].reshape(len(table), len(names), 3)
    t = clock(len(table), None, settings, path) if settings.fps else table[:, 1]
    return Points(t=t, xyz=xyz, score=np.ones(xyz.shape[:2]), names=names, unit=unit)


def _table(lines: list[str], path: Path, separator: str, width: int) -> np.ndarray:
    rows = []
    for number, line in enumerate(lines[_HEADER:], _HEADER + 1):
        cells = line.rstrip().split(separator)
        if any(cells[width:]):
            raise SourceError(
                f"{path.name}, line {number}: {len(cells)} cells; expected {width}, for the names in line 4"
            )
        cells = (cells + [""] * width)[:width]
        try:
            rows += [[float(cell.strip() or "nan") for cell in cells]] if line.strip() else []
        except ValueError:
            raise SourceError(
                f"{path.name}, line {number}: expected numbers separated by {SEPARATORS[separator]}, got {line[:60]!r}"
            ) from None
    return np.array(rows).reshape(-1, width)

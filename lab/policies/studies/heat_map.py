"""Heat map of the survival rate: one row per axis, one cell per value."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import AssetError

CELL, NAME, TOP, GAP = (108, 56), 260, 84, 6
"""Width and height of a cell, width of the names, height above the first row, space between rows [px]."""

WORST, MIDDLE, BEST = (64, 66, 196), (120, 200, 242), (120, 170, 70)
"""Colours of survival rates of 0, 75 and 100 %, BGR."""

INK, PALE = (40, 36, 32), (150, 144, 140)


def shade(share: float) -> tuple[int, int, int]:
    """Return the colour (BGR) of a survival rate; the scale is finer above 75 %."""
    stops = np.array([WORST, MIDDLE, BEST], dtype=np.float64)
    blue, green, red = (int(np.interp(share, [0.0, 0.75, 1.0], stops[:, i])) for i in range(3))
    return blue, green, red


def draw_heat_map(result: Mapping[str, Any], path: Path) -> None:
    """Write the shares of `evaluate_robustness` as a PNG file.

    A frame marks the training range.

    Raises:
        AssetError: If the file cannot be written.
    """
    import cv2

    rows: list[tuple[str, list[tuple[str, float, bool]]]] = []
    for name, axis in result["axes"].items():
        unit = f" [{axis['unit']}]" if axis["unit"] else ""
        low, high = axis["trained"] or (axis["nominal"], axis["nominal"])
        cells = [(f"{p['value']:g}", p["survived"], low - 1e-9 <= p["value"] <= high + 1e-9) for p in axis["points"]]
        rows.append((name.replace("_", " ") + unit, cells))
    together = [(f"{100 * float(share):g} %", value, False) for share, value in result["together"].items()]
    rows.append(("all at once, share of range", together))
    width = NAME + CELL[0] * max(len(cells) for _, cells in rows) + 20
    picture = np.full((TOP + len(rows) * (CELL[1] + GAP) + 20, width, 3), 255, dtype=np.uint8)

    def write(text: str, x: int, y: int, size: float, colour: tuple[int, int, int] = INK, weight: int = 1) -> None:
        cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, colour, weight, cv2.LINE_AA)

    write(f"{result['policy']}: survived episodes", 20, 36, 0.8, weight=2)
    write(f"{result['episodes_per_point']} at each point; framed: training range", 20, 64, 0.55, PALE)
    for i, (name, cells) in enumerate(rows):
        y = TOP + i * (CELL[1] + GAP)
        write(name, 20, y + CELL[1] // 2 + 6, 0.55)
        for j, (value, share, _) in enumerate(cells):
            x = NAME + j * CELL[0]
            cv2.rectangle(picture, (x + 1, y), (x + CELL[0] - 2, y + CELL[1]), shade(share), cv2.FILLED)
            write(f"{100 * share:.0f} %", x + 12, y + 26, 0.65, weight=2)
            write(value, x + 12, y + 47, 0.45)
        framed = [j for j, cell in enumerate(cells) if cell[2]]
        if framed:
            left, right = NAME + framed[0] * CELL[0], NAME + (framed[-1] + 1) * CELL[0] - 1
            cv2.rectangle(picture, (left, y - 2), (right, y + CELL[1] + 2), INK, 3)
    try:
        path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    except OSError as reason:
        raise AssetError(f"cannot write {path}: {reason.strerror}") from None

"""A record, motion, run or calibration as a table of at most ten lines: what a notebook cell shows of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

LINES = 10
"""Most lines of the table."""
WIDTH = 100
"""Most characters of a line."""


class ShownAsTable:
    """Gives a dataclass a short ``repr``: one line for each of its first fields."""

    __slots__ = ()

    def shown(self) -> dict[str, str]:
        """Return what the lines of the table say, by name."""
        return {f.name: in_words(getattr(self, f.name)) for f in fields(self)}  # type: ignore[arg-type]

    def __repr__(self) -> str:
        rows = self.shown()
        names = list(rows)
        shown = names if len(names) < LINES else names[: LINES - 2]
        width = max(map(len, shown))
        lines = [in_words(self), *(f"  {name:<{width}}  {rows[name]}" for name in shown)]
        if len(shown) < len(names):
            lines.append(f"  and {', '.join(names[len(shown) :])}")
        return "\n".join(line if len(line) <= WIDTH else f"{line[: WIDTH - 1]}…" for line in lines)


def number(value: float, form: str) -> str:
    """Return a number in a format such as "{:.1f} cm", and a dash where it is not finite."""
    return form.format(value) if math.isfinite(value) else "–"


def in_words(value: Any) -> str:
    """Return a value in one line: shape and range of an array, length of a record, number of entries."""
    if value is None:
        return "-"
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, (Mapping, tuple, list)):
        entries: list[Any] = list(value)
        inside = ", ".join(str(one) if isinstance(one, (str, int, float)) else type(one).__name__ for one in entries)
        return f"{len(entries)}: {inside}" if entries else "none"
    if is_dataclass(value):
        t = getattr(value, "t", getattr(getattr(value, "log", None), "t", None))
        rows = f", {len(t)} rows, {t[0]:.2f} to {t[-1]:.2f} s" if t is not None and np.size(t) > 1 else ""
        return f"{type(value).__name__}{rows}"
    return " ".join(str(value).split())


def _array(values: NDArray[Any]) -> str:
    """Return the shape of an array, and its range or the share that is true."""
    shape = " x ".join(map(str, values.shape))
    if values.dtype == np.bool_:
        return f"{shape}, {np.mean(values):.0%} true" if values.size else shape
    finite = values[np.isfinite(values)] if np.issubdtype(values.dtype, np.number) else values[:0]
    return f"{shape}, {np.min(finite):.4g} to {np.max(finite):.4g}" if finite.size else shape

"""Small plots as inline SVG: axes with round ticks, decimated curves, bands. CSS sets the colours."""

from __future__ import annotations

import math
from html import escape

import numpy as np

from mimic.records import FloatArray

LEFT = 46
"""Margin on the left of the axes [px]."""
RIGHT = 8
"""Margin on their right [px]."""
TOP = 20
"""Margin above them [px]."""
BOTTOM = 22
"""Margin below them [px]."""


def round_ticks(low: float, high: float, count: int) -> list[float]:
    """Return about ``count`` round numbers from low to high, at least two: steps of 1, 2 or 5 times a power of ten."""
    span = high - low
    if not span > 0 or not math.isfinite(span):
        return [low]
    raw = span / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    ticks: list[float] = []
    for step in (m * power for m in (10, 5, 2, 1, 0.5)):
        if step >= 0.7 * raw or len(ticks) < 2:
            first = math.ceil(low / step - 1e-9)
            ticks = [step * k for k in range(first, math.floor(high / step + 1e-9) + 1)]
    return ticks


def _powers(low: float, high: float, count: float) -> list[float]:
    """Return the logarithms of powers of ten in a range of logarithms; with 2 and 5 between them if there are few."""
    powers = [float(k) for k in range(math.ceil(low - 1e-9), math.floor(high + 1e-9) + 1)]
    if len(powers) < 3:
        fine = [k + math.log10(m) for k in range(math.floor(low), math.ceil(high) + 1) for m in (1, 2, 5)]
        fine = [k for k in fine if low <= k <= high]
        return fine if len(fine) > 1 else [math.log10(v) for v in round_ticks(10.0**low, 10.0**high, 3)]
    return powers[:: max(1, math.ceil(len(powers) / max(count, 2.0)))]


def number(value: float) -> str:
    """Return a number for a tick or a table: three digits, no trailing zeros."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:.0f}" if 1e3 <= abs(value) < 1e5 else f"{value:.3g}"
    return text.replace("e+0", "e").replace("e-0", "e-").replace("-", "−")


def figure(value: float) -> str:
    """Return a number with three digits, aligned within a column."""
    if not math.isfinite(value):
        return "–"
    size = abs(value)
    if value == 0 or size >= 1e4 or size < 1e-4:
        return number(value)
    digits = max(2 - math.floor(math.log10(size) + 1e-12), 0)
    return f"{value:.{digits}f}".replace("-", "−")


class Plot:
    """One plot; the methods add to it, and `svg` returns it."""

    def __init__(
        self,
        *,
        x: tuple[float, float],
        y: tuple[float, float],
        size: tuple[int, int] = (900, 120),
        title: str,
        x_label: str,
        y_label: str,
        log: tuple[bool, bool] = (False, False),
    ) -> None:
        self.width, self.height = size
        self.log = log
        self._x = self._range(x, log[0])
        self._y = self._range(y, log[1])
        self._bottom = BOTTOM + (12 if x_label else 0)
        self._parts: list[str] = []
        self._over = [
            self._text(LEFT, 12, title, "title"),
            self._text(self.width - RIGHT, 12, y_label, "unit end"),
        ]
        if x_label:
            self._over.append(self._text((LEFT + self.width - RIGHT) / 2, self.height - 4, x_label, "unit middle"))
        self._axes()

    @staticmethod
    def _range(limits: tuple[float, float], log: bool) -> tuple[float, float]:
        low, high = limits
        if log:
            low = math.log10(low)
            high = math.log10(high)
        return (low, high) if high > low else (low - 0.5, high + 0.5)

    def _at(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self.log[0]:
            x = np.log10(np.maximum(x, 1e-300))
        if self.log[1]:
            y = np.log10(np.maximum(y, 1e-300))
        (x0, x1) = self._x
        (y0, y1) = self._y
        across = self.width - LEFT - RIGHT
        up = self.height - TOP - self._bottom
        px = LEFT + across * np.clip((x - x0) / (x1 - x0), -0.02, 1.02)
        return px, TOP + up * (1.0 - np.clip((y - y0) / (y1 - y0), -0.05, 1.05))

    def _axes(self) -> None:
        base = self.height - self._bottom
        marks = ["<g class='grid'>"]
        for axis, (limits, log) in enumerate(((self._x, self.log[0]), (self._y, self.log[1]))):
            across = (self.width - LEFT - RIGHT) / (60 if log else 90)
            room = across if axis == 0 else (self.height - TOP - self._bottom) / 28
            ticks = _powers(*limits, count=max(2.0, room)) if log else round_ticks(*limits, count=max(3, round(room)))
            for tick in ticks:
                value = 10.0**tick if log else tick
                px, py = self._at(np.array([value]), np.array([value]))
                if axis == 0:
                    marks.append(f"<path d='M{px[0]:.1f},{TOP}V{base}'/>")
                    self._over.append(self._text(px[0], base + 13, number(value), "tick middle"))
                else:
                    marks.append(f"<path d='M{LEFT},{py[0]:.1f}H{self.width - RIGHT}'/>")
                    self._over.append(self._text(LEFT - 5, py[0] + 3.5, number(value), "tick end"))
        self._parts.append("".join([*marks, "</g>"]))

    @staticmethod
    def _text(x: float, y: float, text: str, kind: str) -> str:
        return f"<text class='{kind}' x='{x:.1f}' y='{y:.1f}'>{escape(text)}</text>"

    def curve(self, x: FloatArray, y: FloatArray, kind: str) -> None:
        """Draw a curve; a long one is reduced to the lowest and highest sample per pixel column."""
        ok = np.isfinite(x) & np.isfinite(y)
        x, y = thinned(x[ok], y[ok], self.width - LEFT - RIGHT)
        if len(x):
            self._parts.append(f"<path class='line {kind}' d='{self._path(x, y)}'/>")

    def band(self, x: FloatArray, low: FloatArray, high: FloatArray, kind: str) -> None:
        """Fill between two curves."""
        ok = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
        if ok.any():
            both = np.concatenate([x[ok], x[ok][::-1]]), np.concatenate([low[ok], high[ok][::-1]])
            self._parts.append(f"<path class='band {kind}' d='{self._path(*both)}Z'/>")

    def level(self, y: float, kind: str) -> None:
        """Draw a horizontal line."""
        _, py = self._at(np.array([1.0]), np.array([y]))
        self._parts.append(f"<path class='line {kind}' d='M{LEFT},{py[0]:.1f}H{self.width - RIGHT}'/>")

    def _path(self, x: FloatArray, y: FloatArray) -> str:
        px, py = self._at(x, y)
        return "M" + " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py, strict=True))

    def svg(self, label: str) -> str:
        """Return the plot; ``label`` is the text for screen readers."""
        inside = "".join([*self._parts, *self._over])
        named = f"role='img' aria-label='{escape(label, quote=True)}'"
        return f"<svg viewBox='0 0 {self.width} {self.height}' {named}>{inside}</svg>"


def thinned(x: FloatArray, y: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """Return a curve with at most two points per column, the lowest and the highest in order; both ends are kept."""
    if len(x) <= 2 * columns:
        return x, y
    column = np.minimum(((x - x[0]) / max(x[-1] - x[0], 1e-300) * columns).astype(int), columns - 1)
    keep = {0, len(x) - 1}
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    for a, b in zip(starts, [*starts[1:], len(x)], strict=True):
        keep |= {a + int(y[a:b].argmin()), a + int(y[a:b].argmax())}
    index = np.array(sorted(keep))
    return x[index], y[index]

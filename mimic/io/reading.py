"""What every reader of other people's files shares: text in any encoding, and clocks that can be true."""

from __future__ import annotations

import codecs
from pathlib import Path

import numpy as np

from mimic.errors import MimicError
from mimic.records import FloatArray

STEPS = (5e-5, 0.5)
"""Plausible median times between two rows of a recording [s]: 20 kHz down to 2 Hz."""
_SCALES = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def read_text(path: Path) -> str:
    """Return the text of a file: UTF-8 or UTF-16, with or without a byte order mark; what is neither becomes U+FFFD."""
    data = path.read_bytes()
    marked = next((name for mark, name in _MARKS.items() if data.startswith(mark)), None)
    zeros = [data[start:2000:2].count(0) for start in (0, 1)]  # of Latin text in UTF-16 each other byte is zero
    plain = "utf-8" if max(zeros) <= len(data[:2000]) // 4 else "utf-16-be" if zeros[0] > zeros[1] else "utf-16-le"
    return data.decode(marked or plain, errors="replace")


def check_clock(
    t: FloatArray, name: str, error: type[MimicError], fix: str = "store times in seconds", *, repeats: bool = False
) -> None:
    """Refuse times that no recording has, in one line.

    Args:
        t: Time of each row (T,) [s].
        name: Of the file or record, for the message.
        error: What to raise.
        fix: What else to do about times of another unit.
        repeats: Some rows may have the time of the row before.
    """
    unknown = np.flatnonzero(~np.isfinite(t))
    if len(unknown):
        raise error(f"row {unknown[0] + 1} of {name} has no time ({t[unknown[0]]:g} s); remove the row")
    if len(t) < 2:
        return
    steps = np.diff(t)
    equal, grain = int(np.sum(steps == 0)), float(np.spacing(np.float32(np.abs(t).max())))
    coarse = np.array_equal(t, t.astype(np.float32)) and grain * len(steps) > 0.25 * abs(t[-1] - t[0])
    if coarse or 2 * equal > len(steps):
        raise error(
            f"the times of {name} are equal in {equal + 1} of {len(t)} rows"
            + (f": numbers of 32 bits step by {grain:.3g} s at {t[0]:.6g} s" if coarse else "")
            + "; store them with 64 bits, or count them from the first row"
        )
    back = np.flatnonzero(steps < 0 if repeats else steps <= 0)
    if len(back):
        row = int(back[0])
        raise error(
            f"the times of {name} do not increase: row {row + 2} has {t[row + 1]:.10g} s after {t[row]:.10g} s; "
            "sort the rows and drop repeated ones"
        )
    usual, largest = float(np.median(steps[steps > 0])), int(steps.argmax())
    if not STEPS[0] <= usual <= STEPS[1]:
        units = [unit for unit, scale in _SCALES.items() if STEPS[0] <= scale * usual <= STEPS[1]]
        rate = f"a rate of {usual:g} Hz where a period is expected" if 5.0 <= usual <= 20_000.0 else ""
        guess = " or ".join(filter(None, (rate, *units))) or "a period where a rate is expected, or another unit"
        raise error(
            f"the rows of {name} are {usual:g} s apart; recordings have {STEPS[0]:g} to {STEPS[1]:g} s: "
            f"is it {guess}? Then {fix}"
        )
    if len(t) > 4 and steps[largest] > 10.0 and 2 * steps[largest] > t[-1] - t[0]:
        raise error(
            f"the times of {name} jump by {steps[largest]:g} s from row {largest + 1} to row {largest + 2}, more than "
            "all other rows take: the clock was set, or these are two recordings; split them, or correct the times"
        )

"""What every reader of other people's files shares: files that are here, and clocks that can be true."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from mimic.errors import MimicError, SourceError
from mimic.records import FloatArray

STEPS = (5e-5, 0.5)
"""Plausible median times between two rows of a recording [s]: 20 kHz down to 2 Hz."""
_POINTER = b"version https://git-lfs."
_SCALES = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}


def existing(source: str | Path, what: str = "file {}") -> Path:
    """Return the path of a source.

    Args:
        source: Its path.
        what: What there is none of, for the message.

    Raises:
        SourceError: If nothing is there, it is an address on a network, or stands for a file of git LFS.
    """
    path = Path(source)
    if os.path.exists(path):  # Path.exists raises for a name that is too long
        refuse_pointer(path, SourceError)
        return path
    if address := re.match(r"(\w{2,}):/+(.*)", str(source)):
        raise SourceError(f"{address[1]}://{address[2]} is an address; download the file and give its path")
    raise SourceError(f"there is no {what.format(path)}")


def refuse_pointer(path: Path, error: type[MimicError]) -> None:
    """Refuse a text of git LFS that stands for a large file."""
    if not path.is_file():
        return
    with open(path, "rb") as file:
        if file.read(len(_POINTER)) == _POINTER:
            raise error(f"{path} is a git LFS pointer, not the file itself; run git lfs pull")


def check_clock(
    t: FloatArray,
    name: str,
    error: type[MimicError],
    fix: str = "store times in seconds",
    *,
    repeats: bool = False,
    apart: tuple[float, float] = STEPS,
) -> None:
    """Refuse times that no recording has, in one line.

    Args:
        t: Time of each row (T,) [s].
        name: Of the file or record, for the message.
        error: What to raise.
        fix: What else to do about times of another unit.
        repeats: Some rows may have the time of the row before.
        apart: Plausible median times between two rows [s].
    """
    unknown = np.flatnonzero(~np.isfinite(t))
    if len(unknown):
        raise error(f"row {unknown[0] + 1} of {name} has no time ({t[unknown[0]]:g} s); remove the row")
    if len(t) < 2:
        return
    steps = np.diff(t)
    equal = int(np.sum(steps == 0))
    grain = float(np.spacing(np.float32(np.abs(t).max())))
    coarse = grain > STEPS[0] and np.array_equal(t, t.astype(np.float32)) and grain * len(steps) > 0.25 * np.ptp(t)
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
    usual = float(np.median(steps[steps > 0]))
    largest = int(steps.argmax())
    if not apart[0] <= usual <= apart[1]:
        units = [unit for unit, scale in _SCALES.items() if apart[0] <= scale * usual <= apart[1]]
        rate = f"a rate of {usual:g} Hz where a period is expected" if 5.0 <= usual <= 20_000.0 else ""
        guess = " or ".join(filter(None, (rate, *units))) or "a period where a rate is expected, or another unit"
        raise error(
            f"the rows of {name} are {usual:g} s apart; expected are {apart[0]:g} to {apart[1]:g} s: "
            f"is it {guess}? Then {fix}"
        )
    if len(t) > 4 and steps[largest] > 10.0 and 2 * steps[largest] > t[-1] - t[0]:
        raise error(
            f"the times of {name} jump by {steps[largest]:g} s from row {largest + 1} to row {largest + 2}, more than "
            "all other rows take: the clock was set, or these are two recordings; split them, or correct the times"
        )

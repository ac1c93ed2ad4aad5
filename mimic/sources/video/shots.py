"""Where a clip goes on with another picture or another person: cuts, fades through black, changes of person."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mimic.records import HIPS, SHOULDERS, BoolArray, FloatArray, IntArray, PoseTrack
from mimic.sources.video.screening import in_pixels, shot_starts, trunk_of

DARK = 24.0
"""A frame with a lower mean of its thumbnail is black [grey levels of 255],"""
FLAT = 10.0
"""… if its spread is also lower than this [grey levels of 255]."""
WINDOW = 0.5
"""What comes before a change and what comes after it is the median over this time [s]."""
DIM = 0.5
"""A fade takes about this long on each side [s]; clothes are compared outside it."""
FEWEST = 3
"""Rows that each side of a cut, and rows with a person that each side of another person must have."""
STEADY = 0.8
"""Least share of them from the first to the last: what is found and lost in turn is nobody (0.7 on a silhouette)."""
GAP = 0.25
"""After a longer gap it may be another person who is seen in another place [s]."""
AWAY = 1.0
"""… and after this one, also in the same place [s]."""
JUMP = 0.4
"""A trunk that moves farther between two frames may be another one [trunk heights]."""
FAR = 1.0
"""A trunk that stays this far away after a jump is another one [trunk heights]: half a metre in a frame."""
OTHER_COLOUR = 22.0
"""Least difference of the clothes of two people [CIE 1976 units of L*a*b*]."""
OTHER_SIZE = 0.3
"""Least difference of the size of two people in the picture [natural logarithm of the ratio]."""
SAME_TIME = 0.3
"""Changes this close to each other are one [s]."""

_ACROSS, _DOWN = np.meshgrid(np.linspace(-0.3, 0.3, 5), np.linspace(0.1, 0.5, 5))
"""Where the colour of the clothes is read: shares of the shoulder line and of the way to the hips."""

Kind = Literal["cut", "fade", "person"]


@dataclass(frozen=True, slots=True)
class Change:
    """A row at which a clip goes on with something else."""

    row: int
    kind: Kind
    """A cut, a fade through black, or another person in the same picture."""
    other_person: bool
    """Whether the person after it looks like another one; False where that cannot be said."""


def is_black(rgb: np.ndarray) -> bool:
    """Return whether a picture shows nothing."""
    grey = rgb[:: max(1, rgb.shape[0] // 24), :: max(1, rgb.shape[1] // 32)].mean(axis=-1)
    return bool(grey.mean() < DARK and grey.std() < FLAT)


def clothes_colour(rgb: np.ndarray, image: FloatArray) -> FloatArray:
    """Return the median colour of the upper trunk (3,), L*a*b*; NaN where none of it is in the picture.

    Args:
        rgb: Picture (H, W, 3).
        image: Landmarks (33, 2), fraction of width and height; NaN without a person.
    """
    import cv2

    if not np.isfinite(image).all():
        return np.full(3, np.nan)
    left, right = image[SHOULDERS]
    middle = (left + right) / 2
    hips = image[HIPS].mean(axis=0)
    points = middle + _ACROSS.reshape(-1, 1) * (left - right) + _DOWN.reshape(-1, 1) * (hips - middle)
    height, width = rgb.shape[:2]
    x, y = np.floor(points * (width, height)).astype(int).T
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    if not inside.any():
        return np.full(3, np.nan)
    colours = rgb[y[inside], x[inside]].astype(np.float32)[None] / 255
    return np.median(cv2.cvtColor(colours, cv2.COLOR_RGB2LAB)[0], axis=0).astype(np.float64)


def find_changes(
    track: PoseTrack, person: BoolArray, clothes: FloatArray, change: FloatArray, black: BoolArray
) -> tuple[Change, ...]:
    """Return the changes of a clip in order of time.

    Args:
        track: What was detected.
        person: Rows that show a person (T,).
        clothes: Colour of the clothes in each row (T, 3), L*a*b*.
        change: Difference of each frame's thumbnail from the previous one (T,) [grey levels].
        black: Frames that show nothing (T,).
    """
    found: dict[int, Kind] = {}
    t = track.t
    rows = np.flatnonzero(person)
    trunks = trunk_of(in_pixels(track))
    candidates: tuple[tuple[Kind, Iterable[int]], ...] = (
        ("fade", _after_black(black)),
        ("cut", (row for row in shot_starts(change) if FEWEST <= row <= len(t) - FEWEST)),
        ("person", _jumps(t, rows, *trunks)),
    )
    for kind, candidate in ((kind, row) for kind, own in candidates for row in own):
        if all(abs(t[candidate] - t[other]) > SAME_TIME for other in found):
            found[int(candidate)] = kind
    changes = (Change(row, kind, _is_other(row, kind, t, rows, clothes, *trunks)) for row, kind in found.items())
    kept = (one for one in changes if one.other_person or one.kind != "person")
    return tuple(sorted(kept, key=lambda one: one.row))


def describe(changes: tuple[Change, ...], t: FloatArray) -> Iterator[str]:
    """Yield a sentence for each kind of change, with its times."""
    names = {"cut": "a cut", "fade": "a fade through black"}
    for kind, name in names.items():
        for other in (True, False):
            rows = [c.row for c in changes if c.kind == kind and c.other_person == other]
            if rows:
                after = "with another person after it" if other else "and may show another person after it"
                yield f"the video has {name} at {_times(t, rows)} {after}; what is before and after is filtered apart"
    rows = [c.row for c in changes if c.kind == "person"]
    if rows:
        yield (
            f"the person who is followed changes at {_times(t, rows)} (place, size or clothes are another's); use a "
            "clip of one person"
        )


def _times(t: FloatArray, rows: list[int]) -> str:
    return ", ".join(f"{t[row]:.2f} s" for row in rows[:5]) + ", …" * (len(rows) > 5)


def _after_black(black: BoolArray) -> IntArray:
    """Return the first row with a picture after each black part that has a picture before it, too."""
    starts = np.flatnonzero(black[:-1] & ~black[1:]) + 1
    return starts[starts > np.argmin(black)]


def _jumps(t: FloatArray, rows: IntArray, place: FloatArray, height: FloatArray) -> IntArray:
    """Return the rows at which it may be another person: after a jump of the trunk or a gap, farthest jumps first.

    Args:
        t: Times (T,) [s].
        rows: Those that show a person.
        place, height: Trunk in each row, [px].
    """
    scale = np.maximum(np.minimum(height[rows[1:]], height[rows[:-1]]), 1.0)
    moved = np.linalg.norm(np.diff(place[rows], axis=0), axis=-1) / scale
    grown = np.abs(np.diff(np.log(np.maximum(height[rows], 1.0))))
    strange = (moved > JUMP) | (grown > OTHER_SIZE) | (np.diff(t[rows]) > GAP)
    order = np.argsort(-(moved + grown)[strange])
    return rows[1:][strange][order]


def _is_other(
    row: int, kind: Kind, t: FloatArray, rows: IntArray, clothes: FloatArray, place: FloatArray, height: FloatArray
) -> bool:
    """Return whether the person from a row on looks like another one than before it; arguments as of `_jumps`.

    Within one picture a person cannot jump; across a cut place and size say nothing, only the clothes do.
    """
    away = DIM if kind == "fade" else 0.0
    before = rows[(rows < row) & (t[rows] < t[row] - away)]
    after = rows[(rows >= row) & (t[rows] >= t[row] + away)]
    if not len(before) or not len(after):
        return False
    gap = t[after[0]] - t[before[-1]]
    before = before[t[before] > t[before[-1]] - WINDOW]
    after = after[t[after] < t[after[0]] + WINDOW]
    if any(len(side) < max(FEWEST, STEADY * (1 + side[-1] - side[0])) for side in (before, after)):
        return False
    colour = float(np.linalg.norm(_median(clothes[before]) - _median(clothes[after])))
    if kind != "person":
        return colour > OTHER_COLOUR
    small = max(min(np.median(height[before]), np.median(height[after])), 1.0)
    moved = float(np.linalg.norm(np.median(place[before], axis=0) - np.median(place[after], axis=0)) / small)
    grown = abs(float(np.log(np.median(height[after]) / max(np.median(height[before]), 1.0))))
    if gap > GAP:  # who only turned has a back of another colour, and is where they were
        return colour > OTHER_COLOUR and bool(gap > AWAY or moved > JUMP or grown > OTHER_SIZE)
    return moved > FAR or (moved > JUMP and (colour > OTHER_COLOUR or grown > OTHER_SIZE))


def _median(colours: FloatArray) -> FloatArray:
    known = colours[np.isfinite(colours).all(axis=-1)]
    return np.median(known, axis=0) if len(known) else np.full(3, np.nan)

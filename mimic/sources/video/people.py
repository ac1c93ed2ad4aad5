"""How many people a video shows, and which of them is followed.

The pose detector follows one person from frame to frame. From time to time a second detector looks for everybody; where
one person was chosen, the first one sees only the part of the picture around them, and frames in which it found
somebody else are left out. People are known again by their place and the colour of their clothes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mimic.errors import SourceError
from mimic.records import SHOULDERS, WRISTS, BoolArray, FloatArray, IntArray
from mimic.sources.video.pose_models.blazepose import Everybody
from mimic.sources.video.screening import trunk_of
from mimic.sources.video.shots import OTHER_COLOUR, clothes_colour

Choice = Literal["left", "right", "largest"] | int

SOONEST = 0.5
"""Shortest time between two looks for everybody [s]: all since the beginning, but the first where one person was
chosen."""
LATEST = 3.0
"""Longest time between two looks [s]."""
VISIBLE = 0.6
"""Both shoulders and a wrist of a person must be at least this visible: an arm by itself is found as a small person."""
SMALLEST = 0.25
"""Smaller people than this share of the largest one are background."""
FIRST = 2.0
"""Who is followed is decided among the people that are seen in this time from the beginning [s]."""
LOST = 3
"""After this many looks without a person, as after a cut, only their clothes tell them."""
UNLIKE = 2.0
"""Most difference of one person between two looks [trunk heights, or OTHER_COLOUR]."""
UNLIKE_ROW = 1.0
"""Most difference of one person between two frames."""
ELSEWHERE = 1.5
"""What counts as the distance of a lost person."""
SAME = 0.5
"""Two findings closer than this are one person [trunk heights]."""
MIN_LOOKS = 2
"""Several people are reported if this many looks found more than one,"""
MIN_SHARE = 0.15
"""… and this share of them."""
FEW_GAPS = 0.02
"""A larger share of frames without the chosen person is reported."""
MARGIN = 0.35
"""What is shown around a chosen person, on each side [box heights]."""
WIDE = 1.2
"""A picture with a longer side than this many shorter ones is also searched in squares: people who are small in the
whole of it are found there. Where nobody was chosen, every second look does so."""

CHOOSE = "--person left|right|largest|N chooses"


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """Somebody in a picture; lengths as a fraction of its height."""

    middle: FloatArray
    """Middle of the shoulders (2,)."""
    trunk: float
    """Height of the trunk, at least the width of the shoulders."""
    low: FloatArray
    """Left and upper end (2,)."""
    high: FloatArray
    """Right and lower end (2,)."""
    colour: FloatArray
    """Of the clothes (3,), L*a*b*; NaN where it is unknown."""
    missed: int = 0
    """Looks since this person was found."""


def person_of(image: FloatArray, aspect: float, colour: FloatArray | None = None) -> Person:
    """Return the person of landmarks (33, 2), fraction of width and height of a picture with this width over height."""
    points = image * (aspect, 1.0)
    middle, trunk = trunk_of(points)
    colour = np.full(3, np.nan) if colour is None else colour
    return Person(middle, max(float(trunk), 1e-3), points.min(axis=0), points.max(axis=0), colour)


def distinct(found: list[Person]) -> list[Person]:
    """Return the people from left to right, each once and without the background."""
    largest = max((person.trunk for person in found), default=0.0)
    kept: list[Person] = []
    for person in sorted(found, key=lambda one: -one.trunk):
        near = any(_apart(person, other) < SAME for other in kept)
        if person.trunk >= SMALLEST * largest and not near:
            kept.append(person)
    return sorted(kept, key=lambda one: float(one.middle[0]))


def chosen(people: list[Person], choice: Choice) -> Person:
    """Return the person that was chosen among people from left to right; the rightmost if there are not as many."""
    if choice == "largest":
        return max(people, key=lambda one: one.trunk)
    place = choice if isinstance(choice, int) else 1 if choice == "left" else len(people)
    return people[min(place, len(people)) - 1]


def _apart(one: Person, other: Person) -> float:
    """Return how far two people are apart [trunk heights of the other]."""
    return float(np.linalg.norm(one.middle - other.middle)) / other.trunk


def unlike(person: Person, known: Person) -> float:
    """Return how much somebody differs from a known person: place [trunk heights] and clothes [OTHER_COLOUR]."""
    colour = float(np.linalg.norm(person.colour - known.colour)) / OTHER_COLOUR
    away = _apart(person, known) if known.missed < LOST else ELSEWHERE
    return away + (0.5 if np.isnan(colour) else colour)


def recognised(people: list[Person], known: list[Person]) -> list[int | None]:
    """Return for each of the people which of the known ones it is; None of a new one."""
    from scipy.optimize import linear_sum_assignment

    costs = np.minimum([unlike(one, other) for one in people for other in known], UNLIKE)
    costs = costs.reshape(len(people), len(known))
    found: list[int | None] = [None] * len(people)
    for row, column in zip(*linear_sum_assignment(costs), strict=True) if costs.size else ():
        if costs[row, column] < UNLIKE:
            found[int(row)] = int(column)
    return found


def squares(width: int, height: int) -> list[tuple[int, int, int]]:
    """Return left end, upper end and side [px] of the squares of a picture; each overlaps the next by half or more."""
    side = min(width, height)
    longest = max(width, height)
    if longest <= WIDE * side:
        return []
    count = 1 + math.ceil(2 * (longest - side) / side)
    starts = [round(i * (longest - side) / (count - 1)) for i in range(count)]
    return [(start, 0, side) if width > height else (0, start, side) for start in starts]


class People:
    """Finds everybody now and then, and shows the detector only a chosen person."""

    def __init__(
        self,
        everybody: Everybody,
        choice: Choice | None,
        name: str,
        hint: str = CHOOSE,
        *,
        latest: int | None = None,
    ) -> None:
        """Prepare.

        Args:
            everybody: Finds the people in a picture.
            choice: Who is followed: by place in the first picture with several people, or by size. None leaves that to
                the detector.
            name: Of the video, for messages.
            hint: What to do about several people.
            latest: How many looks count, the latest; None for all.
        """
        self._everybody = everybody
        self._name = name
        self._hint = hint
        self._choice: Choice | None = choice
        self._next = -np.inf
        self._aspect = 1.0
        self._known: list[Person] = []
        self._own: int | None = None
        self._place: Person | None = None
        self._crop: tuple[int, int, int, int] | None = None
        self._looks: deque[tuple[float, list[Person]]] = deque(maxlen=latest)
        self._closely = True
        self._rows: list[bool] = []
        self._since_look = 0
        self.astray = False
        """Whether the detector follows somebody else, and must forget them."""

    def choose(self, frames: Iterable[tuple[float, np.ndarray]]) -> None:
        """Choose the person from the first seconds: not everybody is found in every picture.

        Args:
            frames: Times [s] and pictures of the clip from its beginning; they are read as far as needed.
        """
        looks: list[list[Person]] = []
        for t, rgb in frames:
            if t > FIRST:
                break
            if t >= SOONEST * len(looks):
                self._aspect = rgb.shape[1] / rgb.shape[0]
                looks.append(distinct(list(self._everybody_in(rgb))))
        most = max(looks, key=len, default=[])
        if self._choice is None or not self._enough(most):
            return
        self._known = list(most)
        own = most.index(chosen(most, self._choice))
        for people in reversed(looks[: looks.index(most)]):  # where they were at the beginning
            self._remember(people)
        self._own = own
        self._place = self._known[own]

    def _enough(self, people: list[Person]) -> bool:
        return len(people) >= (self._choice if isinstance(self._choice, int) else 1)

    def _remember(self, people: list[Person]) -> list[int]:
        """Take who was found, and return which of the known people each of them is; new ones become known."""
        who = recognised(people, self._known)
        self._known = [replace(one, missed=one.missed + 1) for one in self._known]
        for i, (one, known) in enumerate(zip(people, who, strict=True)):
            if known is None:
                who[i] = len(self._known)
                self._known.append(one)
            else:
                self._known[known] = (
                    one if np.isfinite(one.colour).all() else replace(one, colour=self._known[known].colour)
                )
        return [int(known or 0) for known in who]

    def show(self, t: float, rgb: np.ndarray) -> np.ndarray:
        """Return what the detector may see of a frame at time t [s]: all of it, or the chosen person."""
        self._aspect = rgb.shape[1] / rgb.shape[0]
        if t >= self._next:
            self._next = t + (float(np.clip(t, SOONEST, LATEST)) if self._choice is None else SOONEST)
            self.look(t, rgb)
        if self._choice is None or self._place is None:
            return rgb
        height, width = rgb.shape[:2]
        x0, y0, x1, y1 = self._crop = self._section(width, height)
        return np.ascontiguousarray(rgb[y0:y1, x0:x1])

    def in_picture(self, image: FloatArray, width: int, height: int) -> FloatArray:
        """Return landmarks in what `show` gave (33, 2) as fractions of the picture, which has this size [px]."""
        if self._crop is None:
            return image
        x0, y0, x1, y1 = self._crop
        return (image * (x1 - x0, y1 - y0) + (x0, y0)) / (width, height)

    def _section(self, width: int, height: int) -> tuple[int, int, int, int]:
        """Return the ends [px] of the part of a picture that shows the chosen person.

        It stays where it is as long as it fits: the detector looks for the person where they were in it.
        """
        assert self._place is not None
        low = self._place.low
        high = self._place.high
        margin = MARGIN * (high[1] - low[1])

        def around(gap: float) -> IntArray:
            ends = np.concatenate([np.floor((low - gap) * height), np.ceil((high + gap) * height)])
            return np.clip(ends, 0, (width, height, width, height)).astype(np.int64)

        if self._crop is not None:
            inner = around(margin / 3)
            own = np.array(self._crop)
            fits = (own[:2] <= inner[:2]).all() and (own[2:] >= inner[2:]).all()
            if fits and own[3] - own[1] < 2 * (inner[3] - inner[1]):
                return self._crop
        x0, y0, x1, y1 = (int(end) for end in around(margin))
        return (x0, y0, x1, y1) if x1 > x0 and y1 > y0 else (0, 0, width, height)

    def saw(self, image: FloatArray, colour: FloatArray) -> None:
        """Take what the detector found in that frame.

        Args:
            image: Landmarks (33, 2), as fractions of the picture; NaN if none.
            colour: Of the clothes (3,), L*a*b*.
        """
        self.astray = False
        self._rows.append(self._choice is None)
        if not np.isfinite(image).all():
            return
        person = person_of(image, self._aspect, colour)
        if self._own is None or self._place is None:
            return
        others = [unlike(person, one) for i, one in enumerate(self._known) if i != self._own and not one.missed]
        own = unlike(person, replace(self._place, colour=self._known[self._own].colour, missed=0))
        far = _apart(person, self._place) > UNLIKE_ROW  # hands before the trunk change its colour: no limit on that
        self.astray = far or own > min(others, default=np.inf)
        self._rows[-1] = not self.astray
        if not self.astray:
            self._place = person

    def look(self, t: float, rgb: np.ndarray) -> None:
        """Look for everybody in a picture at time t [s]."""
        people = distinct(list(self._everybody_in(rgb, self._closely)))
        self._closely = self._choice is not None or not self._closely  # squares take two thirds of the time
        self._looks.append((t, people))
        if self._choice is None:
            return
        who = self._remember(people)
        if self._own is None and self._enough(people):
            self._own = who[people.index(chosen(people, self._choice))]
        if self._own in who:
            own = self._known[self._own]
            if self._place is not None and _apart(self._place, own) > UNLIKE_ROW:  # it slid to somebody else
                self._rows[self._since_look :] = [False] * (len(self._rows) - self._since_look)
                self.astray = True
            self._place = own
        self._since_look = len(self._rows)

    def followed_rows(self) -> BoolArray:
        """Return the frames (T,) in which the detector found the chosen person, or whom it liked if none was chosen."""
        return np.array(self._rows, dtype=np.bool_)

    def _everybody_in(self, rgb: np.ndarray, closely: bool = True) -> Iterator[Person]:
        """Yield the people in a picture and, if asked, in its squares; some of them twice."""
        height, width = rgb.shape[:2]
        for image in self._poses_in(rgb):
            yield person_of(image, self._aspect, clothes_colour(rgb, image))
        for x, y, side in squares(width, height) if closely else ():
            for image in self._poses_in(rgb[y : y + side, x : x + side]):
                inner = [x > 0, y > 0], [x + side < width, y + side < height]
                if not ((image.min(axis=0) < 0) & inner[0]).any() and not ((image.max(axis=0) > 1) & inner[1]).any():
                    whole = (image * side + (x, y)) / (width, height)
                    yield person_of(whole, self._aspect, clothes_colour(rgb, whole))

    def _poses_in(self, rgb: np.ndarray) -> list[FloatArray]:
        """Return landmarks (33, 2) of everybody in a picture, fraction of its width and height."""
        return [
            image
            for image, score in self._everybody(rgb)
            if min(score[SHOULDERS].min(), score[WRISTS].max()) >= VISIBLE
        ]

    def sentences(self) -> list[str]:
        """Return what is to be said about several people in view.

        Raises:
            SourceError: If fewer people are in view than the number that was chosen.
        """
        most = max((len(people) for _, people in self._looks), default=0)
        if isinstance(self._choice, int) and most < self._choice:
            raise SourceError(
                f"--person {self._choice}: {self._name} shows {most} {'person' if most == 1 else 'people'} at most; "
                "give left, right, largest, or a number from the left"
            )
        said = describe(self._looks, self._choice, self._hint)
        if self._choice is None:
            return said
        gaps = 1.0 - float(self.followed_rows().mean())
        left_out = f"--person {self._choice}: in {gaps:.0%} of the frames that person was not found; these are gaps"
        return [*said, *[left_out] * (gaps > FEW_GAPS)]


def describe(looks: Collection[tuple[float, list[Person]]], choice: Choice | None, hint: str = CHOOSE) -> list[str]:
    """Return a sentence if several people are in view: how many, when, and who chose among them.

    Args:
        looks: Times [s] and the people found then.
        choice: Who was chosen, if anybody.
        hint: What to do if nobody was.
    """
    several = [(t, len(people)) for t, people in looks if len(people) > 1]
    if len(several) < MIN_LOOKS or len(several) < MIN_SHARE * len(looks):
        return []
    most = sorted(count for _, count in several)[-MIN_LOOKS]
    who = f"the detector follows one of them: {hint}" if choice is None else f"--person {choice} is followed"
    return [f"up to {most} people are in view between {several[0][0]:.0f} and {several[-1][0]:.0f} s; {who}"]

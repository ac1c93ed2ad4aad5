"""BVH: a skeleton with joint angles; forward kinematics gives the positions of its joints.

Source: Meredith and Maddock, "Motion Capture File Formats Explained", University of Sheffield, 2001, section 2.1: the
channels of a joint are applied in their order, each about the axes that the ones before it left.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import numpy as np

from mimic.config.pose import MocapSettings
from mimic.config.text_file import read_text
from mimic.errors import SourceError
from mimic.records import FloatArray
from mimic.sources.mocap.points import Points, clock

_CHANNELS = {f"{axis}{kind}": (kind, i) for kind in ("position", "rotation") for i, axis in enumerate("xyz")}


@dataclass(slots=True, eq=False)
class _Joint:
    name: str
    parent: int
    offset: FloatArray = field(default_factory=lambda: np.zeros(3))
    channels: list[tuple[str, int]] = field(default_factory=list)


class _Words:
    """The words of the file, with the line that each is on."""

    def __init__(self, text: str, name: str) -> None:
        self._name = name
        self._words = ((word, n) for n, line in enumerate(text.splitlines(), 1) for word in line.split())
        self.line = 0

    def __iter__(self) -> Iterator[str]:
        for word, line in self._words:
            self.line = line
            yield word

    def next(self, expected: str) -> str:
        for word in self:
            return word
        raise self.wrong("the end of the file", expected)

    def number(self, expected: str, word: str | None = None) -> float:
        word = word or self.next(expected)
        with suppress(ValueError):
            value = float(word)
            if math.isfinite(value):
                return value
        raise self.wrong(repr(word), expected)

    def wrong(self, given: str, expected: str) -> SourceError:
        return SourceError(f"{self._name}, line {self.line}: expected {expected}, got {given}; export the BVH again")


def read_bvh(path: Path, settings: MocapSettings) -> Points:
    """Return the position of every joint of a BVH file in every frame; end sites are left out.

    Raises:
        SourceError: If the file is no BVH, or ends early.
    """
    words = _Words(read_text(path), path.name)
    if next(iter(words), "").upper() != "HIERARCHY":
        raise SourceError(f"{path.name}, line 1: not a BVH file (it must start with HIERARCHY)")
    joints = _hierarchy(words)
    announced, step = _header(words)
    width = sum(len(joint.channels) for joint in joints)
    if not width:
        raise SourceError(f"{path.name} has joints without channels, which do not move; export the BVH again")
    values = np.array(_numbers(words, width))
    frames = len(values) // width
    if frames == 0:
        raise SourceError(f"{path.name} has {len(values)} motion values, less than the {width} of one frame")
    warnings = []
    if frames != announced or len(values) % width:
        warnings.append(f"{path.name} announces {announced} frames and holds {len(values) / width:g}")
    values = values[: frames * width].reshape(frames, width)
    kinds = np.array([kind for joint in joints for kind, _ in joint.channels])
    largest = float(np.abs(values[:, kinds == "rotation"]).max(initial=0.0))
    if 0.0 < largest <= 2.0 * math.pi:
        warnings.append(
            f"no joint turns by more than {largest:.3g} degrees; if these are radians, multiply them by 57.3: BVH has "
            "degrees"
        )
    added = _are_displacements(joints, values)
    if added:
        warnings.append("its positions below the root are added to the offsets, for they are no bones by themselves")
    return Points(
        t=clock(frames, 1.0 / step if step else np.inf, settings, path),
        xyz=_positions(joints, values, added),
        score=np.ones((frames, len(joints))),
        names=tuple(joint.name for joint in joints),
        warnings=tuple(warnings),
    )


def _hierarchy(words: _Words) -> list[_Joint]:
    joints: list[_Joint] = []
    open_ones: list[int] = []
    end_site = -1
    for word in words:
        kind = word.upper()
        if kind in ("ROOT", "JOINT"):
            joints.append(_Joint(words.next("a name"), open_ones[-1] if open_ones else -1))
            for more in iter(lambda: words.next("{"), "{"):
                joints[-1].name += f" {more}"
            open_ones.append(len(joints) - 1)
        elif kind == "END":
            while words.next("{") != "{":
                pass
            open_ones.append(end_site)
        elif kind == "OFFSET":
            offset = np.array([words.number("a number") for _ in range(3)])
            if open_ones and open_ones[-1] != end_site:
                joints[open_ones[-1]].offset = offset
        elif kind == "CHANNELS":
            inside = joints[open_ones[-1]] if open_ones and open_ones[-1] != end_site else None
            _read_channels(words, inside)
        elif word == "}" and open_ones:
            open_ones.pop()
        elif kind == "MOTION" and not open_ones and joints:
            return joints
        else:
            raise words.wrong(repr(word), "ROOT, JOINT, End, OFFSET, CHANNELS or MOTION")
    raise words.wrong("the end of the file", "MOTION")


def _read_channels(words: _Words, joint: _Joint | None) -> None:
    for _ in range(int(words.number("the number of channels"))):
        channel = words.next("a channel")
        if channel.lower() not in _CHANNELS or joint is None:
            raise words.wrong(repr(channel), "a channel such as Xrotation inside a joint")
        joint.channels.append(_CHANNELS[channel.lower()])


def _header(words: _Words) -> tuple[int, float]:
    word = words.next("Frames:")
    if word.lower() != "frames:":
        raise words.wrong(repr(word), "Frames:")
    announced = int(words.number("the number of frames"))
    pair = f"{words.next('Frame')} {words.next('Time:')}"
    if pair.lower() != "frame time:":
        raise words.wrong(repr(pair), "Frame Time:")
    return announced, words.number("the time of a frame")


def _numbers(words: _Words, width: int) -> list[float]:
    """Return the numbers of all rows; a row may go on in the next line, but no line in the next row."""

    numbers: list[float] = []
    for line, row in groupby(words, lambda _: words.line):
        given = [words.number("a number", word) for word in row]
        if len(given) > width - len(numbers) % width:
            words.line = line
            raise words.wrong(
                f"{len(given)} numbers in row {len(numbers) // width + 1}",
                f"the {width} numbers of the channels in each row",
            )
        numbers += given
    return numbers


def _are_displacements(joints: list[_Joint], values: FloatArray) -> bool:
    """Return whether positions of joints below the root move them from their offsets instead of taking their place."""
    columns = iter(values.T)
    bones = given = 0.0
    for joint in joints:
        own = [(kind, next(columns)) for kind, _ in joint.channels]
        moved = [column for kind, column in own if kind == "position"]
        if moved and joint.parent >= 0:
            bones += float(np.linalg.norm(joint.offset))
            given += float(np.linalg.norm(np.median(moved, axis=1)))
    return given < 0.5 * bones


def _positions(joints: list[_Joint], values: FloatArray, added: bool) -> FloatArray:
    """Return the joints' positions (T, N, 3) in the file's axes.

    Args:
        joints, values: Of the file.
        added: Positions below the root are added to the offsets; otherwise they take their place.
    """
    from scipy.spatial.transform import Rotation

    places = np.empty((len(values), len(joints), 3))
    columns = iter(values.T)
    turned = list[Rotation]()
    for index, joint in enumerate(joints):
        moved = np.tile(joint.offset, (len(values), 1))
        turn = Rotation.identity(len(values))
        for kind, axis in joint.channels:
            column = next(columns)
            if kind == "position":
                moved[:, axis] = column + (joint.offset[axis] if added and joint.parent >= 0 else 0.0)
            else:
                turn = turn * Rotation.from_rotvec(np.radians(column)[:, None] * np.eye(3)[axis])
        before = turned[joint.parent] if joint.parent >= 0 else Rotation.identity(len(values))
        places[:, index] = before.apply(moved) + (places[:, joint.parent] if joint.parent >= 0 else 0.0)
        turned.append(before * turn)
    return places

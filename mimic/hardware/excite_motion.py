"""How a robot that hangs is moved: targets row by row, and which motors are asked in which row.

Joints of a leg that moves are asked in every row. A leg that is held is neither moved by the others nor in a hurry: its motors
get their command in turn, as often as a robot that a policy moves, once in a control step, so that they stay supervised as
quickly; what lies between is not a number in the log, and carried on by :func:`mimic.machine_log.read_log`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mimic.errors import ConfigError
from mimic.robot.description import RobotDescription
from mimic.robot.excitation import hung_ranges, probe_targets
from mimic.robot.goals import eased
from mimic.settings import ProbeSettings
from mimic.types import JOINTS, LEGS, BoolArray, FloatArray

GROUPS = {
    "all": (tuple(range(12)),),
    "sides": ((0, 1, 2, 6, 7, 8), (3, 4, 5, 9, 10, 11)),
    "legs": tuple(tuple(range(3 * leg, 3 * leg + 3)) for leg in range(4)),
    "each": tuple((joint,) for joint in range(12)),
}
"""Joints that move at the same time, one group after another; the others are held at the centre."""

EASE, REST = 0.3, 0.2
"""Time in which a group comes back to the centre, and in which it comes to rest there while it is still watched [s]."""

_PER_LEG = len(JOINTS) // len(LEGS)


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """What a robot that hangs is asked to do, a row at a time."""

    q_des: FloatArray
    """Targets (T, 12) [rad]."""
    watched: BoolArray
    """Joints of legs that move (T, 12): asked in every row."""

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.q_des)

    def begin(self, rows: int) -> Motion:
        """Return the first rows."""
        return Motion(q_des=self.q_des[:rows], watched=self.watched[:rows])


@dataclass(frozen=True, kw_only=True)
class Turns:
    """Which motors are asked in a row."""

    rate: float
    """Rows a second [Hz]."""
    rows: int
    """Within so many rows each motor is asked."""

    def asked(self, watched: BoolArray, since: FloatArray) -> list[int]:
        """Return the joints that are asked in a row.

        Those of legs that move come first, so that they always measure at the same time after the beginning of their row.

        Args:
            watched: Joints of legs that move (12,).
            since: When each was asked last (12,) [s]; of the others, those that wait longest are asked, and of these the
                same joint of each leg: rows are alike then, also in the time that their answers take.
        """
        held = np.flatnonzero(~watched)
        oldest = held[np.lexsort((held, held % _PER_LEG, since[held]))[: self._at_once(len(held))]]
        return [*np.flatnonzero(watched).tolist(), *np.sort(oldest).tolist()]

    def rates(self, watched: BoolArray) -> FloatArray:
        """Return how often each motor is asked (12,) [Hz]."""
        held = int(np.count_nonzero(~watched))
        return np.where(watched, self.rate, self.rate * self._at_once(held) / max(held, 1))

    def _at_once(self, held: int) -> int:
        """Return how many motors that hold their joint are asked in a row: always as many."""
        return math.ceil(held / self.rows)


def turns(rate: float, dt: float) -> Turns:
    """Return the turns by which each motor is asked at least once in each control step.

    Args:
        rate: Rows a second [Hz].
        dt: Control step of the robot [s].
    """
    return Turns(rate=rate, rows=max(1, int(rate * dt + 1e-9)))


def asked_rates(motion: Motion, settings: ProbeSettings, description: RobotDescription) -> FloatArray:
    """Return how often each motor is asked in each part of a motion (parts, 12) [Hz]."""
    turn = turns(settings.rate, description.dt)
    return np.array([turn.rates(watched) for watched in np.unique(motion.watched, axis=0)])


def probe_motion(description: RobotDescription, settings: ProbeSettings) -> Motion:
    """Return targets inside the ranges in which nothing can touch, group after group.

    Raises:
        ConfigError: If the time is too short for so many groups.
    """
    low, high, centre = hung_ranges(description)
    groups = GROUPS[settings.joints]
    share = settings.seconds / len(groups)
    if share < 10.0:
        raise ConfigError(
            f"{settings.seconds:g} s are {share:.1f} s for each of {len(groups)} groups; give at least {10 * len(groups)}"
        )
    ease, rest = round(EASE * settings.rate), round(REST * settings.rate)
    parts, watched = [], []
    for number, group in enumerate(groups):
        moved = probe_targets(
            low,
            high,
            centre,
            seconds=share,
            rate_hz=settings.rate,
            seed=settings.seed + number,
            kind=settings.kind,
            size=settings.size,
        ).q_des
        part = np.tile(centre, (len(moved), 1))
        part[:, group] = moved[:, group]
        if len(groups) > 1:
            part[-ease - rest :] = _to_rest(part[-ease - rest], centre, ease, rest)
        parts.append(part)
        legs = {joint // _PER_LEG for joint in group}
        watched.append(np.tile([joint // _PER_LEG in legs for joint in range(len(JOINTS))], (len(moved), 1)))
    return Motion(q_des=np.concatenate(parts), watched=np.concatenate(watched))


def _to_rest(begin: FloatArray, centre: FloatArray, ease: int, rest: int) -> FloatArray:
    """Return targets (ease + rest, 12) from one pose to another, and staying there."""
    way = np.concatenate([eased((np.arange(ease) + 1) / ease), np.ones(rest)])
    return begin + way[:, None] * (centre - begin)


def recorded_motion(t: FloatArray, q: FloatArray, description: RobotDescription, settings: ProbeSettings) -> Motion:
    """Return the targets of a recorded run at the rate of probing, inside the hung robot's ranges; all joints move.

    Args:
        t: Times of the targets, increasing [s].
        q: Targets (ticks, 12) [rad].
        description: The robot.
        settings: Rate and length; a shorter recording begins anew.
    """
    low, high, _ = hung_ranges(description)
    span = float(t[-1] - t[0])
    at = t[0] + np.arange(round(settings.seconds * settings.rate)) / settings.rate % span
    q_des = np.clip(np.stack([np.interp(at, t, column) for column in q.T], -1), low, high)
    return Motion(q_des=q_des, watched=np.ones(q_des.shape, dtype=bool))

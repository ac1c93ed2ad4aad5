"""The motion of a suspended robot: targets row by row, and which motors are asked in which row.

Joints of a moving leg are asked in every row. A held leg does not move, so its motors are asked in turn, at least
once in a control step. That is as often as while a policy moves the robot, so faults are noticed as quickly. Rows
without a reading are NaN in the log, and `mimic.io.joint_log.read_log` carries the last reading forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mimic.config.hardware import ProbeSettings
from mimic.dynamics.excitation import hung_ranges, probe_targets
from mimic.errors import ConfigError
from mimic.geometry import smoothstep
from mimic.records import JOINTS, LEGS, BoolArray, FloatArray
from mimic.robot.description import RobotDescription

GROUPS = {
    "all": (tuple(range(12)),),
    "sides": ((0, 1, 2, 6, 7, 8), (3, 4, 5, 9, 10, 11)),
    "legs": tuple(tuple(range(3 * leg, 3 * leg + 3)) for leg in range(4)),
    "each": tuple((joint,) for joint in range(12)),
}
"""Joints that move at the same time, one group after another; the other joints are held at the centre."""

EASE = 0.3
"""Time in which a group returns to the centre [s]."""
REST = 0.2
"""Time for which it then rests, still read in every row [s]."""

_PER_LEG = len(JOINTS) // len(LEGS)


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeMotion:
    """Targets of a suspended robot, one row at a time."""

    q_des: FloatArray
    """Targets (T, 12) [rad]."""
    watched: BoolArray
    """Joints of moving legs (T, 12): asked in every row."""

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.q_des)

    def begin(self, rows: int) -> ProbeMotion:
        """Return the first rows."""
        return ProbeMotion(q_des=self.q_des[:rows], watched=self.watched[:rows])


@dataclass(frozen=True, kw_only=True)
class Turns:
    """Which motors are asked in a row."""

    rate_hz: float
    """Rows a second [Hz]."""
    rows: int
    """Each motor is asked within so many rows."""

    def asked(self, watched: BoolArray, since: FloatArray) -> list[int]:
        """Return the joints that are asked in a row.

        Joints of moving legs come first, so that they always measure at the same time after the start of their row.
        Of the others, those that have waited longest are asked, and among these the same joint of each leg. So all
        rows are alike, also in the time that their answers take.

        Args:
            watched: Joints of moving legs (12,).
            since: When each joint was asked last (12,) [s].
        """
        held = np.flatnonzero(~watched)
        oldest = held[np.lexsort((held, held % _PER_LEG, since[held]))[: self._at_once(len(held))]]
        return [*np.flatnonzero(watched).tolist(), *np.sort(oldest).tolist()]

    def rates(self, watched: BoolArray) -> FloatArray:
        """Return how often each motor is asked (12,) [Hz]."""
        held = int(np.count_nonzero(~watched))
        return np.where(watched, self.rate_hz, self.rate_hz * self._at_once(held) / max(held, 1))

    def _at_once(self, held: int) -> int:
        """Return how many motors of held joints are asked in a row: the same number in each."""
        return math.ceil(held / self.rows)


def turns(rate_hz: float, dt: float) -> Turns:
    """Return turns in which each motor is asked at least once in a control step.

    Args:
        rate_hz: Rows a second [Hz].
        dt: Control step of the robot [s].
    """
    return Turns(rate_hz=rate_hz, rows=max(1, int(rate_hz * dt + 1e-9)))


def asked_rates(motion: ProbeMotion, settings: ProbeSettings, description: RobotDescription) -> FloatArray:
    """Return how often each motor is asked in each part of a motion (parts, 12) [Hz]."""
    turn = turns(settings.rate_hz, description.dt)
    return np.array([turn.rates(watched) for watched in np.unique(motion.watched, axis=0)])


def probe_motion(description: RobotDescription, settings: ProbeSettings) -> ProbeMotion:
    """Return targets inside the ranges in which no leg can touch anything, group after group.

    Raises:
        ConfigError: If the time is too short for the number of groups.
    """
    low, high, centre = hung_ranges(description)
    groups = GROUPS[settings.joints]
    share = settings.seconds / len(groups)
    if share < 10.0:
        raise ConfigError(
            f"{settings.seconds:g} s are {share:.1f} s for each of {len(groups)} groups; "
            f"give at least {10 * len(groups)}"
        )
    ease = round(EASE * settings.rate_hz)
    rest = round(REST * settings.rate_hz)
    parts = []
    watched = []
    for number, group in enumerate(groups):
        moved = probe_targets(
            low,
            high,
            centre,
            seconds=share,
            rate_hz=settings.rate_hz,
            seed=settings.seed + number,
            kind=settings.kind,
            size=settings.amplitude,
        ).q_des
        part = np.tile(centre, (len(moved), 1))
        part[:, group] = moved[:, group]
        if len(groups) > 1:
            part[-ease - rest :] = _to_rest(part[-ease - rest], centre, ease, rest)
        parts.append(part)
        legs = {joint // _PER_LEG for joint in group}
        watched.append(np.tile([joint // _PER_LEG in legs for joint in range(len(JOINTS))], (len(moved), 1)))
    return ProbeMotion(q_des=np.concatenate(parts), watched=np.concatenate(watched))


def _to_rest(begin: FloatArray, centre: FloatArray, ease: int, rest: int) -> FloatArray:
    """Return targets (ease + rest, 12) [rad] that move from one pose to another and stay there."""
    way = np.concatenate([smoothstep((np.arange(ease) + 1) / ease), np.ones(rest)])
    return begin + way[:, None] * (centre - begin)


def recorded_motion(
    t: FloatArray, q: FloatArray, description: RobotDescription, settings: ProbeSettings
) -> ProbeMotion:
    """Return the targets of a recorded run, inside the ranges of the suspended robot; all joints move.

    Args:
        t: Times of the targets, increasing [s].
        q: Targets (ticks, 12) [rad].
        description: The robot.
        settings: Rate and length; a shorter recording is repeated.
    """
    low, high, _ = hung_ranges(description)
    span = float(t[-1] - t[0])
    at = t[0] + np.arange(round(settings.seconds * settings.rate_hz)) / settings.rate_hz % span
    q_des = np.clip(np.stack([np.interp(at, t, column) for column in q.T], -1), low, high)
    return ProbeMotion(q_des=q_des, watched=np.ones(q_des.shape, dtype=bool))

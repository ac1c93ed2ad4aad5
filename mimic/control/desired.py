"""What the policy is asked for at each control tick: standing up, a blend to the first command, the motion, a hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mimic.config.play import RunSettings
from mimic.geometry import smoothstep
from mimic.records import PHASES, Command, CommandTrack, FloatArray, LiveCommands

STAND_UP, BLEND, TRACK, HOLD = (PHASES.index(name) for name in ("stand_up", "blend", "track", "hold"))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Desired:
    """What is asked for at one control tick."""

    phase: int
    """Index into PHASES."""
    command: Command


MeasuredToes = Callable[[], FloatArray]


class DesiredMotion(Protocol):
    """A motion, one control tick after another."""

    def at(self, tick: int, toes: MeasuredToes) -> Desired | None:
        """Return what is asked for at a control tick, counted from standing up; None when the motion is over.

        Args:
            tick: Ticks are asked for in order, each once.
            toes: Returns where the toes are now (2, 3), base axes [m].
        """
        ...


class _Timing:
    """Ticks of each phase, and what is asked for before the first command counts fully."""

    def __init__(self, settings: RunSettings, dt: float, neutral: FloatArray) -> None:
        self.stand, self.blend, self.hold = (
            round(seconds / dt) for seconds in (settings.stand_up, settings.blend, settings.hold_last)
        )
        self._neutral = neutral
        self._begin: FloatArray | None = None

    def standing_up(self) -> Desired:
        """Return the neutral toes without a turn: the robot first stands, then turns."""
        return Desired(phase=STAND_UP, command=Command(v=np.zeros(2), heading=0.0, p_BE=self._neutral))

    def blending(self, tick: int, toes: MeasuredToes, first: Command) -> Desired:
        """Return toes on the way from where they were when blending began to a command."""
        if self._begin is None:
            self._begin = toes()
        share = smoothstep((tick - self.stand + 1) / self.blend)
        p_BE = self._begin + share * (first.p_BE - self._begin)
        return Desired(phase=BLEND, command=Command(v=np.zeros(2), heading=first.heading, p_BE=p_BE))


def _held(command: Command) -> Desired:
    return Desired(phase=HOLD, command=Command(v=np.zeros(2), heading=command.heading, p_BE=command.p_BE))


class StoredMotion:
    """A motion that is known from its beginning to its end.

    With ``settings.early`` its commands run ahead of the phase "track", which is the time of the motion itself: they
    begin at the end of the blend and end with the last one held.
    """

    def __init__(
        self, track: CommandTrack, settings: RunSettings, dt: float, neutral: FloatArray, *, endless: bool = False
    ) -> None:
        """Prepare a motion.

        Args:
            track: Commands, one each control step.
            settings: Times of the phases.
            dt: Control step [s].
            neutral: Toes while standing up (2, 3), base axes [m].
            endless: Hold the last command for ever.
        """
        self._track, self._timing, self._endless = track, _Timing(settings, dt, neutral), endless
        self._early = round((settings.early or 0.0) / dt)
        self.ticks = self._timing.stand + self._timing.blend + self._early + len(track.t) + self._timing.hold
        """Control ticks of the motion, unless it is endless."""

    def _row(self, row: int) -> Command:
        track = self._track
        return Command(v=track.v[row], heading=float(track.heading[row]), p_BE=track.p_BE[row])

    def at(self, tick: int, toes: MeasuredToes) -> Desired | None:
        """Return what is asked for at a control tick; None when the motion is over."""
        timing = self._timing
        row = tick - timing.stand - timing.blend
        if tick < timing.stand:
            return timing.standing_up()
        if row < 0:
            return timing.blending(tick, toes, self._row(0))
        command = self._row(row) if row < len(self._track.t) else _held(self._row(-1)).command
        if row < self._early + len(self._track.t):
            return Desired(phase=TRACK if row >= self._early else BLEND, command=command)
        return _held(command) if self._endless or tick < self.ticks else None


class LiveMotion:
    """A motion that is made while the robot moves; its last command is held for a while when it ends."""

    def __init__(self, live: LiveCommands, settings: RunSettings, dt: float, neutral: FloatArray) -> None:
        self._live, self._timing = live, _Timing(settings, dt, neutral)
        self._hold_left = self._timing.hold
        self._last: Command | None = None

    def at(self, tick: int, toes: MeasuredToes) -> Desired | None:
        """Return what is asked for at a control tick; None when the motion and the hold are over."""
        timing = self._timing
        if tick < timing.stand:
            return timing.standing_up()
        command = self._live.newest()
        if command is not None:
            self._last = command
            if tick < timing.stand + timing.blend:
                return timing.blending(tick, toes, command)
            return Desired(phase=TRACK, command=command)
        self._hold_left -= 1
        return None if self._hold_left < 0 or self._last is None else _held(self._last)

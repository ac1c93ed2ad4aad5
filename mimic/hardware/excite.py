"""Moving a robot that hangs so that its drives show what they are, and logging it as calibration reads it.

A row is one exchange with the motors of legs that move, and with some of the others in turn: the commands go out at once, and
each motor measures when its own arrives. An answer that comes too late for its own row but before the next commands still
belongs to it; one that is later is missing, as is that of a motor that was not asked. Motors tell the torque of that instant, not the mean since the row before, which a log's ``tau`` is; so it stands beside the log, as
``tau_now``. A position is told as a word that was rounded down; the log has the middle of what the word stands for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mimic.errors import PlantError
from mimic.machine_log import HELD, MachineLog
from mimic.robot.goals import eased
from mimic.robot.wiring import Wiring
from mimic.run.bus_load import expected_load
from mimic.run.can_robot import CanRobot
from mimic.run.cybergear import half_a_word
from mimic.run.exchange import ALL
from mimic.run.motor_messages import VBUS, ReadParameter
from mimic.run.probe_motion import Motion, turns
from mimic.run.safety import Event, Mode, Supervisor
from mimic.run.safety_rules import HUNG_RULES, LIMITS, Facts
from mimic.run.signals import Signals
from mimic.settings import ProbeSettings
from mimic.types import JOINTS, BoolArray, FloatArray, JointCommand

VOLTAGE_EVERY = 0.5
"""How often a motor is asked for the supply's voltage [s]."""

SILENT_TURNS = 3
"""A reading of a joint that is held may be carried on over so many turns at most; the supervisor ends a longer silence."""

STILL_WORDS = 2.0
"""... if the readings around differ by no more than so many words of a position."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Probe:
    """What came of probing."""

    log: MachineLog
    ended: Event | None
    """What ended it early, if anything did."""
    missing: float
    """Share of the readings asked for that did not come."""
    load: FloatArray
    """Share of its time that each bus was busy while the motion was played, by the frames seen here (buses,)."""
    expected: FloatArray
    """The same by the arithmetic (buses,)."""


def probe(
    robot: CanRobot,
    motion: Motion,
    settings: ProbeSettings,
    signals: Signals,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Probe:
    """Move a robot that hangs, and return its log; the robot is left damped and off, whatever happens.

    Args:
        robot: Not started yet.
        motion: Targets, and which joints are asked in every row.
        settings: Rate and gains.
        signals: Ctrl-C ends it and keeps the log.
        progress: Called once a second with the rows done and in all.

    Raises:
        PlantError: If it ended before the first row.
    """
    limits = replace(
        LIMITS,
        silent_ticks=round(LIMITS.silent_ticks * robot.description.dt * settings.rate),
        slow_ticks=round(LIMITS.slow_ticks * robot.description.dt * settings.rate),
        late_ticks=round(LIMITS.late_ticks * robot.description.dt * settings.rate),
    )
    supervisor = Supervisor(robot.description, limits, rules=HUNG_RULES, sits=False)
    rows = _Rows(robot, supervisor, signals, settings)
    try:
        state = robot.start()
        approach = list(_approach(state.q, motion.q_des[0], settings))
        rows.begin()
        for gain, target in approach:
            rows.step(gain, target, motion.watched[0], keep=False)
        for number, (target, watched) in enumerate(zip(motion.q_des, motion.watched, strict=True)):
            rows.step(1.0, target, watched, keep=True, everyone=number in (0, len(motion) - 1))
            if progress is not None and number % round(settings.rate) == 0:
                progress(number, len(motion))
        rows.end()
    except _Ended:
        pass
    except (PlantError, KeyboardInterrupt) as reason:
        supervisor.decide("exception", Mode.DAMP, str(reason) or type(reason).__name__, robot.exchange.link.now())
    finally:
        robot.close()
    return rows.result()


def _approach(begin: FloatArray, first: FloatArray, settings: ProbeSettings) -> Iterator[tuple[float, FloatArray]]:
    """Yield share of the gains and target: first the gains rise, then the joints move."""
    begin, ticks = np.where(np.isnan(begin), first, begin), max(2, round(settings.approach * settings.rate))
    for tick in range(ticks):
        yield (tick + 1) / ticks, begin
    for tick in range(ticks):
        way = (tick + 1) / ticks
        yield 1.0, begin + eased(way) * (first - begin)


class _Ended(Exception):
    """A supervisor ended the motion."""


class _Rows:
    """Sends targets and keeps what comes back."""

    def __init__(self, robot: CanRobot, supervisor: Supervisor, signals: Signals, settings: ProbeSettings) -> None:
        self._robot, self._supervisor, self._signals, self._settings = robot, supervisor, signals, settings
        self._columns: dict[str, list[FloatArray | BoolArray | float]] = {
            name: [] for name in ("t", "asked", "q", "dq", "tau", "q_des", "receive", "temperature", "voltage")
        }
        self._asked = self._due = self._began = 0.0
        self._turns, self._keeps = turns(settings.rate, robot.description.dt), False
        self._joints: list[int] = []
        """Those asked in the last row."""
        self._watched: BoolArray = np.zeros(len(JOINTS), dtype=bool)
        """Those of legs that moved in it."""
        self._since: FloatArray = np.full(len(JOINTS), -np.inf)
        """When each motor was asked last [s]."""
        self._in_effect: FloatArray = np.full(len(JOINTS), np.nan)
        """Target that each motor was sent last [rad]."""
        self._bits: list[tuple[float, FloatArray]] = []
        """Time [s] and bits so far, at the beginning of the first row that is kept and at the end of the last one."""
        self._voltage, self._next_voltage, self._volted = float("nan"), 0.0, 0

    def begin(self) -> None:
        self._began = self._due = self._asked = self._robot.exchange.link.now()

    def step(self, gain: float, target: FloatArray, watched: BoolArray, *, keep: bool, everyone: bool = False) -> None:
        robot, exchange, settings = self._robot, self._robot.exchange, self._settings
        link, zeros = exchange.link, np.zeros(len(JOINTS))
        robot.beat()
        exchange.drain()
        self._finish()
        self._ask_voltage()
        asked = link.now()
        if keep and not self._bits:
            self._bits = [(asked, exchange.bits.copy())] * 2
        joints = list(ALL) if everyone else self._turns.asked(watched, self._since)
        kp, kd = np.full(len(JOINTS), gain * settings.kp), np.full(len(JOINTS), gain * settings.kd)
        sent = exchange.command(JointCommand(q_des=target, dq_des=zeros, kp=kp, kd=kd, tau_ff=zeros), joints)
        self._since[joints], self._in_effect[joints] = asked, sent.q_des[joints]
        self._due += 1.0 / settings.rate
        exchange.listen(self._due)
        now = link.now()
        late = now - self._due
        if late > 1.0 / settings.rate:
            self._due = now
        self._asked, self._joints, self._watched, self._keeps = asked, joints, watched, keep
        if keep:
            self._bits[1] = now, exchange.bits.copy()
        robot.count(asked)
        facts = Facts(
            state=robot.state(self._since, now),
            health=robot.health(0.0, late, now),
            phase=0,
            interrupts=self._signals.interrupts,
            terminated=self._signals.terminated,
        )
        if self._supervisor.judge(facts) > Mode.RUN:
            self._finish()
            raise _Ended

    def end(self) -> None:
        """Keep the last row too."""
        self._robot.exchange.drain()
        self._finish()

    def _finish(self) -> None:
        """Keep the row of the last commands, now that nothing more can come for it."""
        if not self._keeps:
            return
        exchange = self._robot.exchange
        asked = np.isin(np.arange(len(JOINTS)), self._joints)
        since = np.where(asked, self._asked, np.inf)  # what comes of the others is late by a row or more
        q, dq, tau = exchange.readings(since)
        row = (
            self._asked - self._began,
            asked,
            q,
            dq,
            tau,
            self._in_effect.copy(),
            np.where(self._watched & (exchange.came > since), exchange.came - self._began, np.nan),
            exchange.temperature(),
            self._voltage,
        )
        for column, value in zip(self._columns.values(), row, strict=True):
            column.append(value)
        self._keeps = False

    def _ask_voltage(self) -> None:
        """Ask one motor after another for the voltage, without waiting for the answer."""
        exchange = self._robot.exchange
        now = exchange.link.now()
        told = exchange.value(self._volted, VBUS)
        self._voltage = self._voltage if np.isnan(told) else told
        if now >= self._next_voltage:
            self._next_voltage, self._volted = now + VOLTAGE_EVERY, (self._volted + 1) % len(JOINTS)
            wiring = exchange.wiring
            motor = int(wiring.motor[self._volted])
            exchange.send(self._volted, ReadParameter(motor=motor, host=wiring.host, index=VBUS))

    def result(self) -> Probe:
        columns = {name: np.array(values) for name, values in self._columns.items()}
        ended = self._supervisor.decisive
        if len(columns["t"]) < 2:
            raise PlantError(f"nothing was measured: {'it ended at once' if ended is None else ended.text}")
        begin = columns["t"][0]
        settings, t = self._settings, columns["t"] - begin
        extra: dict[str, FloatArray] = {"voltage": _first_known(columns["voltage"])}
        for joint, name in enumerate(JOINTS):
            extra[f"t_send.{name}"] = t
            extra[f"t_receive.{name}"] = columns["receive"][:, joint] - begin
            extra[f"temperature.{name}"] = columns["temperature"][:, joint]
            extra[f"tau_now.{name}"] = columns["tau"][:, joint]
        asked = columns["asked"].astype(bool)
        missing = float(np.isnan(columns["q"][asked]).mean())
        wiring = self._robot.exchange.wiring
        (start, before), (stop, after) = self._bits
        middle = wiring.sign * half_a_word(wiring.position_range)
        log = MachineLog(
            joints=JOINTS,
            t=t,
            q=columns["q"] + middle,
            dq=columns["dq"],
            q_des=columns["q_des"],
            extra=extra,
            metadata={
                "kp": settings.kp,
                "kd": settings.kd,
                "robot": self._robot.description.name,
                "motion": settings.kind,
                "joints_at_once": settings.joints,
                "rate_hz": settings.rate,
                "missing_share": missing,
                "ended": "" if ended is None else ended.text,
            }
            | self._held(asked, wiring),
        )
        return Probe(
            log=log,
            ended=ended,
            missing=missing,
            load=(after - before) / wiring.bitrate / (stop - start),
            expected=expected_load(wiring, settings.rate * asked.mean(axis=0)),
        )

    def _held(self, asked: BoolArray, wiring: Wiring) -> dict[str, Any]:
        """Return the note by which a reader carries on what was read of joints that were held."""
        if asked.all():
            return {}
        within = STILL_WORDS * 2.0 * half_a_word(wiring.position_range)
        return {HELD: {"rows": SILENT_TURNS * self._turns.rows, "within": within}}


def _first_known(values: FloatArray) -> FloatArray:
    """Return values whose missing beginning is the first one known."""
    known = np.flatnonzero(~np.isnan(values))
    if not len(known):
        return values
    return np.concatenate([np.full(known[0], values[known[0]]), values[known[0] :]])

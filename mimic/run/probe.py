"""Moving a robot that hangs so that its drives show what they are, and logging it as calibration reads it.

A row is one exchange with all motors: the commands go out at once, and each motor measures when its own arrives. An answer
that comes too late for its own row but before the next commands still belongs to it; one that is later is missing. Motors
tell the torque of that instant, not the mean since the row before, which a log's ``tau`` is; so it stands beside the log, as
``tau_now``. A position is told as a word that was rounded down; the log has the middle of what the word stands for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from mimic.errors import ConfigError, PlantError
from mimic.machine_log import MachineLog
from mimic.robot.description import RobotDescription
from mimic.robot.excitation import hung_ranges, probe_targets
from mimic.robot.goals import eased
from mimic.run.can_robot import CanRobot
from mimic.run.cybergear import half_a_word
from mimic.run.motor_messages import VBUS, ReadParameter
from mimic.run.safety import Event, Mode, Supervisor
from mimic.run.safety_rules import HUNG_RULES, LIMITS, Facts
from mimic.run.signals import Signals
from mimic.settings import ProbeSettings
from mimic.types import JOINTS, FloatArray, JointCommand

VOLTAGE_EVERY = 0.5
"""How often a motor is asked for the supply's voltage [s]."""

GROUPS = {
    "all": (tuple(range(12)),),
    "sides": ((0, 1, 2, 6, 7, 8), (3, 4, 5, 9, 10, 11)),
    "legs": tuple(tuple(range(3 * leg, 3 * leg + 3)) for leg in range(4)),
    "each": tuple((joint,) for joint in range(12)),
}
"""Joints that move at the same time, one group after another; the others are held at the centre."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Probe:
    """What came of probing."""

    log: MachineLog
    ended: Event | None
    """What ended it early, if anything did."""
    missing: float
    """Share of readings that did not come."""


def probe_motion(description: RobotDescription, settings: ProbeSettings) -> FloatArray:
    """Return targets (T, 12) [rad] inside the ranges in which nothing can touch, group after group.

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
    parts = []
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
        parts.append(part)
    return np.concatenate(parts)


def recorded_motion(t: FloatArray, q: FloatArray, description: RobotDescription, settings: ProbeSettings) -> FloatArray:
    """Return the targets of a recorded run (T, 12) [rad] at the rate of probing, inside the hung robot's ranges.

    Args:
        t: Times of the targets, increasing [s].
        q: Targets (ticks, 12) [rad].
        description: The robot.
        settings: Rate and length; a shorter recording begins anew.
    """
    low, high, _ = hung_ranges(description)
    span = float(t[-1] - t[0])
    at = t[0] + np.arange(round(settings.seconds * settings.rate)) / settings.rate % span
    return np.clip(np.stack([np.interp(at, t, column) for column in q.T], -1), low, high)


def probe(
    robot: CanRobot,
    motion: FloatArray,
    settings: ProbeSettings,
    signals: Signals,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Probe:
    """Move a robot that hangs, and return its log; the robot is left damped and off, whatever happens.

    Args:
        robot: Not started yet.
        motion: Targets (T, 12) [rad], one for each row.
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
        approach = list(_approach(state.q, motion[0], settings))
        rows.begin()
        for gain, target in approach:
            rows.step(gain, target, keep=False)
        for number, target in enumerate(motion):
            rows.step(1.0, target, keep=True)
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
        self._columns: dict[str, list[FloatArray | float]] = {
            name: [] for name in ("t", "q", "dq", "tau", "q_des", "receive", "temperature", "voltage")
        }
        self._asked = self._due = self._began = 0.0
        self._sent: FloatArray | None = None
        self._voltage, self._next_voltage, self._volted = float("nan"), 0.0, 0

    def begin(self) -> None:
        self._began = self._due = self._asked = self._robot.exchange.link.now()

    def step(self, gain: float, target: FloatArray, *, keep: bool) -> None:
        robot, exchange, settings = self._robot, self._robot.exchange, self._settings
        link, zeros = exchange.link, np.zeros(len(JOINTS))
        robot.beat()
        exchange.drain()
        self._finish()
        self._ask_voltage()
        asked = link.now()
        kp, kd = np.full(len(JOINTS), gain * settings.kp), np.full(len(JOINTS), gain * settings.kd)
        sent = exchange.command(JointCommand(q_des=target, dq_des=zeros, kp=kp, kd=kd, tau_ff=zeros))
        self._due += 1.0 / settings.rate
        exchange.listen(self._due)
        now = link.now()
        late = now - self._due
        if late > 1.0 / settings.rate:
            self._due = now
        self._asked, self._sent = asked, sent.q_des if keep else None
        robot.count(asked)
        facts = Facts(
            state=robot.state(asked, now),
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
        if self._sent is None:
            return
        exchange = self._robot.exchange
        q, dq, tau = exchange.readings(self._asked)
        came = np.where(exchange.came > self._asked, exchange.came - self._began, np.nan)
        row = (
            self._asked - self._began,
            q,
            dq,
            tau,
            self._sent,
            came,
            exchange.temperature(),
            self._voltage,
        )
        for column, value in zip(self._columns.values(), row, strict=True):
            column.append(value)
        self._sent = None

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
        missing = float(np.isnan(columns["q"]).mean())
        wiring = self._robot.exchange.wiring
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
            },
        )
        return Probe(log=log, ended=ended, missing=missing)


def _first_known(values: FloatArray) -> FloatArray:
    """Return values whose missing beginning is the first one known."""
    known = np.flatnonzero(~np.isnan(values))
    if not len(known):
        return values
    return np.concatenate([np.full(known[0], values[known[0]]), values[known[0] :]])

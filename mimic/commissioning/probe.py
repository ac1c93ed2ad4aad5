"""Probing: moves a suspended robot so that its drives show their properties, and logs it as calibration reads it.

A row is one exchange with the motors. The commands go out at once, and each motor measures when its own arrives. An
answer that misses its row but comes before the next commands still belongs to it. A later answer is missing from the
log.

Motors report the torque of an instant. A log's ``tau`` is the mean since the row before, so the reported torque is
kept in a column of its own, ``tau_now``. Motors round positions down to a word; the log has the middle of what the
word stands for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from mimic.config.hardware import ProbeSettings
from mimic.control.safety.safety_limits import limits_for
from mimic.control.safety.safety_rules import FAILURE, SUSPENDED_RULES
from mimic.control.safety.step_history import StepReport
from mimic.control.safety.supervisor import Event, SafetyMode, Supervisor
from mimic.control.signals import Signals
from mimic.errors import PlantError
from mimic.geometry import smoothstep
from mimic.hardware.can.load import expected_load
from mimic.hardware.can.wiring import Wiring
from mimic.hardware.robot.plant import Robot
from mimic.io.joint_log import JointLog
from mimic.records import JOINTS, FloatArray, JointCommand


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeResult:
    """The result of probing."""

    log: JointLog
    ended: Event | None
    """Event that ended it early, if any."""
    missing: float
    """Share of the requested readings that are missing."""
    load: FloatArray
    """Measured share of time that each bus was busy during the motion (buses,); empty for a stock robot."""
    expected: FloatArray
    """Expected share, estimated from the rates (buses,)."""


def probe(
    robot: Robot,
    motion: FloatArray,
    settings: ProbeSettings,
    signals: Signals,
    *,
    wiring: Wiring | None,
    progress: Callable[[int, int], None] | None = None,
) -> ProbeResult:
    """Move a suspended robot and return its log; the robot is left damped and off, whatever happens.

    Args:
        robot: Not started yet.
        motion: Targets (T, 12) [rad].
        settings: Rate and gains.
        signals: Ctrl-C ends it and keeps the log.
        wiring: Of motors on CAN, which are asked one by one; None for a motion board, which reads all of them.
        progress: Called once a second with the rows done and the rows in total.

    Raises:
        PlantError: If it ended before the first row.
    """
    limits = limits_for(robot.description)
    counted = ("silent_ticks", "small_overrun_ticks", "overrun_ticks", "off_target_ticks")
    share = robot.description.dt * settings.rate_hz
    limits = replace(limits, **{name: round(getattr(limits, name) * share) for name in counted})
    supervisor = Supervisor(robot.description, limits, rules=SUSPENDED_RULES, sits=False)
    rows = _Rows(robot, supervisor, signals, settings, wiring)
    try:
        state = robot.start()
        for gain, target in approach(state.q, motion[0], settings):
            rows.step(gain, target, keep=False)
        for number, target in enumerate(motion):
            rows.step(1.0, target, keep=True)
            if progress is not None and number % round(settings.rate_hz) == 0:
                progress(number, len(motion))
        rows.end()
    except _Ended:
        pass
    except (PlantError, KeyboardInterrupt) as reason:
        supervisor.decide(FAILURE, SafetyMode.DAMP, str(reason) or type(reason).__name__, rows.t)
    finally:
        robot.close()
    return rows.result()


def approach(begin: FloatArray, first: FloatArray, settings: ProbeSettings) -> Iterator[tuple[float, FloatArray]]:
    """Yield share of the gains and targets (12,) [rad]: first the gains rise, then the joints move."""
    begin = np.where(np.isnan(begin), first, begin)
    ticks = max(2, round(settings.approach * settings.rate_hz))
    for tick in range(ticks):
        yield (tick + 1) / ticks, begin
    for tick in range(ticks):
        way = (tick + 1) / ticks
        yield 1.0, begin + smoothstep(way) * (first - begin)


class _Ended(Exception):
    """The supervisor ended the motion."""


class _Rows:
    """Sends targets and records the answers."""

    def __init__(
        self, robot: Robot, supervisor: Supervisor, signals: Signals, settings: ProbeSettings, wiring: Wiring | None
    ) -> None:
        self._robot = robot
        self._supervisor = supervisor
        self._signals = signals
        self._settings = settings
        self._wiring = wiring
        self._columns: dict[str, list[FloatArray | float]] = {
            name: [] for name in ("t", "q", "dq", "tau", "q_des", "receive", "temperature", "voltage")
        }
        self._row: tuple[float, FloatArray] | None = None
        """The row whose answers may still come: its time [s] and the targets that were sent (12,) [rad]."""
        self._busy: list[tuple[float, FloatArray]] = []
        """Time and how long each bus was busy so far [s], at the first recorded row and at the last."""
        self.t = 0.0
        """Time of the plant [s]."""

    def step(self, gain: float, target: FloatArray, *, keep: bool) -> None:
        robot = self._robot
        settings = self._settings
        signals = self._signals
        self.end()
        asked = robot.now
        zeros = np.zeros(len(JOINTS))
        kp = np.full(len(JOINTS), gain * settings.kp)
        kd = np.full(len(JOINTS), gain * settings.kd)
        command = JointCommand(q_des=target, dq_des=zeros, kp=kp, kd=kd, tau_ff=zeros)
        tick = robot.step(command, 1.0 / settings.rate_hz)
        self.t = tick.state.t
        self._row = (asked, tick.sent.q_des) if keep else None
        report = StepReport(
            state=tick.state,
            health=tick.health,
            phase=0,
            q_des=target,
            interrupts=signals.read(),
            hung_up=signals.hung_up,
            terminated=signals.terminated,
        )
        if self._supervisor.update(report) > SafetyMode.RUN:
            self.end()
            raise _Ended

    def end(self) -> None:
        """Record the row of the last commands; no more answers can belong to it."""
        self._robot.look()
        if self._row is None:
            return
        asked, sent = self._row
        self._row = None
        report = self._robot.report
        came = report["came"] > asked  # others are delayed by a row or more
        row = (
            asked,
            *(np.where(came, report[name], np.nan) for name in ("q", "dq", "tau")),
            sent,
            np.where(came, report["came"], np.nan),
            np.array(report["temperature"]),
            float(report["voltage"]),
        )
        for column, value in zip(self._columns.values(), row, strict=True):
            column.append(value)
        self._busy = [*self._busy[:1], (float(report["t"]), np.array(report["busy"]))]

    def result(self) -> ProbeResult:
        columns = {name: np.array(values) for name, values in self._columns.items()}
        ended = self._supervisor.decisive
        if len(columns["t"]) < 2:
            raise PlantError(f"nothing was measured: {'it ended at once' if ended is None else ended.text}")
        begin = columns["t"][0]
        settings = self._settings
        t = columns["t"] - begin
        wiring = self._wiring
        extra: dict[str, FloatArray] = {}
        if np.isfinite(columns["voltage"]).any():
            extra["voltage"] = _first_known(columns["voltage"])
        for joint, name in enumerate(JOINTS):
            extra[f"t_send.{name}"] = t
            extra[f"t_receive.{name}"] = columns["receive"][:, joint] - begin
            extra[f"temperature.{name}"] = columns["temperature"][:, joint]
            extra[f"tau_now.{name}"] = columns["tau"][:, joint]
        missing = float(np.isnan(columns["q"]).mean())
        middle = 0.0 if wiring is None else wiring.sign * wiring.motors().facts.position_bias
        log = JointLog(
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
                "rate_hz": settings.rate_hz,
                "missing_share": missing,
                "ended": "" if ended is None else ended.text,
            },
        )
        expected = np.zeros(0) if wiring is None else expected_load(wiring, settings.rate_hz)
        (start, before), (stop, after) = self._busy
        load = (after - before) / (stop - start)
        load = load[np.isfinite(load)]
        return ProbeResult(log=log, ended=ended, missing=missing, load=load, expected=expected)


def _first_known(values: FloatArray) -> FloatArray:
    """Return the values with a missing beginning replaced by the first known one."""
    known = np.flatnonzero(~np.isnan(values))
    if not len(known):
        return values
    return np.concatenate([np.full(known[0], values[known[0]]), values[known[0] :]])

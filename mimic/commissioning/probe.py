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
from dataclasses import replace
from typing import Any

import numpy as np

from mimic.config.hardware import ProbeSettings
from mimic.control.safety.safety_rules import FAILURE, SUSPENDED_RULES
from mimic.control.safety.step_history import StepReport
from mimic.control.safety.supervisor import Event, SafetyMode, Supervisor
from mimic.control.signals import Signals
from mimic.dynamics.excitation import hung_ranges, probe_targets
from mimic.errors import PlantError
from mimic.frozen import frozen_arrays
from mimic.geometry import smoothstep
from mimic.hardware.can.wiring import Wiring
from mimic.hardware.robot.plant import Robot
from mimic.io.joint_log import JointLog
from mimic.records import JOINTS, FloatArray, JointCommand
from mimic.robot.description import RobotDescription


@frozen_arrays
class ProbeResult:
    """The result of probing."""

    log: JointLog
    ended: Event | None
    """Event that ended it early, if any."""
    missing: float
    """Share of the requested readings that are missing."""
    load: FloatArray
    """Measured share of time that each bus was busy during the motion (buses,); empty for a stock robot."""


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
    limits = robot.description.safety
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
        self._asked: tuple[float, FloatArray] | None = None
        """When commands were sent whose answers may still come [s], and the targets that were sent (12,) [rad]."""
        self._rows: list[tuple[float, FloatArray, Any]] = []
        """The same of each recorded row, and the report after it."""
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
        self._asked = (asked, tick.sent.q_des) if keep else None
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
        if self._asked is not None:
            self._rows.append((*self._asked, self._robot.report))
        self._asked = None

    def result(self) -> ProbeResult:
        ended = self._supervisor.decisive
        if len(self._rows) < 2:
            raise PlantError(f"nothing was measured: {'it ended at once' if ended is None else ended.text}")
        settings = self._settings
        wiring = self._wiring
        asked = np.array([row[0] for row in self._rows])
        reports = np.array([row[2] for row in self._rows])
        came = reports["came"] > asked[:, None]  # others are delayed by a row or more
        q, dq, tau, receive = (np.where(came, reports[name], np.nan) for name in ("q", "dq", "tau", "came"))
        t = asked - asked[0]
        extra: dict[str, FloatArray] = {}
        if np.isfinite(reports["voltage"]).any():
            extra["voltage"] = _first_known(reports["voltage"])
        for joint, name in enumerate(JOINTS):
            extra[f"t_send.{name}"] = t
            extra[f"t_receive.{name}"] = receive[:, joint] - asked[0]
            extra[f"temperature.{name}"] = reports["temperature"][:, joint]
            extra[f"tau_now.{name}"] = tau[:, joint]
        missing = float(np.isnan(q).mean())
        middle = 0.0 if wiring is None else wiring.sign * wiring.motors().facts.position_bias
        log = JointLog(
            joints=JOINTS,
            t=t,
            q=q + middle,
            dq=dq,
            q_des=np.array([row[1] for row in self._rows]),
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
        load = (reports["busy"][-1] - reports["busy"][0]) / (reports["t"][-1] - reports["t"][0])
        return ProbeResult(log=log, ended=ended, missing=missing, load=load[np.isfinite(load)])


def _first_known(values: FloatArray) -> FloatArray:
    """Return the values with a missing beginning replaced by the first known one."""
    known = np.flatnonzero(~np.isnan(values))
    if not len(known):
        return values
    return np.concatenate([np.full(known[0], values[known[0]]), values[known[0] :]])


def probe_motion(description: RobotDescription, settings: ProbeSettings) -> FloatArray:
    """Return targets (T, 12) [rad] inside the ranges in which no leg can touch anything."""
    return probe_targets(
        *hung_ranges(description),
        seconds=settings.seconds,
        rate_hz=settings.rate_hz,
        seed=settings.seed,
        kind=settings.kind,
        size=settings.amplitude,
    ).q_des


def recorded_motion(t: FloatArray, q: FloatArray, description: RobotDescription, settings: ProbeSettings) -> FloatArray:
    """Return the targets (T, 12) [rad] of a recorded run, inside the ranges of the suspended robot.

    Args:
        t: Times of the targets, increasing [s].
        q: Targets (ticks, 12) [rad].
        description: The robot.
        settings: Rate and length; a shorter recording is repeated.
    """
    low, high, _ = hung_ranges(description)
    span = float(t[-1] - t[0])
    at = t[0] + np.arange(round(settings.seconds * settings.rate_hz)) / settings.rate_hz % span
    return np.clip(np.stack([np.interp(at, t, column) for column in q.T], -1), low, high)

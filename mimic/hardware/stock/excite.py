"""Probing a suspended stock robot: the motions and the log of `mimic.hardware.excite`, over its board.

A row is written when a command goes out: the newest readings, at most some milliseconds old, and the targets that go
out with them. ``t_receive`` has the time at which the readings came.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mimic.config.hardware import ProbeSettings
from mimic.control.safety_limits import limits_for
from mimic.control.safety_rules import SUSPENDED_RULES
from mimic.control.signals import Signals
from mimic.control.step_history import StepReport
from mimic.control.supervisor import SafetyMode, Supervisor
from mimic.errors import PlantError
from mimic.hardware.excite import ProbeResult, approach
from mimic.hardware.excite_motion import ProbeMotion
from mimic.hardware.stock.plant import StockRobot
from mimic.io.joint_log import JointLog
from mimic.records import JOINTS, FloatArray, JointCommand, Tick


def probe_board(robot: StockRobot, motion: ProbeMotion, settings: ProbeSettings, signals: Signals) -> ProbeResult:
    """Move a suspended robot and return its log; the robot is left damped and without torque, whatever happens.

    Args:
        robot: Not started yet.
        motion: Targets; every joint is read in every row.
        settings: Rate and gains.
        signals: Ctrl-C ends it and keeps the log.

    Raises:
        PlantError: If it ended before the first row.
    """
    limits, dt = limits_for(robot.description), 1.0 / settings.rate_hz
    steps = robot.description.dt / dt
    limits = replace(
        limits,
        silent_ticks=round(limits.silent_ticks * steps),
        small_overrun_ticks=round(limits.small_overrun_ticks * steps),
        overrun_ticks=round(limits.overrun_ticks * steps),
    )
    supervisor = Supervisor(robot.description, limits, rules=SUSPENDED_RULES, sits=False)
    columns: dict[str, list[FloatArray | float]] = {name: [] for name in ("t", "q", "dq", "tau", "q_des", "receive")}
    temperature: list[FloatArray] = []

    def go(gain: float, target: FloatArray) -> Tick | None:
        """Make a step; return None where the supervisor ends the motion."""
        kp, kd = np.full(len(JOINTS), gain * settings.kp), np.full(len(JOINTS), gain * settings.kd)
        zeros = np.zeros(len(JOINTS))
        tick = robot.step(JointCommand(q_des=target, dq_des=zeros, kp=kp, kd=kd, tau_ff=zeros), dt)
        report = StepReport(
            state=tick.state,
            health=tick.health,
            phase=0,
            interrupts=signals.read(),
            hung_up=signals.hung_up,
            terminated=signals.terminated,
        )
        return tick if supervisor.update(report) == SafetyMode.RUN else None

    try:
        state = robot.start()
        tick: Tick | None = None
        for gain, target in approach(state.q, motion.q_des[0], settings):
            tick = go(gain, target)
            if tick is None:
                break
        for target in motion.q_des:
            if tick is None:
                break
            now = tick.state
            row = now.t, now.q, now.dq, now.tau, target, now.t - tick.health.age[0]
            for column, value in zip(columns.values(), row, strict=True):
                column.append(value)
            temperature.append(tick.health.temperature)
            tick = go(1.0, target)
    except (PlantError, KeyboardInterrupt) as reason:
        supervisor.decide("exception", SafetyMode.DAMP, str(reason) or type(reason).__name__, 0.0)
    finally:
        robot.close()
    return _result(robot, supervisor, settings, {k: np.array(v) for k, v in columns.items()}, np.array(temperature))


def _result(
    robot: StockRobot,
    supervisor: Supervisor,
    settings: ProbeSettings,
    columns: dict[str, FloatArray],
    temperature: FloatArray,
) -> ProbeResult:
    ended = supervisor.decisive
    if len(columns["t"]) < 2:
        raise PlantError(f"nothing was measured: {'it ended at once' if ended is None else ended.text}")
    begin = columns["t"][0]
    t, extra = columns["t"] - begin, dict[str, FloatArray]()
    for joint, name in enumerate(JOINTS):
        extra[f"t_send.{name}"] = t
        extra[f"t_receive.{name}"] = columns["receive"] - begin
        extra[f"temperature.{name}"] = temperature[:, joint]
        extra[f"tau_now.{name}"] = columns["tau"][:, joint]
    missing = float(np.isnan(columns["q"]).mean())
    metadata = {
        "kp": settings.kp,
        "kd": settings.kd,
        "robot": robot.description.name,
        "motion": settings.kind,
        "joints_at_once": settings.joints,
        "rate_hz": settings.rate_hz,
        "missing_share": missing,
        "ended": "" if ended is None else ended.text,
    }
    log = JointLog(
        joints=JOINTS,
        t=t,
        q=columns["q"],
        dq=columns["dq"],
        q_des=columns["q_des"],
        extra=extra,
        metadata=metadata,
    )
    return ProbeResult(log=log, ended=ended, missing=missing, load=np.zeros(0), expected=np.zeros(0))

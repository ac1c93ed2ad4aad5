"""The fixed-rate loop: lie, stand up, blend from the measured toes to the first target, track, hold."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mimic.errors import ContractError
from mimic.frames import heading_from_quat, up_cosine
from mimic.policy.contract import ObservationBuilder, joint_command
from mimic.policy.runtime import Policy
from mimic.robot.leg import front_toes
from mimic.run.plant import Plant
from mimic.settings import RunSettings
from mimic.store import plain
from mimic.types import PHASES, CommandTrack, FloatArray, JointCommand, JointSamples, RobotState, RunLog, Tick

STAND_UP, BLEND, TRACK, HOLD = (PHASES.index(name) for name in ("stand_up", "blend", "track", "hold"))

FALLEN_COSINE = 0.3
"""A robot whose base x is further from up than this, after standing up, has fallen; the training's own limit."""

Sink = Callable[[Tick], None]
"""Called after each tick; must not block."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RunResult:
    """What came of a run."""

    log: RunLog
    samples: JointSamples | None
    """Joints faster than the control rate, where the plant records them."""
    fell_at: float | None
    """When the robot tipped over and was damped [s]."""
    interrupted: bool
    """Whether Ctrl-C ended it early."""


class _Rows:
    """Columns of a log under construction."""

    def __init__(self) -> None:
        self.columns: dict[str, list[Any]] = {}

    def add(self, **values: Any) -> None:
        for name, value in values.items():
            self.columns.setdefault(name, []).append(value)


def damping_command(q: FloatArray, kd: float) -> JointCommand:
    """Return the command that only brakes: no stiffness, velocity gain kd [N m s/rad]."""
    zeros = np.zeros_like(q)
    return JointCommand(q_des=q.copy(), dq_des=zeros, kp=zeros, kd=np.full_like(q, kd), tau_ff=zeros)


def desired_at(
    track: CommandTrack, tick: int, settings: RunSettings, dt: float, neutral: FloatArray, measured: FloatArray
) -> tuple[int, FloatArray, FloatArray, float]:
    """Return phase, velocity (2,), toes (2, 3) and relative heading that are desired at a control tick.

    Args:
        neutral: Toes while standing up (2, 3) [m].
        measured: Toes when blending began (2, 3) [m].
    """
    stand, blend = round(settings.stand_up / dt), round(settings.blend / dt)
    still = np.zeros(2)
    if tick < stand:
        return STAND_UP, still, neutral, 0.0  # first stand, then turn
    if tick < stand + blend:
        share = (tick - stand + 1) / blend
        smooth = share * share * (3 - 2 * share)
        return BLEND, still, measured + smooth * (track.p_BE[0] - measured), float(track.heading[0])
    row = tick - stand - blend
    if row < len(track.t):
        return TRACK, track.v[row], track.p_BE[row], float(track.heading[row])
    return HOLD, still, track.p_BE[-1], float(track.heading[-1])


def run_policy(
    plant: Plant,
    policy: Policy,
    track: CommandTrack,
    settings: RunSettings,
    *,
    sink: Sink | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RunResult:
    """Play commands on a plant through a policy.

    The track must have the plant's control step. The plant is left damped, whatever happens.

    Args:
        sink: Sees every tick.
        progress: Called with the ticks done and in all.

    Returns:
        The log of every tick up to the end or the fall.

    Raises:
        ContractError: If the track is empty or has another control step than the policy.
    """
    description, contract = plant.description, policy.contract
    dt = contract.dt
    if not len(track.t):
        raise ContractError("there are no commands to play; expected at least one row")
    if not np.allclose(np.diff(track.t), dt, rtol=0.0, atol=1e-6):
        given = float(np.median(np.diff(track.t)))
        raise ContractError(f"the commands come every {given:g} s; the policy needs one every {dt:g} s throughout")
    ticks = round((settings.stand_up + settings.blend + settings.hold) / dt) + len(track.t)
    neutral = np.array(contract.neutral_toes).reshape(2, 3)
    builder, rows = ObservationBuilder(contract), _Rows()
    samples: list[JointSamples] = []
    gains = np.full(12, contract.kp), np.full(12, contract.kd)
    fell_at: float | None = None
    interrupted = False
    try:
        state = plant.start()
        heading0 = float(heading_from_quat(state.quat_WB))
        measured = neutral
        phase = STAND_UP
        for tick in range(ticks):
            toes = front_toes(state.q, description)
            before = phase
            if phase != BLEND:
                measured = toes
            phase, v_des, p_BE_des, turn = desired_at(track, tick, settings, dt, neutral, measured)
            if phase == BLEND and before != BLEND:
                measured = toes
            heading_des = heading0 + turn
            observation = builder.observe(
                q=state.q, quat_WB=state.quat_WB, v_des=v_des, heading_des=heading_des, p_BE_des=p_BE_des
            )
            action = policy.act(observation)
            builder.acted(action)
            q_des = joint_command(contract, action)
            command = JointCommand(q_des=q_des, dq_des=np.zeros(12), kp=gains[0], kd=gains[1], tau_ff=np.zeros(12))
            done = plant.step(command)
            _record(rows, state, toes, phase, v_des, heading_des, p_BE_des, observation, action, command, done)
            if done.samples is not None:
                samples.append(done.samples)
            if sink is not None:
                sink(done)
            if progress is not None:
                progress(tick + 1, ticks)
            state = done.state
            if phase > STAND_UP and up_cosine(*state.quat_WB) < FALLEN_COSINE:
                fell_at = state.t
                plant.step(damping_command(state.q, contract.kd))
                break
    except KeyboardInterrupt:
        if not rows.columns:
            raise
        interrupted = True
    finally:
        plant.close()
    metadata = {
        "robot": description.name,
        "policy": policy.path.name,
        "settings": plain(settings),
        "dt": dt,
        "fell_at": fell_at,
    }
    log = RunLog(**{name: np.array(values) for name, values in rows.columns.items()}, metadata=metadata)
    return RunResult(log=log, samples=_joined(samples), fell_at=fell_at, interrupted=interrupted)


def _record(
    rows: _Rows,
    state: RobotState,
    toes: FloatArray,
    phase: int,
    v_des: FloatArray,
    heading_des: float,
    p_BE_des: FloatArray,
    observation: FloatArray,
    action: FloatArray,
    command: JointCommand,
    done: Tick,
) -> None:
    rows.add(
        t=state.t,
        t_host=time.monotonic(),
        phase=phase,
        q=state.q,
        dq=state.dq,
        tau=state.tau,
        quat_WB=state.quat_WB,
        omega_B=state.omega_B,
        p_WB=state.p_WB,
        v_WB=state.v_WB,
        p_BE=toes,
        v_des=v_des,
        heading_des=heading_des,
        p_BE_des=p_BE_des,
        observation=observation,
        action=action,
        q_des=command.q_des,
        q_sent=done.sent.q_des,
        kp=done.sent.kp,
        kd=done.sent.kd,
    )


def _joined(samples: list[JointSamples]) -> JointSamples | None:
    if not samples:
        return None
    names = ("t", "q", "dq", "tau", "q_des")
    return JointSamples(**{name: np.concatenate([getattr(s, name) for s in samples]) for name in names})

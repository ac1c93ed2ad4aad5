"""The fixed-rate loop: lie, stand up, blend from the measured toes to the first target, track, hold, sit down."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mimic.errors import ContractError, PlantError
from mimic.frames import heading_from_quat, up_cosine
from mimic.metrics import uprightness
from mimic.policy.contract import ObservationBuilder, joint_command
from mimic.policy.runtime import Policy
from mimic.robot.description import RobotDescription
from mimic.robot.leg import front_toes
from mimic.run.plant import Plant
from mimic.settings import RunSettings
from mimic.store import plain
from mimic.types import PHASES, CommandTrack, FloatArray, JointCommand, JointSamples, RobotState, RunLog, Tick

STAND_UP, BLEND, TRACK, HOLD, SIT_DOWN = (
    PHASES.index(name) for name in ("stand_up", "blend", "track", "hold", "sit_down")
)

FALLEN_COSINE = 0.3
"""A robot whose base x is further from up than this, after standing up, has fallen; the training's own limit."""

FALLING_COSINE = 0.85
"""A robot whose base x is further from the upright direction than this, after standing up, is about to fall.

Measured with the shipped policy, 400 episodes of 10 s with robots of the paper's Table II, half of them pushed by 0.3 to
1.2 m/s every 4 s: all 113 falls pass it, 0.22 s before FALLEN_COSINE in the median; of the 287 other episodes one does, at
whose end the robot was falling.
"""

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
    error: Exception | None = None
    """What failed, where that ended it early and the robot sat down."""


class _Rows:
    """Columns of a log under construction."""

    def __init__(self) -> None:
        self.columns: dict[str, list[Any]] = {}

    def add(self, **values: Any) -> None:
        for name, value in values.items():
            self.columns.setdefault(name, []).append(value)


Lost = Callable[[RobotState, RobotDescription], bool]


def fallen(state: RobotState, description: RobotDescription) -> bool:
    """Return whether a robot that should stand has tipped over."""
    return bool(up_cosine(*state.quat_WB) < FALLEN_COSINE)


def falling(state: RobotState, description: RobotDescription) -> bool:
    """Return whether a robot that should stand is about to tip over."""
    return bool(uprightness(state.quat_WB, description) < FALLING_COSINE)


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
    sit_down: Policy | None = None,
    sink: Sink | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RunResult:
    """Play commands on a plant through a policy.

    The track must have the plant's control step. With a policy that sits down, every run ends lying: at its end, when
    Ctrl-C stops it, when anything but the plant fails, and when the robot is about to fall. Another Ctrl-C ends it at
    once. The plant is left damped, whatever happens.

    Args:
        sit_down: Brings the robot down; without it the plant is damped where it stands.
        sink: Sees every tick.
        progress: Called with the ticks done and in all.

    Returns:
        The log of every tick up to the end or the fall.

    Raises:
        ContractError: If the track is empty or has another control step than the policy, or a policy was trained for
            something else.
    """
    contract = policy.contract
    dt = contract.dt
    for given, task in ((policy, "stand_track"), (sit_down, "sit_down")):
        if given is not None and given.contract.task != task:
            raise ContractError(f"{given.path} was trained for {given.contract.task}; expected {task}")
    if not len(track.t):
        raise ContractError("there are no commands to play; expected at least one row")
    if not np.allclose(np.diff(track.t), dt, rtol=0.0, atol=1e-6):
        given = float(np.median(np.diff(track.t)))
        raise ContractError(f"the commands come every {given:g} s; the policy needs one every {dt:g} s throughout")
    ticks = round((settings.stand_up + settings.blend + settings.hold) / dt) + len(track.t)
    last = 0 if sit_down is None else round(settings.sit_down / dt)
    run = _Run(plant, sink, None if progress is None else partial(_told, progress, ticks + last))
    fell_at: float | None = None
    interrupted, error = False, None
    try:
        try:
            fell_at = _follow(run, policy, track, settings, ticks, fallen if sit_down is None else falling)
        except KeyboardInterrupt:
            if not run.rows.columns:
                raise
            interrupted = True
        except PlantError:
            raise
        except Exception as reason:
            if sit_down is None or not run.rows.columns:
                raise
            error = reason
            run.sink = run.progress = None  # whose fault it may have been
        try:
            if sit_down is not None:
                _sit_down(run, sit_down, last)
        except KeyboardInterrupt:
            interrupted = True
        if fell_at is not None or sit_down is not None:
            plant.step(damping_command(run.state.q, contract.kd))
    finally:
        plant.close()
    metadata = {
        "robot": plant.description.name,
        "policy": policy.path.name,
        "sit_down": None if sit_down is None else sit_down.path.name,
        "settings": plain(settings),
        "dt": dt,
        "fell_at": fell_at,
    }
    log = RunLog(**{name: np.array(values) for name, values in run.rows.columns.items()}, metadata=metadata)
    return RunResult(log=log, samples=_joined(run.samples), fell_at=fell_at, interrupted=interrupted, error=error)


def _told(progress: Callable[[int, int], None], ticks: int, done: int) -> None:
    progress(done, max(done, ticks))


class _Run:
    """A run on its way: the plant, its newest state, and what has been recorded."""

    def __init__(self, plant: Plant, sink: Sink | None, progress: Callable[[int], None] | None) -> None:
        self.plant, self.sink, self.progress = plant, sink, progress
        self.rows = _Rows()
        self.samples: list[JointSamples] = []
        self.ticks = 0
        self.state: RobotState

    def tick(
        self,
        policy: Policy,
        builder: ObservationBuilder,
        *,
        phase: int,
        v_des: FloatArray,
        heading_des: float,
        p_BE_des: FloatArray,
    ) -> None:
        """Let a policy act on the newest state, for one control step."""
        contract, state = policy.contract, self.state
        observation = builder.observe(
            q=state.q, quat_WB=state.quat_WB, v_des=v_des, heading_des=heading_des, p_BE_des=p_BE_des
        )
        action = policy.act(observation)
        builder.acted(action)
        q_des, zeros = joint_command(contract, action), np.zeros(12)
        gains = np.full(12, contract.kp), np.full(12, contract.kd)
        command = JointCommand(q_des=q_des, dq_des=zeros, kp=gains[0], kd=gains[1], tau_ff=zeros)
        done = self.plant.step(command)
        toes = front_toes(state.q, self.plant.description)
        _record(self.rows, state, toes, phase, v_des, heading_des, p_BE_des, observation, action, command, done)
        self.state = done.state
        self.ticks += 1
        if done.samples is not None:
            self.samples.append(done.samples)
        if self.sink is not None:
            self.sink(done)
        if self.progress is not None:
            self.progress(self.ticks)


def _follow(
    run: _Run, policy: Policy, track: CommandTrack, settings: RunSettings, ticks: int, lost: Lost
) -> float | None:
    """Stand up, blend, track and hold; return when that was given up because the robot was ``lost``, if ever [s]."""
    contract, description = policy.contract, run.plant.description
    run.state = run.plant.start()
    builder = ObservationBuilder(contract)
    heading0 = float(heading_from_quat(run.state.quat_WB))
    measured = neutral = np.array(contract.neutral_toes).reshape(2, 3)
    phase = STAND_UP
    for tick in range(ticks):
        before = phase
        if before != BLEND:
            measured = front_toes(run.state.q, description)
        phase, v_des, p_BE_des, turn = desired_at(track, tick, settings, contract.dt, neutral, measured)
        run.tick(policy, builder, phase=phase, v_des=v_des, heading_des=heading0 + turn, p_BE_des=p_BE_des)
        if phase > STAND_UP and lost(run.state, description):
            return run.state.t
    return None


def _sit_down(run: _Run, policy: Policy, ticks: int) -> None:
    """Let a policy bring the robot from its newest state down to lying."""
    builder = ObservationBuilder(policy.contract)
    heading = float(heading_from_quat(run.state.quat_WB))
    neutral = np.array(policy.contract.neutral_toes).reshape(2, 3)
    for _ in range(ticks):
        run.tick(policy, builder, phase=SIT_DOWN, v_des=np.zeros(2), heading_des=heading, p_BE_des=neutral)


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

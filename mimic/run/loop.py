"""The fixed-rate loop: lie, stand up, blend from the measured toes to the first target, track, hold, sit down."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import count

import numpy as np

from mimic.errors import ContractError, PlantError
from mimic.frames import heading_from_quat, up_cosine
from mimic.metrics import uprightness
from mimic.policy.contract import ObservationBuilder, PolicyContract
from mimic.policy.runtime import Policy
from mimic.robot.description import RobotDescription
from mimic.robot.goals import eased
from mimic.robot.leg import front_toes
from mimic.run.brake import damping_command
from mimic.run.plant import Plant
from mimic.run.safety import Event, Mode
from mimic.run.ticking import Run, Safety, Sink, observation_width
from mimic.settings import RunSettings
from mimic.store import plain
from mimic.types import (
    PHASES,
    Command,
    CommandTrack,
    FloatArray,
    HealthLog,
    JointCommand,
    JointSamples,
    LiveCommands,
    RobotState,
    RunLog,
)

LIE, STAND_UP, BLEND, TRACK, HOLD, SIT_DOWN, DAMP = range(len(PHASES))

FALLEN_COSINE = 0.3
"""A robot whose base x is further from up than this, after standing up, has fallen; the training's own limit."""

FALLING_COSINE = 0.85
"""A robot whose base x is further from the upright direction than this, after standing up, is about to fall.

Measured with the shipped policy, 400 episodes of 10 s with robots of the paper's Table II, half of them pushed by 0.3 to
1.2 m/s every 4 s: all 70 falls pass it, 0.18 s before the run ends in the median; of the 330 other episodes none does, and
the least of theirs is 0.94.
"""


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
    """What failed, where that ended it early and the robot sat down or was damped."""
    health: HealthLog | None = None
    """What the robot said about itself, where the run was supervised; rows as in the log."""
    events: tuple[Event, ...] = ()
    """What the supervisor found."""


Lost = Callable[[RobotState, RobotDescription], bool]


def fallen(state: RobotState, description: RobotDescription) -> bool:
    """Return whether a robot that should stand has tipped over."""
    return bool(up_cosine(*state.quat_WB) < FALLEN_COSINE)


def falling(state: RobotState, description: RobotDescription) -> bool:
    """Return whether a robot that should stand is about to tip over."""
    return bool(uprightness(state.quat_WB, description) < FALLING_COSINE)


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
        smooth = eased(share)
        return BLEND, still, measured + smooth * (track.p_BE[0] - measured), float(track.heading[0])
    row = tick - stand - blend
    if row < len(track.t):
        return TRACK, track.v[row], track.p_BE[row], float(track.heading[row])
    return HOLD, still, track.p_BE[-1], float(track.heading[-1])


class _Live:
    """Commands as they come, with what leads to them and what follows on them."""

    def __init__(self, live: LiveCommands, settings: RunSettings, dt: float) -> None:
        self._live = live
        self._stand, self._blend = round(settings.stand_up / dt), round(settings.blend / dt)
        self._hold = round(settings.hold / dt)
        self._last: Command | None = None

    def at(
        self, tick: int, neutral: FloatArray, measured: FloatArray
    ) -> tuple[int, FloatArray, FloatArray, float] | None:
        """Return what :func:`desired_at` does; None when the motion and the time to hold its last command are over."""
        still = np.zeros(2)
        if tick < self._stand:
            return STAND_UP, still, neutral, 0.0
        command = self._live.newest()
        if command is not None:
            self._last = command
            if tick < self._stand + self._blend:
                share = (tick - self._stand + 1) / self._blend
                smooth = eased(share)
                return BLEND, still, measured + smooth * (command.p_BE - measured), command.heading
            return TRACK, command.v, command.p_BE, command.heading
        self._hold -= 1
        if self._hold < 0 or self._last is None:
            return None
        return HOLD, still, self._last.p_BE, self._last.heading


def run_policy(
    plant: Plant,
    policy: Policy,
    track: CommandTrack | LiveCommands,
    settings: RunSettings,
    *,
    sit_down: Policy | None = None,
    sink: Sink | None = None,
    progress: Callable[[int, int], None] | None = None,
    safety: Safety | None = None,
) -> RunResult:
    """Play commands on a plant through a policy.

    A track must have the plant's control step; live commands go on until they end or Ctrl-C does. With a policy that sits down, every run ends lying: at its end, when
    Ctrl-C stops it, when anything but the plant fails, and when the robot is about to fall. Another Ctrl-C ends it at
    once. The plant is left damped, whatever happens.

    Under supervision a run begins by bringing the joints from where they are into the lying pose while the gains rise, its
    supervisor decides after every tick how it goes on, it ends by damping until the robot rests, and all ticks are logged.
    What fails is then told in the result instead of being raised, once there is a tick to tell of.

    Args:
        sit_down: Brings the robot down; without it the plant is damped where it stands.
        sink: Sees every tick.
        progress: Called with the ticks done and in all.
        safety: Supervises the run; the plant must tell its health.

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
    ticks = round((settings.stand_up + settings.blend + settings.hold) / dt)
    if isinstance(track, CommandTrack):
        _check_track(track, dt)
        ticks += len(track.t)
    last = 0 if sit_down is None else round(settings.sit_down / dt)
    told = None if progress is None else partial(_told, progress, ticks + last)
    run = Run(plant, observation_width(policy, sit_down), sink, told, safety)
    ending = _Ending()
    try:
        if safety is None:
            _unsupervised(run, policy, track, settings, ticks, sit_down, last, ending)
        else:
            _supervised(run, policy, track, settings, ticks, sit_down, last, ending)
    finally:
        plant.close()
    decisive = None if safety is None else safety.supervisor.decisive
    if decisive is not None and decisive.rule in ("tipping", "rolling_over"):
        ending.fell_at = decisive.t
    events = () if safety is None else tuple(safety.supervisor.events)
    metadata = {
        "robot": plant.description.name,
        "policy": policy.path.name,
        "sit_down": None if sit_down is None else sit_down.path.name,
        "settings": plain(settings),
        "dt": dt,
        "fell_at": ending.fell_at,
    } | ({"events": plain(events)} if safety is not None else {})
    return RunResult(
        log=RunLog(**run.columns(), metadata=metadata),
        samples=_joined(run.samples),
        fell_at=ending.fell_at,
        interrupted=ending.interrupted,
        error=ending.error,
        health=None if safety is None else HealthLog(**run.health_columns()),
        events=events,
    )


def _check_track(track: CommandTrack, dt: float) -> None:
    if not len(track.t):
        raise ContractError("there are no commands to play; expected at least one row")
    if not np.allclose(np.diff(track.t), dt, rtol=0.0, atol=1e-6):
        given = float(np.median(np.diff(track.t)))
        raise ContractError(f"the commands come every {given:g} s; the policy needs one every {dt:g} s throughout")


def _told(progress: Callable[[int, int], None], ticks: int, done: int) -> None:
    progress(done, max(done, ticks))


@dataclass
class _Ending:
    """How a run ended."""

    fell_at: float | None = None
    interrupted: bool = False
    error: Exception | None = None


def _unsupervised(
    run: Run,
    policy: Policy,
    track: CommandTrack | LiveCommands,
    settings: RunSettings,
    ticks: int,
    sit_down: Policy | None,
    last: int,
    ending: _Ending,
) -> None:
    try:
        run.begin()
        lost = fallen if sit_down is None else falling
        ending.fell_at = _follow(run, policy, track, settings, ticks, lost)
    except KeyboardInterrupt:
        if not run.ticks:
            raise
        ending.interrupted = True
    except PlantError:
        raise
    except Exception as reason:
        if sit_down is None or not run.ticks:
            raise
        ending.error = reason
        run.sink = run.progress = None  # whose fault it may have been
    try:
        if sit_down is not None:
            _sit_down(run, sit_down, last)
    except KeyboardInterrupt:
        ending.interrupted = True
    if ending.fell_at is not None or sit_down is not None:
        run.plant.step(damping_command(run.state.q, policy.contract.kd))


def _supervised(
    run: Run,
    policy: Policy,
    track: CommandTrack | LiveCommands,
    settings: RunSettings,
    ticks: int,
    sit_down: Policy | None,
    last: int,
    ending: _Ending,
) -> None:
    """Ramp, follow, sit down, damp; whatever fails is kept in ``ending`` and the robot damped."""
    try:
        run.begin()
        _ramp(run, policy.contract)
        if run.mode == Mode.RUN:
            _follow(run, policy, track, settings, ticks, lambda state, description: False)
        if run.mode <= Mode.SIT_DOWN and sit_down is not None:
            _sit_down(run, sit_down, last)
        run.decide("finished", Mode.DAMP, "the run is over")
        _damp(run)
    except (Exception, KeyboardInterrupt) as reason:
        told = str(reason).strip() or type(reason).__name__
        run.decide("exception", Mode.DAMP, told)
        run.sink = run.progress = None  # whose fault it may have been
        ending.error = reason if isinstance(reason, Exception) else None
        if not run.ticks:
            raise
        if not isinstance(reason, PlantError):  # otherwise closing the plant does what can be done
            with suppress(Exception, KeyboardInterrupt):
                _damp(run)
    ending.interrupted = run.interrupted


def _ramp(run: Run, contract: PolicyContract) -> None:
    """Let the gains rise where the joints are, then bring the joints into the lying pose."""
    assert run.safety is not None
    ticks = max(2, round(run.safety.ramp / contract.dt))
    begin, lie = run.q, run.plant.description.poses["lie"]
    for tick in range(ticks):
        if run.mode > Mode.RUN:
            return
        done = 2.0 * (tick + 1) / ticks
        gain, way = min(done, 1.0), float(np.clip(done - 1.0, 0.0, 1.0))
        q_des = begin + eased(way) * (lie - begin)
        kp, kd = np.full(12, gain * contract.kp), np.full(12, gain * contract.kd)
        run.hold(JointCommand(q_des=q_des, dq_des=np.zeros(12), kp=kp, kd=kd, tau_ff=np.zeros(12)), LIE)


def _damp(run: Run) -> None:
    """Only brake, as hard as the motors can, until the supervisor finds that the robot rests."""
    d = run.plant.description
    kd = float(d.raw["motor"]["kd_most"])
    while run.mode < Mode.STOPPED:
        run.hold(damping_command(np.clip(run.q, d.q_min, d.q_max), kd), DAMP)


def _follow(
    run: Run,
    policy: Policy,
    track: CommandTrack | LiveCommands,
    settings: RunSettings,
    ticks: int,
    lost: Lost,
) -> float | None:
    """Stand up, blend, track and hold; return when that was given up because the robot was ``lost``, if ever [s]."""
    contract, description = policy.contract, run.plant.description
    builder = ObservationBuilder(contract)
    heading0 = float(heading_from_quat(run.quat_WB))
    measured = neutral = np.array(contract.neutral_toes).reshape(2, 3)
    phase = STAND_UP
    live = None if isinstance(track, CommandTrack) else _Live(track, settings, contract.dt)
    endless = live is not None or (run.safety is not None and run.safety.endless)
    for tick in count() if endless else range(ticks):
        before = phase
        if before != BLEND:
            measured = front_toes(run.q, description)
        if isinstance(track, CommandTrack):
            desired = desired_at(track, tick, settings, contract.dt, neutral, measured)
        else:
            assert live is not None
            desired = live.at(tick, neutral, measured)
        if desired is None:
            return None
        phase, v_des, p_BE_des, turn = desired
        run.tick(policy, builder, phase=phase, v_des=v_des, heading_des=heading0 + turn, p_BE_des=p_BE_des)
        if run.mode > Mode.RUN:
            return None
        if phase > STAND_UP and lost(run.state, description):
            return run.state.t
    return None


def _sit_down(run: Run, policy: Policy, ticks: int) -> None:
    """Let a policy bring the robot from its newest state down to lying."""
    builder = ObservationBuilder(policy.contract)
    heading = float(heading_from_quat(run.quat_WB))
    neutral = np.array(policy.contract.neutral_toes).reshape(2, 3)
    for _ in range(ticks):
        run.tick(policy, builder, phase=SIT_DOWN, v_des=np.zeros(2), heading_des=heading, p_BE_des=neutral)
        if run.mode > Mode.SIT_DOWN:
            return


def _joined(samples: list[JointSamples]) -> JointSamples | None:
    if not samples:
        return None
    names = ("t", "q", "dq", "tau", "q_des")
    return JointSamples(**{name: np.concatenate([getattr(s, name) for s in samples]) for name in names})

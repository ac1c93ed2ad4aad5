"""The fixed-rate loop: lie, stand up, blend from the measured toes to the first target, track, hold, sit down, damp.

Every run is supervised, in simulation as on hardware: after each control step the supervisor decides how it goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import partial
from itertools import count

import numpy as np

from mimic.config.play import RunSettings
from mimic.control.desired import HOLD, TRACK, DesiredMotion, LiveMotion, StoredMotion
from mimic.control.odometry import HeldPosition, KeptDistance
from mimic.control.plant import Plant, damping_command
from mimic.control.policy_step import Pilot, observation_width
from mimic.control.safety.safety_rules import FAILURE
from mimic.control.safety.supervisor import Event, SafetyMode, Supervisor
from mimic.control.start import start
from mimic.control.tick import Run, Safety, Sink
from mimic.errors import ContractError, PlantError, SenderError
from mimic.frozen import frozen_arrays
from mimic.geometry import heading_from_quat
from mimic.io.store import plain
from mimic.policy.contract import ObservationBuilder
from mimic.policy.runtime import Policy
from mimic.records import (
    PHASES,
    Command,
    CommandTrack,
    HealthLog,
    JointSamples,
    LiveCommands,
    RunLog,
)

SIT_DOWN, DAMP = (PHASES.index(name) for name in ("sit_down", "damp"))


@frozen_arrays
class RunResult:
    """Outcome of a run."""

    log: RunLog
    health: HealthLog
    """How far the readings of each tick could be trusted; rows as in the log."""
    events: tuple[Event, ...]
    """What the supervisor found."""
    samples: JointSamples | None
    """Joints faster than the control rate, where the plant records them."""
    fell_at: float | None
    """When the robot tipped over [s]."""
    interrupted: bool
    """Whether Ctrl-C or SIGTERM ended it early."""
    error: Exception | None = None
    """What failed, where that ended it early."""


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
    """Play commands on a plant through a policy, under supervision.

    A track must have the plant's control step; live commands go on until they end. The supervisor decides after every
    tick whether the robot runs on, sits down, is damped, or is stopped. The plant is closed whatever happens.

    Without ``safety`` the run is supervised by the rules of `mimic.control.safety.safety_rules`, its joints are not
    tested, and it is over with its last tick. The first Ctrl-C then makes the robot sit down, a second one damps it.

    Args:
        plant: A robot, simulated or real.
        policy: Stands and tracks.
        track: What to play.
        settings: Times of the phases.
        sit_down: Policy that brings the robot down at the end; without it the robot stays as it is, or is damped
            where a rule asks for sitting down.
        sink: Called with every tick.
        progress: Called with the ticks done and the ticks expected.
        safety: Supervisor, recorder, and how the run begins and ends.

    Returns:
        The log of every tick, and how the run ended. A failure after the first tick is reported in ``error``.

    Raises:
        ContractError: If the track is empty or has another control step than the policy, or a policy was trained for
            another task.
        Exception: Whatever fails before the first tick.
    """
    contract = policy.contract
    for given, task in ((policy, "stand_track"), (sit_down, "sit_down")):
        if given is not None and given.contract.task != task:
            raise ContractError(f"{given.path} was trained for {given.contract.task}; expected {task}")
    counted = safety is None
    if safety is None:
        supervisor = Supervisor(plant.description, sits=sit_down is not None)
        safety = Safety(supervisor=supervisor, tested=False, damp_at_end=False)
    position: HeldPosition | KeptDistance | None = None
    if settings.hold_position:
        walks = isinstance(track, CommandTrack) and track.v.any()
        position = KeptDistance(track, plant.description) if walks else HeldPosition(plant.description)
    motion: DesiredMotion
    if isinstance(track, CommandTrack):
        over = partial(_may_be_over, safety, position)
        motion = StoredMotion(track, settings, contract, plant.description, over=over)
        if motion.out_of_reach:
            far = f"{motion.out_of_reach} of {len(track.t)} rows ask for toes out of reach"
            safety.supervisor.note("clamped", f"{far}; they go to the closest point", 0.0)
    else:
        motion = LiveMotion(track, settings, contract, plant.description)
    sit_ticks = 0 if sit_down is None else round(settings.sit_down / contract.dt)
    report = None if progress is None else partial(_report, progress, motion.ticks + sit_ticks)
    run = Run(plant, observation_width(policy, sit_down), sink, report, safety)
    error: Exception | None = None
    try:
        with safety.signals.interrupts_counted() if counted else nullcontext():
            leans = settings.lean_against_pulls and safety.supervisor.moves  # motors that are off show a pull
            pilot = Pilot(run, lean_against_pulls=leans)
            error = _play(pilot, policy, motion, sit_down, sit_ticks, position)
    finally:
        plant.close()
    events = tuple(safety.supervisor.events)
    fell_at = safety.supervisor.fell_at
    metadata = {
        "robot": plant.description.name,
        "policy": policy.path.name,
        "sit_down": None if sit_down is None else sit_down.path.name,
        "settings": plain(settings),
        "dt": contract.dt,
        "fell_at": fell_at,
        "events": plain(events),
    }
    return RunResult(
        log=RunLog(**run.journal.columns(), metadata=metadata),
        health=HealthLog(**run.journal.health_columns()),
        events=events,
        samples=run.journal.samples(),
        fell_at=fell_at,
        interrupted=run.interrupted,
        error=error,
    )


def _may_be_over(safety: Safety, position: HeldPosition | KeptDistance | None) -> bool:
    """Return whether a motion may be over at its end: a robot that walks has arrived."""
    return not safety.endless and (not isinstance(position, KeptDistance) or position.arrived)


def _report(progress: Callable[[int, int], None], expected: int, done: int) -> None:
    progress(done, max(done, expected))


def _play(
    pilot: Pilot,
    policy: Policy,
    motion: DesiredMotion,
    sit_down: Policy | None,
    sit_ticks: int,
    position: HeldPosition | KeptDistance | None,
) -> Exception | None:
    """Ramp, follow, sit down and damp; return what failed, after damping the robot."""
    run = pilot.run
    safety = run.safety
    try:
        run.begin()
        if safety.ramp > 0.0:
            start(run)
        if run.mode == SafetyMode.RUN:
            _follow(pilot, policy, motion, position)
        if run.mode <= SafetyMode.SIT_DOWN and sit_down is not None:
            _sit_down(pilot, sit_down, sit_ticks)
        if run.mode < SafetyMode.DAMP:
            run.decide("finished", SafetyMode.DAMP if safety.damp_at_end else SafetyMode.STOPPED, "the run is over")
        _damp(run)
    except (Exception, KeyboardInterrupt) as reason:
        rule = "sender" if isinstance(reason, SenderError) else FAILURE
        run.decide(rule, SafetyMode.DAMP, str(reason).strip() or type(reason).__name__)
        run.sink = run.progress = None  # one of them may have failed
        if not run.ticks:
            raise
        if isinstance(reason, KeyboardInterrupt):
            safety.signals.interrupts += 1  # nothing else has counted it
        if not isinstance(reason, PlantError):  # otherwise closing the plant does what can be done
            with suppress(Exception, KeyboardInterrupt):
                _damp(run)
        return reason if isinstance(reason, Exception) else None
    return None


def _follow(pilot: Pilot, policy: Policy, motion: DesiredMotion, position: HeldPosition | KeptDistance | None) -> None:
    """Stand up, blend, track and hold, until the motion is over or the supervisor ends it."""
    run = pilot.run
    builder = ObservationBuilder(policy.contract)
    heading0 = float(heading_from_quat(run.sensed.quat_WB))
    for tick in count():
        desired = motion.at(tick, run.sensed.q)
        if desired is None:
            return
        asked = desired.command
        command = replace(asked, heading=heading0 + asked.heading)
        if position is not None and desired.phase in (TRACK, HOLD):
            command = position.corrected(command, run.sensed.q, run.sensed.quat_WB)
        pilot.tick(policy, builder, desired.phase, command, desired.arms)
        if run.mode > SafetyMode.RUN:
            return


def _sit_down(pilot: Pilot, policy: Policy, ticks: int) -> None:
    """Let a policy bring the robot from its newest state down to lying."""
    run = pilot.run
    builder = ObservationBuilder(policy.contract)
    heading = float(heading_from_quat(run.sensed.quat_WB))
    neutral = np.array(policy.contract.neutral_toes).reshape(2, 3)
    for _ in range(ticks):
        pilot.tick(policy, builder, SIT_DOWN, Command(v=np.zeros(2), heading=heading, p_BE=neutral))
        if run.mode > SafetyMode.SIT_DOWN:
            return


def _damp(run: Run) -> None:
    """Damp with the motors' highest velocity gain until the supervisor finds that the robot rests, or it was left."""
    d = run.plant.description
    while run.mode < SafetyMode.STOPPED and run.plant.damp():
        run.hold(damping_command(np.clip(run.sensed.q, d.q_min, d.q_max), d.kd_max), DAMP)
    run.decide("at_rest", SafetyMode.STOPPED, "the process that sends has left the robot")

"""One episode of an evaluation: a supervised run with rules of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from mimic.config.evaluation import EpisodeSettings
from mimic.config.play import (
    AS_DESCRIBED,
    RAMP,
    TRIM,
    EffectsSettings,
    Randomisation,
    RunSettings,
)
from mimic.control.loop import RunResult, run_policy
from mimic.control.plant import Plant
from mimic.control.safety.safety_rules import FALLEN, TIPPING, Alert, Rule
from mimic.control.safety.step_history import StepHistory, StepReport
from mimic.control.safety.supervisor import Supervisor
from mimic.control.tick import Safety
from mimic.jobs.local import Progress, run_all
from mimic.policy.runtime import Policy, cached_policy
from mimic.records import PHASES, BoolArray, CommandTrack
from mimic.records.base import Record
from mimic.robot.description import RobotDescription
from mimic.robot.parts import SafetyLimits
from mimic.simulation.plant import SimulatedPlant, plant_options

OF_EPISODES: dict[str, Any] = {"samples": False, "begin": -RAMP - TRIM}
"""Options of the plant of an episode: time 0 is where the policy begins."""

J = TypeVar("J")
R = TypeVar("R")
L = TypeVar("L", bound=Record)

TIMING = RunSettings(stand_up=1.0, blend=0.5, hold_last=0.0, hold_position=False)
"""One second to stand up, as in the paper, then half a second to the first goal. Logs begin where the policy does."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """One episode: a robot, and what is asked of it."""

    kind: str = ""
    seed: int
    seconds: float
    """Length, standing up included [s]."""
    ranges: Randomisation
    """What the robot is drawn from."""
    robot: EffectsSettings = AS_DESCRIBED
    speed: float | None = None
    """Forward speed throughout [m/s]; drawn where None."""
    turn: float | None = None
    """Heading throughout, relative to the start [rad]; drawn where None."""

    def plant(self, description: RobotDescription, **options: Any) -> SimulatedPlant:
        """Return the robot, with further options of a `SimulatedPlant`."""
        given: dict[str, Any] = {**OF_EPISODES, **plant_options(self.robot), **options}
        return SimulatedPlant(description, ranges=self.ranges, seed=self.seed, **given)


def _sits_down(report: StepReport, history: StepHistory, limits: SafetyLimits) -> Iterator[Alert]:
    for alert in TIPPING.check(report, history, limits):
        yield replace(alert, outcome="SIT_DOWN", needs_upright=False)


TRACKING_RULES = (FALLEN,)
"""Rules of an episode in which a policy stands and tracks.

It goes on until the robot has fallen. The rules of a robot on its bus would end it earlier: they stop a robot that is
about to fall, one whose readings contradict each other (which noise and a tilted IMU bring about), and one whose
motors are hot. An evaluation asks how far a policy gets in spite of that.
"""

SIT_DOWN_RULES = (replace(TIPPING, check=_sits_down, reads_history=False),)
"""Rules of an episode that ends by sitting down: a robot that is about to fall sits down at once, instead of being
damped, so that the policy that sits down is seen in that case too."""


def play_episode(
    plant: Plant,
    policy: Policy,
    track: CommandTrack,
    settings: RunSettings,
    *,
    sit_down: Policy | None = None,
) -> RunResult:
    """Play an episode; with a policy that sits down it ends lying, without one it ends where the track does.

    Args:
        plant: A simulated robot.
        policy: Stands and tracks.
        track: What to play.
        settings: Times of the phases.
        sit_down: Brings the robot down at the end, and when it is about to fall.

    Raises:
        ContractError: If the commands or a policy do not fit.
        PlantError: If the simulation is no longer finite.
        Exception: Whatever else fails.
    """
    rules: tuple[Rule, ...] = TRACKING_RULES if sit_down is None else SIT_DOWN_RULES
    supervisor = Supervisor(plant.description, rules=rules)
    result = run_policy(plant, policy, track, settings, sit_down=sit_down, safety=of_episode(supervisor))
    if result.error is not None:
        raise result.error
    if result.interrupted:
        raise KeyboardInterrupt
    return without_start(result)


def of_episode(supervisor: Supervisor) -> Safety:
    """Return the supervision of an episode: a robot that a policy may not begin with is judged like any other."""
    return Safety(supervisor=supervisor, tested=False, checked=False, damp_at_end=False)


def without_start(result: RunResult) -> RunResult:
    """Return a run from where its policy begins."""
    log = result.log
    samples = result.samples
    rows = log.phase != PHASES.index("lie")
    if samples is not None:
        samples = _of_rows(samples, samples.t > 0.0)
    return replace(result, log=_of_rows(log, rows), health=_of_rows(result.health, rows), samples=samples)


def _of_rows(record: L, rows: BoolArray) -> L:
    shaped = [f.name for f in fields(record) if f.metadata.get("axes") is not None]  # type: ignore[arg-type]
    columns = {name: getattr(record, name)[rows] for name in shaped}
    return replace(record, **columns)  # type: ignore[type-var]


def play_all(
    play: Callable[[J, Policy], R],
    jobs: Sequence[J],
    policy: Path,
    settings: EpisodeSettings,
    progress: Progress | None = None,
) -> list[R]:
    """Play a job for each episode, in parallel; return what each gives, in order.

    Args:
        play: Plays a job with the policy of a file.
        jobs: What to play.
        policy: ONNX file.
        settings: Processes, and the simulated robot.
        progress: Called with the episodes done and in all.

    Raises:
        AssetError, ContractError: If the policy cannot be run on this robot.
        ConfigError: If the effects of the robot cannot be used.
    """
    cached_policy.cache_clear()  # by now another policy may be in the file
    given = str(policy), settings.robot.robot_model
    cached_policy(*given)
    plant_options(settings.robot)
    return run_all(partial(_with_policy, play=play, given=given), jobs, workers=settings.workers, progress=progress)


def _with_policy(job: J, play: Callable[[J, Policy], R], given: tuple[str, str]) -> R:
    return play(job, cached_policy(*given))

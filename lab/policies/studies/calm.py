"""How calmly a policy stands: planted feet, heat, torque, jitter of its commands, drift, and pushes from anywhere.

Torques are those of every physics step. One sample a control step would be off by some tens of percent, as the policy
answers at the same phase each time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from lab.policies.disturbed import Disturbance, DisturbedJob, Solver
from lab.policies.standing import standing_track
from lab.policies.studies.senses import SENSES, Senses, SensingPolicy
from lab.policies.studies.settings import CalmSettings
from mimic.evaluation.episode import TIMING, play_all, play_episode
from mimic.evaluation.policy import stands_at_end
from mimic.jobs.local import Progress
from mimic.policy.runtime import Policy
from mimic.records import JOINTS, LEGS, SIDES, BoolArray, FloatArray, JointSamples
from mimic.robot.description import RobotDescription
from mimic.simulation.plant import plant_options

SETTLED = 2.0
"""Figures count from this time on [s]."""

PUSHED_AT = 4.0
"""Pushes come at this time, or a part of a gait period later [s]."""

HIGH = 20.0
"""Torque that changes faster than this is heard, not needed [Hz]."""

KNEES = [JOINTS.index(f"{leg}_knee") for leg in LEGS[2:]]
HIND = [i for i, joint in enumerate(JOINTS) if joint.startswith(LEGS[2:])]
"""The joints that carry a standing robot."""


FARTHEST = ("drift_m", "farthest_m")
"""Figures of which the largest is told."""

BEARS = 0.2
"""A foot is planted that bears this share of the robot's weight."""

STANDING: dict[str, dict[str, Any]] = {
    "as described": {},
    "the paper's noise": {"senses": SENSES["the paper's noise"]},
    "impratio 1": {"impratio": 1.0},
    "IMU pitched by 1 deg": {"disturbance": Disturbance(imu_tilt=1.0, imu_axis="pitch")},
    "position held": {"hold_position": True},
    "position held, noise": {"hold_position": True, "senses": SENSES["the paper's noise"]},
}
"""Ways of standing, each with what differs; the first one counts. At MuJoCo's impratio of 1 feet creep under load."""

PUSH_WAYS: tuple[Literal["fore-aft", "sideways"], ...] = ("fore-aft", "sideways")
PULL_WAYS: tuple[Literal["forward", "backward", "left", "right"], ...] = ("forward", "backward", "left", "right")
PULLED: dict[str, Any] = {"drag_from": PUSHED_AT, "drag_ramp": 1.5, "drag_seconds": 4.5}


@dataclass(frozen=True, kw_only=True)
class _Job(DisturbedJob):
    what: str
    impratio: float | None = None
    hold_position: bool = False
    senses: Senses = SENSES["no noise"]


class _Planted:
    """Notes at each physics step whether both hind feet bear weight."""

    def __init__(self, model: mujoco.MjModel, description: RobotDescription) -> None:
        self._side = np.full(model.ngeom, -1)
        for side, leg in enumerate(LEGS[2:]):
            self._side[[model.geom(name).id for name in description.names.shapes("toe", "shank", legs=(leg,))]] = side
        self._least = BEARS * abs(float(model.opt.gravity[2])) * float(model.body_subtreemass[0])
        self.rows: list[bool] = []

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        load, force = np.zeros(2), np.zeros(6)
        for i, pair in enumerate(data.contact.geom[: data.ncon]):
            side = self._side[pair].max()
            if side >= 0:
                mujoco.mj_contactForce(model, data, i, force)
                load[side] += force[0]
        self.rows.append(bool(load.min() >= self._least))


def winding_heat(tau: FloatArray, description: RobotDescription) -> FloatArray:
    """Return the heat of the windings [W] (...,) for torques (..., 12) [N m]: resistance times current squared.

    The torque constant is the voltage over the speed without load; at standstill the peak torque takes that voltage's
    share which leaves the torque-speed line of the description.
    """
    constant = description.voltage / description.speed_max
    resistance = (description.voltage - constant * description.speed_flat) * constant / description.torque_max
    return (resistance * np.square(np.asarray(tau) / constant)).sum(axis=-1)


def fast_share(values: FloatArray, rate_hz: float, above: float = HIGH) -> float:
    """Return the share of the variance of values (N, k) that lies above a frequency [Hz]."""
    power = np.square(np.abs(np.fft.rfft(values - values.mean(axis=0), axis=0))).sum(axis=1)
    fast = np.fft.rfftfreq(len(values), 1.0 / rate_hz) > above
    return float(power[fast].sum() / power.sum()) if power.sum() > 0 else 0.0


def still_figures(
    samples: JointSamples, planted: BoolArray, q_des: FloatArray, p_WB: FloatArray, description: RobotDescription
) -> dict[str, float]:
    """Return how a robot stood.

    Args:
        samples: Joints at each physics step.
        planted: Whether both hind feet touched the ground, at each physics step.
        q_des: Joint targets at each control step (T, 12) [rad].
        p_WB: Position of the base at each control step (T, 3) [m].
        description: The robot.
    """
    tau = samples.tau
    return {
        "planted": float(planted.mean()),
        "heat_w": float(winding_heat(tau, description).mean()),
        "knee_rms_nm": float(np.sqrt(np.square(tau[:, KNEES]).mean())),
        "at_limit": float((np.abs(tau) > 0.999 * description.torque_max).any(axis=1).mean()),
        "fast_torque": fast_share(tau, 1.0 / float(np.median(np.diff(samples.t)))),
        "action_rate_rad": float(np.sqrt(np.square(np.diff(q_des[:, HIND], axis=0)).mean())),
        "drift_m": float(np.linalg.norm(p_WB[-1, :2] - p_WB[0, :2])),
        "farthest_m": float(np.linalg.norm(p_WB[:, :2] - p_WB[0, :2], axis=1).max()),
    }


def _play(job: _Job, policy: Policy) -> dict[str, Any]:
    description = policy.description
    stands = job.kind == "standing"
    options: dict[str, Any] = {}
    if job.impratio is not None:
        timestep = plant_options(job.robot).get("timestep", description.timestep)
        options["solver"] = Solver(timestep=timestep, impratio=job.impratio)
    plant = job.plant(description, samples=stands, **options)
    planted = _Planted(plant.model, description)
    if stands:
        plant.watch(planted)
    track = standing_track(policy, job.seconds)
    timing = replace(TIMING, hold_position=job.hold_position)
    result = play_episode(plant, SensingPolicy(policy, job.senses, job.seed), track, timing)
    figures: dict[str, Any] = {"kind": job.kind, "what": job.what, "seed": job.seed}
    figures["stands"] = stands_at_end(result, description)
    if not stands or not figures["stands"]:
        return figures
    assert result.samples is not None
    steps = result.samples.t >= SETTLED
    rows = result.log.t >= SETTLED
    names = ("t", "q", "dq", "tau", "q_des")
    samples = JointSamples(**{name: getattr(result.samples, name)[steps] for name in names})
    feet = np.array(planted.rows)[-len(steps) :][steps]  # of the ramp no samples are left
    return figures | still_figures(samples, feet, result.log.q_des[rows], result.log.p_WB[rows], description)


def _jobs(s: CalmSettings) -> Iterator[_Job]:
    def job(kind: str, what: str, seed: int, seconds: float, *, push: float = 0.0, **more: Any) -> _Job:
        ranges = replace(s.randomisation, push=(push, push), push_interval=PUSHED_AT)
        made = _Job(kind=kind, what=what, seed=seed, seconds=seconds, ranges=ranges, robot=s.robot, **more)
        return replace(made, disturbance=replace(made.disturbance, toe=SIDES[seed % 2]))

    for what, differs in STANDING.items():
        for seed in range(s.seed, s.seed + s.episodes):
            yield job("standing", what, seed, s.seconds, **differs)
    for seed in range(s.seed, s.seed + s.pushed_episodes):
        for push, way in product(s.pushes, PUSH_WAYS):
            pushed, seconds = Disturbance(push_way=way), 2 * PUSHED_AT - 0.5
            yield job("pushed", f"{push:g} m/s {way}", seed, seconds, push=push, disturbance=pushed)
        for pull, way in product(s.pulls, PULL_WAYS):
            pulled, seconds = Disturbance(drag=pull, drag_way=way, **PULLED), PUSHED_AT + PULLED["drag_seconds"] + 1.5
            yield job("pulled", f"{pull:g} N {way}", seed, seconds, disturbance=pulled)


def evaluate_calm(policy_path: Path, settings: CalmSettings, *, progress: Progress | None = None) -> dict[str, Any]:
    """Evaluate standing without commands, pushes and pulls meanwhile; the same seeds give the same figures."""
    rows = play_all(_play, list(_jobs(settings)), policy_path, settings, progress)
    return {"policy": policy_path.name, "summary": summarise(rows), "episodes": rows}


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return, by kind and what was done, the share that stood; of standing also means over who stood, and the worst."""
    names = ("planted", "heat_w", "knee_rms_nm", "at_limit", "fast_torque", "action_rate_rad", "drift_m")
    found: dict[str, dict[str, Any]] = {"standing": {}, "pushed": {}, "pulled": {}}
    for kind, what in dict.fromkeys((r["kind"], r["what"]) for r in rows):
        mine = [r for r in rows if (r["kind"], r["what"]) == (kind, what)]
        share = float(np.mean([r["stands"] for r in mine]))
        stood = [r for r in mine if r["stands"]]
        if kind != "standing":
            found[kind][what] = share
            continue
        means = {name: float(np.mean([r[name] for r in stood])) if stood else float("nan") for name in names}
        most = {f"{name[:-2]}_max_m": max((r[name] for r in stood), default=float("nan")) for name in FARTHEST}
        found[kind][what] = {"episodes": len(mine), "stood": share} | means | most
    return found

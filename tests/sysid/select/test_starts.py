"""Where the fit of an effect begins."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mimic.config.sysid import LogSettings
from mimic.dynamics.catalogue import BASELINE, CATALOGUE
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.io.joint_log import JointLog
from mimic.sysid.fit.least_squares import fit
from mimic.sysid.fit.problem import Point, Problem
from mimic.sysid.fit.replay import Replay
from mimic.sysid.log.pool import make_blocks
from mimic.sysid.predict import simulate_log
from mimic.sysid.select.starts import PredictedMotion, starting_points, starts_of

PAIR = """<mujoco><worldbody>
<body name="a"><joint name="a" axis="0 1 0" armature="0.003" damping="0.05" frictionloss="0.04"/>
<inertial pos="0 0 -0.08" mass="0.3" diaginertia="0.001 0.001 0.0003"/></body>
<body name="b" pos="0 1 0"><joint name="b" axis="0 1 0" armature="0.003" damping="0.05" frictionloss="0.04"/>
<inertial pos="0 0 -0.06" mass="0.4" diaginertia="0.001 0.001 0.0003"/></body></worldbody></mujoco>"""


@pytest.fixture
def pair(tmp_path: Path) -> MachineModel:
    path = tmp_path / "pair.xml"
    path.write_text(PAIR)
    return read_machine(path, {"kp": 20.0, "kd": 0.8})


def log_of(pair: MachineModel, *hidden: EffectValues, fast: float = 0.0, timestep: float = 0.001) -> JointLog:
    """Return 10 s of sines; with ``fast``, in the seventh second only there is also a swing of this size at 4 Hz."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 10.0, 0.02)
    phase = rng.uniform(0, 2 * np.pi, (3, 2))
    q_des = sum(0.4 / (1 + k) * np.sin(2 * np.pi * f * t[:, None] + phase[k]) for k, f in enumerate((0.4, 0.9, 1.7)))
    q_des = np.asarray(q_des)[:, : len(pair.joints)]
    swing = np.where((t > 6.0) & (t < 7.0), fast * np.sin(8 * np.pi * t), 0.0)
    made = simulate_log(pair, t, q_des + swing[:, None], EffectSet(hidden), LogSettings(seed=4, timestep=timestep))
    return replace(made, tau=None)


def problem_of(pair: MachineModel, log: JointLog, timestep: float = 0.005) -> tuple[Problem, Point]:
    replay = Replay(pair, log, timestep=timestep)
    problem = Problem(replay, np.full(len(pair.joints), 0.35e-3), None, make_blocks(log.t, replay.counts))
    return problem, Point.of(BASELINE, pair)


def test_cogging_is_looked_for_near_its_order(pair: MachineModel) -> None:
    """Two thirds of a wave in the range of motion is near enough for the fit that begins there."""
    ripple = {"cosine": np.array([0.03, 0.05]), "sine": np.array([0.04, -0.02]), "order": np.array([37.0, 61.0])}
    log = log_of(pair, EffectValues(name="cogging", joints=pair.joints, values=ripple))
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=1)
    motion = PredictedMotion(t=log.t, q=log.q, dq=np.gradient(log.q, log.t, axis=0), tau=np.zeros_like(log.q))
    order = starts_of("cogging", fitted, problem, motion)[0].values["cogging", "order"]
    assert order == pytest.approx(ripple["order"], abs=4.0 / np.ptp(log.q, axis=0).max())


def test_cogging_is_not_looked_for_beyond_its_bound(pair: MachineModel) -> None:
    """The range of motion would allow orders up to 180; here ripple of another 700 is left."""
    log = log_of(pair)
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=1)
    left = replace(fitted, residual=np.cos(700.0 * log.q))
    slow = 0.1 * log.q
    motion = PredictedMotion(t=log.t, q=slow, dq=np.gradient(slow, log.t, axis=0), tau=np.zeros_like(log.q))
    order = starts_of("cogging", left, problem, motion)[0].values["cogging", "order"]
    assert np.all(order <= CATALOGUE["cogging"].parameter("order").high)


@pytest.mark.slow
def test_backlash_begins_near_its_gap(pair: MachineModel) -> None:
    """The sum of squares over it is rough: a fit finds it only from nearby, and the derivative there may lead away."""
    log = log_of(pair, EffectValues(name="backlash", joints=("a",), values={"gap": np.array([0.03])}))
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=3)
    motion = PredictedMotion(t=log.t, q=log.q, dq=np.gradient(log.q, log.t, axis=0), tau=np.zeros_like(log.q))
    start = starting_points(problem, fitted, ["backlash"], motion)[0]
    assert start.joints[0]
    assert start.point.values["backlash", "gap"][0] == pytest.approx(0.03, rel=0.2)

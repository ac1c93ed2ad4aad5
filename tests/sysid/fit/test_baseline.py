"""The fit of the baseline parameters."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mimic.config.sysid import CalibrateSettings, LogSettings
from mimic.dynamics.catalogue import BASELINE
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.excitation import hung_ranges, probe_targets
from mimic.dynamics.machine import MachineModel, as_logged, hung_robot, read_machine
from mimic.robot.description import load_description
from mimic.sysid.fit.baseline import problem_of
from mimic.sysid.fit.least_squares import MOST_STEPS, fit
from mimic.sysid.fit.problem import Point, Problem
from mimic.sysid.fit.replay import Replay
from mimic.sysid.log.pool import make_blocks
from mimic.sysid.predict import simulate_log

ARM = """<mujoco><worldbody>
<body name="a"><joint name="a" axis="0 1 0" armature="0.003" damping="0.05" frictionloss="0.04"/>
<inertial pos="0 0 -0.08" mass="0.3" diaginertia="0.001 0.001 0.0003"/>
<body name="b" pos="0 0 -0.2"><joint name="b" axis="1 0 0" armature="0.003" damping="0.05" frictionloss="0.04"/>
<inertial pos="0 0 -0.06" mass="0.4" diaginertia="0.001 0.001 0.0003"/></body></body></worldbody></mujoco>"""

FAR_FROM_MODEL = (
    EffectValues(name="coulomb", joints=("a", "b"), values={"level": np.array([0.3, 0.02])}),
    EffectValues(name="viscous", joints=("a", "b"), values={"coefficient": np.array([0.3, 0.01])}),
    EffectValues(name="link_mass", joints=("a", "b"), values={"factor": np.array([2.2, 0.5])}),
    EffectValues(name="delay", joints=(), values={"time": 0.03}),
)
"""Numbers far from the model's."""


def posed(tmp_path: Path, seconds: float, rests: float = 0.0) -> tuple[Problem, Point]:
    """Return a log of sines with the model it is fitted to; the second joint rests for so long at first [s]."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    arm: MachineModel = read_machine(path, {"kp": 20.0, "kd": 0.8})
    t = np.arange(0.0, seconds, 0.02)
    phase = np.random.default_rng(3).uniform(0, 2 * np.pi, (3, 2))
    waves = [0.5 / (1 + k) * np.sin(2 * np.pi * f * t[:, None] + phase[k]) for k, f in enumerate((0.4, 0.9, 1.7))]
    q_des = np.sum(waves, axis=0)
    q_des[t < rests, 1] = 0.1
    log = simulate_log(arm, t, q_des, EffectSet(FAR_FROM_MODEL), LogSettings(seed=4, timestep=0.0025))
    replay = Replay(arm, log, timestep=0.0025)
    problem = Problem(replay, np.full(2, 0.35e-3), None, make_blocks(log.t, replay.counts))
    return problem, Point.of(BASELINE, arm)


def squares(problem: Problem, residual: np.ndarray) -> float:
    return float(problem.block_squares(residual)[problem.blocks.train].sum())


@pytest.mark.slow
def test_it_goes_on_as_long_as_that_pays() -> None:
    """Else any effect that lets it go on seems to explain something. Five steps leave a seventh more here."""
    robot, rng = hung_robot(load_description("cyberdog2")), np.random.default_rng(4)
    motion = probe_targets(*hung_ranges(load_description("cyberdog2")), seconds=15.0, seed=4)
    true = {
        "coulomb": {"level": rng.uniform(0.03, 0.12, 12)},
        "viscous": {"coefficient": rng.uniform(0.02, 0.1, 12)},
        "link_mass": {"factor": rng.uniform(0.9, 1.15, 12)},
        "delay": {"time": rng.uniform(0.004, 0.018)},
    }
    hidden = [EffectValues(name=n, joints=() if n == "delay" else robot.joints, values=v) for n, v in true.items()]
    log = simulate_log(robot, motion.t, motion.q_des, EffectSet(tuple(hidden)), LogSettings(seed=4, timestep=0.0025))
    log = replace(log, tau=None)
    problem = problem_of(log, as_logged(robot, log.metadata), CalibrateSettings())
    fitted = fit(problem, Point.of(BASELINE, problem.machine), BASELINE, {}, most=MOST_STEPS)
    again = fit(problem, fitted.point, BASELINE, {}, most=3)
    assert squares(problem, fitted.residual) < 1.005 * squares(problem, again.residual)


@pytest.mark.slow
def test_numbers_far_from_those_of_the_model_are_found(tmp_path: Path) -> None:
    problem, start = posed(tmp_path, 20.0, rests=8.0)
    fitted = fit(problem, start, BASELINE, {}, most=MOST_STEPS)
    assert fitted.point.values["viscous", "coefficient"] == pytest.approx([0.3, 0.01], abs=0.01)
    assert fitted.point.values["link_mass", "factor"] == pytest.approx([2.2, 0.5], rel=0.05)

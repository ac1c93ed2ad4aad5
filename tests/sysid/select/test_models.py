"""The one rule: how much better a model predicts blocks that were left out."""

from pathlib import Path

import numpy as np
import pytest

from mimic.dynamics.machine import read_machine
from mimic.io.joint_log import JointLog
from mimic.sysid.fit.problem import Problem
from mimic.sysid.fit.replay import Replay
from mimic.sysid.log.pool import make_blocks
from mimic.sysid.select.models import compare

PENDULUM = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.05"/>
<inertial pos="0 0 -0.1" mass="0.2" diaginertia="0.004 0.004 0.0001"/></body></worldbody></mujoco>"""


@pytest.fixture
def problem(tmp_path: Path) -> Problem:
    """A log of 28 s, of which 21 blocks are fitted."""
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    machine = read_machine(tmp_path / "pendulum.xml", {"kp": 20.0, "kd": 0.8})
    t = np.arange(0.0, 28.0, 0.01)
    q = 0.3 * np.sin(t)[:, None]
    log = JointLog(joints=("hinge",), t=t, q=q, q_des=q, metadata={"sent": "row"})
    replay = Replay(machine, log, timestep=0.0025, threads=1)
    return Problem(replay, np.full(1, 1e-3), None, make_blocks(t, replay.counts))


def squares(problem: Problem, floors: np.ndarray) -> np.ndarray:
    """Return the squares of blocks with such errors [noise floors]."""
    return (problem.readings * floors**2)[:, None]


def test_a_fit_that_is_better_where_it_moves_is_not_doubted_for_what_rests(problem: Problem) -> None:
    """At rest both leave a small part of the noise, and their ratio may be anything."""
    rng = np.random.default_rng(0)
    count = len(problem.readings)
    rests = np.arange(count) % 5 == 0
    worse = np.where(rests, 0.1, rng.uniform(2.5, 4.0, count))
    better = np.where(rests, 0.3, 0.6 * worse)
    found = compare(problem, squares(problem, better), squares(problem, worse), 1)
    assert found.gain == pytest.approx(np.log(1.0 / 0.6), rel=0.1)
    assert found.z > 5.0
    assert found.better


def test_blocks_at_the_noise_say_nothing_by_chance(problem: Problem) -> None:
    rng = np.random.default_rng(1)
    count = len(problem.readings)
    scores = [
        compare(problem, *(squares(problem, 1.0 + 0.05 * rng.standard_normal(count)) for _ in range(2)), 0).z
        for _ in range(300)
    ]
    assert np.mean(np.array(scores) > 3.0) < 0.02


def test_where_noise_explains_all_no_effect_removes_anything(problem: Problem) -> None:
    rng = np.random.default_rng(3)
    worse = 0.98 + 0.01 * rng.standard_normal(len(problem.readings))
    found = compare(problem, squares(problem, 0.95 * worse), squares(problem, worse), 1)
    assert found.z > 3.0
    assert found.gain > 0.04
    assert found.share == 0.0
    assert "it removes 0 % of the unexplained error" in found.why_not


def test_an_effect_that_acts_in_few_blocks_is_seen_there(problem: Problem) -> None:
    count = len(problem.readings)
    worse = np.where(np.arange(count) < 12, 1.4, 1.0)
    found = compare(problem, squares(problem, np.ones(count)), squares(problem, worse), 1)
    assert found.gain > 0.1
    assert found.better


def test_numbers_have_a_price(problem: Problem) -> None:
    """What one number explains surely is not worth twenty."""
    rng = np.random.default_rng(2)
    worse = rng.uniform(1.1, 1.3, len(problem.readings))
    one, twenty = (compare(problem, squares(problem, 0.9 * worse), squares(problem, worse), n) for n in (1, 20))
    assert one.better
    assert twenty.gain == one.gain
    assert twenty.z < one.z
    assert not twenty.better
    assert "standard errors" in twenty.why_not


def test_what_removes_little_of_the_unexplained_error_is_not_better(problem: Problem) -> None:
    worse = np.full(len(problem.readings), 10.0) + 0.01 * np.arange(len(problem.readings))
    found = compare(problem, squares(problem, 0.97 * worse), squares(problem, worse), 1)
    assert found.z > 3.0
    assert found.gain > 0.01
    assert not found.better
    assert "of the unexplained error" in found.why_not

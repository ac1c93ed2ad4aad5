"""Targets on the grid of a replay, and that a step in which one takes over from another drives as far as it should."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mimic.dynamics.machine import read_machine
from mimic.io.joint_log import JointLog
from mimic.sysid.fit.replay import Replay, acting, on_grid

PENDULUM = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.05" frictionloss="0.05"/>
<inertial pos="0 0 -0.1" mass="0.2" diaginertia="0.004 0.004 0.0001"/></body></worldbody>
<actuator><position joint="hinge" kp="30" kv="3" forcerange="-12 12"/></actuator></mujoco>"""

STEP = 0.5e-3


@pytest.mark.parametrize("share", [0.25, pytest.param(0.75, marks=pytest.mark.slow)])
def test_a_target_that_a_motor_cannot_follow_at_once_acts_neither_early_nor_late(tmp_path: Path, share: float) -> None:
    """The torque of the mean of two targets is not the mean of their torques where the limit cuts one of them."""
    (tmp_path / "robot.xml").write_text(PENDULUM)
    machine = read_machine(tmp_path / "robot.xml")
    t = np.arange(0.0, 8.0, 0.005)
    sent = np.repeat(np.random.default_rng(0).uniform(-0.6, 0.6, len(t) // 16 + 1), 16)[: len(t), None]
    log = JointLog(joints=machine.joints, t=t, q=np.zeros((len(t), 1)), q_des=sent)
    late = {("delay", "time"): np.array([[0.01 + share * STEP]])}

    def moved(step: float) -> np.ndarray:
        made = Replay(machine, log, timestep=step, segment=1.0, threads=1).run(late, 1).residual
        return -made[0, 200:, 0].astype(np.float64)

    truth = moved(STEP / 8)
    speed = np.gradient(truth, t[200:])
    early = float(np.sum((moved(STEP) - truth) * speed) / np.sum(speed**2))
    assert np.abs(30.0 * np.diff(sent[:, 0])).max() > 2 * 12.0  # it does meet its limits
    assert abs(early) < 5e-6


@given(
    st.lists(st.floats(0.1, 3.0), min_size=1, max_size=12), st.floats(0.0, 1.0), st.lists(st.booleans(), min_size=12)
)
def test_shares_of_a_step_are_the_times_for_which_targets_are_held(
    between: list[float], part: float, odd: list[bool]
) -> None:
    arrival = np.concatenate([[0.0], np.cumsum(np.maximum(between, 1.0) + np.array(odd[: len(between)]))])
    values = np.random.default_rng(len(between)).normal(size=(len(arrival), 1))
    steps = 40
    made = on_grid(arrival, values, 1.0, steps)
    fine = np.linspace(0.0, 1.0, 2001)[:-1] + 0.5 / 2000
    for k in range(2, steps):
        begin = k - part
        held = values[np.searchsorted(arrival, begin + fine, side="right") - 1, 0]
        rows = [made.held[i : i + 1] for i in (k - 2, k - 1, k)]
        mean, shares = acting(*rows, (made.begun[k - 1], made.begun[k]), part, np)
        assert mean[0, 0] == pytest.approx(held.mean(), abs=5e-3)
        assert sum(np.ravel(share)[0] for share, _ in shares) == pytest.approx(1.0)
        assert min(np.ravel(share)[0] for share, _ in shares) >= -1e-12
        torque = sum(np.ravel(share)[0] * np.clip(value[0, 0], -0.3, 0.3) for share, value in shares)
        assert torque == pytest.approx(np.clip(held, -0.3, 0.3).mean(), abs=5e-3)


def test_targets_that_overtake_each_other_within_a_step_are_taken_as_one(tmp_path: Path) -> None:
    made = on_grid(np.array([0.0, 3.25, 3.75]), np.array([[0.0], [1.0], [2.0]]), 1.0, 6)
    assert made.held[:, 0].tolist() == [0.0, 0.0, 0.0, 2.0, 2.0, 2.0]
    assert made.begun.tolist() == [0.0, 0.0, 0.0, 0.5, 0.0, 0.0]


def test_a_target_waits_on_the_edge_of_a_step_whatever_rounding_says() -> None:
    made = on_grid(np.array([0.0, 0.3]), np.array([[0.0], [1.0]]), 0.1, 5)  # 0.3 / 0.1 is below 3
    assert made.held[:, 0].tolist() == [0.0, 0.0, 0.0, 1.0, 1.0]
    assert not made.begun.any()


def test_no_delay_and_one_of_less_than_a_step_are_causal(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(PENDULUM)
    machine = read_machine(tmp_path / "robot.xml")
    machine = replace(machine, drives=replace(machine.drives, friction=np.zeros(1)))
    t = np.arange(0.0, 3.0, 0.005)
    log = JointLog(joints=machine.joints, t=t, q=np.zeros((len(t), 1)), q_des=np.where(t < 2.0, 0.0, 0.2)[:, None])
    replay = Replay(machine, log, timestep=0.0025, threads=1)
    made = [
        -replay.run({("delay", "time"): np.array([[delay]])}, 1).residual[0, :, 0]
        for delay in (0.0, 0.001, 0.0024, 0.0025)
    ]
    for q in made:
        assert np.nanmax(np.abs(q[t < 1.9975])) < 1e-6
    after = np.array([q[np.searchsorted(t, 2.02)] for q in made])
    assert (np.diff(after) < 0.0).all()
    assert after.min() > 0.01

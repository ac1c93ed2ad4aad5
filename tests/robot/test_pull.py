"""A pull on a front toe: how it is felt while the robot moves, and what a network is shown of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.geometry import heading_from_quat, multiply_quats, rotation_from_quat, turned_by
from mimic.records import RobotState
from mimic.robot.arm_torques import ArmTorques
from mimic.robot.pull import (
    BEGINS,
    FULL,
    LEAN_FORWARD,
    LEAST,
    MOST_LEAN,
    MOST_TURN,
    PullBalance,
    PullEstimator,
    StandsAgainstPull,
)
from mimic.robot.rigid_body import rigid_body_model

TOES = np.array([[0.15, 0.12, 0.5], [0.15, -0.12, 0.5]])
UPRIGHT = np.array([np.cos(np.deg2rad(-40.0)), 0.0, np.sin(np.deg2rad(-40.0)), 0.0])
NOBODY = np.zeros((2, 3))


def weight(description) -> float:
    return 9.81 * sum(body.mass for body in rigid_body_model(description)[0].inertias)


def pulled(size: float, way: float, side: int = 0) -> np.ndarray:
    """A horizontal pull of a size [N] on one toe, in a direction from where the belly faces [rad]."""
    force = np.zeros((2, 3))
    force[side] = size * np.cos(way), size * np.sin(way), 0.0
    return force


def turn(description, force, heading=0.0):
    return PullBalance(description).turn(force, TOES, np.array(heading), np)


def moving(description, dq: np.ndarray, ddq: np.ndarray, extra: np.ndarray, q: np.ndarray, t: float) -> RobotState:
    """A robot whose front legs move, with torques that the motion takes and those that hold against a pull (6,)."""
    nothing = np.zeros(3)
    tau = np.zeros(12)
    tau[:6] = ArmTorques(description).of(q[:6], dq[:6], ddq[:6], UPRIGHT) + extra
    return RobotState(t=t, q=q, dq=dq, tau=tau, quat_WB=UPRIGHT, omega_B=nothing, p_WB=nothing, v_WB=nothing)


def after(description, seconds: float, speed: float, extra: float) -> np.ndarray:
    """What is felt after front legs have swung to and fro; their knees give more torque than that takes [N m]."""
    estimator = PullEstimator(description)
    force = NOBODY
    for step in range(round(seconds / description.dt)):
        t = step * description.dt
        swing = np.zeros(12)
        swing[[1, 2, 4, 5]] = 1.0
        q = description.poses["upright"] + 0.2 * np.sin(speed * t) * swing
        dq = 0.2 * speed * np.cos(speed * t) * swing
        before = 0.2 * speed * np.cos(speed * (t - description.dt)) * swing
        more = extra * swing[:6] * (np.arange(6) % 3 == 2)
        force = estimator.smoothed(moving(description, dq, (dq - before) / description.dt, more, q, t))
    return force


def test_a_motion_by_itself_is_no_pull(description):
    assert np.abs(after(description, 2.0, 8.0, 0.0)).max() < 0.3


def test_the_faster_the_arms_the_less_a_torque_says(description):
    slow, fast = (np.abs(after(description, 2.0, speed, 0.5)).max() for speed in (0.1, 15.0))
    assert slow > 1.5
    assert fast < 0.5 * slow


def test_nobody_pulls_and_nothing_is_turned(description):
    assert not turn(description, NOBODY).any()


@pytest.mark.parametrize("way", [0.0, 1.0, np.pi / 2, np.pi, -2.0])
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_the_robot_that_stands_against_a_pull_is_shown_as_upright(description, way, heading):
    w = weight(description)
    force = pulled(0.09 * w, heading + way)
    shown = turn(description, force, heading)
    toward = np.array([np.cos(heading + way), np.sin(heading + way)])
    balance = PullBalance(description)
    angle = 0.09 * w * TOES[0, 2] / (w * balance.height)
    leant = np.array([*(-np.sin(angle) * toward), np.cos(angle)])  # its feet -> centre of mass, away from the pull
    lean = np.array([shown[0], shown[1], 0.0])
    up = rotation_from_quat(turned_by(np.array([1.0, 0.0, 0.0, 0.0]), lean, np)) @ leant
    assert up == pytest.approx([0.0, 0.0, 1.0], abs=0.01)


def test_it_turns_toward_a_pull_from_the_side(description):
    w = weight(description)
    for sign in (1.0, -1.0):
        shown = turned_by(UPRIGHT, turn(description, pulled(0.05 * w, sign * np.pi / 2)), np)
        # shown turned away from the pull, it turns back toward it
        assert sign * float(heading_from_quat(shown) - heading_from_quat(UPRIGHT)) < -0.3


def test_it_turns_against_the_moment_of_a_pull_from_behind(description):
    w = weight(description)
    left = turn(description, pulled(0.08 * w, np.pi, side=0))
    right = turn(description, pulled(0.08 * w, np.pi, side=1))
    assert left[2] == pytest.approx(-right[2])
    assert left[2] > 0.05  # pulled back at its left toe it would turn to the left: it is shown as if it did already


def test_it_leans_forward_against_a_pull_from_behind_only(description):
    w = weight(description)
    balance = PullBalance(description)
    for heading in (0.0, 2.0):
        leans = {way: balance.lean(pulled(0.08 * w, heading + way), heading) for way in (0.0, np.pi / 2, np.pi)}
        assert leans[np.pi] == pytest.approx(0.08 * LEAN_FORWARD)
        assert leans[np.pi / 2] == pytest.approx(0.0, abs=1e-9)
        assert leans[0.0] == 0.0
    assert balance.lean(pulled(0.99 * LEAST * w, np.pi), 0.0) == 0.0


def test_small_pulls_do_not_count_and_large_ones_are_limited(description):
    w = weight(description)
    assert not turn(description, pulled(0.99 * LEAST * w, 0.5)).any()
    assert turn(description, pulled(1.01 * LEAST * w, 0.5)).any()
    middle = 0.5 * (LEAST + FULL)
    half, whole = (turn(description, pulled(size * w, 0.0))[1] / size for size in (middle, FULL))
    assert half == pytest.approx(0.5 * whole, rel=1e-6)
    assert np.linalg.norm(turn(description, pulled(5.0 * w, 0.0))[:2]) == pytest.approx(MOST_LEAN, rel=1e-6)
    assert abs(turn(description, pulled(5.0 * w, np.pi / 2))[2]) == pytest.approx(MOST_TURN)


@pytest.mark.train
def test_training_shows_the_same(description):
    torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
    rng = np.random.default_rng(0)
    force = rng.normal(size=(50, 2, 3)) * 5.0
    toes = TOES + 0.05 * rng.normal(size=(50, 2, 3))
    heading = rng.uniform(-3.0, 3.0, 50)
    balance = PullBalance(description)
    tensors = (torch.as_tensor(value) for value in (force, toes, heading))
    rotation = balance.turn(force, toes, heading, np)
    assert balance.turn(*tensors, torch).numpy() == pytest.approx(rotation, abs=1e-9)
    quat = torch.as_tensor(np.tile(UPRIGHT, (50, 1)))
    ours = turned_by(np.tile(UPRIGHT, (50, 1)), rotation, np)
    assert turned_by(quat, torch.as_tensor(rotation), torch).numpy() == pytest.approx(ours, abs=1e-9)
    angle = np.linalg.norm(rotation[0])
    quat0 = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * rotation[0] / angle])
    assert multiply_quats(quat0, UPRIGHT) == pytest.approx(ours[0])


def test_a_motor_that_misses_an_answer_changes_nothing(description):
    still = np.zeros(12)
    state = moving(description, still, still, np.full(6, 1.0), description.poses["upright"], 0.0)
    deaf = dataclasses.replace(state, tau=np.where(np.arange(12) == 1, np.nan, state.tau))
    estimator = PullEstimator(description)
    for _ in range(round(2.0 / description.dt)):
        felt = estimator.smoothed(state)
    missed = estimator.smoothed(deaf)
    assert missed == pytest.approx(felt, abs=0.01)
    assert np.isfinite(estimator.smoothed(state)).all()


def test_at_first_nothing_counts(description):
    stands = StandsAgainstPull(description)
    state = moving(description, np.zeros(12), np.zeros(12), np.full(6, 1.0), description.poses["upright"], 0.0)
    shown = [stands.shown(state) for _ in range(round(2 * BEGINS / description.dt))]
    begin = round(BEGINS / description.dt)
    assert all(np.array_equal(quat, UPRIGHT) for quat in shown[:begin])
    assert not np.allclose(shown[-1], UPRIGHT, atol=1e-3)

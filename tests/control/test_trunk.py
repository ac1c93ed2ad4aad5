"""What the network is shown, and what is added to its answer, while the trunk moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mimic.control.trunk import Trunk
from mimic.flows.play import play
from mimic.geometry import rotation_from_quat
from mimic.records import CommandTrack, JointCommand, RobotState
from mimic.robot.trunk import TrunkPoses

LEAN = np.array([np.cos(-0.75), 0.0, np.sin(-0.75), 0.0])


def state(description) -> RobotState:
    zero = {"dq": np.zeros(12), "tau": np.zeros(12), "omega_B": np.zeros(3), "v_WB": np.zeros(3), "p_WB": np.zeros(3)}
    return RobotState(t=0.0, q=description.poses["upright"], quat_WB=LEAN, **zero)


def command(description) -> JointCommand:
    zero = np.zeros(12)
    return JointCommand(q_des=zero, dq_des=zero, kp=zero + 30.0, kd=zero + 3.0, tau_ff=zero, ramp=0.02)


def test_a_robot_that_stands_by_itself_is_shown_as_it_is(description):
    trunk = Trunk(description)
    trunk.advance(0.0, 0.0)
    same = state(description)
    assert trunk.seen(same) is same
    assert not trunk.moves


def test_after_a_while_the_network_is_shown_a_robot_that_stands_by_itself(description):
    trunk = Trunk(description)
    for _ in range(50):
        trunk.advance(-0.05, 0.2)
    pose = TrunkPoses(description).of(-0.05, 0.2)
    sent = trunk.added(command(description))
    np.testing.assert_allclose(sent.q_des[6:], pose.joints)
    np.testing.assert_allclose(sent.tau_ff[6:], pose.torque)
    assert not sent.q_des[:6].any()
    lowered = state(description)
    q = lowered.q.copy()
    q[6:] += pose.joints
    leant = np.array([np.cos(-0.75 + 0.1), 0.0, np.sin(-0.75 + 0.1), 0.0])
    seen = trunk.seen(replace(lowered, q=q, quat_WB=leant))
    np.testing.assert_allclose(seen.q, description.poses["upright"], atol=1e-9)
    np.testing.assert_allclose(seen.quat_WB, LEAN, atol=1e-9)
    np.testing.assert_allclose(seen.omega_B, 0.0, atol=1e-9)


def test_the_trunk_keeps_to_its_speed_and_its_range(description):
    trunk = Trunk(description)
    numbers = description.trunk_numbers
    heights = []
    for _ in range(60):
        assert trunk.advance(-1.0, 2.0) == 2
        heights.append(trunk.now[0])
    assert np.diff(heights).min() >= -numbers.height_speed * description.dt - 1e-12
    assert trunk.now == (numbers.height[0], numbers.pitch[1])


def test_a_lean_besides_what_is_asked_takes_what_room_there_is(description):
    trunk = Trunk(description)
    most = description.trunk_numbers.pitch[1]
    for lean, reached in ((0.1, 0.2), (most, most), (0.0, 0.1)):
        assert not any(trunk.advance(0.0, 0.1, lean) for _ in range(60))
        assert trunk.now == (0.0, pytest.approx(reached))


def test_a_robot_without_a_trunk_of_its_own_stays_and_counts_what_it_was_asked(description):
    trunk = Trunk(replace(description, trunk_numbers=None))
    assert trunk.advance(-0.05, 0.1) == 2
    assert trunk.advance(0.0, 0.0, 0.1) == 0
    assert not trunk.moves


def test_a_simulated_robot_crouches_and_leans_as_it_is_told(description, contract):
    height = -0.03
    pitch = 0.15
    t = 0.02 * np.arange(250)
    share = np.clip(t, 0.0, 1.0)
    toes = np.tile(np.reshape(contract.neutral_toes, (2, 3)), (len(t), 1, 1))
    trunk = share[:, None] * [height, pitch]
    track = CommandTrack(t=t, v=np.zeros((len(t), 2)), heading=np.zeros(len(t)), p_BE=toes, trunk=trunk)
    run = play(track)
    log = run.result.log
    assert run.result.fell_at is None
    rows = np.flatnonzero(np.isclose(log.trunk_des[:, 0], height) & np.isclose(log.trunk_des[:, 1], pitch))
    before = np.flatnonzero(log.trunk_des[:, 0] == 0.0)[60:100]
    expected = TrunkPoses(description).of(height, pitch).base[1]
    lower = log.p_WB[rows[50:], 2].mean() - log.p_WB[before, 2].mean()
    assert lower == pytest.approx(expected, abs=0.015)
    ahead = rotation_from_quat(log.quat_WB)[..., 0]  # it looks along x of the world
    lean = np.arctan2(ahead[:, 0], ahead[:, 2])
    leant = lean[rows[50:]].mean() - lean[before].mean()
    assert np.degrees(leant - pitch) == pytest.approx(0.0, abs=4.0)

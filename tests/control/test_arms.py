from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from mimic.config.play import RunSettings
from mimic.control.arms import LiveArms, StoredArms, arm_joints, blended
from mimic.control.loop import run_policy
from mimic.dynamics.robot_model import load_model
from mimic.metrics import run_metrics
from mimic.policy.contract import lead_time
from mimic.policy.runtime import load_policy
from mimic.records import Command, CommandTrack
from mimic.robot.arm_torques import ArmTorques
from mimic.robot.description import load_description
from mimic.robot.goals import leg_joints
from mimic.robot.leg_kinematics import front_toes
from mimic.robot.reach import Reach
from mimic.simulation.plant import SimulatedPlant

BLEND = 25


@pytest.fixture(scope="module", params=["cyberdog2", "go2"])
def robot(request):
    return load_description(request.param)


@pytest.fixture(scope="module")
def contract(robot):
    return load_policy(None, robot).contract


def swinging(description, rows: int = 200) -> np.ndarray:
    """Toes of joints that swing about the upright pose (rows, 2, 3) [m]."""
    t = description.dt * np.arange(rows)
    q = np.tile(description.poses["upright"], (rows, 1))
    q[:, [1, 4]] += 0.2 * np.sin(6.0 * t)[:, None]
    return front_toes(q, description)


def test_joints_of_goals_within_reach_put_the_toes_there(robot):
    toes = swinging(robot)
    q, moved = arm_joints(toes, Reach(robot), robot.poses["upright"][:6])
    assert moved == 0
    assert front_toes(np.hstack([q, np.zeros((len(q), 6))]), robot) == pytest.approx(toes, abs=1e-9)


def test_a_leg_that_could_also_reach_with_its_other_posture_does_not_jump_into_it(robot):
    """From where the leg is folded over, both postures are within limits for a part of the way."""
    reach = Reach(robot)
    rng = np.random.default_rng(0)
    ways = rng.uniform(reach.q_min, reach.q_max, (25, 2, 6))
    jumps = 0
    for begin, end in ways:
        q = begin + np.linspace(0.0, 1.0, 150)[:, None] * (end - begin)
        toes = reach.toes(q)
        followed, _ = arm_joints(toes, reach, begin)
        assert np.abs(np.diff(followed, axis=0)).max() < 0.15
        closed_form, excess = leg_joints(toes, robot)
        closed_form = closed_form.reshape(-1, 6)
        jumps += bool(np.abs(np.diff(closed_form, axis=0)).max() > 0.5 and excess.max() == 0.0)
    assert jumps > 0


def test_a_goal_out_of_reach_becomes_the_closest_one_and_is_counted(robot):
    toes = swinging(robot)
    toes[100, 0] += [1.0, 0.0, 0.0]
    reach = Reach(robot)
    q, moved = arm_joints(toes, reach, robot.poses["upright"][:6])
    assert moved == 1
    assert np.isfinite(q).all()
    assert reach.toes(q[100]) == pytest.approx(reach.closest(toes[100], q[99]).p_BE)


def test_a_goal_is_where_the_toes_should_be_when_the_command_acts(robot, contract):
    toes = swinging(robot)
    arms = StoredArms(toes, BLEND, contract, robot)
    q = robot.poses["upright"]
    steps = [arms.at(row, q) for row in range(-BLEND, len(toes))]
    at = 100 + round(lead_time(contract) / contract.dt)
    later = 100 * contract.dt + lead_time(contract)
    exact = q[1] + 0.2 * np.sin(6.0 * later)
    assert at > 100
    assert steps[BLEND + 100].q[1] == pytest.approx(exact, abs=2e-4)
    assert steps[BLEND + 100].dq[1] == pytest.approx(1.2 * np.cos(6.0 * later), abs=5e-3)
    assert steps[BLEND + 100].ddq[1] == pytest.approx(-7.2 * np.sin(6.0 * later), abs=0.1)


def test_the_arms_begin_where_they_are_and_end_at_rest(robot, contract):
    toes = swinging(robot)
    arms = StoredArms(toes, BLEND, contract, robot)
    begin = robot.poses["upright"] + 0.1
    first = arms.at(-BLEND, begin)
    assert first.q == pytest.approx(begin[:6], abs=0.01)
    last = arms.at(len(toes) + 50, begin)
    assert last.q == pytest.approx(arm_joints(toes[-1:], Reach(robot), begin[:6])[0][0], abs=1e-9)
    assert not last.dq.any()
    assert not last.ddq.any()


def test_a_blend_keeps_the_legs_clear_of_each_other_and_of_the_head(description):
    reach = Reach(description)
    apart = reach.closest(np.array([[0.25, 0.10, -0.05], [0.25, -0.10, -0.05]])).q
    crossed = apart.copy()
    crossed[[0, 3]] = crossed[[3, 0]]
    for row in blended(apart, reach.closest(reach.toes(crossed)).q, BLEND, reach)[1:]:
        assert reach.is_clear(row)


def test_live_goals_have_the_velocity_of_the_rows_so_far(robot, contract):
    toes = swinging(robot)
    live = LiveArms(BLEND, contract, robot)
    q = robot.poses["upright"]
    goals = [live.at(row, q, toes[max(row, 0)]) for row in range(-BLEND, 100)]
    t = 99 * contract.dt
    assert goals[-1].dq[1] == pytest.approx(1.2 * np.cos(6.0 * (t - 0.5 * contract.dt)), abs=0.02)
    assert goals[-1].q[1] - q[1] == pytest.approx(
        0.2 * np.sin(6.0 * t) + lead_time(contract) * goals[-1].dq[1], abs=1e-6
    )


def test_torques_at_rest_are_those_that_hold_the_arms_in_simulation(robot):
    """Held at rest by MuJoCo's own inverse dynamics, with the base on its side."""
    model = load_model(robot)
    data = mujoco.MjData(model)
    quat = np.array([0.8, 0.0, -0.6, 0.0])
    data.qpos[:7] = [0.0, 0.0, 5.0, *quat]
    data.qpos[7:] = robot.poses["upright"]
    mujoco.mj_forward(model, data)
    q = robot.poses["upright"]
    zeros = np.zeros(6)
    assert ArmTorques(robot).of(q[:6], zeros, zeros, quat) == pytest.approx(data.qfrc_bias[6:12], abs=1e-9)


def test_a_moving_joint_also_needs_its_friction_and_the_inertia_of_its_rotor(robot):
    torques = ArmTorques(robot)
    q = robot.poses["upright"]
    quat = np.array([1.0, 0.0, 0.0, 0.0])
    zeros = np.zeros(6)
    fast = np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])
    still = torques.of(q[:6], zeros, zeros, quat)
    forward = torques.of(q[:6], fast, zeros, quat)
    backward = torques.of(q[:6], -fast, zeros, quat)
    assert forward[2] - still[2] == pytest.approx(still[2] - backward[2])
    assert forward[2] > still[2]
    speeding = torques.of(q[:6], zeros, fast, quat)
    assert speeding[2] - still[2] > 2.0 * robot.armature[2]


@pytest.mark.parametrize("arms", ["inverse_kinematics", "network"])
def test_the_toes_of_a_standing_robot_are_where_they_should_be(robot, arms):
    toes = swinging(robot)
    rows = len(toes)
    zeros = np.zeros(rows)
    track = CommandTrack(t=robot.dt * np.arange(rows), v=np.zeros((rows, 2)), heading=zeros, p_BE=toes)
    settings = RunSettings(arms=arms, hold_last=0.0)
    log = run_policy(SimulatedPlant(robot, samples=False), load_policy(None, robot), track, settings).log
    error = run_metrics(log, robot)["toe_error_cm"]["mean"]
    assert (error < 0.3) == (arms == "inverse_kinematics")


@dataclasses.dataclass
class Far:
    """Asks for toes that no leg reaches."""

    toes: np.ndarray
    left: int = 60

    def newest(self) -> Command | None:
        self.left -= 1
        return Command(v=np.zeros(2), heading=0.0, p_BE=self.toes) if self.left >= 0 else None


def test_toes_out_of_reach_harm_neither_a_stored_nor_a_live_motion(play, memory_plant, fixed_policy):
    toes = np.full((2, 3), 2.0)
    policy = fixed_policy()
    policy.contract = dataclasses.replace(policy.contract, arms="inverse_kinematics")
    zeros = np.zeros(60)
    track = CommandTrack(t=0.02 * np.arange(60), v=np.zeros((60, 2)), heading=zeros, p_BE=np.tile(toes, (60, 1, 1)))
    short = RunSettings(stand_up=1.0, blend=0.2, hold_last=0.1)
    stored = play(memory_plant(), policy, track, short)
    live = play(memory_plant(), policy, Far(toes), short)
    assert any("60 of 60 rows" in event.text for event in stored.events)
    for result in (stored, live):
        assert np.isfinite(result.log.q_des).all()
        assert result.error is None


def test_a_target_that_is_not_a_number_damps_the_robot_when_its_time_has_come(play, memory_plant, fixed_policy, track):
    policy = fixed_policy()
    policy.contract = dataclasses.replace(policy.contract, arms="inverse_kinematics")
    asked = track(20)
    toes = asked.p_BE.copy()
    toes[10, 0, 0] = np.nan
    short = RunSettings(stand_up=1.0, blend=0.2, hold_last=0.1)
    result = play(memory_plant(), policy, dataclasses.replace(asked, p_BE=toes), short)
    assert any(event.text == "a target is not a number" for event in result.events)
    assert np.isfinite(result.log.q_des).all()
    assert result.error is None


def test_a_motion_that_needs_more_torque_than_the_motors_give_is_told(play, memory_plant, fixed_policy):
    policy = fixed_policy()
    policy.contract = dataclasses.replace(policy.contract, arms="inverse_kinematics")
    rows = 50
    robot = load_description("cyberdog2")
    q = np.tile(robot.poses["upright"], (rows, 1))
    short = RunSettings(stand_up=1.0, blend=0.2, hold_last=0.1)
    for fast in (False, True):
        q[:, 1] += 0.4 * (np.arange(rows) % 2) * fast
        toes = front_toes(q, robot)
        track = CommandTrack(t=0.02 * np.arange(rows), v=np.zeros((rows, 2)), heading=np.zeros(rows), p_BE=toes)
        told = [e.text for e in play(memory_plant(), policy, track, short).events if e.rule == "arm_torque"]
        assert len(told) == fast
        assert all("whose motor gives 12: the toes lag" in text for text in told)

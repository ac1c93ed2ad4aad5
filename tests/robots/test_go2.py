"""Everything that a description promises, shown for a robot with another size, other limits and other names."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from mimic.cli import main
from mimic.config.retarget import RetargetSettings
from mimic.config.training import MdpSettings
from mimic.dynamics.robot_model import load_model
from mimic.errors import AssetError, ContractError
from mimic.io import store
from mimic.io.assets import shipped
from mimic.policy.runtime import load_policy
from mimic.records import JOINTS, TargetTrack, WristTrack
from mimic.retargeting.targets import target_track
from mimic.robot.description import RobotDescription, load_description
from mimic.robot.goals import draw_goals
from mimic.robot.leg_kinematics import all_toes, front_legs
from mimic.robot.model import TOES, _tell
from mimic.robot.reach import FRONT, Reach

STANDING = {
    "left_shoulder": (0.0, 0.2, 1.4),
    "right_shoulder": (0.0, -0.2, 1.4),
    "left_elbow": (0.15, 0.25, 1.2),
    "right_elbow": (0.15, -0.25, 1.2),
    "left_wrist": (0.4, 0.25, 1.3),
    "right_wrist": (0.4, -0.25, 1.3),
    "left_hip": (0.0, 0.1, 0.9),
    "right_hip": (0.0, -0.1, 0.9),
}
"""A person who looks along x, z up [m]."""


@pytest.fixture(scope="session")
def reach(go2: RobotDescription) -> Reach:
    return Reach(go2)


@pytest.fixture(scope="session")
def model(go2: RobotDescription) -> mujoco.MjModel:
    return load_model(go2, visuals=False)


def toes_in_mujoco(model: mujoco.MjModel, q: np.ndarray) -> np.ndarray:
    data = mujoco.MjData(model)
    data.qpos[:7] = 0, 0, 0, 1, 0, 0, 0
    data.qpos[7:] = q
    mujoco.mj_kinematics(model, data)
    return np.array([data.site(name).xpos for name in TOES])


def test_both_kinematics_agree_with_mujoco(go2, reach, model):
    for q in np.random.default_rng(0).uniform(go2.q_min, go2.q_max, (50, 12)):
        expected = toes_in_mujoco(model, q)
        assert np.abs(all_toes(q, go2) - expected).max() < 1e-9
        assert np.abs(reach.toes(q) - expected[:2]).max() < 1e-9


def test_the_closed_form_inverts_itself(go2, reach):
    for q in np.random.default_rng(1).uniform(reach.q_min, reach.q_max, (50, FRONT)):
        for side, leg in enumerate(front_legs(go2)):
            own = q[3 * side : 3 * side + 3]
            assert np.abs(leg.inverse(leg.forward(own)) - own).max(axis=1).min() < 1e-6


def test_the_limits_are_those_of_the_model(go2, model):
    assert np.allclose(model.jnt_range[1:], np.stack([go2.q_min, go2.q_max], axis=1), atol=1e-6)


def test_joints_links_and_motors_are_called_by_their_roles(model):
    assert tuple(model.joint(j).name for j in range(1, model.njnt)) == JOINTS
    assert tuple(model.actuator(a).name for a in range(model.nu)) == JOINTS
    assert all(model.jnt_bodyid[model.joint(name).id] == model.body(name).id for name in JOINTS)


def test_every_pose_keeps_the_limits_and_touches_the_ground(go2, model):
    for name, q in go2.poses.items():
        assert np.all((go2.q_min < q) & (q < go2.q_max))
        tilt = -np.arcsin(go2.upright_direction[2]) if name == "upright" else 0.0
        data = mujoco.MjData(model)
        data.qpos[:7] = 0, 0, go2.pose_height[name], np.cos(tilt / 2), 0, np.sin(tilt / 2), 0
        data.qpos[7:] = q
        mujoco.mj_kinematics(model, data)
        assert min(data.site(toe).xpos[2] for toe in TOES) == pytest.approx(go2.toe_radius, abs=1e-3)


def test_targets_are_clamped_into_its_own_workspace(go2, reach, description):
    arms = np.tile([[1.5, 0.0, 0.0], [0.9, 0.0, 0.1]], (8, 1, 1))
    wrists = WristTrack(
        t=0.05 * np.arange(8),
        p_SH=arms,
        heading=np.zeros(8),
        valid=np.ones((8, 2), dtype=bool),
    )
    own, other = (target_track(wrists, robot, RetargetSettings()) for robot in (reach, Reach(description)))
    length = go2.leg.thigh + np.linalg.norm(go2.leg.toe)
    hips = np.array([leg.origin for leg in reach.legs])
    away = np.linalg.norm(own.p_BE - hips, axis=-1)
    assert np.all(away < np.hypot(length, go2.leg.offset))
    assert np.linalg.norm(own.p_BE - other.p_BE, axis=-1).min() > 0.05


def test_the_command_retargets_into_its_workspace(go2, reach, tmp_path):
    rows = np.arange(60)
    points = {name: np.zeros((60, 3)) + place for name, place in STANDING.items()}
    points["left_wrist"] = points["left_wrist"] + 0.2 * np.sin(0.2 * rows)[:, None] * [1.0, 0.0, 1.0]
    source = tmp_path / "someone.npz"
    np.savez(source, points=np.stack(list(points.values()), axis=1), names=list(points), fps=50)
    out = tmp_path / "targets.parquet"
    assert main(["retarget", str(source), "--out", str(out), "--robot-model", str(go2.folder)]) == 0
    targets = store.load(out, TargetTrack)
    for toes in targets.p_BE[::25]:
        assert reach.closest(toes).moved.max() < 1e-6
    hips = np.array([leg.origin for leg in reach.legs])
    other = load_description("cyberdog2").leg
    assert np.linalg.norm(targets.p_BE - hips, axis=-1).max() > other.thigh + np.linalg.norm(other.toe)


def test_goals_are_drawn_in_its_boxes(go2):
    goals = draw_goals(go2, 100, np.random.default_rng(2))
    assert np.all((goals[:, 0] >= go2.goals.low.min(axis=0)) & (goals[:, 0] <= go2.goals.high.max(axis=0)))


@pytest.mark.slow
@pytest.mark.train
def test_training_worlds_build_and_step_on_a_cpu(go2):
    torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
    from mimic.train.stand_track import StandTrackEnv

    env = StandTrackEnv(go2, MdpSettings(worlds=2), "cpu", 0)
    for _ in range(3):
        observations, reward, _, _ = env.step(torch.zeros(2, 12))
    assert torch.isfinite(reward).all()
    assert torch.isfinite(observations["policy"]).all()
    assert env.worlds.qpos[:, 2].min() > 0.05


def test_the_shipped_policy_is_refused_in_a_line_that_names_both_robots(go2):
    with pytest.raises(ContractError, match=r"^[^\n]*cyberdog2[^\n]*go2[^\n]*$"):
        load_policy(shipped("policies", "stand_track.onnx"), go2)


def test_a_robot_without_a_shipped_policy_is_told_what_to_do(go2):
    with pytest.raises(
        AssetError, match=r"no shipped sit_down policy for other; .* --robot-model other, or its folder$"
    ):
        load_policy(None, dataclasses.replace(go2, name="other"), task="sit_down")


def test_what_nobody_measured_is_refused_by_name(foreign):
    with pytest.raises(AssetError, match=r"no \[motor\.thermal\]"):
        _ = foreign.thermal
    with pytest.raises(AssetError, match=r"no \[probe\]"):
        _ = foreign.probe


def test_of_a_foreign_mjcf_what_refers_to_old_names_or_to_missing_files_is_left_out_with_a_line(foreign, caplog):
    _tell.cache_clear()
    with caplog.at_level("INFO"):
        model = load_model(foreign)
    assert (model.nsensor, model.nkey, model.nmesh, model.nu) == (0, 0, 0, 12)
    assert "left out 12 actuators, 1 sensors, 1 keyframes, 1 shapes from meshes" in caplog.text


def test_upright_the_hind_legs_carry_it_with_a_quarter_of_their_torque():
    """Source of the figures: Unitree's MJCF with its meshes, hind feet under the centre of mass."""
    robot = load_description("go2")
    model = load_model(robot, visuals=False)
    data = mujoco.MjData(model)
    tilt = -np.arcsin(robot.upright_direction[2])
    data.qpos[:7] = 0, 0, robot.pose_height["upright"], np.cos(tilt / 2), 0, np.sin(tilt / 2), 0
    data.qpos[7:] = robot.poses["upright"]
    mujoco.mj_forward(model, data)
    weight = model.body_subtreemass[0] * 9.81
    torque, jacobian = data.qfrc_bias.copy(), np.zeros((3, model.nv))
    for toe in TOES[2:]:
        mujoco.mj_jacSite(model, data, jacobian, None, model.site(toe).id)
        torque -= jacobian.T @ [0.0, 0.0, weight / 2]
    assert np.abs(torque[:6]).max() < 0.5  # in balance
    assert np.abs(torque[[13, 16]]) == pytest.approx(3.8, abs=0.1)
    assert np.abs(torque[[14, 17]]) == pytest.approx(10.4, abs=0.1)
    assert data.qpos[2] == pytest.approx(0.56, abs=0.005)


def test_its_knees_are_slower_and_stronger_than_its_hips():
    robot = load_description("go2")
    hips, knees = slice(1, None, 3), slice(2, None, 3)
    assert np.all(robot.torque_max[knees] > 1.9 * robot.torque_max[hips])
    assert np.all(robot.speed_max[hips] > 1.9 * robot.speed_max[knees])
    model = load_model(robot, visuals=False)
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    data.qpos[7:], data.ctrl[:] = robot.poses["four"], robot.poses["four"] + 10.0
    for _ in range(10):  # past the delay
        data.qpos[7:], data.qvel[:] = robot.poses["four"], 0.0
        mujoco.mj_step(model, data)
    assert data.actuator_force == pytest.approx(robot.torque_max)


def test_every_collision_shape_has_a_role(go2, model):
    shapes = {model.geom(g).name for g in range(model.ngeom)} - {"floor"}
    assert {shape for role in go2.names.patterns for shape in go2.names.shapes(role)} == shapes


def test_a_shape_that_the_model_lacks_is_refused(go2):
    names = dataclasses.replace(go2.names, patterns={**go2.names.patterns, "trunk": ("chest",)})
    with pytest.raises(AssetError, match="has no shape 'chest'"):
        load_model(dataclasses.replace(go2, names=names))


def test_legs_with_the_names_of_others_are_refused(go2):
    names = dataclasses.replace(go2.names, legs=("FR", "FL", "RR", "RL"))
    with pytest.raises(AssetError, match=r"has joints FL_.*names FR_|FR toe of .* is \d+\.\d cm from"):
        load_model(dataclasses.replace(go2, names=names))


def test_the_shipped_robot_is_another_one(go2):
    assert go2.name != load_description("cyberdog2").name

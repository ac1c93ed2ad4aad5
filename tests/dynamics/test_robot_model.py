from __future__ import annotations

import subprocess
import sys

import mujoco
import numpy as np
import pytest

from mimic.config.play import DESCRIBED_REBOUND, NOMINAL, Randomisation
from mimic.dynamics.robot_model import (
    bouncing,
    command_in_effect,
    draw_variation,
    load_model,
    restitution_damping,
    vary_model,
)
from mimic.geometry import rotation_from_quat
from mimic.io.assets import shipped
from mimic.records import JOINTS, LEGS
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import front_toes
from mimic.robot.model import TOES

VARIED = (
    "dof_frictionloss",
    "dof_damping",
    "geom_friction",
    "geom_solref",
    "actuator_gainprm",
    "body_mass",
    "body_inertia",
    "body_ipos",
    "body_subtreemass",
)


@pytest.fixture(scope="module")
def model(description) -> mujoco.MjModel:
    """The robot on its floor, as it is; do not write to it."""
    return load_model(description)


@pytest.fixture
def floating(description) -> mujoco.MjModel:
    """The robot without floor and gravity."""
    model = load_model(description, floor=False, visuals=False)
    model.opt.gravity[:] = 0.0
    return model


def random_q(description, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(description.q_min, description.q_max, (count, 12))


# ---------------------------------------------------------------------- the MJCF


@pytest.mark.parametrize("robot", ["cyberdog2", "go2"])
def test_the_mjcf_is_what_its_script_writes(robot):
    command = [sys.executable, str(shipped("assets", "make_mjcf.py")), robot, "--check"]
    assert subprocess.run(command, check=False).returncode == 0


def test_the_robot_weighs_what_it_should(model):
    assert model.body_subtreemass[0] == pytest.approx(8.52, abs=0.01)


def test_joints_have_the_limits_order_and_rotors_of_the_description(model, description):
    assert tuple(model.joint(i).name for i in range(1, model.njnt)) == JOINTS
    assert tuple(model.actuator(i).name for i in range(model.nu)) == JOINTS
    assert np.allclose(model.jnt_range[1:], np.stack([description.q_min, description.q_max], -1))
    assert model.jnt_limited[1:].all()
    assert np.allclose(model.dof_armature[6:], 2.87e-3, rtol=1e-3)


def test_time_passes_in_the_steps_of_the_description(model, description):
    assert model.opt.timestep == description.timestep


def test_shapes_that_are_only_looked_at_can_be_left_out(model, description):
    bare = load_model(description, visuals=False)
    assert bare.ngeom < model.ngeom
    assert np.allclose(bare.body_mass, model.body_mass)
    assert np.allclose(bare.body_inertia, model.body_inertia)


def standing_on(model: mujoco.MjModel, name: str) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(name).id)
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize(("name", "legs"), [("lie", LEGS), ("four", LEGS), ("upright", LEGS[2:])])
def test_a_keyframe_touches_the_floor_with_its_toes_only(name, legs, model, description):
    data = standing_on(model, name)
    heights = {leg: data.site(f"{leg}_toe").xpos[2] - description.toe_radius for leg in LEGS}
    for leg in LEGS:
        assert (abs(heights[leg]) < 0.003) == (leg in legs)
    assert all(contact.dist > -0.003 for contact in data.contact)
    assert np.array_equal(data.qpos[7:], description.poses[name])
    assert np.array_equal(data.ctrl, description.poses[name])


def test_upright_the_centre_of_mass_is_over_the_hind_toes(model, description):
    data = standing_on(model, "upright")
    toes = [data.site(f"{leg}_toe").xpos for leg in ("RL", "RR")]
    com = data.subtree_com[model.body("base").id]
    assert abs(com[0] - np.mean([toe[0] for toe in toes])) < 0.01
    assert toes[1][1] < com[1] < toes[0][1]
    assert np.allclose(data.body("base").xmat.reshape(3, 3)[:, 0], description.upright_direction, atol=1e-4)


def test_toes_by_formula_are_where_mujoco_has_them(model, description):
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for q in random_q(description, 300):
        data.qpos[:3] = rng.normal(size=3)
        data.qpos[3:7] = rng.normal(size=4)
        data.qpos[7:] = q
        mujoco.mj_kinematics(model, data)
        base = data.body("base")
        R_WB = rotation_from_quat(base.xquat)
        sites = np.array([R_WB.T @ (data.site(toe).xpos - base.xpos) for toe in TOES[:2]])
        assert np.abs(front_toes(q, description) - sites).max() < 1e-9


def test_toes_of_many_poses_are_those_of_each(description):
    q = random_q(description, 12).reshape(3, 4, 12)
    many = front_toes(q, description)
    assert many.shape == (3, 4, 2, 3)
    assert np.array_equal(many[1, 2], front_toes(q[1, 2], description))


# ---------------------------------------------------------------------- the actuator law


def torque(model: mujoco.MjModel, joint: int, *, speed: float, target: float, position: float = 0.0) -> float:
    data = mujoco.MjData(model)
    data.qpos[7 + joint] = position
    data.qvel[6 + joint] = speed
    data.ctrl[joint] = target
    mujoco.mj_forward(model, data)
    return float(data.actuator_force[joint])


def torque_limits(description: RobotDescription, dq):
    """Full torque to speed_flat, from there a line to none at speed_max, where the motor drives; it brakes in full.

    Source: CyberGear manual, torque-speed chart; cyberdog_locomotion actuator_model.hpp.
    """
    slope = description.torque_max / (description.speed_max - description.speed_flat)
    up = np.clip((description.speed_max - dq) * slope, 0.0, description.torque_max)
    down = np.clip((description.speed_max + dq) * slope, 0.0, description.torque_max)
    return -down, up


@pytest.mark.parametrize("joint", [0, 1, 5, 8, 11], ids=lambda i: JOINTS[i])
def test_the_strongest_torques_are_on_the_torque_speed_line(joint, floating, description):
    for speed in np.linspace(-1.0, 1.0, 41) * description.speed_max[joint]:
        low, high = torque_limits(description, speed)
        assert torque(floating, joint, speed=speed, target=-100.0) == pytest.approx(low[joint], abs=1e-6)
        assert torque(floating, joint, speed=speed, target=100.0) == pytest.approx(high[joint], abs=1e-6)


def test_inside_the_line_the_torque_is_a_spring_and_a_damper(floating, description):
    rng = np.random.default_rng(2)
    for error, speed in zip(rng.uniform(-0.2, 0.2, 50), rng.uniform(-1.5, 1.5, 50), strict=True):
        expected = description.kp[4] * error - description.kd[4] * speed
        assert torque(floating, 4, speed=speed, position=0.3, target=0.3 + error) == pytest.approx(expected, abs=1e-6)


def test_a_moving_robot_never_leaves_the_torque_speed_line(description):
    model = load_model(description, visuals=False)
    data = standing_on(model, "four")
    rng = np.random.default_rng(3)
    fastest = 0.0
    for step in range(400):
        if step % 20 == 0:
            data.ctrl[:] = rng.uniform(description.q_min, description.q_max)
        speed = data.qvel[6:].copy()
        mujoco.mj_step(model, data)
        fastest = max(fastest, np.abs(speed).max())
        low, high = torque_limits(description, speed)
        assert np.all(data.actuator_force >= low - 1e-6)
        assert np.all(data.actuator_force <= high + 1e-6)
    assert fastest > description.speed_flat.max()


def slide(model: mujoco.MjModel, joint: int, share: float, description) -> float:
    """How far a joint moves in 2 s under a share of its breakaway torque, with its motor off [rad]."""
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    data = mujoco.MjData(model)
    data.qpos[7:] = description.poses["four"]
    data.qfrc_applied[6 + joint] = share * model.dof_frictionloss[6 + joint]
    for _ in range(round(2.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return float(abs(data.qpos[7 + joint] - description.poses["four"][joint]))


@pytest.mark.parametrize("joint", range(12), ids=lambda i: JOINTS[i])
def test_a_joint_held_at_half_its_breakaway_torque_does_not_creep(joint, floating, description):
    assert slide(floating, joint, 0.5, description) < 1e-3


def test_a_joint_above_its_breakaway_torque_moves(floating, description):
    assert slide(floating, 2, 1.5, description) > 0.1


# ---------------------------------------------------------------------- variations


def copies(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    return {name: np.array(getattr(model, name)) for name in VARIED}


def same(one: dict[str, np.ndarray], other: dict[str, np.ndarray], *, exactly: bool = True) -> bool:
    equal = np.array_equal if exactly else np.allclose
    return all(equal(one[name], other[name]) for name in VARIED)


def drawn(seed: int, description, ranges: Randomisation = Randomisation()):  # noqa: B008
    return draw_variation(ranges, description.timestep, np.random.default_rng(seed))


def test_the_nominal_variation_is_the_robot_as_described(model, description):
    varied = load_model(description)
    vary_model(varied, model, drawn(0, description, NOMINAL))
    assert same(copies(varied), copies(model), exactly=False)
    nominal = drawn(0, description, NOMINAL)
    assert nominal.delay_steps * description.timestep == pytest.approx(description.delay)


def test_a_variation_leaves_no_trace_of_the_one_before(model, description):
    first, second = drawn(1, description), drawn(2, description)
    varied = load_model(description)
    vary_model(varied, model, first)
    once = copies(varied)
    vary_model(varied, model, second)
    assert not same(copies(varied), once)
    vary_model(varied, model, first)
    assert same(copies(varied), once)
    vary_model(varied, model, drawn(0, description, NOMINAL))
    assert same(copies(varied), copies(model), exactly=False)


def test_a_variation_does_not_write_to_the_nominal_model(description):
    nominal, varied = load_model(description), load_model(description)
    before = copies(nominal)
    vary_model(varied, nominal, drawn(3, description))
    assert same(copies(nominal), before)


def test_a_variation_adds_its_masses(model, description):
    variation = drawn(4, description)
    varied = load_model(description)
    vary_model(varied, model, variation)
    legs = (variation.abad_mass, variation.hip_mass, variation.knee_mass, variation.toe_mass)
    added = variation.base_mass + sum(float(part.sum()) for part in legs)
    assert varied.body_subtreemass[0] - model.body_subtreemass[0] == pytest.approx(added)
    assert np.all(varied.body_mass[1:] > 0)


def test_the_same_seed_draws_the_same_robot(description):
    one, other, third = (drawn(seed, description) for seed in (5, 5, 6))
    assert np.array_equal(one.kp, other.kp)
    assert one.base_mass == other.base_mass
    assert one.base_mass != third.base_mass


def test_delays_are_whole_steps_over_the_whole_range(description):
    delays = {drawn(seed, description).delay_steps for seed in range(200)}
    assert delays == set(range(2, 13))


def test_a_ball_that_rebounds_less_is_damped_more():
    damping = [restitution_damping(e) for e in (0.05, 0.1, 0.2, 0.4, 0.8, 1.0)]
    assert np.all(np.diff(damping) < 0)
    assert damping[-1] == 0.0


@pytest.mark.parametrize("restitution", [0.02, 0.1, DESCRIBED_REBOUND, 0.2, 0.4, 0.6])
@pytest.mark.parametrize("speed", [0.3, 1.0])
def test_a_ball_rebounds_as_asked(restitution, speed):
    """MuJoCo's own contact, without gravity, in steps of 1 ms."""
    time, damping = bouncing(0.02, restitution)
    ball = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
        <geom type="plane" size="1 1 1" solref="{time} {damping}" priority="1"/>
        <body pos="0 0 0.0201"><freejoint/><geom type="sphere" size="0.02" mass="2"/></body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(ball)
    data.qvel[2] = -speed
    mujoco.mj_step(ball, data, 300)
    assert data.qvel[2] / speed == pytest.approx(restitution, abs=0.01)


@pytest.mark.parametrize("delay", range(8))
def test_each_command_acts_for_one_control_step_after_its_delay(delay):
    commands = list(range(10))
    acting = [
        int(command_in_effect(k, 4, delay, commands[i - 2 : i + 1][::-1], np.where, interpolate=False))
        for i in range(2, 10)
        for k in range(4)
    ]
    expected = [(8 + step - delay) // 4 for step in range(32)]
    assert acting == expected


@pytest.mark.parametrize("delay", range(17))
def test_longer_delays_reach_further_back(delay):
    commands = list(range(12))
    acting = [
        int(command_in_effect(k, 4, delay, commands[i - 4 : i + 1][::-1], np.where, interpolate=False))
        for i in range(5, 12)
        for k in range(4)
    ]
    assert acting == [(20 + step - delay) // 4 for step in range(28)]

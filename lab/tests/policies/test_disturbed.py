"""What happens to a robot besides its variation, on the plant."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lab.policies.disturbed import Disturbance, DisturbedPlant, Solver
from mimic.config.play import NOMINAL
from mimic.dynamics.robot_model import load_model
from mimic.records import JointCommand, RobotState, Tick
from mimic.simulation.plant import SimulatedPlant


def command(description, q: np.ndarray) -> JointCommand:
    zeros = np.zeros(12)
    gains = description.kp, description.kd
    return JointCommand(q_des=q, dq_des=zeros, kp=gains[0], kd=gains[1], tau_ff=zeros)


def play(plant: DisturbedPlant, ticks: int = 30) -> list[Tick]:
    """Sway, the same each time."""
    d = plant.description
    plant.start()
    return [plant.step(command(d, d.poses["lie"] + 0.2 * np.sin(0.3 * i + np.arange(12)))) for i in range(ticks)]


def same(one: RobotState, other: RobotState) -> bool:
    names = [f.name for f in dataclasses.fields(RobotState)]
    return all(np.array_equal(getattr(one, n), getattr(other, n)) for n in names)


def level(description) -> list[Tick]:
    return play(SimulatedPlant(description))


def between(one: RobotState, quat: np.ndarray) -> float:
    turned = Rotation.from_quat(one.quat_WB, scalar_first=True).inv() * Rotation.from_quat(quat, scalar_first=True)
    return float(turned.magnitude())


EACH = [
    Disturbance(toe_payload=0.2),
    Disturbance(drag=10.0, drag_from=0.1),
    Disturbance(slope=5.0),
    Disturbance(imu_tilt=3.0),
    Disturbance(noise_q=0.01),
    Disturbance(noise_imu=0.01),
    Disturbance(lost_share=0.3),
]


@pytest.mark.parametrize("disturbance", EACH, ids=lambda d: str(d).split("(")[1][:24])
def test_a_disturbance_does_something_and_is_that_of_its_seed(disturbance, description):
    first, second, other = (play(DisturbedPlant(description, seed=seed, disturbance=disturbance)) for seed in (1, 1, 2))
    assert same(first[-1].state, second[-1].state)
    assert not same(first[-1].state, level(description)[-1].state)
    if not disturbance.toe_payload:  # which has no direction
        assert not same(first[-1].state, other[-1].state)


@pytest.mark.parametrize(("toe", "leg"), [("left", "FL"), ("right", "FR")])
def test_a_payload_weighs_at_its_toe(toe, leg, description):
    loaded = DisturbedPlant(description, disturbance=Disturbance(toe=toe, toe_payload=0.3)).model
    bare = DisturbedPlant(description).model
    body = bare.body(f"{leg}_knee").id
    data = [mujoco.MjData(model) for model in (bare, loaded)]
    for model, d in zip((bare, loaded), data, strict=True):
        mujoco.mj_forward(model, d)
    assert loaded.body_mass.sum() == pytest.approx(bare.body_mass.sum() + 0.3)
    mass, toe_at = bare.body_mass[body], data[0].site(f"{leg}_toe").xpos
    expected = (mass * data[0].xipos[body] + 0.3 * toe_at) / (mass + 0.3)
    assert data[1].xipos[body] == pytest.approx(expected, abs=1e-9)


def test_a_varied_robot_carries_its_payload_too(description):
    ranges = dataclasses.replace(NOMINAL, base_mass=(1.0, 1.0))
    plant = DisturbedPlant(description, ranges=ranges, disturbance=Disturbance(toe_payload=0.3))
    nominal = load_model(description, visuals=False).body_mass.sum()
    assert plant.model.body_mass.sum() == pytest.approx(nominal + 1.3)


def test_a_drag_is_a_horizontal_force_for_its_time(description):
    """On a robot in free fall, whose momentum nothing else changes sideways."""
    plant = DisturbedPlant(description, seed=3, disturbance=Disturbance(drag=10.0, drag_from=0.1, drag_seconds=0.2))
    start = plant.start()
    plant.data.qpos[2] = 100.0
    base = plant.model.body("base").id
    speeds = []
    for _ in range(25):
        plant.step(command(description, start.q))
        mujoco.mj_forward(plant.model, plant.data)
        mujoco.mj_subtreeVel(plant.model, plant.data)
        speeds.append(plant.data.subtree_linvel[base].copy())
    sideways = np.linalg.norm(np.array(speeds)[:, :2], axis=-1)
    assert np.abs(sideways[:5]).max() < 1e-6
    expected = 10.0 * 0.2 / plant.model.body_subtreemass[base]
    assert sideways[15:] == pytest.approx(expected, rel=1e-3)
    assert speeds[-1][2] == pytest.approx(-9.81 * 0.5, rel=1e-3)


def test_a_pull_sideways_is_to_the_left_or_the_right_of_where_the_belly_faces(description):
    ways = set()
    for seed in range(6):
        disturbance = Disturbance(drag=10.0, drag_from=0.1, drag_seconds=0.2, drag_way="sideways")
        turned = dataclasses.replace(NOMINAL, heading=(1.0, 1.0))
        plant = DisturbedPlant(description, seed=seed, ranges=turned, disturbance=disturbance)
        start = plant.start()
        plant.data.qpos[2] = 100.0
        for _ in range(15):
            plant.step(command(description, start.q))
        mujoco.mj_forward(plant.model, plant.data)
        mujoco.mj_subtreeVel(plant.model, plant.data)
        velocity = plant.data.subtree_linvel[plant.model.body("base").id][:2]
        left = np.array([-np.sin(1.0), np.cos(1.0)])
        assert abs(velocity @ left) == pytest.approx(np.linalg.norm(velocity), rel=1e-3)
        ways.add(float(np.sign(velocity @ left)))
    assert ways == {-1.0, 1.0}


def test_an_imu_that_is_pitched_is_turned_about_the_left_axis(description):
    for seed in (1, 2):
        plant = DisturbedPlant(description, seed=seed, disturbance=Disturbance(imu_tilt=3.0, imu_axis="pitch"))
        read = Rotation.from_quat(plant.start().quat_WB, scalar_first=True)
        true = Rotation.from_quat(plant.data.qpos[3:7], scalar_first=True)
        assert np.abs((true.inv() * read).as_rotvec(degrees=True)) == pytest.approx([0.0, 3.0, 0.0], abs=1e-6)


def test_a_robot_lies_on_a_slope_as_on_the_level(description):
    plant = DisturbedPlant(description, seed=4, disturbance=Disturbance(slope=10.0))
    plant.start()
    flat = DisturbedPlant(description, seed=4)
    flat.start()
    normal = Rotation.from_quat(plant.disturber.slope_quat, scalar_first=True).apply([0.0, 0.0, 1.0])
    assert np.arccos(normal[2]) == pytest.approx(np.deg2rad(10.0))
    assert plant.data.site_xpos @ normal == pytest.approx(flat.data.site_xpos[:, 2], abs=0.02)
    assert plant.data.qpos[:3] @ normal == pytest.approx(flat.data.qpos[2], abs=0.005)


def ground_height(plant: DisturbedPlant, p_W: np.ndarray) -> float:
    """Return the height of the ground under a point (3,)."""
    normal = Rotation.from_quat(plant.disturber.slope_quat, scalar_first=True).as_matrix()[:, 2]
    return -(p_W[0] * normal[0] + p_W[1] * normal[1]) / normal[2]


def test_the_ground_of_a_slope_is_under_a_robot_that_rests_on_it(description):
    plant = DisturbedPlant(description, seed=4, disturbance=Disturbance(slope=5.0))
    plant.start()
    for _ in range(50):
        plant.step(command(description, description.poses["lie"]))
    touching = [contact.pos for contact in plant.data.contact]
    assert len(touching) >= 3
    for point in touching:
        assert ground_height(plant, point) == pytest.approx(point[2], abs=2e-3)


def test_a_slope_without_friction_carries_a_robot_down(description):
    ice = dataclasses.replace(NOMINAL, ground_friction=(0.02, 0.02))
    plant = DisturbedPlant(description, ranges=ice, seed=5, disturbance=Disturbance(slope=10.0))
    begin = plant.start()
    for _ in range(50):
        state = plant.step(command(description, description.poses["lie"])).state
    assert ground_height(plant, state.p_WB) < ground_height(plant, begin.p_WB) - 0.05


def test_a_tilted_imu_shows_the_same_error_all_the_time(description):
    plant = DisturbedPlant(description, disturbance=Disturbance(imu_tilt=3.0))
    true = level(description)
    for tick, truth in zip(play(plant), true, strict=True):
        assert between(tick.state, truth.state.quat_WB) == pytest.approx(np.deg2rad(3.0))
        assert np.array_equal(tick.state.q, truth.state.q)


def test_noise_is_on_what_is_measured_and_not_on_the_motion(description):
    plant = DisturbedPlant(description, disturbance=Disturbance(noise_q=0.02, noise_imu=0.03))
    errors = []
    for tick, truth in zip(play(plant), level(description), strict=True):
        errors.append(tick.state.q - truth.state.q)
        assert between(tick.state, truth.state.quat_WB) <= 0.03 * np.sqrt(3)
        assert np.array_equal(tick.state.p_WB, truth.state.p_WB)
        assert np.array_equal(tick.samples.q, truth.samples.q)
    assert 0.018 < np.abs(errors).max() <= 0.02


def test_a_robot_that_hears_nothing_stays_as_it_was(description):
    dropping = play(DisturbedPlant(description, disturbance=Disturbance(lost_share=1.0)))
    plant = DisturbedPlant(description)
    start = plant.start()
    commanded = [plant.step(command(description, start.q)) for _ in range(30)]
    assert same(dropping[-1].state, commanded[-1].state)
    assert np.array_equal(dropping[-1].sent.q_des, start.q)


def test_some_commands_are_lost_and_the_rest_arrive(description):
    ticks = play(DisturbedPlant(description, disturbance=Disturbance(lost_share=0.3)), 300)
    repeated = [np.array_equal(a.sent.q_des, b.sent.q_des) for a, b in pairwise(ticks)]
    assert 0.2 < np.mean(repeated) < 0.4


# ---------------------------------------------------------------------- solvers


def test_the_usual_solver_is_the_one_of_the_description(description):
    usual = play(DisturbedPlant(description, solver=Solver()))
    assert same(usual[-1].state, level(description)[-1].state)


@pytest.mark.parametrize(
    "solver",
    [Solver(timestep=0.001), Solver(integrator="implicit"), Solver(timestep=0.001, integrator="Euler")],
    ids=str,
)
def test_other_solvers_move_the_robot_nearly_the_same_way(solver, description):
    ticks = play(DisturbedPlant(description, solver=solver))
    usual = level(description)
    assert ticks[-1].state.t == pytest.approx(usual[-1].state.t)
    assert len(ticks[0].samples.t) == round(description.dt / solver.timestep)
    assert np.abs(ticks[-1].state.q - usual[-1].state.q).max() < 0.05
    assert not same(ticks[-1].state, usual[-1].state)


def test_friction_cones_can_be_chosen(description):
    models = [DisturbedPlant(description, solver=Solver(cone=cone)).model for cone in ("elliptic", "pyramidal")]
    assert [model.opt.cone for model in models] == [mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtCone.mjCONE_PYRAMIDAL]


@pytest.mark.parametrize(
    ("way", "angles"), [("forward", [0.0]), ("backward", [np.pi]), ("left", [np.pi / 2]), ("right", [-np.pi / 2])]
)
def test_a_pull_grows_in_its_direction(way, angles, description):
    pull = Disturbance(drag=10.0, drag_from=0.1, drag_seconds=0.4, drag_ramp=0.2, drag_way=way)
    plant = DisturbedPlant(description, ranges=dataclasses.replace(NOMINAL, heading=(1.0, 1.0)), disturbance=pull)
    start = plant.start()
    plant.data.qpos[2] = 100.0
    base, speeds = plant.model.body("base").id, []
    for _ in range(30):
        plant.step(command(description, start.q))
        mujoco.mj_forward(plant.model, plant.data)
        mujoco.mj_subtreeVel(plant.model, plant.data)
        speeds.append(plant.data.subtree_linvel[base][:2].copy())
    mass = plant.model.body_subtreemass[base]
    toward = np.array([np.cos(1.0 + angles[0]), np.sin(1.0 + angles[0])])
    assert speeds[14] @ toward == pytest.approx(10.0 * 0.5 * 0.2 / mass, rel=0.03)
    assert speeds[-1] @ toward == pytest.approx(10.0 * (0.5 * 0.2 + 0.2) / mass, rel=0.01)
    assert np.linalg.norm(speeds[-1]) == pytest.approx(speeds[-1] @ toward, rel=1e-3)


@pytest.mark.parametrize(("way", "ahead"), [("fore-aft", 1.0), ("sideways", 0.0)])
def test_a_push_comes_from_where_it_is_asked_for(way, ahead, description):
    ranges = dataclasses.replace(NOMINAL, heading=(1.0, 1.0), push=(0.5, 0.5), push_interval=0.1)
    signs = set()
    for seed in range(6):
        plant = DisturbedPlant(description, ranges=ranges, seed=seed, disturbance=Disturbance(push_way=way))
        plant.start()
        plant.data.time, plant.data.qvel[:] = 10.0, 0.0
        plant._push()
        push = plant.data.qvel[:2] / 0.5
        assert abs(push @ [np.cos(1.0), np.sin(1.0)]) == pytest.approx(ahead, abs=0.01), "it turns a little as it sinks"
        assert np.linalg.norm(push) == pytest.approx(1.0)
        signs.add(float(np.sign(push.sum())))
    assert len(signs) == 2


def test_a_tilted_imu_feels_turning_about_its_own_axes(description):
    plant = DisturbedPlant(description, disturbance=Disturbance(imu_tilt=30.0, imu_axis="pitch"), seed=1)
    start = plant.start()
    plant.data.qvel[3:6] = 1.0, 2.0, 3.0
    seen, turn = plant._state().omega_B, Rotation.from_quat(start.quat_WB, scalar_first=True)
    assert np.abs(seen - [1.0, 2.0, 3.0]).max() > 0.3
    true = Rotation.from_quat(plant.data.qpos[3:7], scalar_first=True)
    assert turn.apply(seen) == pytest.approx(true.apply([1.0, 2.0, 3.0]))

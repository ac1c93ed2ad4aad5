"""The law of the drives in training worlds is that of the simulated robot, for each effect of the catalogue."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from mimic.config.play import NOMINAL
from mimic.config.training import TRAINING_RANDOMISATION, UNDISTURBED, MdpSettings
from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.effect_set import EffectSet, EffectValues, write_effects
from mimic.errors import ConfigError
from mimic.records import JOINTS, JointCommand
from mimic.simulation.plant import SimulatedPlant

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
pytest.importorskip("mujoco_warp", reason="training needs the extra 'train'")
from mimic.train.stand_track import StandTrackEnv  # noqa: E402
from mimic.train.worlds import Worlds  # noqa: E402

STEP = 0.0025
EXACT = MdpSettings(
    worlds=6,
    randomisation=NOMINAL,
    disturbances=UNDISTURBED,
    disturbance_share_at_first=1.0,
    quiet_share=0.0,
    solver_iterations=100,
    timestep=STEP,
)

VALUES: dict[str, dict[str, float]] = {
    "coulomb": {"level": 0.3},
    "viscous": {"coefficient": 0.1},
    "link_mass": {"factor": 1.3},
    "delay": {"time": 0.0055},
    "armature": {"inertia": 0.006},
    "gains": {"kp": 0.8, "kd": 1.2},
    "torque_speed": {"torque": 5.0, "speed": 12.0},
    "supply_sag": {"drop": 0.003},
    "kt_gain": {"factor": 0.85},
    "kt_drift": {"rate": -0.3},
    "kt_heat": {"loss": 0.02, "time": 5.0},
    "torque_lag": {"time": 0.006},
    "velocity_lag": {"time": 0.005},
    "stribeck": {"level": 0.2, "speed": 0.1},
    "load_friction": {"ratio": 0.2},
    "asymmetric_friction": {"level": 0.05, "coefficient": 0.02},
    "quadratic_drag": {"coefficient": 0.01},
    "coupling": {"coefficient": 0.05},
    "backlash": {"gap": 0.03},
    "compliance": {"compliance": 0.01},
    "encoder_offset": {"angle": 0.05},
    "encoder_scale": {"factor": 1.05},
    "encoder_step": {"angle": 0.004},
    "cogging": {"cosine": 0.1, "sine": -0.2, "order": 40.0},
    "spring": {"stiffness": 0.8, "moment": 0.3},
    "payload": {"mass": 0.2},
    "com_shift": {"distance": 0.02},
    "joint_delay": {"time": 0.004},
    "encoder_eccentricity": {"cosine": 0.02, "sine": -0.03},
    "target_filter": {"time": 0.01},
}
ELSEWHERE = {"base_tilt", "delay_jitter", "lost_commands", "gear_load_friction", "motor"}
"""Of a stand, of voltage drives, drawn by other generators, or by what the links needed in the physics step before."""


def one(name: str, *, exact: bool = True, **values: float) -> EffectValues:
    spec = CATALOGUE[name]
    joints = () if spec.scope == "machine" else JOINTS[2::3] if spec.tip else JOINTS
    rows = max(1, len(joints))
    intervals = {k: np.full((rows, 2), v) for k, v in values.items()} if exact else {}
    return EffectValues(name=name, joints=joints, values=values, intervals=intervals)


def file(folder: Path, *effects: EffectValues) -> str:
    return str(write_effects(EffectSet(effects), folder / "effects.toml"))


def difference(folder: Path, description, effects: tuple[EffectValues, ...], steps: int = 12) -> float:
    """Return the largest difference of a joint position after one physics step from the same position and velocity."""
    d = dataclasses.replace(description, timestep=STEP, decimation=1)
    worlds = Worlds(d, dataclasses.replace(EXACT, effects=file(folder, *effects)), "cpu", 0)
    assert worlds.motors is not None
    rng, n = np.random.default_rng(0), EXACT.worlds
    lie, gains = (d.q_min + d.q_max) / 2, (d.kp, d.kd)
    plants = [SimulatedPlant(d, effects=EffectSet(effects), timestep=STEP, samples=False) for _ in range(n)]
    for plant in plants:
        qpos, qvel = np.zeros(19), rng.normal(size=18) * np.repeat([0.5, 6.0], [6, 12])
        quat = rng.normal(size=4)
        qpos[2], qpos[3:7], qpos[7:] = 2.0, quat / np.linalg.norm(quat), lie + rng.uniform(-0.2, 0.2, 12)
        plant.start_at(qpos, qvel)
    start = _state(plants, worlds)
    everyone = torch.ones(n, dtype=torch.bool)
    q, dq = worlds.qpos[:, 7:], worlds.qvel[:, 6:]
    worlds.motors.reset(everyone, q, dq, q)
    worlds.motors.reset(everyone, q, dq, worlds.read_q)  # told to hold what the encoders read
    worst, delay = 0.0, torch.full((n, 1), 6)
    q_des = np.stack([lie + rng.uniform(-0.3, 0.3, 12) for _ in plants])
    for k in range(steps):
        if k % 4 == 0:
            q_des = q_des + rng.uniform(-0.4, 0.4, q_des.shape)
        worlds.motors.time.fill_(k * STEP)
        worlds.motors.send(torch.as_tensor(q_des, dtype=torch.float32), delay)
        worlds.step()
        for plant, target in zip(plants, q_des, strict=True):
            ramp = plant.description.dt
            plant.step(
                JointCommand(
                    q_des=target, dq_des=np.zeros(12), kp=gains[0], kd=gains[1], tau_ff=np.zeros(12), ramp=ramp
                )
            )
        there = np.array([plant.data.qpos for plant in plants])
        worst = max(worst, float(np.abs(worlds.qpos.numpy() - there)[:, 7:].max()))
        _state(plants, worlds)
    assert np.abs(there - start)[:, 7:].min() > 0.0
    return worst


def _state(plants: list[SimulatedPlant], worlds: Worlds) -> np.ndarray:
    """Give the worlds the positions and velocities of the plants; the law's own states stay."""
    qpos = np.array([plant.data.qpos for plant in plants])
    worlds.qpos.copy_(torch.as_tensor(qpos, dtype=torch.float32))
    worlds.qvel.copy_(torch.as_tensor(np.array([plant.data.qvel for plant in plants]), dtype=torch.float32))
    worlds.warmstart.copy_(torch.as_tensor(np.array([p.data.qacc_warmstart for p in plants]), dtype=torch.float32))
    return qpos


@pytest.mark.parametrize("name", VALUES)
def test_one_step_is_that_of_the_simulated_robot(name, description, tmp_path):
    """Position and velocity are made equal before each step; what is left is single precision."""
    assert difference(tmp_path, description, (one(name, **VALUES[name]),)) < 1e-6


def test_all_effects_at_once_too(description, tmp_path):
    assert difference(tmp_path, description, tuple(one(name, **values) for name, values in VALUES.items())) < 2e-6


def test_no_effect_of_the_catalogue_is_left_out():
    assert set(VALUES) | ELSEWHERE == set(CATALOGUE)


def environment(description, effects: str, **changes) -> StandTrackEnv:
    settings = dataclasses.replace(EXACT, effects=effects, noise_q=0.0, noise_axes=0.0, worlds=4)
    return StandTrackEnv(description, dataclasses.replace(settings, **changes), "cpu", 3)


def test_a_control_step_has_the_physics_steps_that_were_asked_for(description, tmp_path):
    env = environment(description, file(tmp_path, one("torque_lag", time=0.005)))
    assert env.worlds.decimation == 8
    assert env.worlds.mj_model.opt.timestep == STEP
    assert env.contract.dt == description.dt


def test_policies_in_training_read_the_encoders(description, tmp_path):
    plain = environment(description, file(tmp_path, one("kt_gain", factor=1.0)))
    offset = environment(description, file(tmp_path, one("encoder_offset", angle=0.05)))
    seen = [env.get_observations()["policy"].numpy()[:, :12] for env in (plain, offset)]
    assert seen[1] - seen[0] == pytest.approx(0.05, abs=1e-5)


def test_worlds_that_explode_begin_again_with_all_states_of_the_law(description, tmp_path):
    effects = (one("backlash", gap=0.02), one("torque_lag", time=0.004), one("kt_heat", loss=0.01, time=20.0))
    env = environment(description, file(tmp_path, *effects))
    env.worlds.qvel[2] = float("nan")
    assert env.step(torch.zeros(4, 12))[2][2] == 1
    for _ in range(3):
        seen, reward, _, _ = env.step(0.1 * torch.randn(4, 12))
        assert torch.isfinite(seen["policy"]).all()
        assert torch.isfinite(reward).all()


def test_robots_are_drawn_from_intervals_or_a_tenth_around_the_value(description, tmp_path):
    friction = dataclasses.replace(one("coulomb", level=0.2), intervals={"level": np.tile([0.18, 0.3], (12, 1))})
    env = environment(
        description,
        file(tmp_path, friction, one("armature", exact=False, inertia=0.005)),
        worlds=40,
        solver_iterations=2,
    )
    env.step(torch.zeros(40, 12))
    level, inertia = env.worlds.model.dof_frictionloss.numpy()[:, 6:], env.worlds.model.dof_armature.numpy()[:, 6:]
    armature = inertia - 0.5 * STEP * description.kd  # half of the damping is implicit
    for drawn, low, high in ((level, 0.18, 0.3), (armature, 0.0045, 0.0055)):
        assert low <= drawn.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < drawn.max() <= high + 1e-6


def test_gains_come_in_over_the_ramp(description, tmp_path):
    env = environment(description, file(tmp_path, one("gains", kp=1.0, kd=0.8)), randomisation=TRAINING_RANDOMISATION)

    def spread(share: float) -> float:
        env.worlds.set_share(share)
        env.worlds.substep_ctrl[:] = env.worlds.qpos[:, 7:]  # far from the limits of the torque
        env.worlds.step()
        damping = (env.worlds.model.dof_armature.numpy()[:, 6:] - description.armature) / (0.5 * STEP)
        return float(np.abs(damping / (0.8 * description.kd) - 1).max())

    assert spread(1.0) > 0.1
    assert spread(0.0) < 1e-5


def test_lost_commands_leave_the_one_before(description, tmp_path):
    """With nine of ten lost, most worlds still hold their first command after a step."""
    env = environment(description, file(tmp_path, one("lost_commands", share=0.9)), worlds=60, solver_iterations=2)
    env.step(torch.zeros(60, 12))
    motors = env.worlds.motors
    assert motors is not None
    before = motors._targets[0].clone()
    env.step(torch.ones(60, 12))
    env.step(torch.ones(60, 12))
    env.step(torch.ones(60, 12))
    held = (motors._targets[0] - before).abs().amax(-1) < 1e-6
    assert 0.4 < held.float().mean() < 0.98


def test_effects_of_a_stand_are_left_out_and_unknown_files_refused(description, tmp_path):
    env = environment(description, file(tmp_path, one("base_tilt", roll=0.2, pitch=0.0)))
    assert torch.equal(env.worlds.slope_quat[:, 0], torch.ones(4))
    with pytest.raises(ConfigError, match="cannot be read"):
        environment(description, str(tmp_path / "nothing.toml"))

"""The disturbed training physics against MuJoCo's own, on a slope, with a payload and a pull."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from mimic.config.play import NOMINAL
from mimic.config.training import UNDISTURBED, MdpSettings
from mimic.dynamics.robot_model import load_model
from mimic.records import LEGS

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
pytest.importorskip("mujoco_warp", reason="training needs the extra 'train'")
from mimic.train.rewards import slip  # noqa: E402
from mimic.train.stand_track import StandTrackEnv  # noqa: E402
from mimic.train.tensors import quat_apply_inverse, quat_multiply  # noqa: E402

RANGES = dataclasses.replace(
    UNDISTURBED,
    slope=(4.0, 4.0),
    toe_payload=(0.3, 0.3),
    drag=(8.0, 8.0),
    drag_share=1.0,
    drag_from=(0.0, 0.0),
    drag_ramp=(0.0, 0.0),
)


@pytest.fixture(autouse=True)
def solved(monkeypatch):
    """Physics that is solved to the end."""
    monkeypatch.setattr("mimic.train.worlds.LINE_SEARCHES", 50)


def newest_frame(env: StandTrackEnv) -> torch.Tensor:
    """Return the newest frame of the first world's observation."""
    history, width = env.settings.history, env.contract.frame_size
    return env.get_observations()["policy"][0, : history * width].reshape(history, width)[-1]


def make(description, **changes: object) -> StandTrackEnv:
    settings = MdpSettings(
        worlds=1,
        friction_speed=0.0,
        noise_q=0.0,
        noise_axes=0.0,
        noise_gyro=0.0,
        noise_dq=0.0,
        upright_share=0.0,
        randomisation=NOMINAL,
        command_margin=0.0,
        disturbance_share_at_first=1.0,
        upright_share_at_first=0.0,
        timestep=0.0025,
        solver_iterations=100,
    )
    return StandTrackEnv(description, dataclasses.replace(settings, **changes), "cpu", 6)


def test_slope_payload_and_pull_are_those_of_the_simulation(description):
    env = make(description, disturbances=RANGES)
    env.episode_length_buf.zero_()
    side = int(env.worlds.features[0, -1] > 0)
    model = load_model(description, visuals=False, payloads={LEGS[side]: 0.3})
    tilt = env.worlds.slope_quat[0].numpy().astype(np.float64)
    assert np.rad2deg(2 * np.arccos(tilt[0])) == pytest.approx(4.0, abs=0.05)
    down, up = np.zeros(3), tilt * [1, -1, -1, -1]
    mujoco.mju_rotVecQuat(down, model.opt.gravity, up)
    model.opt.gravity = down
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = env.worlds.qpos[0].numpy(), env.worlds.qvel[0].numpy()
    toe = int(env.disturbances.toe[0, 1] > 0)
    site, d = model.site(f"{LEGS[toe]}_toe").id, env.disturbances
    assert float(d.force[0]) == pytest.approx(8.0, rel=1e-5)
    d.advance(env.episode_length_buf, torch.zeros(1, 2, 3), env._heading)
    force = d.pull[0, toe].numpy().astype(np.float64)
    assert np.linalg.norm(force) == pytest.approx(8.0, rel=1e-5)
    mujoco.mj_forward(model, data)
    rng = np.random.default_rng(0)
    env.worlds.site_xpos.copy_(torch.as_tensor(data.site_xpos, dtype=torch.float32)[None])
    env.worlds.xipos.copy_(torch.as_tensor(data.xipos[: env.worlds.xipos.shape[1]], dtype=torch.float32)[None])
    for _ in range(10):
        env.step(torch.as_tensor(rng.normal(scale=0.5, size=12), dtype=torch.float32)[None])
        for k in range(description.decimation):
            data.ctrl[:] = env.worlds.substep_ctrl[k, 0].numpy()
            data.qfrc_applied[:] = 0.0
            at, none = data.site_xpos[site], np.zeros(3)
            mujoco.mj_applyFT(model, data, force, none, at, model.site_bodyid[site], data.qfrc_applied)
            mujoco.mj_step(model, data)
        assert (
            np.abs(env.worlds.qpos[0].numpy() - data.qpos).max() < 2e-3
        )  # the pull's moment is held for a control step


def test_on_a_slope_down_is_seen_where_it_is(description):
    env = make(description, disturbances=dataclasses.replace(UNDISTURBED, slope=(4.0, 4.0)))
    seen = newest_frame(env)[env.contract.columns("down")]
    gravity = quat_apply_inverse(env.worlds.slope_quat, torch.tensor([[0.0, 0.0, -1.0]]))
    expected = quat_apply_inverse(env.worlds.qpos[:, 3:7], gravity)[0]
    assert torch.allclose(seen, expected, atol=1e-5)


def test_a_tilted_imu_sees_another_down(description):
    env = make(description, disturbances=dataclasses.replace(UNDISTURBED, imu_tilt=(3.0, 3.0)))
    seen = newest_frame(env)[env.contract.columns("down")].numpy()
    true = quat_apply_inverse(env.worlds.qpos[:, 3:7], torch.tensor([[0.0, 0.0, -1.0]]))[0].numpy()
    angle = np.rad2deg(np.arccos(np.clip(seen @ true / np.linalg.norm(seen) / np.linalg.norm(true), -1, 1)))
    assert 0.0 < angle <= 3.01
    mount = env.disturbances.mount
    assert np.rad2deg(2 * np.arccos(float(mount[0, 0]))) == pytest.approx(3.0, abs=0.05)
    assert quat_multiply(mount, mount * torch.tensor([1.0, -1.0, -1.0, -1.0]))[0, 0] == pytest.approx(1.0, abs=1e-6)


def test_lost_commands_leave_the_one_before_in_effect(description):
    lost = dataclasses.replace(UNDISTURBED, lost_share=(1.0, 1.0))
    env = make(description, disturbances=lost, limp_share=0.0, ramped_share=0.0)
    before = env.worlds.qpos[0, 7:].clone()
    env.step(torch.ones(1, 12))
    assert torch.allclose(env.worlds.substep_ctrl[:, 0], before.expand(description.decimation, 12))


def test_toe_motion_is_that_of_mujoco(description):
    worlds = make(description).worlds
    model = worlds.mj_model
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    data.qpos[:3], data.qvel[:] = rng.normal(size=3), rng.normal(size=18)
    quat = rng.normal(size=4)
    data.qpos[3:7] = quat / np.linalg.norm(quat)
    data.qpos[7:] = rng.uniform(description.q_min, description.q_max)
    mujoco.mj_forward(model, data)
    expected = np.zeros((4, 6))
    for i, leg in enumerate(LEGS):
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, model.site(f"{leg}_toe").id, expected[i], 0)
    for there, here in ((worlds.qpos, data.qpos), (worlds.qvel, data.qvel)):
        there.copy_(torch.as_tensor(here, dtype=torch.float32)[None])
    worlds.see()
    velocity, turning = worlds.toe_motion()
    assert np.allclose(velocity[0].numpy(), expected[:, 3:5], atol=1e-5)
    assert np.allclose(turning[0].numpy(), expected[:, 2], atol=1e-5)


def test_only_low_toes_pay_for_moving():
    height = torch.tensor([[0.02, 0.05, 0.02, 0.05]])
    velocity, turning = torch.full((1, 4, 2), 0.5), torch.full((1, 4), torch.pi)
    assert slip(height, velocity, turning, below=0.03).item() == pytest.approx(2 * (0.5 + 1.0))


def test_a_pull_grows_to_its_size_and_comes_more_often_from_behind(description, monkeypatch):
    monkeypatch.setattr("mimic.train.disturbances.DRAG_SECONDS", 1.0)
    ranges = dataclasses.replace(
        UNDISTURBED, drag=(8.0, 8.0), drag_share=1.0, drag_from=(1.0, 1.0), drag_ramp=(2.0, 2.0)
    )
    env = make(description, worlds=4000, disturbances=ranges, quiet_share=0.0)
    d, heading = env.disturbances, torch.full((4000,), 0.7)
    sizes = {}
    for step in range(220):
        d.advance(torch.full((4000,), step), torch.zeros(4000, 2, 3), heading if step <= 50 else heading + 1.0)
        sizes[step] = d.pull.sum(1).norm(dim=-1)
        if step == 100:
            way = torch.atan2(d.pull.sum(1)[:, 1], d.pull.sum(1)[:, 0]) - 0.7
    assert sizes[49].max() == 0.0
    assert sizes[100].numpy() == pytest.approx(4.0, abs=0.1)
    assert sizes[160].numpy() == pytest.approx(8.0)
    assert sizes[205].max() == 0.0
    behind, ahead = (torch.cos(way) < -0.7072).float().mean(), (torch.cos(way) > 0.7072).float().mean()
    assert 1.7 < behind / ahead < 2.4


def test_a_tilted_imu_shows_turning_about_its_own_axes_and_quiet_worlds_have_one_too(description):
    ranges = dataclasses.replace(UNDISTURBED, imu_tilt=(3.0, 3.0), gyro_bias=0.05)
    env = make(description, worlds=40, disturbances=ranges, quiet_share=0.5)
    d, quiet = env.disturbances, env.worlds.quiet
    degrees = torch.rad2deg(2 * torch.acos(d.mount[:, 0].clamp(max=1.0)))
    assert degrees[~quiet].numpy() == pytest.approx(3.0, abs=0.05)
    assert degrees[quiet].numpy() == pytest.approx(2.0, abs=0.05)
    assert (d.mount[:, [1, 3]].abs().amax(-1) < 1e-6).float().mean() > 0.25  # pitch alone
    env.worlds.qvel[:, 3:6] = torch.tensor([1.0, 2.0, -1.0])
    env._observe(torch.ones(40, dtype=torch.bool), env.worlds.lowest())
    frames = env.get_observations()["policy"][:, : env.settings.history * env.contract.frame_size]
    seen = frames.reshape(40, env.settings.history, -1)[:, -1, env.contract.columns("gyro")] * 4
    true = quat_apply_inverse(d.mount, env.worlds.qvel[:, 3:6])
    assert (seen - true).abs().max() <= 0.05 + 1e-5
    assert (seen - true).abs().max() > 0.03

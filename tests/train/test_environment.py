from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from mimic.config.leading import HandSettings
from mimic.config.play import NOMINAL, Randomisation
from mimic.config.rewards import FinishFactors, RewardWeights
from mimic.config.training import UNDISTURBED, MdpSettings
from mimic.dynamics.robot_model import load_model, restitution_damping
from mimic.policy.contract import FRAME_SIZE, FRONT, ObservationBuilder, arm_reference, joint_command
from mimic.records import JointCommand
from mimic.robot.description import with_timestep
from mimic.robot.leg_kinematics import front_toes
from mimic.robot.model import TOES
from mimic.simulation.hand import Hand
from mimic.simulation.plant import SimulatedPlant

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
pytest.importorskip("mujoco_warp", reason="training needs the extra 'train'")
from mimic.train.contract import STAND_UP_STEPS  # noqa: E402
from mimic.train.rewards import BEARS, MOST_DRIFT, MOST_SHUFFLE  # noqa: E402
from mimic.train.schedules import SETTLES  # noqa: E402
from mimic.train.stand_track import StandTrackEnv  # noqa: E402
from mimic.train.tensors import in_heading_frame  # noqa: E402

FEW = MdpSettings(
    worlds=6,
    history=6,
    noise_q=0.0,
    noise_axes=0.0,
    noise_gyro=0.0,
    noise_dq=0.0,
    rest_steps=(-1.0, 0.0),
    disturbances=UNDISTURBED,
    disturbance_share_at_first=1.0,
    quiet_share=0.0,
    friction_speed=0.0,
)


def make(description, seed: int = 3, **changes: object) -> StandTrackEnv:
    return StandTrackEnv(description, dataclasses.replace(FEW, **changes), "cpu", seed)


@pytest.fixture(scope="module")
def env(description) -> StandTrackEnv:
    return make(description)


def test_pushes_from_the_side_come_from_within_thirty_degrees_of_it(env, monkeypatch):
    monkeypatch.setattr("mimic.train.stand_track.PUSHED_SIDEWAYS", 1.0)
    lengths, velocities = env.episode_length_buf.clone(), env.worlds.qvel.clone()
    env.episode_length_buf.fill_(round(env.settings.randomisation.push_interval / env.contract.dt))
    kicks = []
    for _ in range(50):
        env.worlds.qvel.zero_()
        env._push()
        kicks.append(in_heading_frame(env.worlds.qvel[:, :2], env._heading))
    env.episode_length_buf.copy_(lengths)
    env.worlds.qvel.copy_(velocities)
    ahead, left = torch.cat(kicks).unbind(-1)
    assert ahead.abs().le(math.tan(math.pi / 6) * left.abs() + 1e-6).all()
    assert left.gt(0).float().mean().item() == pytest.approx(0.5, abs=0.15)


def actions(step: int, worlds: int = FEW.worlds) -> torch.Tensor:
    return 0.3 * torch.randn(worlds, 12, generator=torch.Generator().manual_seed(step))


def policy_observation(env: StandTrackEnv) -> np.ndarray:
    return env.get_observations()["policy"].numpy().astype(np.float64)


def newest(env: StandTrackEnv, term: str) -> np.ndarray:
    """Return a term of the newest frames (worlds, width)."""
    seen = env.get_observations()["policy"].numpy()[:, : env.settings.history * FRAME_SIZE]
    frames = seen.reshape(env.num_envs, env.settings.history, -1)
    return frames[:, -1, env.contract.columns(term)]


def seen_arms(env: StandTrackEnv, world: int) -> np.ndarray | None:
    """Return what a player tells a policy of its arms, from where training says they will be."""
    if not env._tracking()[world]:
        return None
    q, dq = env.arms.q[world, 1:].numpy(), env.arms.dq[world, 1:].numpy()
    default_q = np.array(env.contract.default_q[:FRONT])
    return arm_reference(q, dq, env._known[world].numpy(), default_q, np)


def test_training_and_running_build_the_same_observation(env):
    """The commands are read from the environment's own buffers; all that is measured comes from its physics."""
    env.episode_length_buf.zero_()
    env.phase_at_start.zero_()
    builders = [ObservationBuilder(env.contract) for _ in range(env.num_envs)]
    alive = np.ones(env.num_envs, dtype=bool)
    compared = 0
    for step in range(12):
        measured = env.worlds.qpos.numpy().astype(np.float64)
        speeds = env.worlds.qvel.numpy().astype(np.float64)
        running = np.array(
            [
                builder.observe(
                    q=measured[i, 7:],
                    quat_WB=measured[i, 3:7],
                    v_des=env.moves.velocity[i].numpy(),
                    heading_des=float(env.moves.heading[i]),
                    p_BE_des=np.zeros((2, 3)),
                    omega_B=speeds[i, 3:6],
                    dq=speeds[i, 6:],
                    arms=seen_arms(env, i),
                )
                for i, builder in enumerate(builders)
            ]
        )
        if step > env.settings.history:  # by then no frame is left from before the clock was set
            assert np.abs(running - policy_observation(env))[alive].max() < 1e-5
            compared += int(alive.sum())
        action = actions(step) * (50.0 if step == 5 else 1.0)
        for i, builder in enumerate(builders):
            builder.acted(action[i].numpy().astype(np.float64))
        if step == 2:
            env.moves.velocity[::2, 0] = 0.3  # their clocks fade in
        _, _, done, _ = env.step(action)
        alive &= done.numpy() == 0
    assert compared > 20
    frames = running[:, : env.settings.history * FRAME_SIZE].reshape(env.num_envs, env.settings.history, -1)
    clocks = np.linalg.norm(frames[:, -1, env.contract.columns("clock")], axis=1)
    assert clocks[::2].min() > 0.5
    assert (clocks[1::2] == 0.0).any()


def test_the_critic_sees_what_the_policy_sees_and_more(env):
    seen = env.get_observations()
    width = env.contract.observation_size
    assert seen["policy"].shape == (env.num_envs, width)
    assert seen["critic"].shape[1] > width
    assert torch.equal(seen["critic"][:, :width], seen["policy"].clamp(-50, 50))


@pytest.mark.parametrize("timestep", [0.005, 0.0025])
def test_training_physics_is_that_of_the_simulation(description, timestep, monkeypatch):
    """From the same lying start, through the same actuators and delay, with the same actions, solved to the end."""
    description = with_timestep(description, timestep)
    monkeypatch.setattr("mimic.train.worlds.LINE_SEARCHES", 50)
    solved = {"solver_iterations": 100, "timestep": timestep, "command_margin": 0.0}
    crouched = {"upright_share": 0.0, "upright_share_at_first": 0.0, "limp_share": 0.0, "ramped_share": 0.0}
    env = make(description, worlds=1, randomisation=NOMINAL, **crouched, **solved)
    plant = SimulatedPlant(description, timestep=timestep)
    lie = [0.0, 0.0, description.pose_height["lie"] + 0.005, 1.0, 0.0, 0.0, 0.0, *description.poses["lie"]]
    state = plant.start_at(np.array(lie), np.zeros(18))  # without power it lies on its stops, where solvers differ more
    env.episode_length_buf.zero_()
    env.worlds.qpos[0] = torch.as_tensor(np.concatenate([state.p_WB, state.quat_WB, state.q]))
    env.worlds.qvel.zero_()
    gains = description.kp, description.kd
    rng = np.random.default_rng(0)
    moved = 0.0
    for _ in range(15):
        action = rng.normal(scale=0.5, size=12)
        env.step(torch.as_tensor(action, dtype=torch.float32)[None])
        q_des = joint_command(env.contract, action)
        command = JointCommand(
            q_des=q_des, dq_des=np.zeros(12), kp=gains[0], kd=gains[1], tau_ff=np.zeros(12), ramp=env.contract.dt
        )
        before, state = state, plant.step(command).state
        moved = max(moved, np.abs(state.q - before.q).max())
        assert np.abs(env.worlds.qpos[0, 7:].numpy() - state.q).max() < 1e-4
        assert np.abs(env.worlds.qpos[0, :3].numpy() - state.p_WB).max() < 1e-4
        assert np.abs(env.worlds.actuator_force[0].numpy() - state.tau).max() < 1e-2
    assert moved > 0.05


@pytest.mark.parametrize(("ranges", "most"), [(NOMINAL, 0.25), (Randomisation(), 0.5)])
def test_arms_are_where_they_should_be(description, ranges, most):
    """Of robots that are held up; mean distance of the toes [cm]."""
    env = make(description, worlds=16, randomisation=ranges, upright_share_at_first=1.0)
    errors, fast = [], []
    before = env.arms.q[:, 1].clone()
    for step in range(90):
        env.worlds.qpos[:, 2] = 1.0
        env.worlds.qvel[:, :6] = 0.0
        env.step(torch.zeros(16, 12))
        q, wanted = env.worlds.qpos[:, 7:13], env.arms.q[:, 1]
        toes = front_toes(q, description, torch) - front_toes(wanted, description, torch)
        moved = front_toes(wanted, description, torch) - front_toes(before, description, torch)
        before = wanted.clone()
        going = env.episode_length_buf > 30
        if step > 30:
            errors.append(100 * toes.norm(dim=-1)[going])
            fast.append(moved.norm(dim=-1)[going] / env.contract.dt)
    assert torch.cat(errors).mean() < most
    assert torch.cat(fast).max() > 1.0


def test_a_policy_moves_front_legs_until_the_blend_and_then_not(description):
    env = make(description, upright_share=1.0, upright_share_at_first=1.0, randomisation=NOMINAL)
    env._upright_start.fill_(False)
    env.episode_length_buf.fill_(STAND_UP_STEPS - 2)
    env.step(actions(9))
    own = []
    for step in range(6):
        env.step(actions(step))
        own.append(env.get_observations()["own"].clone())
    assert own[0].min() == 1.0
    alive = env.episode_length_buf > STAND_UP_STEPS
    assert alive.any()
    assert own[-1][alive, :6].max() == 0.0
    assert own[-1][:, 6:].min() == 1.0
    assert (newest(env, "last_action")[alive.numpy(), 6:] != 0.0).all()


def test_motors_differ_in_torque_and_speed(description):
    ranges = dataclasses.replace(UNDISTURBED, torque=(0.7, 1.5), speed=(0.7, 1.5))
    model = make(description, worlds=40, disturbances=ranges).worlds.model
    most = model.actuator_forcerange.numpy()[..., 1]
    constant, resistance = model.actuator_gainprm.numpy()[..., 1], model.actuator_gainprm.numpy()[..., 0]
    fastest = description.voltage / constant
    assert 0.7 <= (most / description.torque_max).min() < 0.8 < 1.4 < (most / description.torque_max).max() <= 1.5
    assert 0.7 <= (fastest / description.speed_max).min() < 0.8 < 1.4 < (fastest / description.speed_max).max() <= 1.5
    flat = fastest - most * resistance / constant**2
    assert flat == pytest.approx(description.speed_flat / description.speed_max * fastest, rel=1e-3)


def test_an_environment_of_the_same_seed_goes_the_same_way(description):
    def play(seed: int) -> torch.Tensor:
        env = make(description, seed)
        return torch.stack([env.step(actions(step))[0]["policy"] for step in range(5)])

    first, second, third = play(3), play(3), play(4)
    assert torch.equal(first, second)
    assert not torch.equal(first, third)


def test_every_world_is_another_robot(env):
    robots = env.worlds.features.numpy()
    assert len(np.unique(robots, axis=0)) == env.num_envs


def test_every_episode_ends_and_begins_again(description):
    env = make(description, episode_steps=100)
    ended = torch.zeros(env.num_envs)
    for step in range(100):
        seen, reward, done, extras = env.step(actions(step))
        assert torch.isfinite(seen["policy"]).all()
        assert torch.isfinite(seen["critic"]).all()
        assert torch.isfinite(reward).all()
        assert torch.all(done[extras["time_outs"]] > 0)
        assert torch.all(env.episode_length_buf[done > 0] == 0)
        ended += done
    assert torch.all(ended >= 1)


def test_actions_that_are_not_finite_do_no_harm(env):
    seen, reward, _, _ = env.step(torch.full((env.num_envs, 12), float("nan")))
    assert torch.isfinite(seen["policy"]).all()
    assert torch.isfinite(reward).all()


def test_a_world_that_explodes_is_started_again(env):
    env.worlds.qvel[2] = float("nan")
    seen, reward, done, _ = env.step(torch.zeros(env.num_envs, 12))
    assert done[2] == 1
    assert reward[2] == 0.0
    assert torch.isfinite(seen["critic"]).all()
    for step in range(3):
        seen, reward, done, _ = env.step(actions(step))
        assert torch.isfinite(seen["critic"]).all()
        assert torch.isfinite(reward).all()
        assert done[2] == 0


def test_noise_is_on_measured_terms_only(description):
    quiet = make(description)
    noisy = make(description, noise_q=0.01, noise_axes=0.015, noise_gyro=0.2, noise_dq=0.9, noise_least=1.0)
    difference = np.abs(policy_observation(noisy) - policy_observation(quiet))[
        :, : quiet.settings.history * FRAME_SIZE
    ].reshape(-1, FRAME_SIZE)
    columns, rest = noisy.contract.columns, difference.copy()
    halves = {"joint_position": 0.01, "down": 0.015, "forward": 0.015, "gyro": 0.05, "joint_velocity": 0.045}
    for name, half in halves.items():
        assert 0.5 * half < difference[:, columns(name)].max() <= half + 1e-6
        rest[:, columns(name, "slow_mean")] = 0.0
    assert dict(noisy.contract.noise) == pytest.approx(halves)
    assert rest.max() == 0.0


def test_smooth_friction_moves_the_robot_as_dry_friction_does(description):
    """The same robots from the same starts with the same actions, through friction of either kind."""

    def moved(speed: float, friction: float) -> np.ndarray:
        ranges = dataclasses.replace(NOMINAL, dry_friction=(friction, friction))
        lying = {"upright_share": 0.0, "upright_share_at_first": 0.0, "timestep": 0.0025}
        env = make(description, worlds=24, friction_speed=speed, randomisation=ranges, solver_iterations=50, **lying)
        for step in range(10):
            env.step(0.3 * actions(step, 24))
        return env.worlds.qpos[:, 7:].numpy().copy()

    dry, smooth, none = moved(0.0, 4.0), moved(MdpSettings().friction_speed, 4.0), moved(0.0, 0.0)
    away, without = (np.median(np.abs(other - dry).mean(axis=1)) for other in (smooth, none))
    assert without > 0.003
    assert away < 0.4 * without


def test_quiet_worlds_are_the_papers_robots_and_nobody_pulls_them(description):
    env = make(
        description,
        worlds=40,
        quiet_share=0.5,
        randomisation=dataclasses.replace(FEW.randomisation, dry_friction=(4.0, 4.0), push=(1.0, 1.0)),
        disturbances=dataclasses.replace(UNDISTURBED, drag=(8.0, 8.0), drag_share=1.0, slope=(4.0, 4.0)),
    )
    quiet, d = env.worlds.quiet, env.disturbances
    assert quiet.sum() == 20
    friction = env.worlds.model.dof_frictionloss.numpy()[:, 6:]
    assert friction[quiet].max() < 0.081
    assert friction[~quiet] == pytest.approx(0.2)
    assert not d.force[quiet].any()
    assert d.force[~quiet].numpy() == pytest.approx(8.0, rel=1e-5)
    assert env.worlds.slope_quat[quiet, 0].numpy() == pytest.approx(1.0)
    assert (d.push_share[~quiet] == 1.0).all()
    pushes = torch.cat([d.push_share[quiet] for _ in range(50)])
    assert set(pushes.tolist()) == {0.25, 1.0}
    assert pushes.eq(1.0).float().mean().item() == pytest.approx(0.25, abs=0.06)


def test_a_hand_pulls_as_that_of_the_simulation_does(description, monkeypatch):
    """The same toe path before both: standing still, then faster than the hand, then far behind."""
    hand = HandSettings(toe="right", direction=0.0, speed=0.2, most=6.0, stiffness=60.0, begin=2.0, way=0.8)
    for name, value in (("SPEED", hand.speed), ("MOST", hand.most), ("SECONDS", hand.way / hand.speed)):
        monkeypatch.setattr(f"mimic.train.disturbances.LEAD_{name}", (value, value))
    ranges = dataclasses.replace(UNDISTURBED, lead_share=1.0, drag_from=(hand.begin, hand.begin))
    env = make(description, disturbances=ranges)
    d, dt = env.disturbances, description.dt
    model = load_model(description)
    data = mujoco.MjData(model)
    data.qpos[3] = 1.0
    mujoco.mj_forward(model, data)
    reference = Hand(model, hand)
    side = int(d.toe[0, 1])
    site = model.site(TOES[1]).id
    steps = torch.ones(FEW.worlds)
    unit = d.hand_velocity[0].numpy() / np.linalg.norm(d.hand_velocity[0].numpy())
    pulls, wanted = [], []
    for step in range(round((hand.end + 0.2) / dt)):
        way = np.interp(step * dt, [2.5, 3.0, 4.0, 6.0], [0.0, 0.3, 0.3, 0.35])
        toes = torch.zeros(FEW.worlds, 2, 3)
        toes[0, side, :2] = torch.as_tensor(unit * way)
        d.advance(step * steps, toes, torch.zeros(FEW.worlds))
        pulls.append(float(d.pull[0, side, :2] @ torch.as_tensor(unit, dtype=torch.float32)))
        data.time, data.site_xpos[site] = step * dt + 1e-6, [way, 0.0, 0.3]
        reference(model, data)
        wanted.append(data.xfrc_applied[model.site_bodyid[site], 0])
        assert not d.pull[0, 1 - side].any()
    assert max(wanted) == pytest.approx(hand.most)
    assert min(wanted) < -1.0
    assert pulls == pytest.approx(wanted, abs=0.05)
    assert d.came.all()
    assert not d.held.any()


def test_a_robot_is_to_rest_once_it_has_had_time_to_turn(description):
    env = make(description, stand_share=1.0, command_seconds=(5000.0, 5000.0))
    everyone = torch.ones(FEW.worlds, dtype=torch.bool)
    env.moves.reset(everyone, torch.zeros(FEW.worlds))
    steps = round(SETTLES / env.contract.dt)
    seen = []
    for _ in range(2 * steps):
        env.moves.advance()
        seen.append(env.moves.settled.clone())
    assert not seen[steps - 2].any()
    assert seen[steps + 1].all()
    env.moves.velocity[:, 0] = 0.3
    assert not env.moves.settled.any()


def test_gains_slopes_and_the_ground_come_in_over_the_ramp(description):
    env = make(
        description,
        worlds=2,
        disturbances=dataclasses.replace(UNDISTURBED, slope=(4.0, 4.0), contact_time=(1.5, 1.5)),
        randomisation=dataclasses.replace(FEW.randomisation, restitution=(0.4, 0.4)),
        disturbance_share_at_first=0.25,
        rest_steps=(240.0, 720.0),
    )

    usual = env.worlds.mj_model.geom("floor").solref[0]

    def at(calls: int) -> tuple[float, float, np.ndarray]:
        env.resume_at(calls)
        env.step(torch.zeros(2, 12))
        ground = env.worlds.model.geom_solref.numpy()[0, env.worlds.mj_model.geom("floor").id].copy()
        slope = np.rad2deg(2 * np.arccos(env.worlds.slope_quat[:, 0].numpy().clip(-1, 1)))
        spread = np.abs(env.worlds.model.actuator_gainprm.numpy()[..., 4] / description.kp - 1).max()
        return float(slope.mean()), float(spread), ground

    def ground(bounce: float, slower: float) -> list[float]:
        damping = restitution_damping(bounce)
        return [slower * usual / damping, damping]

    early, late = at(0), at(720)
    assert early[0] == pytest.approx(1.0, abs=0.05)
    assert late[0] == pytest.approx(4.0, abs=0.05)
    assert early[1] == pytest.approx(0.25 * late[1], rel=1e-3)
    assert late[1] > 0.05
    assert early[2] == pytest.approx(ground(0.1, 1.125), rel=1e-5)
    assert late[2] == pytest.approx(ground(0.4, 1.5), rel=1e-5)


def only(**weights: float) -> RewardWeights:
    return RewardWeights(**{f.name: weights.get(f.name, 0.0) for f in dataclasses.fields(RewardWeights)})


def test_the_finish_makes_a_term_count_for_more_once_all_is_learned(description):
    def rewards(factor: float, calls: int) -> torch.Tensor:
        env = make(
            description,
            rewards=only(velocity=1.0),
            finish=FinishFactors(velocity=factor),
            finish_steps=(240.0, 720.0),
            upright_share=1.0,
            upright_share_at_first=1.0,
            curriculum_latest=0.0,
            curriculum_steps=240.0,
        )
        env.resume_at(calls)
        return env.step(torch.zeros(FEW.worlds, 12))[1]

    plain = rewards(1.0, 480)
    assert plain.min() > 0
    for calls, factor in ((240, 1.0), (480, 2.5), (1440, 4.0)):
        assert torch.allclose(rewards(4.0, calls), factor * plain)


@pytest.fixture
def upright(description, monkeypatch):
    """Makes worlds in which every robot starts upright, with rewards at their full weight and size."""
    monkeypatch.setattr("mimic.train.stand_track.REWARD_SCALE", 1.0)
    monkeypatch.setattr("mimic.train.weights.REFINING_SHARE", 1.0)
    return lambda **settings: make(description, upright_share=1.0, upright_share_at_first=1.0, **settings)


def test_unrest_has_a_largest_cost_and_is_free_while_the_robot_topples(upright):
    for size, cost in ((0.1, 6 * 0.1**2), (5.0, 6.0)):
        env = upright(rewards=only(unrest=-1.0), stand_share=1.0)
        fresh = env.episode_length_buf == 0
        _, reward, done, _ = env.step(torch.full((FEW.worlds, 12), size))
        counted = reward[(done == 0) & ~fresh]
        assert all(v == pytest.approx(-cost, rel=1e-5) or v == 0.0 for v in counted.tolist())
        assert counted.min() < 0.0


def test_shuffling_costs_the_speed_of_toes_on_the_ground(upright, description):
    env = upright(rewards=only(shuffle=-1.0), stand_share=1.0, worlds=24, randomisation=NOMINAL)
    model = env.worlds.mj_model
    data, jacobian, compared = mujoco.MjData(model), np.zeros((3, model.nv)), 0
    for _ in range(12):
        _, reward, done, _ = env.step(torch.zeros(24, 12))
        for world in torch.nonzero((done == 0) & (reward < 0)).flatten().tolist():
            data.qpos[:], data.qvel[:] = env.worlds.qpos[world], env.worlds.qvel[world]
            mujoco.mj_forward(model, data)
            speeds = []
            heights = np.array([data.site(name).xpos[2] - description.toe_radius for name in TOES[2:]])
            if np.abs(heights - 0.003).min() < 1e-3:  # too near to where a toe begins to touch
                continue
            for name in TOES[2:]:
                mujoco.mj_jacSite(model, data, jacobian, None, model.site(name).id)
                on_ground = data.site(name).xpos[2] - description.toe_radius < 0.003
                speeds.append(min(np.linalg.norm((jacobian @ data.qvel)[:2]), MOST_SHUFFLE) * on_ground)
            assert -reward[world].item() == pytest.approx(np.mean(speeds), rel=0.02, abs=1e-3)
            compared += 1
    assert compared > 10


def test_drift_is_the_distance_from_where_the_robot_came_to_rest(upright):
    env = upright(rewards=only(drift=-1.0), still_share=1.0)
    env.moves._since.fill_(SETTLES + 1.0)
    env.moves._left.fill_(100.0)
    env.step(torch.zeros(FEW.worlds, 12))
    env.moves._since.fill_(SETTLES + 1.0)
    start = env._anchor.clone()
    env.worlds.qpos[:, 0] += torch.linspace(0.0, 0.5, FEW.worlds)
    _, reward, done, _ = env.step(torch.zeros(FEW.worlds, 12))
    away = (env.worlds.qpos[:, :2] - start).norm(dim=-1).clamp(max=MOST_DRIFT)
    alive = done == 0
    assert alive.sum() >= FEW.worlds - 1
    assert -reward[alive].numpy() == pytest.approx(away[alive].numpy(), abs=1e-3)
    env.moves.velocity[:, 0] = 0.3
    _, reward, done, _ = env.step(torch.zeros(FEW.worlds, 12))
    assert reward[done == 0].abs().max() < 1e-6


def test_a_foot_bears_the_share_of_the_weight_that_the_ground_gives_it(description):
    env = make(description, upright_share=1.0, upright_share_at_first=1.0, randomisation=NOMINAL)
    for _ in range(10):
        env.step(torch.zeros(FEW.worlds, 12))
    forces = env.worlds.data.contact
    count = int(env.worlds.data.nacon.numpy()[0])
    rows, worlds = forces.efc_address.numpy()[:count, 0], forces.worldid.numpy()[:count]
    pressed = env.worlds.data.efc.force.numpy()[worlds, rows] * (rows >= 0)
    whole = np.bincount(worlds, pressed, minlength=FEW.worlds)
    only_feet = (env.worlds.lowest()[:, env._near_ground] > 0.03).all(-1).numpy()
    assert only_feet.any()
    assert (env._load.sum(-1) * env.worlds.weight).numpy()[only_feet] == pytest.approx(whole[only_feet], rel=1e-4)
    mass = float(sum(env.worlds.mj_model.body_mass))
    assert env.worlds.weight.numpy() == pytest.approx(9.81 * mass, rel=1e-3)


def test_at_first_every_robot_steps_and_in_the_end_only_who_is_asked_to(description):
    env = make(description, rest_steps=(240.0, 720.0), still_share=1.0, stand_share=1.0)
    env.step(torch.zeros(FEW.worlds, 12))
    assert (env._gait == 1).all()
    for calls, least, most in ((480, 1, FEW.worlds - 1), (720, FEW.worlds, FEW.worlds)):
        env.resume_at(calls)
        for _ in range(15):
            env.moves.heading.copy_(env._heading)
            env.step(torch.zeros(FEW.worlds, 12))
        assert least <= (env._gait < 0.2).sum() <= most


def test_worlds_have_their_own_ratio_of_friction(description):
    wide = dataclasses.replace(UNDISTURBED, friction_ratio=(1.0, 100.0))
    env = make(description, worlds=40, quiet_share=0.5, disturbances=wide)
    ratio = env.worlds._stiffer.numpy() ** -2.0
    assert ratio.min() < 4 < 25 < ratio.max() <= 100.0 + 1e-3
    assert np.ptp(ratio[env.worlds.quiet.numpy()]) > 10


def test_a_robot_that_should_rest_gains_nothing_by_turning_away_so_that_its_clock_starts(upright):
    env = upright(rewards=only(gait=1.0), still_share=1.0, quiet_share=1.0)  # a quiet one never topples
    env.moves._left.fill_(100.0)
    gained = {}
    for away in (0.0, 1.0):
        env._reset(torch.ones(FEW.worlds, dtype=torch.bool))
        torch.manual_seed(0)
        for _ in range(4):
            env.moves._since.fill_(SETTLES + 1.0)
            env.moves.heading.copy_(env._heading + away)
            env.step(torch.zeros(FEW.worlds, 12))
        assert bool((env._gait > 0).all()) == (away > 0)
        terms = env._log["reward/gait"]
        planted = (env._load.amin(-1) / BEARS).clamp(0.0, 1.0)
        gained[away] = float(terms), float(planted.mean())
    for reward, planted in gained.values():
        assert reward <= planted + 1e-6
    assert gained[0.0][0] > 0.2

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimic.config.play import NOMINAL, Randomisation, RunSettings
from mimic.control.loop import run_policy
from mimic.control.plant import damping_command
from mimic.errors import ConfigError, PlantError
from mimic.geometry import heading_from_quat
from mimic.metrics import stand_up_time, standing
from mimic.policy.runtime import load_policy
from mimic.records import CommandTrack, JointCommand, JointSamples, RobotState, Tick
from mimic.robot.description import with_timestep
from mimic.simulation.plant import SimulatedPlant

PUSHED = dataclasses.replace(Randomisation(), push_interval=0.1)


def samples(tick: Tick) -> JointSamples:
    """Return the samples of a simulated step."""
    assert tick.samples is not None
    return tick.samples


def command(description, q: np.ndarray, **changes: Any) -> JointCommand:
    zeros = np.zeros(12)
    values: dict[str, Any] = {
        "q_des": q,
        "dq_des": zeros,
        "kp": description.kp,
        "kd": description.kd,
        "tau_ff": zeros,
    }
    return JointCommand(**(values | changes))


def play(plant: SimulatedPlant, ticks: int = 40) -> list[RobotState]:
    """Random motions, the same each time."""
    rng = np.random.default_rng(0)
    d = plant.description
    states = [plant.start()]
    for _ in range(ticks):
        q_des = d.poses["lie"] + rng.uniform(-0.4, 0.2, 12)
        states.append(plant.step(command(d, q_des)).state)
    return states


def same(one: list[RobotState], other: list[RobotState]) -> bool:
    names = [f.name for f in dataclasses.fields(RobotState)]
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for a, b in zip(one, other, strict=True) for n in names)


@pytest.mark.parametrize("ranges", [NOMINAL, PUSHED], ids=["nominal", "randomised"])
def test_the_same_seed_gives_the_same_motion_to_the_last_bit(ranges, description):
    first, second = (play(SimulatedPlant(description, ranges=ranges, seed=11)) for _ in range(2))
    assert same(first, second)


def test_another_seed_gives_another_robot(description):
    first, second = (play(SimulatedPlant(description, ranges=PUSHED, seed=seed)) for seed in (1, 2))
    assert not same(first, second)


def test_a_robot_drawn_anew_is_the_one_of_that_seed(description):
    plant = SimulatedPlant(description, ranges=PUSHED, seed=1)
    play(plant)
    plant.restart(2)
    assert same(play(plant), play(SimulatedPlant(description, ranges=PUSHED, seed=2)))


def test_recording_the_joints_does_not_change_the_motion(description):
    assert same(play(SimulatedPlant(description, samples=True)), play(SimulatedPlant(description, samples=False)))


@pytest.mark.parametrize("steps", range(14))
def test_a_command_takes_effect_after_exactly_its_delay(steps, description):
    seconds = steps * description.timestep
    ranges = dataclasses.replace(NOMINAL, delay=(seconds, seconds))
    lie = description.poses["lie"]

    def torques(then: np.ndarray) -> np.ndarray:
        plant = SimulatedPlant(description, ranges=ranges)
        plant.start()
        before = [plant.step(command(description, lie)) for _ in range(5)]
        after = [plant.step(command(description, then)) for _ in range(5)]
        assert len(before) == 5
        return np.concatenate([samples(tick).tau for tick in after])

    differs = np.any(torques(lie) != torques(lie + 0.1), axis=1)
    assert np.argmax(differs) == steps
    assert differs[steps:].all()


def test_joints_are_sampled_at_each_physics_step(description):
    plant = SimulatedPlant(description)
    plant.start()
    ticks = [plant.step(command(description, description.poses["four"])) for _ in range(5)]
    t = np.concatenate([samples(tick).t for tick in ticks])
    assert np.allclose(t, description.timestep * np.arange(1, 5 * description.decimation + 1))
    for tick in ticks:
        assert np.array_equal(samples(tick).q[-1], tick.state.q)
        assert np.array_equal(samples(tick).dq[-1], tick.state.dq)
        assert np.array_equal(samples(tick).tau[-1], tick.state.tau)
        assert np.array_equal(samples(tick).q_des, np.tile(description.poses["four"], (description.decimation, 1)))


def test_a_lying_robot_rests_on_the_floor(description):
    plant = SimulatedPlant(description)
    state = plant.start()
    for _ in range(50):
        state = plant.step(command(description, description.poses["lie"])).state
    sagged = description.pose_height["lie"] - state.p_WB[2]
    assert 0.0 < sagged < 0.04
    assert np.abs(state.v_WB).max() < 0.02
    assert np.abs(state.dq).max() < 0.1


def test_a_damped_robot_only_brakes(description):
    plant = SimulatedPlant(description)
    plant.start()
    tick = [plant.step(command(description, description.poses["four"])) for _ in range(30)][-1]
    height = tick.state.p_WB[2]
    for _ in range(20):
        tick = plant.step(damping_command(tick.state.q, description.kd[0]))
    moving = np.abs(samples(tick).dq[:-1]) > 1e-2
    assert moving.any()
    assert np.all(np.sign(samples(tick).tau[1:][moving]) == -np.sign(samples(tick).dq[:-1][moving]))
    assert tick.state.p_WB[2] < height - 0.02


def test_stiffness_comes_back_after_damping(description):
    plant = SimulatedPlant(description)
    start = plant.start()
    for _ in range(5):
        plant.step(damping_command(start.q, description.kd[0]))
    ticks = [plant.step(command(description, description.poses["four"])) for _ in range(60)]
    assert np.abs(ticks[-1].state.q - description.poses["four"]).max() < 0.15


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_command_that_is_not_finite_is_refused(bad, description):
    plant = SimulatedPlant(description)
    plant.start()
    q = description.poses["lie"].copy()
    q[3] = bad
    with pytest.raises(PlantError, match="not finite"):
        plant.step(command(description, q))


def test_speeds_are_those_of_the_motion(description):
    """Angular velocity in base axes, the others in world axes; on a robot that does not face along world x."""
    plant = SimulatedPlant(description, ranges=dataclasses.replace(NOMINAL, heading=(1.5, 1.5)))
    states = [plant.start()]
    for tick in range(100):
        sway = 0.3 * np.sin(0.12 * tick + np.arange(12) // 3)
        states.append(plant.step(command(description, description.poses["four"] + sway)).state)
    states = states[40:]
    turns = [Rotation.from_quat(state.quat_WB, scalar_first=True) for state in states]

    def measured(name: str) -> np.ndarray:
        values = np.array([getattr(state, name) for state in states])
        return (values[1:] + values[:-1]) / 2

    turned = np.array([(a.inv() * b).as_rotvec() for a, b in pairwise(turns)])
    for seen, moved in (
        (measured("omega_B"), turned),
        (measured("v_WB"), np.diff([state.p_WB for state in states], axis=0)),
        (measured("dq"), np.diff([state.q for state in states], axis=0)),
    ):
        wrong = np.abs(seen - moved / description.dt).mean()
        assert wrong < 0.25 * np.abs(seen).mean()


@pytest.mark.slow
def test_a_drawn_start_turns_the_robot_and_leaves_its_joints_on_their_stops_at_most(description):
    starts = [SimulatedPlant(description, ranges=Randomisation(), seed=seed).start() for seed in range(20)]
    headings = np.array([heading_from_quat(state.quat_WB) for state in starts])
    assert np.ptp(headings) > np.pi
    assert all(np.all(s.q > description.q_min - 0.03) and np.all(s.q < description.q_max + 0.03) for s in starts)
    assert np.ptp([s.q for s in starts], axis=0).max() > 0.01


def test_it_starts_where_a_robot_without_power_lies(description):
    plant = SimulatedPlant(description)
    lies = plant.start()
    for _ in range(100):
        after = plant.step(command(description, lies.q, kp=np.zeros(12), kd=np.zeros(12))).state
    assert np.abs(after.q - lies.q).max() < 0.05
    assert lies.p_WB[2] < 0.5 * description.pose_height["lie"]


def test_the_shipped_policy_stands_up_and_stays_up(description):
    policy = load_policy(None, description)
    ticks = 150
    neutral = np.array(policy.contract.neutral_toes).reshape(2, 3)
    still = CommandTrack(
        t=policy.contract.dt * np.arange(ticks),
        v=np.zeros((ticks, 2)),
        heading=np.zeros(ticks),
        p_BE=np.tile(neutral, (ticks, 1, 1)),
    )
    settings = RunSettings(stand_up=1.5, blend=0.5, hold_last=0.1)
    runs = [run_policy(SimulatedPlant(description), policy, still, settings) for _ in range(2)]
    log = runs[0].log
    assert runs[0].fell_at is None
    assert stand_up_time(log, description) <= 1.5
    assert log.t[-1] >= 5.0
    assert standing(log, description)[-1]
    for name in ("q", "dq", "tau", "quat_WB", "p_WB", "action", "q_sent", "observation"):
        assert np.array_equal(getattr(log, name), getattr(runs[1].log, name), equal_nan=True), name
    one, other = (run.samples for run in runs)
    assert one is not None
    assert other is not None
    assert np.array_equal(one.tau, other.tau)


@pytest.mark.parametrize("delay", [0.0, 0.015, 0.03])
def test_interpolated_commands_move_linearly_from_one_to_the_next_after_their_delay(description, delay):
    seen = []
    ranges = dataclasses.replace(NOMINAL, delay=(delay, delay))
    plant = SimulatedPlant(description, ranges=ranges, observer=lambda model, data: seen.append(data.ctrl[1]))
    q, dt = plant.start().q, description.dt
    zeros = np.zeros(12)
    for target in (0.0, 0.1, -0.1, -0.1, -0.1):
        q_des = q + target
        gains: dict[str, Any] = {"kp": description.kp, "kd": description.kd}
        plant.step(JointCommand(q_des=q_des, dq_des=zeros, tau_ff=zeros, ramp=dt, **gains))
    t = description.timestep * np.arange(1, len(seen) + 1) - delay
    expected = q[1] + np.interp(t, dt * np.arange(6), [0.0, 0.0, 0.1, -0.1, -0.1, -0.1])
    np.testing.assert_allclose(seen, expected, atol=1e-9)


def test_commands_act_at_once_where_interpolation_is_not_asked_for(description):
    seen = []
    plant = SimulatedPlant(description, observer=lambda model, data: seen.append(data.ctrl[1]))
    q, zeros = plant.start().q, np.zeros(12)
    for target in (0.0, 0.1, 0.1):
        gains: dict[str, Any] = {"kp": description.kp, "kd": description.kd}
        plant.step(JointCommand(q_des=q + target, dq_des=zeros, tau_ff=zeros, **gains))
    assert set(np.round(seen - q[1], 9)) == {0.0, 0.1}


def test_an_interpolation_over_another_time_than_the_control_step_is_refused(description):
    plant = SimulatedPlant(description)
    command = dataclasses.replace(damping_command(plant.start().q, 5.0), ramp=0.01)
    with pytest.raises(PlantError, match=r"interpolates commands over 0\.02 s"):
        plant.step(command)


def test_a_control_step_is_a_whole_number_of_physics_steps(description):
    assert with_timestep(description, 0.001).dt == pytest.approx(description.dt)
    with pytest.raises(ConfigError, match="must be a multiple"):
        SimulatedPlant(description, timestep=0.003)


def test_a_delay_is_the_same_time_at_any_timestep(description):
    delayed = dataclasses.replace(NOMINAL, delay=(0.03, 0.03))
    steps = [SimulatedPlant(description, ranges=delayed, timestep=h).variation.delay_steps for h in (0.005, 0.001)]
    assert steps == [6, 30]

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.config.play import NOMINAL
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.emulator.body import AMBIENT, EmulatedBody
from mimic.emulator.faults import miswiring, parse_fault
from mimic.emulator.motor import FREE, HOT, Drive
from mimic.errors import ConfigError
from mimic.records import JOINTS, JointCommand
from mimic.simulation.plant import SimulatedPlant

KNEE = JOINTS.index("FL_knee")


def body(description, **options) -> EmulatedBody:
    made = EmulatedBody(description, **options)
    made.release()
    return made


def hold(made: EmulatedBody, q: np.ndarray, kp: float = 30.0, kd: float = 3.0, **more: float) -> None:
    for i in range(12):
        made.drive(i, Drive(kp=kp, kd=kd, q=float(q[i]), **more), made.time)


def joints(made: EmulatedBody) -> np.ndarray:
    return np.array([made.joint(i, made.time) for i in range(12)])


def effect(name: str, joint: str | None = None, **values: float) -> EffectSet:
    parts = {key: np.array([value]) for key, value in values.items()}
    return EffectSet((EffectValues(name=name, joints=(joint,) if joint else (), values=parts),))


def test_it_moves_as_the_simulated_plant_does(description):
    """Commands 20 ms apart, half a physics step later here: the plant applies a target from the middle of a step on."""
    ranges = dataclasses.replace(NOMINAL, delay=(0.0, 0.0))
    plant = SimulatedPlant(description, ranges=ranges, effects=EffectSet(()), timestep=0.0025)
    made = body(description)
    plant.start()
    lie, four, none = description.poses["lie"], description.poses["four"], np.zeros(12)
    gains = {"dq_des": none, "kp": np.full(12, 30.0), "kd": np.full(12, 3.0), "tau_ff": none}
    heights = []
    for tick in range(60):
        q_des = lie + min(tick / 30, 1.0) * (four - lie)
        state = plant.step(JointCommand(q_des=q_des, **gains)).state
        hold(made, q_des)
        made.advance((tick + 1) * 0.02)
        assert np.abs(joints(made)[:, 0] - state.q).max() < 0.02
        heights.append(made.data.qpos[2] - state.p_WB[2])
    assert np.abs(heights).max() < 0.003
    assert made.data.qpos[2] > 0.2


def test_until_it_is_released_somebody_keeps_its_legs_folded(description):
    made = EmulatedBody(description, placement=0.1, folded=True, seed=3)
    before = joints(made)[:, 0]
    made.advance(1.0)
    assert np.array_equal(joints(made)[:, 0], before)
    assert 0.03 < np.abs(before - description.poses["lie"]).max() <= 0.11
    made.release()
    made.advance(2.0)
    assert np.abs(joints(made)[:, 0] - before).max() > 0.2, "free motors do not carry it"
    assert made.data.qpos[2] < 0.07


def test_nobody_keeps_it_from_lying_as_without_power(description):
    made, plant = body(description), SimulatedPlant(description)
    assert made.data.qpos[2:] == pytest.approx(np.r_[plant.start().p_WB[2], plant.data.qpos[3:]], abs=0.05)
    before = joints(made)[:, 0]
    made.advance(1.0)
    assert np.abs(joints(made)[:, 0] - before).max() < 0.05


def test_a_miswired_joint_is_commanded_and_read_where_it_is_not(description):
    made, right = body(description), body(description)
    order, sign = miswiring([parse_fault("legs_swapped:FL_hip"), parse_fault("sign_wrong:RL_abad")])
    made.miswire(order, sign, description.poses["lie"])
    swapped = description.poses["lie"] + 0.1 * np.arange(12) / 12
    really = swapped[order]
    really[6] = 2 * description.poses["lie"][6] - swapped[6]
    for _ in range(40):
        hold(made, swapped, kp=100.0, kd=5.0)
        hold(right, really, kp=100.0, kd=5.0)
        for one in (made, right):
            one.advance(one.time + 0.02)
    assert np.allclose(made.data.qpos, right.data.qpos, atol=1e-9)
    assert joints(made)[:6, 0] == pytest.approx(joints(right)[order[:6], 0])
    assert joints(made)[6, 0] - description.poses["lie"][6] == pytest.approx(
        description.poses["lie"][6] - joints(right)[6, 0]
    )


def test_suspended_its_trunk_stays_and_its_free_legs_hang(description):
    made = body(description, suspended=True)
    made.advance(4.0)
    q = joints(made)[:, 0].reshape(4, 3)
    assert np.allclose(np.abs(q[:, 0]), description.q_max[0], atol=0.01), "thighs swing in under their axis"
    assert np.all(q[:, 2] > -1.5), "knees fall open"
    quat, omega = made.base()
    assert np.allclose(quat, [1, 0, 0, 0])
    assert not omega.any()


def test_between_steps_a_joint_is_where_its_velocity_takes_it(description):
    made = body(description, suspended=True)
    made.advance(0.1)
    q, dq, _ = made.joint(KNEE, made.time)
    assert abs(dq) > 0.1
    assert made.joint(KNEE, made.time + 0.001)[0] == pytest.approx(q + 0.001 * dq)


def test_damping_only_brakes_and_a_feed_forward_torque_is_given(description):
    made = body(description, suspended=True)
    made.drive(KNEE, Drive(kd=5.0), 0.0)
    free = body(description, suspended=True)
    for m in (made, free):
        m.advance(0.15)
    assert abs(made.joint(KNEE, made.time)[1]) < 0.3 * abs(free.joint(KNEE, free.time)[1])
    made.drive(KNEE, Drive(tau=1.5), made.time)
    made.advance(made.time + 0.01)
    assert made.joint(KNEE, made.time)[2] == pytest.approx(1.5)


def test_no_more_torque_than_the_limit_is_given(description):
    made = body(description, suspended=True)
    made.drive(KNEE, Drive(tau=9.0, limit=2.0), 0.0)
    made.advance(0.01)
    assert made.joint(KNEE, made.time)[2] == pytest.approx(2.0)
    made.drive(KNEE, Drive(tau=9.0), made.time)
    made.advance(made.time + 0.005)
    assert made.joint(KNEE, made.time)[2] == pytest.approx(9.0)


def test_a_desired_velocity_is_followed(description):
    made = body(description, suspended=True)
    hold(made, description.poses["four"])
    made.advance(0.5)
    made.drive(KNEE, Drive(kd=5.0, dq=-1.0), made.time)
    made.advance(made.time + 0.3)
    assert made.joint(KNEE, made.time)[1] == pytest.approx(-1.0, abs=0.4)


def test_a_delay_is_that_of_the_effect(description):
    """A torque that is asked for at 0.1 s is given from 0.1 s plus the delay on."""
    for seconds in (0.0, 0.02):
        made = body(description, suspended=True, effects=effect("delay", time=seconds))
        made.drive(KNEE, Drive(tau=1.0), 0.1)
        made.advance(0.1 + seconds - 0.001)
        assert made.joint(KNEE, made.time)[2] == 0.0
        made.advance(0.1 + seconds + 0.005)
        assert made.joint(KNEE, made.time)[2] == pytest.approx(1.0)


def test_a_command_that_comes_within_a_step_acts_for_what_is_left_of_it(description):
    made = body(description, suspended=True)
    made.advance(0.1)
    made.drive(KNEE, Drive(tau=1.0), 0.101)
    made.drive(KNEE, Drive(tau=3.0), 0.102)
    made.advance(0.1025)
    assert made.joint(KNEE, made.time)[2] == pytest.approx((1.0 * 0.0 + 1.0 * 1.0 + 0.5 * 3.0) / 2.5)
    made.advance(0.105)
    assert made.joint(KNEE, made.time)[2] == pytest.approx(3.0)


def test_hidden_friction_slows_a_falling_leg(description):
    speeds = []
    for level in (0.05, 0.4):
        made = body(description, suspended=True, effects=effect("coulomb", "FL_knee", level=level))
        made.advance(0.1)
        speeds.append(abs(made.joint(KNEE, made.time)[1]))
    assert speeds[1] < 0.7 * speeds[0]


def test_an_encoder_that_is_off_reads_off(description):
    made = body(description, effects=effect("encoder_offset", "FL_knee", angle=0.05))
    plain = body(description)
    assert made.joint(KNEE, 0.0)[0] - plain.joint(KNEE, 0.0)[0] == pytest.approx(0.05)


def test_a_tilted_stand_tilts_the_trunk_and_is_of_suspended_robots_only(description):
    tilt = effect("base_tilt", roll=0.0, pitch=0.1)
    quat, _ = body(description, suspended=True, effects=tilt).base()
    assert np.allclose(quat, [np.cos(0.05), 0, np.sin(0.05), 0])
    with pytest.raises(ConfigError, match="base_tilt"):
        EmulatedBody(description, effects=tilt)


def test_work_makes_a_motor_warm_as_fast_as_the_maker_says(description):
    """12 N m may last 28 s by the manual; the fitted model says 33 s at most."""
    made = body(description, suspended=True)
    assert made.temperature(KNEE) == AMBIENT
    made.drive(KNEE, Drive(tau=-12.0), 0.0)  # against the stop
    made.advance(20.0)
    assert AMBIENT + 20 < made.temperature(KNEE) < HOT
    made.advance(36.0)
    assert made.temperature(KNEE) > HOT
    assert made.temperature(0) < AMBIENT + 10


def test_the_same_seed_gives_the_same_motion(description):
    def play(seed: int) -> np.ndarray:
        made = body(description, placement=0.1, seed=seed, effects=effect("delay_jitter", spread=0.02))
        rows = []
        for tick in range(20):
            hold(made, description.poses["lie"] + 0.1 * np.sin(tick + np.arange(12)))
            made.advance((tick + 1) * 0.02)
            rows.append(joints(made))
        return np.array(rows)

    assert np.array_equal(play(1), play(1))
    assert not np.array_equal(play(1), play(2))


def test_a_free_motor_gives_no_torque(description):
    made = body(description, suspended=True)
    hold(made, description.poses["four"])
    made.advance(0.2)
    assert np.abs(joints(made)[:, 2]).max() > 0.1
    for i in range(12):
        made.drive(i, FREE, made.time)
    made.advance(made.time + 0.01)
    assert not joints(made)[:, 2].any()

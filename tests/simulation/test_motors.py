"""The simulated robot with effects of a calibration, and that it is untouched without them."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from mimic.config.play import NOMINAL, Randomisation
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.robot_model import command_in_effect, load_model
from mimic.errors import ConfigError
from mimic.records import JOINTS, JointCommand, RobotState
from mimic.simulation.plant import SimulatedPlant

FINE = 0.001


def joints(name: str, **values: float) -> EffectValues:
    return EffectValues(name=name, joints=JOINTS, values=values)


def machine(name: str, **values: float) -> EffectValues:
    return EffectValues(name=name, values=values)


def command(description, q: np.ndarray, gain: float = 1.0, ramp: float = 0.0) -> JointCommand:
    zeros = np.zeros(12)
    return JointCommand(q_des=q, dq_des=zeros, kp=gain * description.kp, kd=description.kd, tau_ff=zeros, ramp=ramp)


def play(plant: SimulatedPlant, ticks: int = 25, *, hanging: bool = False, ramp: float = 0.0) -> list[RobotState]:
    """Random motions, the same each time; hanging is without ground or weight."""
    rng, d = np.random.default_rng(0), plant.description
    states = [plant.start()]
    if hanging:
        plant.data.qpos[2] = 2.0
        plant.model.opt.gravity[:] = 0.0
    for _ in range(ticks):
        states.append(plant.step(command(d, d.poses["lie"] + rng.uniform(-0.4, 0.2, 12), ramp=ramp)).state)
    return states


def apart(one: list[RobotState], other: list[RobotState]) -> float:
    return max(float(np.abs(a.q - b.q).max()) for a, b in zip(one, other, strict=True))


def test_without_effects_the_robot_is_mujocos_own_motor_to_the_last_bit(description):
    """Stepped by hand: the model as it is loaded, the delayed commands, and nothing else."""
    states = play(SimulatedPlant(description))
    model = load_model(description, visuals=False)
    model.geom_friction[model.geom("floor").id, 0] = 1.0
    data = mujoco.MjData(model)
    data.qpos[:3] = states[0].p_WB
    data.qpos[3:7], data.qpos[7:] = states[0].quat_WB, states[0].q
    mujoco.mj_forward(model, data)
    rng, d = np.random.default_rng(0), description
    delay = round(0.015 / d.timestep)
    commands = [states[0].q] * 3
    for state in states[1:]:
        commands = [d.poses["lie"] + rng.uniform(-0.4, 0.2, 12), *commands[:2]]
        for k in range(d.decimation):
            data.ctrl[:] = command_in_effect(k, d.decimation, delay, commands, np.where, interpolate=False)
            mujoco.mj_step(model, data)
        assert np.array_equal(state.q, data.qpos[7:])
        assert np.array_equal(state.tau, data.actuator_force)
        assert np.array_equal(state.p_WB, data.qpos[:3])


@pytest.mark.parametrize("moving", [False, True])
def test_an_empty_set_of_effects_is_the_same_robot_at_short_steps(moving, description):
    ramp = description.dt if moving else 0.0
    native = play(SimulatedPlant(description, timestep=FINE), hanging=True, ramp=ramp)
    law = play(SimulatedPlant(description, timestep=FINE, effects=EffectSet()), hanging=True, ramp=ramp)
    assert np.ptp([s.q for s in native], axis=0).max() > 0.1
    assert apart(native, law) < 0.01


def test_effects_run_in_short_steps_of_the_same_control_step(description):
    plant = SimulatedPlant(description, effects=EffectSet())
    assert (plant.description.timestep, plant.description.dt) == (0.0025, description.dt)
    assert plant.model.opt.timestep == 0.0025


def test_encoders_show_their_offset_and_hold_the_joints_off_by_it(description):
    offset = EffectSet((joints("encoder_offset", angle=0.1),))
    plain, shifted = (SimulatedPlant(description, effects=e) for e in (EffectSet(), offset))
    start, seen = plain.start(), shifted.start()
    assert seen.q == pytest.approx(start.q + 0.1)
    assert shifted.data.qpos[7:] == pytest.approx(start.q)
    hold = command(description, seen.q)
    for plant in (plain, shifted):
        plant.data.qpos[2], plant.model.opt.gravity[:] = 2.0, 0.0
    for _ in range(10):
        shifted.step(hold)
    assert shifted.data.qpos[7:] == pytest.approx(start.q, abs=2e-3)


@pytest.mark.parametrize("milliseconds", [7.5, 15.0, 45.0])
def test_a_calibrated_delay_takes_the_place_of_the_drawn_one(milliseconds, description):
    effects = EffectSet((machine("delay", time=milliseconds / 1e3),))
    plant = SimulatedPlant(description, effects=effects, ranges=dataclasses.replace(NOMINAL, delay=(0.03, 0.03)))
    lie = plant.start().q
    moved = command(description, lie + 0.2)
    samples = [plant.step(moved).samples for _ in range(4)]
    t, tau = np.concatenate([s.t for s in samples]), np.concatenate([s.tau for s in samples])
    begun = t[np.abs(np.diff(tau, axis=0, prepend=tau[:1])).max(axis=1) > 2.5]
    assert begun[0] - 0.0025 == pytest.approx(milliseconds / 1e3, abs=0.0025)


def test_one_joint_may_act_later_than_the_others(description):
    delayed = EffectSet((EffectValues(name="joint_delay", joints=("FL_knee",), values={"time": 0.02}),))
    plant = SimulatedPlant(description, effects=delayed)
    lie = plant.start().q
    tau = plant.step(command(description, lie + 0.2)).state.tau
    assert tau[1] > 2.0
    assert abs(tau[2]) < 1.5


def test_lost_and_late_commands_are_those_of_the_seed(description):
    effects = EffectSet((machine("lost_commands", share=0.4), machine("delay_jitter", spread=0.03)))
    first, again, other = (play(SimulatedPlant(description, effects=effects, seed=s)) for s in (1, 1, 2))
    assert apart(first, again) == 0.0
    assert apart(first, other) > 1e-3
    plain = play(SimulatedPlant(description, effects=EffectSet(), seed=1))
    assert apart(first, plain) > 1e-2


def test_declared_friction_wins_and_gain_factors_multiply(description):
    declared = EffectSet((joints("coulomb", level=0.2), joints("viscous", coefficient=0.11)))
    plant = SimulatedPlant(description, effects=declared, ranges=Randomisation(), seed=4)
    state = plant.start()
    plant.step(command(plant.description, state.q))
    assert plant.model.dof_frictionloss[6:] == pytest.approx(0.2)
    assert plant.model.dof_damping[6:] == pytest.approx(0.11)
    damping = (plant.model.dof_armature[6:] - description.armature) / plant.description.timestep
    assert damping == pytest.approx(0.5 * description.kd * plant.variation.kd)
    drawn = SimulatedPlant(description, effects=EffectSet(), ranges=Randomisation(), seed=4)
    drawn.step(command(plant.description, drawn.start().q))
    assert drawn.model.dof_frictionloss[6:] == pytest.approx(0.05 * drawn.variation.dry_friction)


def test_a_command_with_other_gains_is_obeyed(description):
    moved = []
    for factor, gain in ((0.5, 0.4), (0.2, 1.0), (0.5, 1.0)):
        plant = SimulatedPlant(description, effects=EffectSet((joints("gains", kp=factor, kd=1.0),)))
        moved.append(plant.step(command(description, plant.start().q + 0.1, gain=gain)).state.q)
    assert moved[0] == pytest.approx(moved[1], abs=1e-9)
    assert np.abs(moved[0] - moved[2]).max() > 3e-4


def test_a_payload_is_in_every_robot_that_is_drawn(description):
    loaded = EffectSet((EffectValues(name="payload", joints=("FL_knee",), values={"mass": 0.3}),))
    plant = SimulatedPlant(description, effects=loaded)
    nominal = load_model(description, visuals=False).body_mass.sum()
    for seed in range(3):
        plant.restart(seed)
        assert plant.model.body_mass.sum() == pytest.approx(nominal + 0.3)


def test_a_robot_drawn_anew_is_the_one_of_that_seed(description):
    effects = EffectSet(
        (joints("backlash", gap=0.02), joints("torque_lag", time=0.005), machine("supply_sag", drop=0.001))
    )
    plant = SimulatedPlant(description, effects=effects, ranges=Randomisation(), seed=1)
    play(plant)
    plant.restart(2)
    assert apart(play(plant), play(SimulatedPlant(description, effects=effects, ranges=Randomisation(), seed=2))) == 0.0


def test_a_tilted_stand_is_refused_on_the_feet(description):
    with pytest.raises(ConfigError, match="base_tilt"):
        SimulatedPlant(description, effects=EffectSet((machine("base_tilt", roll=0.1),)))

"""What a model foretells of a log, on a pendulum whose effects are known."""

from dataclasses import replace

import numpy as np
import pytest

from mimic.config.sysid import LogSettings
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, as_logged, read_machine
from mimic.errors import ConfigError
from mimic.sysid.predict import predict, simulate_log

PENDULUM = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.05" frictionloss="0.05"/>
<inertial pos="0 0 -0.15" mass="0.8" diaginertia="0.006 0.006 0.0002"/></body></worldbody></mujoco>"""
NOISE = LogSettings(noise=0.0003, resolution=0.0, rate_hz=100.0, timestep=0.0005)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> MachineModel:
    path = tmp_path_factory.mktemp("model") / "pendulum.xml"
    path.write_text(PENDULUM)
    return read_machine(path, {"kp": 15.0, "kd": 0.6})


def having(name: str, **values: float) -> EffectSet:
    rows = {key: np.array([value]) for key, value in values.items()}
    joints = () if name in ("delay", "delay_jitter") else ("hinge",)
    return EffectSet((EffectValues(name=name, joints=joints, values=rows),))


def logged(machine: MachineModel, effects: EffectSet, seconds: float = 5.0):
    t = np.arange(0.0, seconds, 0.02)
    wave = 0.5 * np.sin(2 * np.pi * 0.4 * t) + 0.3 * np.sin(2 * np.pi * 1.7 * t + 1.0)
    return simulate_log(machine, t, (np.minimum(t, 1.0) * wave)[:, None], effects, NOISE)


def rms(residual: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(residual**2)))


@pytest.mark.parametrize("whole", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_model_with_the_effects_of_the_machine_predicts_it_to_the_noise(pendulum, whole):
    spring = having("spring", stiffness=2.0)
    log = logged(pendulum, spring)
    assert rms(predict(log, pendulum, EffectSet(), whole=whole)) > 0.02
    assert rms(predict(log, pendulum, spring, whole=whole)) == pytest.approx(0.0003, rel=0.15)


@pytest.mark.slow
def test_pieces_begin_where_the_machine_was_and_the_whole_where_it_began(pendulum):
    log = logged(pendulum, EffectSet())
    assert np.isnan(predict(log, pendulum, EffectSet())[:30]).all()  # settling
    assert np.isfinite(predict(log, pendulum, EffectSet(), whole=True)).all()


def test_a_slow_filter_on_the_velocity_lets_a_step_ring(pendulum):
    t = np.arange(0.0, 1.5, 0.01)
    target = np.where(t > 0.5, 0.4, 0.0)[:, None]
    lag = having("velocity_lag", time=0.04)
    logs = [simulate_log(pendulum, t, target, effects, NOISE) for effects in (EffectSet(), lag)]
    plain, ringing = (np.abs(log.q[60:] - log.q[-1]).max() for log in logs)
    assert ringing > plain + 0.02


@pytest.mark.slow
def test_jitter_is_predicted_as_late_as_it_is_on_the_average(pendulum):
    jitter = having("delay_jitter", spread=0.01)
    log = logged(pendulum, jitter)
    late, mean = (predict(log, pendulum, e) for e in (jitter, having("delay", time=0.005)))
    np.testing.assert_allclose(late, mean, atol=2e-4, equal_nan=True)
    assert rms(late) < 0.5 * rms(predict(log, pendulum, EffectSet()))


def test_a_joint_that_the_machine_lacks_is_reported(pendulum):
    elsewhere = EffectSet((EffectValues(name="spring", joints=("elbow",), values={"stiffness": np.array([2.0])}),))
    with pytest.raises(ConfigError, match="names joint 'elbow'"):
        predict(logged(pendulum, EffectSet(), 2.0), pendulum, elsewhere)


def test_a_voltage_drive_is_followed_with_its_register_gain_and_supply(pendulum, tmp_path):
    """Half of the supply moves it less, and a log that says so is predicted as well."""
    notes = {"drive": "voltage", "gain": 3.0, "voltage": 12.0, "kt": 1.0, "resistance": 4.0}
    (tmp_path / "servo.xml").write_text(PENDULUM)
    servo = read_machine(tmp_path / "servo.xml", notes)
    log = logged(servo, EffectSet())
    assert {k: log.metadata[k] for k in ("drive", "voltage")} == {"drive": "voltage", "voltage": 12.0}
    again = as_logged(pendulum, log.metadata)
    assert rms(predict(log, again, EffectSet(), whole=True)) == pytest.approx(0.0003, rel=0.15)
    low = replace(log, extra={"voltage": np.full(len(log.t), 6.0)})
    weak = as_logged(pendulum, {**log.metadata, "voltage": 6.0})
    apart = predict(low, again, EffectSet(), whole=True)
    assert rms(apart) > 0.01
    less = replace(log, metadata={**log.metadata, "voltage": 6.0})
    np.testing.assert_allclose(apart, predict(less, weak, EffectSet(), whole=True), atol=1e-6)


SHAFT = """<mujoco><worldbody><body><inertial pos="0 0 0" mass="1" diaginertia="{0} {0} {0}"/>
<joint name="shaft" axis="0 0 1"/></body></worldbody></mujoco>"""
SERVO = {"drive": "voltage", "gain": 5.0, "voltage": 10.0, "kt": 0.4, "resistance": 4.0}
"""1 N m at rest with full duty, 25 rad/s without a load."""
NOTHING = EffectSet()


def driven(folder, target, inertia, effects=NOTHING, seconds=0.05):
    """Return torque and speed of a shaft that a voltage drive turns to a target."""
    (folder / "shaft.xml").write_text(SHAFT.format(inertia))
    t = np.arange(0.0, seconds, 0.02)
    exact = LogSettings(noise=0.0, resolution=0.0, torque_noise=0.0, timestep=0.0025)
    log = simulate_log(read_machine(folder / "shaft.xml", SERVO), t, np.full((len(t), 1), target), effects, exact)
    return log.tau[1:, 0], np.diff(log.q[:, 0]) * log.rate


def test_a_voltage_drive_gives_its_full_duty_and_no_more(tmp_path):
    assert driven(tmp_path, 0.1, 1e5)[0][0] == pytest.approx(0.5)
    assert driven(tmp_path, 3.0, 1e5)[0][0] == pytest.approx(1.0)


def test_a_voltage_drive_at_full_duty_runs_up_to_the_supply_over_its_constant(tmp_path):
    assert driven(tmp_path, 1e4, 0.02, seconds=5.0)[1][-1] == pytest.approx(25.0, rel=1e-3)


def test_another_motor_constant_moves_torque_and_speed(tmp_path):
    values = {"kt": np.array([0.2]), "resistance": np.array([4.0])}
    other = EffectSet((EffectValues(name="motor", joints=("shaft",), values=values),))
    assert driven(tmp_path, 1e5, 1e5, other)[0][0] == pytest.approx(0.5)
    assert driven(tmp_path, 1e5, 0.02, other, 12.0)[1][-1] == pytest.approx(50.0, rel=1e-2)

"""What a replay reads off the simulation, and where its segments begin."""

from copy import copy
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mimic.config.sysid import LogSettings
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.io.joint_log import JointLog
from mimic.sysid.fit.replay import Replay
from mimic.sysid.predict import simulate_log

PENDULUM = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8"/></body></worldbody>
<actuator><position joint="hinge" kp="30" kv="1.5"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> MachineModel:
    path = tmp_path_factory.mktemp("model") / "robot.xml"
    path.write_text(PENDULUM)
    return read_machine(path)


@pytest.fixture(scope="module")
def swing(pendulum: MachineModel) -> JointLog:
    """Return 8 s of a sine wave of 4 rad/s, without noise."""
    t = np.arange(0.0, 8.0, 0.02)
    target = 0.8 * np.sin(5.0 * t)[:, None]
    return simulate_log(
        pendulum, t, target, EffectSet(), LogSettings(noise=0.0, resolution=0.0, timestep=0.0005, rate_hz=200.0)
    )


@pytest.mark.parametrize("timestep", [0.0025, 0.0021, 0.0017])
def test_readings_between_two_steps_are_predicted_at_their_own_time(
    pendulum: MachineModel, swing: JointLog, timestep: float
) -> None:
    """At 4 rad/s, a reading taken for one a step later would be off by 8 mrad."""
    replay = Replay(pendulum, swing, timestep=timestep, segment=2.0, threads=1)
    residual = replay.run({("delay", "time"): np.zeros((1, 1))}, 1).residual[0]
    assert np.nanmax(np.abs(residual)) < 5e-4


def test_threads_change_nothing(pendulum: MachineModel, swing: JointLog) -> None:
    delays = {("delay", "time"): np.linspace(0.0, 0.02, 200)[:, None]}
    one, two = (
        Replay(pendulum, swing, timestep=0.005, segment=2.0, threads=n, torque=True).run(delays, 200) for n in (1, 2)
    )
    assert np.isfinite(one.residual).any()
    assert np.ptp(one.residual[:, 300]) > 0.01
    np.testing.assert_array_equal(one.residual, two.residual)
    np.testing.assert_array_equal(one.torque_residual, two.torque_residual)


def test_a_joint_that_swings_freely_is_followed_from_before_it_was_let_go(pendulum: MachineModel) -> None:
    """Begun at noisy readings on its way, the swing would be off by far more than the readings are."""
    t = np.arange(0.0, 8.0, 0.02)
    held = LogSettings(noise=0.0, resolution=0.0, timestep=0.0005, rate_hz=200.0)
    log = simulate_log(pendulum, t, np.where(t > 2.0, 1.0, 0.0)[:, None], EffectSet(), held)
    on = (log.t - log.t[0] < 4.0).astype(float)
    none = {("delay", "time"): np.zeros((1, 1))}
    let_go = replace(log, extra={**log.extra, "enabled": on})
    free = Replay(pendulum, let_go, timestep=0.0025, segment=100.0, threads=1).run(none, 1).residual[0]
    swing = replace(let_go, q=let_go.q - np.nan_to_num(free))
    assert np.ptp(swing.q[on == 0.0]) > 0.5
    noisy = replace(swing, q=swing.q + 0.01 * np.random.default_rng(0).standard_normal(swing.q.shape))
    cut = Replay(pendulum, noisy, timestep=0.0025, segment=1.0, threads=1).run(none, 1).residual[0]
    left = np.nan_to_num(cut)[on == 0.0] - (noisy.q - swing.q)[on == 0.0]
    assert np.abs(left).max() < 0.02


@pytest.mark.slow
def test_segments_begin_as_warm_as_the_motors_were(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(PENDULUM)
    machine = read_machine(tmp_path / "robot.xml")
    t = np.arange(0.0, 12.0, 0.02)
    hot = {("kt_heat", "loss"): np.array([[0.3]]), ("kt_heat", "time"): np.array([[6.0]])}
    heat = EffectSet(
        (EffectValues(name="kt_heat", joints=("hinge",), values={"loss": np.array([0.3]), "time": np.array([6.0])}),)
    )
    exact = LogSettings(noise=0.0, torque_noise=0.0, resolution=0.0, timestep=0.001)
    log = simulate_log(machine, t, 0.8 * np.sin(9.0 * t)[:, None], heat, exact)
    cut = Replay(machine, log, timestep=0.0025, segment=3.0, threads=1)
    cold = np.nanstd(cut.run(hot, 1).residual)
    warm = np.nanstd(cut.with_heat(log.tau).run(hot, 1).residual)
    whole = np.nanstd(Replay(machine, log, timestep=0.0025, segment=60.0, threads=1).run(hot, 1).residual)
    assert warm < 1.3 * whole
    assert cold > 3 * whole


@pytest.mark.slow
def test_the_heat_of_short_peaks_is_that_between_readings_and_not_at_them(tmp_path: Path) -> None:
    """Jumps of the target ask for a peak of a few milliseconds, which readings 20 ms apart see whole or not at all."""
    (tmp_path / "robot.xml").write_text(PENDULUM)
    machine = read_machine(tmp_path / "robot.xml")
    t = np.arange(0.0, 6.0, 0.02)
    target = np.where(np.arange(len(t)) // 5 % 2, 0.2, -0.2)[:, None]
    log = JointLog(joints=machine.joints, t=t, q=np.zeros((len(t), 1)), q_des=target)
    late = {("delay", "time"): np.zeros((1, 1))}
    heat = Replay(machine, log, timestep=0.0005, threads=1).mean_square_torque(late)
    often = np.arange(0.0, 5.98, 0.0005)
    rows = np.searchsorted(t, often + 1e-9, side="right") - 1
    dense = JointLog(joints=machine.joints, t=often, q=np.zeros((len(often), 1)), q_des=target[rows])
    truth = Replay(machine, dense, timestep=0.00025, threads=1).mean_square_torque(late)
    assert heat.shape == (len(t), 1)
    assert heat[t > 1.0].mean() == pytest.approx(truth[often > 1.0].mean(), rel=0.03)
    assert heat.max() < 0.7 * truth.max()


def test_a_simulation_that_blows_up_is_not_heard(tmp_path: Path, capfd) -> None:
    (tmp_path / "robot.xml").write_text(PENDULUM)
    machine = read_machine(tmp_path / "robot.xml")
    t = np.arange(0.0, 3.0, 0.02)
    log = JointLog(joints=machine.joints, t=t, q=np.zeros((len(t), 1)), q_des=0.1 * np.sin(t)[:, None])
    replay = Replay(machine, log, timestep=0.0025, segment=1.0)
    moment = {("spring", "stiffness"): np.zeros((2, 1)), ("spring", "moment"): np.array([[0.0], [1e14]])}
    residual = replay.run(moment, 2).residual[:, replay.counts]
    assert np.isfinite(residual[0]).all()
    assert (residual[1] == 0.0).all()  # MuJoCo begins again at zero, at every step
    assert capfd.readouterr().err == ""


def test_readings_within_one_step_have_the_same_mean_torque(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(PENDULUM)
    machine = read_machine(tmp_path / "robot.xml")
    t = np.arange(0.0, 2.0, 0.02)
    settings = LogSettings(noise=0.0, timestep=0.001)
    log = simulate_log(machine, t, 0.4 * np.sin(5.0 * t)[:, None], EffectSet(), settings)
    twice = np.sort(np.concatenate([log.t, log.t[1:] - 0.001]))
    q, target = (np.interp(twice, log.t, x[:, 0])[:, None] for x in (log.q, log.q_des))
    close = JointLog(joints=log.joints, t=twice, q=q, q_des=target, tau=np.zeros_like(q))
    made = Replay(machine, close, timestep=0.0025, threads=1, torque=True).run({("delay", "time"): np.zeros((1, 1))}, 1)
    torque = made.torque_residual[0, :, 0]
    late = torque[np.searchsorted(twice, 1.0) :]
    assert np.array_equal(late[1:-1:2], late[2::2])
    assert np.all(late != 0.0)


def test_readings_after_a_gap_count_once_the_machine_has_forgotten_it(pendulum: MachineModel, swing: JointLog) -> None:
    """The targets inside the gap are unknown; 0.8 s later they no longer matter."""
    cut = swing.part((swing.t < 3.0) | (swing.t > 3.6))
    replay = Replay(pendulum, cut, timestep=0.0025, threads=1)
    since = cut.t - np.where(cut.t > 3.3, cut.t[cut.t > 3.3][0], cut.t[0])
    lost = since < 0.8
    assert np.array_equal(replay.counts, ~lost)
    residual = replay.run({("delay", "time"): np.zeros((1, 1))}, 1).residual[0]
    assert np.abs(residual[replay.counts]).max() < 1e-3


def test_a_joint_without_a_servo_begins_each_segment_with_its_own_velocity(tmp_path: Path) -> None:
    """Nothing makes it forget: at an acceleration of 8 rad/s2, one taken 10 ms ahead of itself is 0.08 rad/s off."""
    path = tmp_path / "robot.xml"
    path.write_text(PENDULUM[: PENDULUM.index("<actuator>")].replace("0.1", "0.01") + "</mujoco>")
    machine = read_machine(path)
    model = copy(machine.model)
    model.opt.timestep = 0.0005
    data = mujoco.MjData(model)
    t = np.arange(0.0, 12.0, 0.005)
    force = 0.4 * np.sin(4.0 * t) + 0.2 * np.sin(9.0 * t)
    q = []
    for f in force:
        q.append(data.qpos.copy())
        for _ in range(10):
            data.qfrc_applied[:] = f
            mujoco.mj_step(model, data)
    log = JointLog(joints=machine.joints, t=t, q=np.array(q), force=force[:, None])
    replay = Replay(machine, log, timestep=0.0005, segment=2.0, threads=1)
    residual = replay.run({("delay", "time"): np.zeros((1, 1))}, 1).residual[0]
    assert np.nanstd(residual[replay.counts]) < 0.001 * np.ptp(log.q)


def test_short_segments_begin_where_the_machine_was_whatever_the_model_says(pendulum: MachineModel) -> None:
    """A joint that sticks in the model alone is soon not far off; and where a drive is off is cut as well."""
    t = np.arange(0.0, 8.0, 0.02)
    quiet = LogSettings(noise=0.0, resolution=0.0, timestep=0.001, rate_hz=200.0)
    log = simulate_log(pendulum, t, 0.8 * np.sin(t)[:, None], EffectSet(), quiet)
    log = replace(log, extra={**log.extra, "enabled": (log.t - log.t[0] < 6.0).astype(float)})
    stuck = {("coulomb", "level"): np.full((1, 1), 50.0)}
    long = Replay(pendulum, log, timestep=0.0025, threads=1)
    short = long.in_short_segments()
    on = log.t - log.t[0] < 5.0
    errors = [np.sqrt(np.nanmean(r.run(stuck, 1).residual[0][on] ** 2)) for r in (long, short)]
    assert errors[1] < 0.5 * errors[0]
    assert short.segments >= 15
    assert short.length * short.dt < 0.7

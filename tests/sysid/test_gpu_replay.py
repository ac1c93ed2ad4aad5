"""Replays in worlds of MuJoCo Warp are those on the processor, here with worlds on the processor too."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mimic.config.sysid import CalibrateSettings, LogSettings
from mimic.dynamics.catalogue import BASELINE
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.errors import ConfigError
from mimic.io.joint_log import JointLog
from mimic.sysid.baseline import random_search
from mimic.sysid.calibrate import calibrate
from mimic.sysid.least_squares import fit
from mimic.sysid.logs import make_blocks
from mimic.sysid.predict import simulate_log
from mimic.sysid.replay import Job, Replay, Targets
from mimic.sysid.residuals import Point, Problem, stack

torch = pytest.importorskip("torch", reason="worlds need the extra 'train'")
pytest.importorskip("mujoco_warp", reason="worlds need the extra 'train'")
from mimic.sysid.gpu_replay import WorldReplay  # noqa: E402

ARM = """<mujoco><worldbody><body name="upper" pos="0 0 1">
<joint name="shoulder" axis="0 1 0" armature="0.003" damping="0.04" frictionloss="0.05"/>
<inertial pos="0 0 -0.06" mass="0.5" diaginertia="0.001 0.001 0.0003"/>
<body name="lower" pos="0 0 -0.12">
<joint name="elbow" axis="0 1 0" armature="0.003" damping="0.04" frictionloss="0.05"/>
<inertial pos="0 0 -0.09" mass="0.2" diaginertia="0.0008 0.0008 0.0001"/><site name="tip" pos="0 0 -0.18"/>
</body></body></worldbody></mujoco>"""

SINGLE = 1e-6
"""Positions of a radian have steps of 1.2e-7 rad in single precision, and a residual is stored so; what they add up to
in a simulation fades as the servo forgets. A 350th of the noise of a reading.
"""

SINGLE_TORQUE = 5e-5
"""Velocities are less exact, and play and gears less smooth. A 400th of the noise of a reading."""


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> MachineModel:
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(ARM)
    return read_machine(path, {"kp": 20.0, "kd": 0.8})


@pytest.fixture(scope="module")
def log(arm: MachineModel) -> JointLog:
    t = np.arange(0.0, 6.0, 0.02)
    phase = np.random.default_rng(3).uniform(0, 2 * np.pi, (3, 2))
    q_des = sum(0.4 / (1 + k) * np.sin(2 * np.pi * f * t[:, None] + phase[k]) for k, f in enumerate((0.4, 0.9, 1.7)))
    truth = EffectValues(name="coulomb", joints=arm.joints, values={"level": np.array([0.09, 0.03])})
    return simulate_log(arm, t, q_des, EffectSet((truth,)), LogSettings(seed=4, jitter=0.0003, timestep=0.001))


def baseline(arm: MachineModel) -> Point:
    return Point.of(BASELINE, arm)


def points(arm: MachineModel) -> list[Point]:
    given = {
        "coulomb": {"level": [0.2, 0.01]},
        "link_mass": {"factor": [1.2, 0.8]},
        "stribeck": {"level": [0.1, 0.2], "speed": 0.1},
        "torque_lag": {"time": 0.006},
        "backlash": {"gap": [0.01, 0.0]},
        "compliance": {"compliance": [0.0, 0.01]},
        "kt_heat": {"loss": 0.1, "time": 5.0},
        "torque_speed": {"torque": 1.0, "speed": 4.0},
        "base_tilt": {"roll": 0.1, "pitch": 0.1},
        "payload": {"mass": [0.0, 0.1]},
        "joint_delay": {"time": [0.004, 0.011]},
    }
    return [baseline(arm), *(baseline(arm).with_effect(name, arm, values) for name, values in given.items())]


def both(arm: MachineModel, log: JointLog, torque: bool = True) -> tuple[Replay, WorldReplay]:
    """Return replays of the same segments."""
    on_processor = Replay(arm, log, timestep=0.005, segment=0.75, threads=1, torque=torque)
    return on_processor, WorldReplay(arm, log, device="cpu", timestep=0.005, segment=0.75, threads=1, torque=torque)


@pytest.mark.slow
def test_worlds_go_the_way_of_the_replay_on_the_processor(arm: MachineModel, log: JointLog) -> None:
    tried = points(arm)
    replays = both(arm, log)
    late = np.zeros(len(replays[0].sent))
    late[5::7] = 0.013
    made = []
    for replay in replays:
        warm = replay.with_heat(np.full((len(log.t), 2), 0.7)).with_late(late)
        made.append(warm.run(stack(tried, arm), len(tried)))
    one, other = made
    assert np.array_equal(np.isnan(one.residual), np.isnan(other.residual))
    assert np.nanmax(np.abs(one.residual - other.residual)) < SINGLE
    assert np.nanmax(np.abs(one.torque_residual - other.torque_residual)) < SINGLE_TORQUE
    assert np.nanmin([np.nanstd(one.residual[0] - r) for r in one.residual[1:]]) > 20 * SINGLE  # they do differ


@pytest.mark.slow
def test_motors_get_as_warm_in_worlds(arm: MachineModel, log: JointLog) -> None:
    values = stack([baseline(arm)], arm)
    one, other = (replay.mean_square_torque(values) for replay in both(arm, log, torque=False))
    assert other == pytest.approx(one, abs=1e-4)
    assert one.std() > 0.01


@pytest.mark.slow
def test_each_set_may_have_targets_of_its_own(arm: MachineModel, log: JointLog) -> None:
    made = []
    for replay in both(arm, log, torque=False):
        none = np.zeros(len(replay.sent))
        grids = Targets.stacked([replay.delayed(none + late) for late in (0.0, 0.01, 0.02)])
        made.append(replay.run(stack([baseline(arm)] * 3, arm), 3, grids).residual)
    assert np.nanmax(np.abs(made[0] - made[1])) < SINGLE
    assert np.nanmax(np.abs(made[0][0] - made[0][2])) > 1e-3


@pytest.mark.slow
def test_replays_side_by_side_are_those_one_after_another(arm: MachineModel, log: JointLog) -> None:
    _, replay = both(arm, log)
    finer = replay.finer(2, 0.75)
    jobs = [
        Job(replay=which, parameters=stack(tried, arm), count=len(tried))
        for which, tried in ((replay, points(arm)[:3]), (finer, points(arm)[:3]), (replay, points(arm)[3:6]))
    ]
    beside = replay.side_by_side(jobs)
    alone = [job.replay.run(job.parameters, job.count) for job in jobs]
    for one, other in zip(beside, alone, strict=True):
        assert np.array_equal(one.residual, other.residual, equal_nan=True)
        assert np.array_equal(one.torque_residual, other.torque_residual, equal_nan=True)
    assert np.nanmax(np.abs(alone[0].residual - alone[1].residual)) > SINGLE  # finer steps are others


@pytest.mark.slow
def test_squares_are_those_of_the_residuals(arm: MachineModel, log: JointLog) -> None:
    rows = log.t > 2.0
    noise = np.array([0.3e-3, 0.4e-3])
    tried = points(arm)[:3]
    found = [replay.squares(stack(tried, arm), 3, rows, noise) for replay in both(arm, log)]
    residual = both(arm, log)[0].run(stack(tried, arm), 3).residual[:, rows] / noise
    assert found[0] == pytest.approx((residual.astype(float) ** 2).sum(1))
    assert found[1] == pytest.approx(found[0], rel=1e-2)


@pytest.mark.slow
def test_fit_and_random_search_end_at_the_same_numbers(arm: MachineModel, log: JointLog) -> None:
    fits, picks = [], []
    for replay in both(arm, replace(log, tau=None), torque=False):
        problem = Problem(replay, np.full(2, 0.35e-3), None, make_blocks(log.t, replay.counts))
        fits.append(fit(problem, baseline(arm), BASELINE, {}, most=2))
        picks.append(random_search(problem, baseline(arm), 20, 1, lambda *_: None))
    steps = np.array([k.step for k in fits[0].free_parameters])
    assert fits[1].point.read(fits[0].free_parameters) == pytest.approx(
        fits[0].point.read(fits[0].free_parameters), abs=0.05 * steps.min()
    )
    for key, row in picks[0].point.values.items():
        assert np.array_equal(row, picks[1].point.values[key])


@pytest.mark.slow
@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_reported(arm: MachineModel, log: JointLog) -> None:
    with pytest.raises(ConfigError, match="PyTorch sees no GPU; use --device cpu"):
        calibrate(log, arm, CalibrateSettings(device="cuda"))


def test_another_device_is_refused() -> None:
    with pytest.raises(ConfigError, match="device is tpu"):
        CalibrateSettings(device="tpu")


@pytest.mark.slow
def test_a_model_file_is_all_it_needs(tmp_path: Path, log: JointLog) -> None:
    """Force-driven machines have no targets, and forces of their own."""
    (tmp_path / "arm.xml").write_text(ARM)
    free = read_machine(tmp_path / "arm.xml", {"kp": 0.0, "kd": 0.5})
    force = JointLog(joints=log.joints, t=log.t, q=log.q, force=0.2 * np.sin(3.0 * log.t[:, None] + np.array([0, 1])))
    made = [replay.run(stack([baseline(free)], free), 1).residual for replay in both(free, force)]
    assert np.nanmax(np.abs(made[0] - made[1])) < 10 * SINGLE

"""A base that swings is told from forces in the joints, and never named as one."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.io.joint_log import JointLog
from mimic.sysid.calibrate import calibrate
from mimic.sysid.result import Calibration
from mimic.sysid.torque.regression import base_torques, shared_frequencies

ARMS = ("a", "b", "c")

ARM = """<body name="{name}" pos="{place} 0.2 0.1"><joint name="{name}" axis="0 1 0" armature="0.003" damping="0.05"
frictionloss="0.02"/><inertial pos="0.02 0 {depth}" mass="{mass}" diaginertia="0.001 0.001 0.0003"/></body>"""

BASE = """<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
<joint name="z" type="slide" axis="0 0 1"/><joint name="about_x" axis="1 0 0"/><joint name="about_y" axis="0 1 0"/>
<joint name="about_z" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>"""

KP, KD = 20.0, 0.8


def mjcf(inside: str = "") -> str:
    numbers = zip(ARMS, (0.0, 0.3, 0.6), (-0.12, -0.06, -0.09), (0.3, 0.5, 0.4), strict=True)
    arms = "".join(ARM.format(name=n, place=p, depth=d, mass=m) for n, p, d, m in numbers)
    return f"<mujoco><worldbody><body name='base'>{inside}{arms}</body></worldbody></mujoco>"


@pytest.fixture(scope="module")
def arms(tmp_path_factory: pytest.TempPathFactory) -> MachineModel:
    path: Path = tmp_path_factory.mktemp("arms") / "arms.xml"
    path.write_text(mjcf())
    return read_machine(path, {"kp": KP, "kd": KD})


def log_of(swing: float, forces: tuple[complex, ...] = (0.0, 0.0, 0.0)) -> JointLog:
    """Return the log of arms whose base swings forward at 0.9 Hz by so much [m/s^2], and on which forces act [N m]."""
    rng = np.random.default_rng(5)
    sent = np.arange(0.0, 11.0, 0.02)
    phase = rng.uniform(0, 2 * np.pi, (4, 3))
    q_des = sum(
        0.6 / (1 + k) * np.sin(2 * np.pi * f * sent[:, None] + phase[k]) for k, f in enumerate((0.3, 0.7, 1.6, 3))
    )
    model = mujoco.MjModel.from_xml_string(mjcf())
    model.opt.timestep = step = 0.0005
    data = mujoco.MjData(model)
    data.qpos[:] = q_des[0]
    rows = []
    for k in range(round(11.0 / step)):
        if k % 10 == 0:
            rows.append(np.array(data.qpos))
        wave = np.exp(2j * np.pi * 0.9 * k * step)
        model.opt.gravity[0] = -swing * wave.imag
        servo = KP * (q_des[k // 40] - data.qpos) - KD * data.qvel
        data.qfrc_applied[:] = servo + (np.array(forces) * wave).real
        mujoco.mj_step(model, data)
    q = np.array(rows) + 0.0002 * rng.standard_normal((len(rows), 3))
    rows_of = np.arange(len(q)) // 4
    return JointLog(joints=ARMS, t=np.arange(len(q)) * 0.005, q=q, q_des=q_des[rows_of], metadata={"kp": KP, "kd": KD})


def calibrated(arms: MachineModel, log: JointLog) -> Calibration:
    return calibrate(log, arms, CalibrateSettings(effects=("periodic_force",), timestep=0.005))


def found(result: Calibration) -> list[str]:
    return [s.added for s in result.stages if s.added not in ("", "baseline")]


@pytest.mark.slow
def test_a_swinging_base_is_not_named_as_forces_in_the_joints(arms: MachineModel) -> None:
    result = calibrated(arms, log_of(2.0))
    assert found(result) == []
    assert {r.verdict for r in result.unexplained} == {"moving base"}
    assert all(r.depends_on == ("the base",) for r in result.unexplained)
    assert "0.90 Hz" in result.experiments[-1]
    force = next(c for c in result.stages[-1].candidates if c.name == "periodic_force")
    assert "one motion of the base at 0.90 Hz" in force.why


@pytest.mark.slow
def test_forces_of_one_frequency_that_no_base_makes_are_named(arms: MachineModel) -> None:
    forces = (0.08 * np.exp(0.4j), 0.07 * np.exp(2.9j), 0.0)
    result = calibrated(arms, log_of(0.0, forces))
    assert found(result) == ["periodic_force"]
    effect = next(e for e in result.effects if e.name == "periodic_force")
    size = dict(zip(effect.joints, np.hypot(effect.values["cosine"], effect.values["sine"]), strict=True))
    assert [size.get(name, 0.0) for name in ARMS] == pytest.approx([0.08, 0.07, 0.0], rel=0.1, abs=0.005)


def test_the_pattern_is_that_of_a_base_which_accelerates(arms: MachineModel) -> None:
    free = mujoco.MjModel.from_xml_string(mjcf(BASE))
    data = mujoco.MjData(free)
    q = np.array([0.3, -0.8, 1.1])
    data.qpos[6:] = q
    mujoco.mj_forward(free, data)
    mass = np.zeros((9, 9))
    mujoco.mj_fullM(free, data, mass)
    assert base_torques(arms, q[None], np.ones(3))[0] == pytest.approx(-mass[6:, :6], abs=1e-9)


def test_frequencies_that_one_joint_has_alone_are_not_shared() -> None:
    frequency, size = np.array([0.83, 0.94, 0.831, 0.939, 2.2]), np.array([1.0, 2.0, 1.0, 1.0, 5.0])
    shared = shared_frequencies(frequency, size, np.ones(5, dtype=bool), 0.03)
    assert sorted(shared) == pytest.approx([0.8305, 0.9398], abs=1e-4)
    assert shared_frequencies(frequency, size, np.array([True, True, False, False, True]), 0.03) == ()

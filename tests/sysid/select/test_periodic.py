from pathlib import Path

import numpy as np
import pytest

from mimic.config.sysid import CalibrateSettings, LogSettings
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.io.joint_log import JointLog
from mimic.sysid.calibrate import calibrate
from mimic.sysid.fit.baseline import problem_of
from mimic.sysid.predict import simulate_log
from mimic.sysid.select.starts import on_harmonic

PENDULUM = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8"/></body></worldbody>
<actuator><position joint="hinge" kp="30" kv="1.5"/></actuator></mujoco>"""


@pytest.fixture
def machine(tmp_path: Path) -> MachineModel:
    (tmp_path / "robot.xml").write_text(PENDULUM)
    return read_machine(tmp_path / "robot.xml")


def logged(machine: MachineModel, *hidden: EffectValues) -> JointLog:
    """Return a log whose motion repeats every 4 s."""
    t = np.arange(0.0, 16.0, 0.02)
    target = (0.5 * np.sin(0.5 * np.pi * t) + 0.15 * np.sin(1.5 * np.pi * t + 1))[:, None]
    return simulate_log(machine, t, target, EffectSet(hidden), LogSettings(timestep=0.001))


@pytest.mark.slow
def test_what_repeats_with_the_motion_is_no_external_force(machine: MachineModel) -> None:
    rubbing = EffectValues(name="asymmetric_friction", joints=("hinge",), values={"coefficient": 0.2})
    settings = CalibrateSettings(effects=("periodic_force",), torque=False, timestep=0.005)
    result = calibrate(logged(machine, rubbing), machine, settings)
    assert [s.added for s in result.stages if s.added not in ("", "baseline")] == []


def test_a_force_beside_the_motion_is_on_none_of_its_harmonics(machine: MachineModel) -> None:
    problem = problem_of(logged(machine), machine, CalibrateSettings(torque=False))
    assert on_harmonic(problem, np.array([0.25, 0.75, 1.13, 1.25])).tolist() == [True, True, False, True]

from pathlib import Path

import numpy as np
import pytest

from mimic.config.sysid import CalibrateSettings, LogSettings
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.sysid.calibrate import calibrate
from mimic.sysid.predict import simulate_log

PENDULUM = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8"/></body></worldbody>
<actuator><position joint="hinge" kp="30" kv="1.5"/></actuator></mujoco>"""


@pytest.fixture
def machine(tmp_path: Path) -> MachineModel:
    (tmp_path / "robot.xml").write_text(PENDULUM)
    return read_machine(tmp_path / "robot.xml")


def found(machine: MachineModel, hidden: EffectValues) -> list[str]:
    """Return what is named in a log whose motion repeats every 4 s, when only an external force may be named."""
    t = np.arange(0.0, 16.0, 0.02)
    target = (0.5 * np.sin(0.5 * np.pi * t) + 0.15 * np.sin(1.5 * np.pi * t + 1))[:, None]
    log = simulate_log(machine, t, target, EffectSet((hidden,)), LogSettings(timestep=0.001))
    settings = CalibrateSettings(effects=("periodic_force",), torque=False, timestep=0.005)
    return [s.added for s in calibrate(log, machine, settings).stages if s.added not in ("", "baseline")]


@pytest.mark.slow
def test_what_repeats_with_the_motion_is_no_external_force(machine: MachineModel) -> None:
    assert (
        found(machine, EffectValues(name="asymmetric_friction", joints=("hinge",), values={"coefficient": 0.2})) == []
    )


@pytest.mark.slow
def test_an_external_force_beside_the_motion_is_found(machine: MachineModel) -> None:
    shaken = EffectValues(name="periodic_force", joints=("hinge",), values={"cosine": 0.1, "frequency": 1.13})
    assert found(machine, shaken) == ["periodic_force"]

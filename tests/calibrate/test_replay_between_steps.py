from pathlib import Path

import numpy as np
import pytest

from mimic.calibrate.replay import Replay
from mimic.calibrate.simulate import simulate_log
from mimic.robot.effect_set import EffectSet
from mimic.robot.machine import read_machine
from mimic.settings import LogSettings

PENDULUM = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8"/></body></worldbody>
<actuator><position joint="hinge" kp="30" kv="1.5"/></actuator></mujoco>"""


@pytest.mark.parametrize("timestep", [0.0025, 0.0021, 0.0017])
def test_readings_between_two_steps_are_predicted_at_their_own_time(tmp_path: Path, timestep: float) -> None:
    """At 4 rad/s, a reading taken for one a step later would be off by 8 mrad."""
    (tmp_path / "robot.xml").write_text(PENDULUM)
    machine = read_machine(tmp_path / "robot.xml")
    t = np.arange(0.0, 12.0, 0.02)
    target = 0.8 * np.sin(5.0 * t)[:, None]
    log = simulate_log(machine, t, target, EffectSet(), LogSettings(noise=0.0, resolution=0.0))
    residual = (
        Replay(machine, log, timestep=timestep, threads=1).run({("delay", "time"): np.zeros((1, 1))}, 1).residual[0]
    )
    assert np.nanmax(np.abs(residual)) < 5e-4

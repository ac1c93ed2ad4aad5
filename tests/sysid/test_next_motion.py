"""The motion that tells two explanations apart, on a pendulum whose machines are known."""

import numpy as np
import pytest

from mimic.config.sysid import LogSettings
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.errors import ConfigError
from mimic.io.joint_log import JointLog
from mimic.sysid.next_motion import next_motion
from mimic.sysid.predict import simulate_log
from mimic.sysid.sentences import next_logs

PENDULUM = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.05" frictionloss="0.05"/>
<inertial pos="0 0 -0.15" mass="0.8" diaginertia="0.006 0.006 0.0002"/></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> MachineModel:
    path = tmp_path_factory.mktemp("model") / "pendulum.xml"
    path.write_text(PENDULUM)
    return read_machine(path, {"kp": 15.0, "kd": 0.6})


def having(name: str, **values: float) -> EffectSet:
    rows = {key: np.array([value]) for key, value in values.items()}
    return EffectSet((EffectValues(name=name, joints=("hinge",), values=rows),))


def logged(machine: MachineModel, reach: float) -> JointLog:
    t = np.arange(0.0, 5.0, 0.02)
    targets = 0.2 + reach * np.sin(2 * np.pi * 0.4 * t)
    return simulate_log(machine, t, targets[:, None], EffectSet(), LogSettings(timestep=0.001))


def test_the_motion_stays_where_the_machine_has_been(pendulum):
    log = logged(pendulum, 0.5)
    found = next_motion(pendulum, [log], np.array([3e-4]), having("spring", stiffness=2.0), EffectSet())
    assert found.joint == "hinge"
    assert found.log.q_des.min() >= log.q_des.min() - 1e-12
    assert found.log.q_des.max() <= log.q_des.max() + 1e-12


def test_it_shows_more_of_the_difference_than_other_motions(pendulum):
    gap = having("backlash", gap=0.02, compliance=0.001)
    log = logged(pendulum, 0.5)
    found = next_motion(pendulum, [log], np.array([3e-4]), gap, EffectSet())
    t = np.arange(0.0, 20.0, 0.02)
    slow = 0.2 + 0.5 * np.sin(2 * np.pi * 0.05 * t)[:, None]
    exact = LogSettings(noise=0.0, resolution=0.0, timestep=0.001)
    pair = [simulate_log(pendulum, t, slow, effects, exact).q for effects in (gap, EffectSet())]
    assert found.apart > np.sqrt(((pair[0] - pair[1]) ** 2).mean()) / 3e-4
    assert found.apart > 5.0


def test_equal_explanations_are_not_told_apart(pendulum):
    spring = having("spring", stiffness=2.0)
    assert next_motion(pendulum, [logged(pendulum, 0.5)], np.array([3e-4]), spring, spring).apart == 0.0


def test_a_joint_that_was_not_moved_is_refused(pendulum):
    with pytest.raises(ConfigError, match="centre"):
        next_motion(pendulum, [logged(pendulum, 0.0)], np.array([3e-4]), EffectSet(), EffectSet())


def test_what_to_log_next_names_the_file_or_says_that_no_motion_tells(pendulum):
    log = logged(pendulum, 0.5)
    spring = having("spring", stiffness=2.0)
    told = next_motion(pendulum, [log], np.array([3e-4]), spring, EffectSet())
    same = next_motion(pendulum, [log], np.array([3e-4]), spring, spring)
    assert next_logs((), (), (), told)[0].startswith("next_motion.parquet (")
    assert next_logs((), (), (), same) == (
        "no motion in these ranges tells what was found from the nearest alternative: 0.0 noise floors apart, in hinge",
    )

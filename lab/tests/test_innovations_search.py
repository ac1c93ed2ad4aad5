"""Effects hidden in logs that another simulator made are found, and nothing where nothing is hidden."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lab.innovations.data import data_of
from lab.innovations.laws import ROW
from lab.innovations.model import setting_of
from lab.innovations.result import dependences, effects_of
from lab.innovations.search import baseline, describe, search
from mimic.config.sysid import LogSettings
from mimic.dynamics.catalogue import BASELINE
from mimic.dynamics.effect_set import EffectSet, EffectValues, read_effects, write_effects
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.io.joint_log import JointLog
from mimic.sysid.predict import simulate_log

PAIR = """<mujoco><worldbody>
<body name="a"><joint name="a" axis="0 1 0" armature="0.003" damping="0.05" frictionloss="0.04"/>
<inertial pos="0 0 -0.08" mass="0.3" diaginertia="0.001 0.001 0.0003"/></body>
<body name="b" pos="0 1 0"><joint name="b" axis="0 1 0" armature="0.003" damping="0.05" frictionloss="0.04"/>
<inertial pos="0 0 -0.06" mass="0.4" diaginertia="0.001 0.001 0.0003"/></body></worldbody></mujoco>"""
ONE_WAY = EffectValues(name="asymmetric_friction", joints=("a",), values={"level": np.array([0.02])})
SPRING = EffectValues(name="spring", joints=("a",), values={"stiffness": np.array([0.5])})
FRICTION = ("stribeck", "asymmetric_friction", "quadratic_drag", "spring")


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> MachineModel:
    """Two joints beside each other."""
    path = tmp_path_factory.mktemp("pair") / "pair.xml"
    path.write_text(PAIR)
    return read_machine(path, {"kp": 20.0, "kd": 0.8})


@pytest.fixture
def log_of() -> Callable[..., JointLog]:
    """Return a function that simulates a log of a machine with hidden effects."""
    return made_log


def made_log(pair: MachineModel, *hidden: EffectValues, fast: float = 0.0, timestep: float = 0.001) -> JointLog:
    """Return 10 s of sines; with ``fast``, in the seventh second only there is also a swing of this size at 4 Hz."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 10.0, 0.02)
    phase = rng.uniform(0, 2 * np.pi, (3, 2))
    q_des = sum(0.4 / (1 + k) * np.sin(2 * np.pi * f * t[:, None] + phase[k]) for k, f in enumerate((0.4, 0.9, 1.7)))
    q_des = np.asarray(q_des)[:, : len(pair.joints)]
    swing = np.where((t > 6.0) & (t < 7.0), fast * np.sin(8 * np.pi * t), 0.0)
    made = simulate_log(pair, t, q_des + swing[:, None], EffectSet(hidden), LogSettings(seed=4, timestep=timestep))
    return replace(made, tau=None)


def test_innovations_of_the_true_machine_are_its_noise(pair, log_of):
    data = data_of([log_of(pair)], pair)
    model = baseline(setting_of(data), BASELINE).settled(2, 5)
    np.testing.assert_allclose(model.scale[0], 0.0003, rtol=0.4)


def test_nothing_is_found_where_nothing_is_hidden(pair, log_of):
    outcome = search(data_of([log_of(pair)], pair), BASELINE, FRICTION)
    assert describe(outcome.best.model) == "nothing"
    assert outcome.explained


@pytest.mark.xfail(run=False, reason="the search still calls one-way friction of this machine a spring")
def test_a_hidden_effect_is_named_in_its_joint_and_can_be_written(pair, log_of, tmp_path):
    outcome = search(data_of([log_of(pair, ONE_WAY)], pair), BASELINE, FRICTION)
    assert describe(outcome.best.model) == "asymmetric_friction (a)"
    level = outcome.best.model.table[ROW["asymmetric_friction", "level"], 0]
    assert level == pytest.approx(0.02, rel=0.1)
    write_effects(effects_of(outcome.best.model), tmp_path / "effects.toml")
    read = {e.name: e for e in read_effects(tmp_path / "effects.toml")}
    low, high = read["asymmetric_friction"].intervals["level"][0]
    assert low < level < high


def test_an_unknown_torque_says_that_it_depends_on_position(pair, log_of):
    data = data_of([log_of(pair, SPRING)], pair)
    model = baseline(setting_of(data), BASELINE).settled(2, 5)
    first, second = dependences(model)
    assert first.on[0][0] == "position"
    assert first.size > 3 * second.size

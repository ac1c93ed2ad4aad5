"""A small machine, and what is made of it, for the tests of several rooms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mimic.config.sysid import LogSettings
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.io.joint_log import JointLog
from mimic.records import FloatArray
from mimic.sysid.predict import simulate_log

PAIR = """<mujoco><worldbody>
<body name="a"><joint name="a" axis="0 1 0" armature="0.003" damping="0.05" frictionloss="0.04"/>
<inertial pos="0 0 -0.08" mass="0.3" diaginertia="0.001 0.001 0.0003"/></body>
<body name="b" pos="0 1 0"><joint name="b" axis="0 1 0" armature="0.003" damping="0.05" frictionloss="0.04"/>
<inertial pos="0 0 -0.06" mass="0.4" diaginertia="0.001 0.001 0.0003"/></body></worldbody></mujoco>"""


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


def made_log(
    pair: MachineModel,
    *hidden: EffectValues,
    fast: float = 0.0,
    timestep: float = 0.001,
    push: FloatArray | float = 0.0,
) -> JointLog:
    """Return 10 s of sines; with ``fast``, in the seventh second only there is also a swing of this size at 4 Hz; with
    ``push`` (500, J), the machine's targets are moved by it, as a torque over its stiffness does.
    """
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 10.0, 0.02)
    phase = rng.uniform(0, 2 * np.pi, (3, 2))
    q_des = sum(0.4 / (1 + k) * np.sin(2 * np.pi * f * t[:, None] + phase[k]) for k, f in enumerate((0.4, 0.9, 1.7)))
    q_des = np.asarray(q_des)[:, : len(pair.joints)]
    swing = np.where((t > 6.0) & (t < 7.0), fast * np.sin(8 * np.pi * t), 0.0)
    asked = q_des + swing[:, None]
    made = simulate_log(pair, t, asked + push, EffectSet(hidden), LogSettings(seed=4, timestep=timestep))
    told = made.q_des if np.ndim(push) == 0 else asked[np.searchsorted(t, made.t + 1e-9, side="right") - 1]
    return replace(made, q_des=told, tau=None)

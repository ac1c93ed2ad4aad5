"""Dynamics of trees against MuJoCo's."""

import os
from pathlib import Path

import mujoco
import numpy as np

from mimic.dynamics.machine import MachineModel, read_machine
from mimic.sysid.engine.tree import AT, BIAS, MOVING, drop_outdated, dynamics, links_of, room_of, tree_of

TREE = """<mujoco><compiler angle="radian"/><worldbody>
<body pos=".1 .2 1" euler=".3 .2 .1"><joint name="a" axis="1 2 0" pos=".01 0 .02" ref=".2"/>
<inertial pos=".03 .01 -.1" mass="1.2" fullinertia=".01 .02 .015 .001 .002 -.001"/>
<body pos=".1 0 .2" quat=".8 .6 0 0"><inertial pos="0 .02 0" mass=".3" diaginertia=".001 .002 .001"/>
<body pos="0 .1 .1"><joint name="b" type="slide" axis="0 1 1"/><joint name="c" axis="1 0 0"/>
<inertial pos="0 .05 .02" mass=".7" diaginertia=".003 .002 .001"/></body></body>
<body pos="-.2 0 0"><joint name="d" axis="0 0 1"/><inertial pos=".1 0 0" mass=".4" diaginertia=".001 .001 .001"/>
</body></body>
<body pos="0 1 0"><joint name="e" axis="0 1 0"/><inertial pos="0 0 -.1" mass=".5" diaginertia=".001 .001 .001"/></body>
</worldbody></mujoco>"""


def machine_of(text: str, folder: Path) -> MachineModel:
    path = folder / "machine.xml"
    path.write_text(text)
    return read_machine(path)


def test_mass_matrix_and_bias_forces_are_those_of_mujoco(tmp_path):
    machine = machine_of(TREE, tmp_path)
    tree, n = tree_of(machine), len(machine.joints)
    one = np.ones(n)
    links = links_of(tree, one, 0 * one, 0 * one)
    data, rng = mujoco.MjData(machine.model), np.random.default_rng(1)
    room, mass = room_of(n, machine.model.opt.gravity), np.zeros((n, n))
    for _ in range(20):
        data.qpos[:] = room[:n, AT] = rng.uniform(-2, 2, n)
        data.qvel[:] = room[:n, MOVING] = rng.normal(0, 3, n)
        mujoco.mj_forward(machine.model, data)
        dynamics(tree, links[None], 0, room, mass)
        full = np.zeros((n, n))
        mujoco.mj_fullM(machine.model, data, full)
        np.testing.assert_allclose(mass, full, atol=1e-9)
        np.testing.assert_allclose(room[:n, BIAS], data.qfrc_bias, atol=1e-9)


def test_a_load_at_the_tip_is_a_point_of_that_mass(tmp_path):
    machine = machine_of(TREE, tmp_path)
    tree, n = tree_of(machine), len(machine.joints)
    one, load = np.ones(n), np.eye(n)[n - 1] * 0.2
    bare, loaded = (links_of(tree, one, 0 * one, m) for m in (0 * one, load))
    added = (loaded - bare)[-1]
    tip = tree.tip[-1]
    np.testing.assert_allclose(added[:4], 0.2 * np.array([1.0, *tip]), atol=1e-12)
    np.testing.assert_allclose(
        added[4:], 0.2 * (tip @ tip * np.eye(3) - np.outer(tip, tip))[np.triu_indices(3)], atol=1e-12
    )


def test_what_was_compiled_before_a_source_changed_is_made_anew(tmp_path):
    compiled = tmp_path / "__pycache__"
    compiled.mkdir()
    for name, seconds in (("laws.py", 200), ("__pycache__/pass.nbi", 100), ("__pycache__/pass.nbc", 300)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (seconds, seconds))
    drop_outdated(tmp_path)
    assert [path.name for path in compiled.iterdir()] == ["pass.nbc"]

"""Effects in an MJCF and in the actuator settings of other programs."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import read_machine
from mimic.dynamics.written_model import actuator_settings, not_written, write_mjcf

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.0005"/><worldbody>
<body name="upper"><joint name="a" axis="0 1 0" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8"/>
<body name="lower" pos="0 0 -0.3"><joint name="b" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.4"/></body></body></worldbody>
<actuator><position joint="a" kp="30" kv="1.5"/><position joint="b" kp="20" kv="1"/></actuator></mujoco>"""

JOINTS = ("a", "b")

TETRAHEDRON = """v 0 0 0
v 0.1 0 0
v 0 0.1 0
v 0 0 0.1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


def effect(name, joints=JOINTS, **values):
    return EffectValues(name=name, joints=joints, values={k: np.atleast_1d(v) for k, v in values.items()})


HELD = EffectSet(
    (
        effect("coulomb", level=[0.2, 0.1]),
        effect("viscous", coefficient=[0.3, 0.2]),
        effect("link_mass", factor=[1.1, 0.9]),
        effect("armature", inertia=[0.02, 0.01]),
        effect("gains", kp=[1.1, 0.8], kd=[0.9, 1.2]),
        effect("spring", stiffness=[3.0, 0.0], moment=[0.5, 0.0]),
        effect("payload", mass=[0.0, 0.2]),
        effect("torque_speed", torque=[4.0, 2.0], speed=[1e6, 1e6], flat=[0.0, 0.0]),
        effect("base_tilt", joints=(), roll=0.1, pitch=-0.2),
        effect("delay", joints=(), time=0.006),
    )
)


@pytest.fixture
def source(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM, encoding="utf-8")
    return file


def played(path, delay):
    """Return joints (T, 2) [rad] of a plain MuJoCo simulation whose targets come a delay [s] later."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    rows = []
    for k in range(4000):
        t = k * model.opt.timestep - delay
        data.ctrl[:] = np.array([0.8 * np.sin(4 * t), 0.6 * np.sin(7 * t)]) * (t > 0)
        mujoco.mj_step(model, data)
        rows.append(data.qpos.copy())
    return np.array(rows)


def changed_by_hand(source, out):
    """Write what the effects say into the MJCF as its author would."""
    spec = mujoco.MjSpec.from_file(str(source))
    values = {"a": (0.2, 0.3, 0.02, 33.0, 1.35, 4.0, 1.1), "b": (0.1, 0.2, 0.01, 16.0, 1.2, 2.0, 0.9)}
    for actuator, (name, numbers) in zip(spec.actuators, values.items(), strict=True):
        friction, damping, armature, kp, kd, most, factor = numbers
        joint = spec.joint(name)
        joint.frictionloss, joint.damping[0], joint.armature = friction, damping, armature
        actuator.set_to_position(kp=kp, kv=kd)
        actuator.forcerange = [-most, most]
        joint.parent.geoms[0].mass *= factor
    spec.joint("a").stiffness[0] = 3.0
    spec.joint("a").springref = 0.5 / 3.0
    spec.body("lower").add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-4, 0, 0], pos=[0, 0, -0.2], mass=0.2)
    down = np.array([0.0, 0.0, -9.81])
    roll = np.array([[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]])
    pitch = np.array([[np.cos(0.2), 0, -np.sin(0.2)], [0, 1, 0], [np.sin(0.2), 0, np.cos(0.2)]])
    spec.option.gravity = (pitch @ roll).T @ down
    spec.compile()
    out.write_text(spec.to_xml(), encoding="utf-8")
    return out


def test_the_mjcf_moves_in_mujoco_as_the_effects_written_into_it_by_hand(source, tmp_path):
    write_mjcf(source, read_machine(source), HELD, tmp_path / "found.xml")
    by_hand = changed_by_hand(source, tmp_path / "by_hand.xml")
    found = played(tmp_path / "found.xml", delay=0.0)
    expected = played(by_hand, delay=0.006)
    assert np.abs(found - played(source, delay=0.0)).max() > 0.1
    assert np.abs(found - expected).max() < 2e-3


def test_a_spring_of_the_file_stays_and_one_that_was_found_is_added(source, tmp_path):
    source.write_text(ARM.replace('name="b" axis="0 1 0"', 'name="b" axis="0 1 0" stiffness="2" springref="0.4"'))
    machine = read_machine(source)
    write_mjcf(source, machine, EffectSet(()), tmp_path / "same.xml")
    assert played(tmp_path / "same.xml", 0.0) == pytest.approx(played(source, 0.0), abs=1e-9)
    found = EffectSet((effect("spring", joints=("b",), stiffness=1.0, moment=0.5),))
    write_mjcf(source, machine, found, tmp_path / "more.xml")
    joint = mujoco.MjModel.from_xml_path(str(tmp_path / "more.xml")).joint("b")
    assert joint.stiffness[0] == pytest.approx(3.0)
    assert joint.qpos_spring[0] == pytest.approx((2.0 * 0.4 + 0.5) / 3.0)


def test_a_machine_without_effects_stays_as_it_is(source, tmp_path):
    write_mjcf(source, read_machine(source), EffectSet(()), tmp_path / "same.xml")
    assert played(tmp_path / "same.xml", 0.0) == pytest.approx(played(source, 0.0), abs=1e-9)


def test_meshes_are_still_found_from_another_folder(source, tmp_path):
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes/hull.obj").write_text(TETRAHEDRON, encoding="utf-8")
    text = ARM.replace('angle="radian"', 'angle="radian" meshdir="shapes"')
    text = text.replace("<worldbody>", '<asset><mesh name="hull" file="hull.obj"/></asset><worldbody>')
    text = text.replace("</body></body>", '<geom type="mesh" mesh="hull" mass="0"/></body></body>')
    source.write_text(text, encoding="utf-8")
    (tmp_path / "out").mkdir()
    write_mjcf(source, read_machine(source), EffectSet(()), tmp_path / "out/model.xml")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "out/model.xml")).nmesh == 1


def test_actuator_settings_have_the_names_of_mjlab_and_isaac_lab(source):
    settings = actuator_settings(read_machine(source), HELD)
    mjlab, isaac = settings["mjlab"]["a"], settings["isaac_lab"]["a"]
    assert mjlab["stiffness"] == isaac["stiffness"] == pytest.approx(33.0)
    assert mjlab["frictionloss"] == isaac["friction"] == pytest.approx(0.2)
    assert mjlab["effort_limit"] == isaac["effort_limit"] == pytest.approx(4.0)
    assert mjlab["delay"] == pytest.approx(0.006)
    assert isaac["velocity_limit"] is None


def test_what_cannot_be_written_is_named(source):
    effects = EffectSet(
        (effect("coulomb", level=[0.2, 0.1]), effect("backlash", gap=[0.01, 0.0], compliance=[1e-3, 1e-3]))
    )
    assert not_written(effects) == ("backlash",)

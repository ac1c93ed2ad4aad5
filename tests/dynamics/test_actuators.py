import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mimic.dynamics.actuators import FileDrives, refuse_other_machine
from mimic.dynamics.machine import MachineModel, hung_robot, read_machine
from mimic.dynamics.robot_model import load_model
from mimic.errors import AssetError
from mimic.robot.description import RobotDescription

ARM = """<mujoco>{top}<compiler autolimits="true"/><worldbody><body><joint name="a" axis="0 1 0" armature="{armature}"
damping="{damping}"/><inertial pos="0 0 -0.15" mass="0.3" diaginertia="1e-4 1e-4 1e-4"/>
<body pos="0 0 -0.3"><joint name="b" axis="0 1 0" frictionloss="0.05"{joint}/>
<inertial pos="0 0 -0.1" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>{link}</body></body></worldbody>
<actuator>{actuators}</actuator></mujoco>"""

SERVOS = '<position joint="a" kp="8" kv=".3"/><position joint="b" kp="4" kv=".1"/>'


def arm(folder: Path, actuators: str = SERVOS, **more: object) -> Path:
    path = folder / "arm.xml"
    nothing = {"top": "", "armature": 0.004, "damping": 0.0, "joint": "", "link": ""}
    path.write_text(ARM.format(actuators=actuators, **{**nothing, **more}))
    return path


def moves_alike(one: MachineModel, other: MachineModel) -> None:
    """Both have the same drives, and the same physics at any state under any torque."""
    for name in ("kp", "kd", "torque", "flat", "speed", "friction", "armature"):
        assert getattr(one.drives, name) == pytest.approx(getattr(other.drives, name)), name
    rng = np.random.default_rng(1)
    for _ in range(5):
        q, dq, torque = rng.normal(size=(3, len(one.joints)))
        found = []
        for machine in (one, other):
            data = mujoco.MjData(machine.model)
            data.qpos[:], data.qvel[:], data.ctrl[:] = q, 3 * dq, 10 * torque
            mujoco.mj_forward(machine.model, data)
            found.append(np.array(data.qacc))
        assert found[0] == pytest.approx(found[1], rel=1e-9)


# ---------------------------------------------------------------------- defaults

DEFAULTS = [
    '<position kp="8" kv=".3"/>',
    '<general ctrllimited="true" forcelimited="true" ctrlrange="-.1 .1" forcerange="-.2 .2"/>',
    '<motor gear="40" ctrlrange="-.1 .1" armature="0.02" damping="0.3"/>',
    '<default class="other"/><general gainprm="3" biastype="affine" biasprm="1 -7 -.2" group="2"/>',
    '<intvelocity kp="3" actrange="-1 1"/>',
    '<dcmotor motorconst="0.1" resistance="2" delay="0.01" nsample="5"/>',
]

EXPLICIT = """<general name="{0}" joint="{0}" gainprm="{1}" biastype="affine" biasprm="0 -{1} -{2}" gear="1"
dyntype="none" gaintype="fixed" ctrllimited="false" forcelimited="false" actlimited="false" armature="0" damping="0"
delay="0" nsample="0" group="0"/>"""


@pytest.mark.parametrize("defaults", DEFAULTS)
def test_defaults_of_a_file_do_not_reach_the_motors_of_a_machine(tmp_path: Path, defaults: str) -> None:
    plain = read_machine(arm(tmp_path))
    actuators = EXPLICIT.format("a", 8, 0.3) + EXPLICIT.format("b", 4, 0.1)
    path = arm(tmp_path, actuators, top=f"<default>{defaults}</default>")
    moves_alike(read_machine(path), plain)


@pytest.mark.parametrize("top", ['<option actuatorgroupdisable="0"/>', '<option><flag actuation="disable"/></option>'])
def test_actuators_that_a_file_disables_do_nothing_and_motors_of_a_machine_act(tmp_path: Path, top: str) -> None:
    machine = read_machine(arm(tmp_path, top=top))
    assert not np.asarray(machine.drives.kp).any()
    moves_alike(machine, read_machine(arm(tmp_path, "")))


def with_file(description: RobotDescription, path: Path) -> RobotDescription:
    return replace(description, names=replace(description.names, file=str(path), scene=""))


def robot_with(description: RobotDescription, folder: Path, defaults: str = "") -> RobotDescription:
    """Return the robot from a file without motors, so that mimic adds them."""
    text = description.mjcf.read_text().replace("<default>", f"<default>{defaults}", 1)
    path = folder / "robot.xml"
    path.write_text(re.sub("<(actuator|keyframe|sensor)>.*</\\1>", "", text, flags=re.DOTALL))
    return with_file(description, path)


@pytest.mark.parametrize("defaults", DEFAULTS)
def test_defaults_of_a_file_do_not_reach_the_motors_of_a_robot_with_effects(
    tmp_path: Path, description: RobotDescription, defaults: str
) -> None:
    spoiled = robot_with(description, tmp_path, defaults)
    for driven in (False, True):
        models = [load_model(d, floor=False, driven=driven) for d in (spoiled, description)]
        for name in ("gainprm", "biasprm", "gear", "ctrllimited", "forcelimited", "armature", "damping", "group"):
            assert getattr(models[0], f"actuator_{name}") == pytest.approx(getattr(models[1], f"actuator_{name}")), name
    moves_alike(hung_robot(spoiled), hung_robot(description))


def test_defaults_of_shapes_do_not_reach_the_floor(tmp_path: Path, description: RobotDescription) -> None:
    spoiled = robot_with(description, tmp_path, '<geom contype="0" conaffinity="0" condim="1" solref="0.5 1"/>')
    floors = [load_model(d, floor=True).geom("floor") for d in (spoiled, with_file(description, description.mjcf))]
    for name in ("contype", "conaffinity", "condim", "solref", "friction"):
        assert np.array_equal(getattr(floors[0], name), getattr(floors[1], name)), name


# ---------------------------------------------------------------------- armature and damping


@pytest.mark.parametrize(
    ("actuator", "armature", "damping"),
    [
        ('<position joint="a" kp="8" kv=".3" armature="0.004"/>', 0.004, 0.0),
        ('<motor joint="a" armature="0.004"/>', 0.004, 0.0),
        ('<position joint="a" kp="8" kv=".3" damping="0.2"/>', 0.0, "0.2"),
        (
            '<position joint="a" kp="2" kv=".075" gear="-2" armature="0.001" damping="0.05 0.01 0.002"/>',
            0.004,
            ".2 .04 .008",
        ),
        ('<motor jointinparent="a" gear="3" armature="0.001" damping=".1"/>', 0.009, "0.9"),
        ('<muscle joint="a" lengthrange="0 1" armature="0.004"/>', 0.004, 0.0),
    ],
)
def test_armature_and_damping_of_an_actuator_are_those_of_its_joint(
    tmp_path: Path, actuator: str, armature: float, damping: object
) -> None:
    found = read_machine(arm(tmp_path, actuator, armature=0))
    kp, kd = float(np.asarray(found.drives.kp)[0]), float(np.asarray(found.drives.kd)[0])
    own = f'<position joint="a" kp="{kp}" kv="{kd}"/>' if kp else ""
    moves_alike(found, read_machine(arm(tmp_path, own, armature=armature, damping=damping)))


def test_armature_and_damping_of_actuators_of_a_robot_are_those_of_its_joints(
    tmp_path: Path, description: RobotDescription
) -> None:
    text = description.mjcf.read_text()
    for leg in ("FL", "RR"):
        text = text.replace(f'joint="{leg}_knee"', f'joint="{leg}_knee" armature="0.01" damping="0.5"')
    (tmp_path / "robot.xml").write_text(text)
    heavy, plain = hung_robot(with_file(description, tmp_path / "robot.xml")), hung_robot(description)
    more = np.isin(plain.joints, ("FL_knee", "RR_knee"))
    assert heavy.drives.armature == pytest.approx(plain.drives.armature + 0.01 * more)
    assert heavy.model.dof_damping == pytest.approx(plain.model.dof_damping + 0.5 * more)


# ---------------------------------------------------------------------- parts that are kept or told


@pytest.mark.parametrize(
    ("actuators", "said"),
    [
        (
            '<general joint="a" gainprm="8" biastype="affine" biasprm="1.5 -8 -.3"/>',
            "constant forces (biasprm) of the actuators a",
        ),
        ('<general joint="a" biastype="affine" biasprm="-2"/>', "constant forces (biasprm) of the actuators a"),
        (
            '<general name="m" joint="a" gainprm="10" biastype="affine" biasprm="0 -8 -.3"/>',
            "gains that are not those of the bias (gainprm) of the actuators m",
        ),
        (
            '<general joint="b" gainprm="0" biastype="affine" biasprm="0 -8 -.3"/>',
            "gains that are not those of the bias (gainprm) of the actuators b",
        ),
        (
            '<position joint="a" kp="8" forcerange="-1 3"/>',
            "by direction (the larger counts) of the actuators a",
        ),
        ('<motor joint="a" ctrlrange="0 2"/>', "by direction (the larger counts) of the actuators a"),
        (
            '<position name="p" joint="a" kp="8" forcerange="-1 1"/><velocity name="v" joint="a" kv="1"/>',
            "beside others at a joint (their sum counts) of the actuators p, v",
        ),
        (
            '<general joint="a" biastype="muscle" lengthrange="0 1" biasprm=".75 1.05 -1 200 .5 1.6 1.5 1.3 1.2"/>',
            "all forces (not linear) of the actuators a",
        ),
        ('<muscle name="m" joint="a" lengthrange="0 1"/>', "all forces (of a muscle) of the actuators m"),
        (SERVOS + '<adhesion body="world" ctrlrange="0 1" gain="3"/>', "(at no joint) of the actuators number 2"),
        ('<intvelocity joint="a" kp="8" actrange="-1 1"/>', "activation dynamics (timeconst) of the actuators a"),
        ('<position joint="a" kp="8" delay="0.01" nsample="5"/>', "delays of the actuators a"),
    ],
)
def test_what_a_drive_cannot_do_is_told(tmp_path: Path, actuators: str, said: str) -> None:
    dropped = read_machine(arm(tmp_path, actuators)).dropped
    assert len(dropped) == 1
    assert said in dropped[0]


@pytest.mark.parametrize(
    ("actuators", "more"),
    [
        (SERVOS, {}),
        ('<position joint="a" kp="50" kv="2" gear="-3" forcerange="-4 4"/>', {}),
        ('<position joint="a" kp="50"/><velocity joint="a" kv="3"/>', {}),
        ('<motor joint="a" gear="-20" ctrlrange="-.4 .4"/><motor joint="b" forcerange="-.2 .2"/>', {}),
        ('<motor joint="a" ctrlrange="-1 2"/>', {"top": '<option><flag clampctrl="disable"/></option>'}),
        ('<position jointinparent="a" kp="8" dampratio="1"/>', {}),
        (SERVOS, {"joint": ' actuatorfrcrange="-.5 .2"'}),
        (SERVOS, {"joint": ' range="-1 1" stiffness="2" springref=".3" ref=".1"'}),
        (SERVOS, {"top": '<compiler inertiafromgeom="true"/>', "link": '<geom size=".1"/>'}),
        (SERVOS, {"top": '<option density="900" viscosity="2"/>', "link": '<geom fluidshape="ellipsoid" size=".1"/>'}),
        (SERVOS, {"top": '<custom><tuple name="t"><element objtype="actuator" objname="a"/></tuple></custom>'}),
    ],
)
def test_what_a_drive_can_do_is_kept_without_a_word(tmp_path: Path, actuators: str, more: dict[str, object]) -> None:
    named = actuators.replace('<position joint="a" kp="8"', '<position name="a" joint="a" kp="8"')
    assert not read_machine(arm(tmp_path, named, **more)).dropped


def test_the_limit_of_a_drive_is_the_larger_one_of_both_directions(tmp_path: Path) -> None:
    machine = read_machine(arm(tmp_path, '<position joint="a" kp="8" gear="2" forcerange="-3 1"/>'))
    assert np.asarray(machine.drives.torque)[0] == pytest.approx(6.0)


def test_shapes_that_touch_are_told(tmp_path: Path) -> None:
    ground = '<body pos="0 0 -.5"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom size=".3"/></body>'
    path = arm(tmp_path, link='<geom size=".1" pos="0 0 -.2"/>')
    path.write_text(path.read_text().replace("<worldbody>", f"<worldbody>{ground}"))
    assert read_machine(path).dropped == ("contacts",)


# ---------------------------------------------------------------------- the comparison


@pytest.mark.parametrize("field", ["dof_damping", "body_mass", "actuator_gear", "qpos_spring"])
def test_a_machine_that_moves_otherwise_than_its_file_is_refused_in_one_line(tmp_path: Path, field: str) -> None:
    path = arm(tmp_path, joint=' stiffness="1"')
    machine = read_machine(path)
    drives = FileDrives(mujoco.MjModel.from_xml_path(str(path)))
    refuse_other_machine(machine, drives.reference, path, "mend it")
    values = getattr(machine.model, field)
    values[-1:] += 0.01 * np.ones_like(values[-1:])
    with pytest.raises(AssetError, match=r"mimic would accelerate joint '.' by .* rad/s.*; mend it") as error:
        refuse_other_machine(machine, drives.reference, path, "mend it")
    assert "\n" not in str(error.value)


def test_gains_that_are_not_those_of_the_file_are_noticed(tmp_path: Path) -> None:
    path = arm(tmp_path)
    other = read_machine(path, {"kd": 0.31})
    drives = FileDrives(mujoco.MjModel.from_xml_path(str(path)))
    with pytest.raises(AssetError, match=r"arm\.xml"):
        refuse_other_machine(other, drives.reference, path, "mend it")


def test_a_robot_whose_motors_are_not_those_of_its_description_is_refused_with_effects(
    tmp_path: Path, description: RobotDescription
) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(description.mjcf.read_text().replace('saturation="12"', 'saturation="9"'))
    with pytest.raises(AssetError, match=r"make its motors those of robot\.toml") as error:
        hung_robot(with_file(description, path))
    assert "\n" not in str(error.value)

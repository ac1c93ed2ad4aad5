"""An MJCF as others publish them: another order of the legs, lights and cameras that follow, sensors, keyframes."""

from __future__ import annotations

import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mimic.dynamics.robot_model import load_model
from mimic.errors import AssetError
from mimic.io.assets import shipped
from mimic.records import JOINTS
from mimic.robot.description import RobotDescription, load_description
from mimic.robot.leg_kinematics import all_toes
from mimic.robot.model import TOES

LEG = """<body name="{leg}_hip" pos="{x} {y} 0"><joint class="abduction" name="{leg}_hip_joint"/>
<geom type="sphere" size="0.04" mass="0.7"/>
<body name="{leg}_thigh" pos="0 {hip} 0"><joint class="hip" name="{leg}_thigh_joint"/>
<geom type="capsule" size="0.015" fromto="0 0 0 0 0 -0.2" mass="1"/>
<body name="{leg}_calf" pos="0 0 -0.213"><joint class="knee" name="{leg}_calf_joint"/>
<geom type="capsule" size="0.01" fromto="0 0 0 0 0 -0.15" mass="0.2"/>
<geom type="sphere" size="0.023" pos="0 0 -0.213" mass="0.02"/><site name="{leg}" pos="0 0 -0.213"/></body></body>
</body>"""
MODEL = """<mujoco><compiler angle="radian"/><default><joint axis="0 1 0"/>
<default class="abduction"><joint axis="1 0 0" range="-0.863 0.863"/></default>
<default class="hip"><joint range="-0.686 4.501"/></default>
<default class="knee"><joint range="-2.818 -0.888"/></default></default>
<worldbody><light name="spot" mode="targetbodycom" target="trunk" pos="0 0 5"/>
<camera name="follow" mode="targetbody" target="trunk" pos="0 -2 1"/>
<body name="trunk" pos="0 0 0.4"><freejoint/><geom type="box" size="0.12 0.04 0.05" mass="5"/>LEGS</body></worldbody>
<contact><exclude body1="trunk" body2="FR_thigh"/></contact>
<actuator><position name="FR_hip" joint="FR_hip_joint" kp="100"/></actuator>
<sensor><framepos objtype="body" objname="trunk"/><jointpos joint="FL_hip_joint"/></sensor>
<keyframe><key name="home" qpos="0 0 0.27 1 0 0 0 0 .9 -1.8 0 .9 -1.8 0 .9 -1.8 0 .9 -1.8"/></keyframe></mujoco>"""
OWN = {
    "origin = [0.1934, 0.0465, 0.0]": "origin = [0.1881, 0.04675, 0.0]",
    "origin = [0.0, 0.0955, 0.0]": "origin = [0.0, 0.08, 0.0]",
    "position = [-0.002, 0.0, -0.213]": "position = [0.0, 0.0, -0.213]",
    "range = [-1.0472, 1.0472]": "range = [-0.863, 0.863]",
    "range_front = [-1.5708, 3.4907]": "range_front = [-0.686, 4.501]",
    "range_rear = [-0.5236, 4.5379]": "range_rear = [-0.5236, 4.501]",
    "range = [-2.7227, -0.83776]": "range = [-2.818, -0.888]",
}
"""Numbers of the Go2 -> those of the model above, whose lengths and limits are a Go1's."""
NAMES = """file = "robot.xml"
base = "trunk"
legs = ["FL", "FR", "RL", "RR"]
joints = ["{leg}_hip_joint", "{leg}_thigh_joint", "{leg}_calf_joint"]
links = ["{leg}_hip", "{leg}_thigh", "{leg}_calf"]
toe_site = "{leg}"
[model.shapes]
trunk = ["trunk#0"]
thigh = ["{leg}_thigh#0"]
shank = ["{leg}_calf#0"]
toe = ["{leg}_calf#1"]
"""


def robot(folder: Path, *, left_out: str = "") -> RobotDescription:
    """Return a robot of the model above; numbers that hold ``left_out`` stay the Go2's."""
    text = (shipped("assets") / "go2" / "robot.toml").read_text(encoding="utf-8")
    for theirs, own in OWN.items():
        assert theirs in text
        if not left_out or left_out not in theirs:
            text = text.replace(theirs, own)
    before, after = text.split("[model] "), text.split("[body] ")
    text = f"{before[0]}[model]\n{NAMES}\n[body] {after[1]}"
    tomllib.loads(text)
    (folder / "robot.toml").write_text(text, encoding="utf-8")
    places = {"FR": (1, -1), "FL": (1, 1), "RR": (-1, -1), "RL": (-1, 1)}
    legs = [LEG.format(leg=leg, x=0.1881 * f, y=0.04675 * s, hip=0.08 * s) for leg, (f, s) in places.items()]
    (folder / "robot.xml").write_text(MODEL.replace("LEGS", "".join(legs)), encoding="utf-8")
    return load_description(folder)


def test_another_order_of_legs_and_parts_that_refer_to_names_do_no_harm(tmp_path):
    description = robot(tmp_path)
    model = load_model(description)
    assert tuple(model.joint(j).name for j in range(1, model.njnt)) == JOINTS
    assert tuple(model.actuator(a).name for a in range(model.nu)) == JOINTS
    assert model.nexclude == 1
    data = mujoco.MjData(model)
    q = np.random.default_rng(0).uniform(description.q_min, description.q_max)
    data.qpos[:7] = 0, 0, 0, 1, 0, 0, 0
    data.qpos[7:] = q
    mujoco.mj_kinematics(model, data)
    assert np.abs([data.site(toe).xpos for toe in TOES] - all_toes(q, description)).max() < 1e-9


def test_a_model_whose_contacts_are_off_as_of_a_suspended_robot_stands_on_the_floor(tmp_path):
    description = robot(tmp_path)
    path = tmp_path / "robot.xml"
    off = '<mujoco><option><flag contact="disable" gravity="disable"/></option>'
    path.write_text(path.read_text(encoding="utf-8").replace("<mujoco>", off, 1), encoding="utf-8")
    flags = load_model(description).opt.disableflags
    assert not flags & mujoco.mjtDisableBit.mjDSBL_CONTACT
    assert flags & mujoco.mjtDisableBit.mjDSBL_GRAVITY


@pytest.mark.parametrize(
    ("left_out", "said"),
    [
        ("0.0955", r"pose 'lie' the \w\w toe of .*robot.xml is 1\.\d cm from where the lengths"),
        ("-1.0472", "FL_abad turns from -0.863 to 0.863 rad in .*, from -1.047 to 1.047 rad in its robot.toml"),
    ],
)
def test_numbers_of_another_robot_are_refused(left_out, said, tmp_path):
    with pytest.raises(AssetError, match=said):
        load_model(robot(tmp_path, left_out=left_out))

"""A robot's folder that is written from its MJCF."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mimic.cli import main
from mimic.errors import AssetError, ConfigError
from mimic.flows.new_robot import new_robot
from mimic.io.assets import shipped
from mimic.robot.description import load_description
from mimic.robot.goals import draw_goals
from mimic.robot.model import read_model


@pytest.mark.parametrize("name", ["go2", "cyberdog2"])
def test_the_numbers_of_a_shipped_model_are_found_again(name, tmp_path):
    theirs = load_description(name)
    found, guessed = new_robot(theirs.mjcf, tmp_path / "again")
    text = (tmp_path / "again" / "robot.toml").read_text(encoding="utf-8")
    assert guessed == text.count("# GUESSED") > 0
    assert np.allclose(found.leg.origin, theirs.leg.origin, atol=1e-6)
    assert found.leg.thigh == pytest.approx(theirs.leg.thigh)
    assert np.allclose(found.leg.toe, theirs.leg.toe, atol=1e-6)
    assert found.toe_radius == theirs.toe_radius
    assert np.all(found.q_min >= theirs.q_min - 1e-6)
    assert np.all(found.q_max <= theirs.q_max + 1e-6)
    assert np.allclose(found.armature, theirs.armature)
    assert draw_goals(found, 20, np.random.default_rng(0)).shape == (20, 2, 3)


def test_the_heights_and_the_upright_pose_of_a_go2_are_those_that_were_found_by_hand(tmp_path):
    theirs = load_description("go2")
    found, _ = new_robot(theirs.mjcf, tmp_path / "again")
    for pose in ("lie", "four", "upright"):
        assert found.pose_height[pose] == pytest.approx(theirs.pose_height[pose], abs=1e-3)
        assert np.allclose(found.poses[pose], theirs.poses[pose], atol=5e-3)


def test_the_command_says_what_was_guessed_and_what_to_do_next(tmp_path, capsys):
    out = tmp_path / "mine"
    assert main(["robot", "new", str(load_description("go2").mjcf), "-o", str(out)]) == 0
    said = capsys.readouterr().out
    assert re.search(r"guessed .* \d+ numbers", said)
    assert f"--robot-model {out}" in said.splitlines()[-1]
    assert load_description(out).name == "mine"


def plain_go2():
    """Return the Go2's MJCF without what names its motors."""
    spec = mujoco.MjSpec.from_file(str(load_description("go2").mjcf))
    for part in (*spec.actuators, *spec.sensors, *spec.keys, *spec.excludes, *spec.pairs):
        spec.delete(part)
    return spec


def saved(spec, folder):
    file = folder / "other.xml"
    spec.compile()
    file.write_text(spec.to_xml(), encoding="utf-8")
    return file


def test_joints_that_turn_the_other_way_and_legs_of_other_names_make_the_same_robot(tmp_path):
    straight, _ = new_robot(saved(plain_go2(), tmp_path), tmp_path / "straight")
    spec = plain_go2()
    for joint in spec.joints:
        if "hip" in joint.name or "knee" in joint.name:
            joint.axis = [0, -1, 0]
            joint.range = -joint.range[::-1]
    for part in (*spec.joints, *spec.geoms, *spec.sites, *spec.bodies[1:]):
        part.name = part.name.replace("RL", "hl").replace("RR", "hr").replace("FL", "fl").replace("FR", "fr")
    turned, _ = new_robot(saved(spec, tmp_path), tmp_path / "turned")
    assert turned.names.legs == ("fl", "fr", "hl", "hr")
    for pose in ("lie", "four", "upright"):
        assert np.allclose(turned.poses[pose], straight.poses[pose], atol=1e-6)
    q = np.random.default_rng(1).uniform(straight.q_min, straight.q_max)
    assert np.allclose(simulated_toes(turned, q), simulated_toes(straight, q), atol=1e-6)


def simulated_toes(description, q):
    model = read_model(description).compile()
    data = mujoco.MjData(model)
    data.qpos[-12:] = q
    mujoco.mj_kinematics(model, data)
    return data.site_xpos


def too_stiff(spec):
    for leg in ("RL", "RR"):
        spec.joint(f"{leg}_hip").range = [-1.57, 1.57]


def without_names(spec):
    for link in [body for body in spec.bodies if body.name != "world"]:
        link.name = ""
    for shape in spec.geoms:
        shape.name = ""


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (too_stiff, r"cannot stand so; its hind hips turn from -1.57 to 1.57 rad"),
        (lambda spec: spec.delete(spec.body("RR_knee")), "11 hinges in 4 chains; expected four legs of three joints"),
        (lambda spec: spec.delete(spec.geom("FL_toe")), "has no ball at the toe of FL"),
        (lambda spec: setattr(spec.joint("FL_knee"), "name", "elbow"), "expected names that differ by FL, FR, RL, RR"),
        (without_names, "joints or links have no names; name them"),
        (lambda spec: setattr(spec.joint("FL_knee"), "axis", [0, 0, 1]), r"FL_knee' must turn about"),
    ],
)
def test_a_model_of_another_kind_is_refused_and_nothing_is_left(change, said, tmp_path):
    spec = plain_go2()
    change(spec)
    file = saved(spec, tmp_path)
    with pytest.raises(AssetError, match=said):
        new_robot(file, tmp_path / "robot")
    assert list(tmp_path.iterdir()) == [file]


PAINT = '<asset><texture name="paint" type="2d" file="paint.png"/><material name="paint" texture="paint"/></asset>'


def test_a_picture_that_is_not_there_and_a_shape_that_one_leg_alone_has_do_no_harm(tmp_path):
    spec = plain_go2()
    spec.body("FL_hip").add_geom(size=[0.01, 0, 0])
    file = saved(spec, tmp_path)
    text = file.read_text().replace("_knee", "_calf").replace("<worldbody>", f"{PAINT}<worldbody>", 1)
    file.write_text(text)
    found, _ = new_robot(file, tmp_path / "robot")
    assert found.names.patterns["thigh"] == ("{leg}_thigh",)


def test_a_model_whose_inertia_no_body_can_have_is_refused_in_a_line(tmp_path):
    file = saved(plain_go2(), tmp_path)
    file.write_text(re.sub('diaginertia="[^"]*"', 'diaginertia="1 1 9"', file.read_text(), count=1))
    with pytest.raises(AssetError, match="inertia must satisfy"):
        new_robot(file, tmp_path / "robot")


def test_a_folder_that_is_there_is_kept(tmp_path):
    with pytest.raises(ConfigError, match="exists; name another folder"):
        new_robot(Path(shipped("assets") / "go2" / "go2.xml"), tmp_path)


def test_a_joint_without_limits_turns_as_far_as_it_can_and_what_a_model_includes_comes_along(tmp_path):
    spec = plain_go2()
    for joint in spec.joints:
        if joint.name.endswith(("_hip", "_knee")):
            joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    spec.compile()
    floor = tmp_path / "floor.xml"
    floor.write_text('<mujoco><worldbody><geom name="ground" type="plane" size="1 1 .1"/></worldbody></mujoco>')
    mjcf = tmp_path / "go2.xml"
    mjcf.write_text(spec.to_xml().replace("<worldbody>", '<include file="floor.xml"/><worldbody>', 1))
    found, _ = new_robot(mjcf, tmp_path / "mine")
    assert found.q_max[1] == pytest.approx(np.pi)
    assert (found.q_min[2], found.q_max[2]) == pytest.approx((-np.pi, 0.0))
    assert (tmp_path / "mine/robot.toml").read_text().count("the MJCF has no limit") == 3
    floor.unlink()
    assert read_model(load_description(tmp_path / "mine")).geom("ground").name == "ground"

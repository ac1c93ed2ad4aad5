from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mimic.errors import AssetError
from mimic.records import JOINTS
from mimic.robot.description import RobotDescription, load_description


def test_every_pose_keeps_inside_the_joint_limits(description):
    assert set(description.poses) == {"lie", "four", "upright"}
    for q in description.poses.values():
        assert np.all(q > description.q_min)
        assert np.all(q < description.q_max)


def test_legs_have_the_limits_of_their_end(description):
    by_name = {name: (description.q_min[i], description.q_max[i]) for i, name in enumerate(JOINTS)}
    for part in ("abad", "hip", "knee"):
        assert by_name[f"FL_{part}"] == by_name[f"FR_{part}"]
        assert by_name[f"RL_{part}"] == by_name[f"RR_{part}"]
    assert by_name["RL_hip"][1] > by_name["FL_hip"][1]


def test_a_policy_runs_at_50_hz_over_physics_at_200_hz(description):
    assert description.dt == pytest.approx(1 / 50)
    assert description.timestep == pytest.approx(1 / 400)


def test_upright_is_a_direction(description):
    assert np.linalg.norm(description.upright_direction) == pytest.approx(1.0)
    assert description.upright_direction[1] == 0.0


def test_goal_boxes_have_volume_and_shares_of_one(description):
    assert description.goals.share.sum() == pytest.approx(1.0)
    assert np.all(description.goals.low < description.goals.high)


def test_the_overload_table_goes_from_little_to_much(description, overload):
    torque, seconds = overload
    assert np.all(np.diff(torque) > 0)
    assert np.all(np.diff(seconds) < 0)
    assert np.all(description.torque_rated < torque[0])
    assert np.all(torque[-1] == description.torque_max)


def test_an_unknown_robot_is_refused():
    with pytest.raises(AssetError, match="name a shipped robot"):
        load_description("spot")


def edited(text: str, folder: Path) -> RobotDescription:
    (folder / "robot.toml").write_text(text, encoding="utf-8")
    return load_description(folder)


def test_a_missing_number_is_reported_by_name(description, tmp_path):
    text = (description.folder / "robot.toml").read_text(encoding="utf-8").replace("torque_rated =", "torque_rotted =")
    with pytest.raises(AssetError, match=r"robot\.toml lacks 'torque_rated'"):
        edited(text, tmp_path)


def test_a_pose_that_lacks_a_joint_is_refused(description, tmp_path):
    text = (description.folder / "robot.toml").read_text(encoding="utf-8")
    text = text.replace("four = { z = 0.259, up = 0.0, q = [0.0, ", "four = { z = 0.259, up = 0.0, q = [")
    with pytest.raises(AssetError, match="does not have 12 joints"):
        edited(text, tmp_path)


def test_a_description_is_found_by_its_name_its_folder_and_its_file(description):
    assert load_description(description.folder) is description
    assert load_description(description.folder / "robot.toml") is description
    assert load_description("cyberdog2") is description


def test_a_folder_without_a_description_is_refused(tmp_path):
    with pytest.raises(AssetError, match=r"there is no .*robot\.toml"):
        load_description(tmp_path)

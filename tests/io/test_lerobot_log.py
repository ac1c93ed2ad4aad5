"""A LeRobot dataset as a log of servos."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mimic.errors import CalibrationError
from mimic.io.joint_log import read_log

MOTORS = ["shoulder_pan", "gripper"]
RANGES = {"shoulder_pan": (1024, 3072), "gripper": (2000, 3024)}
STATES = [[[0.0, 50.0], [10.0, 60.0], [20.0, 60.0]], [[-5.0, 0.0], [-4.0, 1.0]]]
ACTIONS = [[[50.0, 100.0], [60.0, 0.0], [70.0, 50.0]], [[-10.0, 5.0], [-20.0, 6.0]]]


@pytest.fixture
def calibration(tmp_path):
    file = tmp_path / "my_follower.json"
    motors = {
        name: {"id": 1, "drive_mode": 0, "homing_offset": 7, "range_min": low, "range_max": high}
        for name, (low, high) in RANGES.items()
    }
    file.write_text(json.dumps(motors), encoding="utf-8")
    return file


@pytest.fixture
def dataset(tmp_path):
    """Return a function that writes a dataset of two episodes at 50 rows a second."""

    def write(names=None, files=1, **other):
        folder = tmp_path / "dataset"
        (folder / "meta").mkdir(parents=True)
        own = [f"{motor}.pos" for motor in MOTORS] if names is None else names
        features = {"observation.state": {"names": own}, "action": {"names": own}} | other
        (folder / "meta/info.json").write_text(json.dumps({"fps": 50, "features": features}), encoding="utf-8")
        rows = [(e, k) for e, states in enumerate(STATES) for k in range(len(states))]
        table = pa.table(
            {
                "observation.state": [STATES[e][k] for e, k in rows],
                "action": [ACTIONS[e][k] for e, k in rows],
                "timestamp": pa.array([0.02 * k for _, k in rows], pa.float32()),
                "episode_index": [e for e, _ in rows],
            }
        )
        (folder / "data/chunk-000").mkdir(parents=True)
        if files == 1:
            pq.write_table(table, folder / "data/chunk-000/file-000.parquet")
        for number in range(files if files > 1 else 0):
            own = table.filter(pa.compute.equal(table["episode_index"], number))
            pq.write_table(own, folder / f"data/chunk-000/episode_{number:06d}.parquet")
        return folder

    return write


@pytest.mark.parametrize("files", [1, 2])
def test_percent_of_the_range_become_radians_from_its_middle(dataset, calibration, files):
    log = read_log(dataset(files=files), {"calibration": str(calibration)})
    assert log.joints == ("shoulder_pan", "gripper")
    assert log.q[:, 0] == pytest.approx(np.array([0, 10, 20, -5, -4]) / 100 * np.pi / 2)
    assert log.q[:, 1] == pytest.approx((np.array([50, 60, 60, 0, 1]) - 50) / 100 * np.pi / 2)


def test_an_action_is_in_effect_in_the_row_after_and_not_in_the_next_episode(dataset, calibration):
    q_des = read_log(dataset(), {"calibration": str(calibration)}).q_des[:, 0] / (np.pi / 2) * 100
    assert np.isnan(q_des[[0, 3]]).all()
    assert q_des[[1, 2, 4]] == pytest.approx([50, 60, -10])


def test_episodes_follow_each_other_a_second_apart(dataset, calibration):
    t = read_log(dataset(), {"calibration": str(calibration)}).t
    assert t == pytest.approx([0, 0.02, 0.04, 1.04, 1.06])


def test_degrees_are_said_and_a_gripper_without_a_range_is_no_joint(dataset):
    log = read_log(dataset(names={"motors": MOTORS}), {"units": "deg"})
    assert log.joints == ("shoulder_pan",)
    assert log.q[:, 0] == pytest.approx(np.deg2rad([0, 10, 20, -5, -4]))
    assert log.extra["percent.gripper"] == pytest.approx([50, 60, 60, 0, 1])


def test_values_of_which_nothing_is_said_are_refused(dataset):
    with pytest.raises(CalibrationError, match=r"--note calibration=FILE.*--note units=deg"):
        read_log(dataset())


@pytest.mark.parametrize(
    ("features", "said"),
    [
        ({"names": []}, "names no motors of observation.state"),
        ({"action": {"names": ["elbow.pos"]}}, "has other motors in action"),
        ({"names": ["wrist.pos", "gripper.pos"]}, "no range_min and range_max of wrist"),
        ({"names": ["gripper.pos"]}, r"has rows of \(2,\) positions; expected 1"),
    ],
)
def test_what_does_not_fit_is_named(dataset, calibration, features, said):
    with pytest.raises(CalibrationError, match=said):
        read_log(dataset(**features), {"calibration": str(calibration)})

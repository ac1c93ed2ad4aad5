from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.errors import ContractError
from mimic.records import JOINTS, LANDMARKS, CommandTrack, JointSamples, PoseTrack, WristTrack


def wrists(rows: int = 3, **changes: np.ndarray) -> WristTrack:
    values = {
        "t": np.arange(rows) / 30,
        "p_SH": np.zeros((rows, 2, 3)),
        "heading": np.zeros(rows),
        "valid": np.ones((rows, 2), dtype=bool),
    }
    return WristTrack(**(values | changes))


def test_a_record_keeps_a_copy_of_what_it_was_given():
    heading = np.zeros(3)
    track = wrists(heading=heading)
    heading[:] = 7.0
    assert not track.heading.any()


def test_the_arrays_of_a_record_cannot_be_written():
    track = wrists()
    with pytest.raises(ValueError, match="read-only"):
        track.p_SH[0, 0, 0] = 1.0


def test_the_fields_of_a_record_cannot_be_replaced():
    with pytest.raises(dataclasses.FrozenInstanceError):
        wrists().heading = np.ones(3)  # type: ignore[misc]


def test_a_changed_copy_of_a_record_is_checked_again():
    with pytest.raises(ContractError, match="heading"):
        dataclasses.replace(wrists(), heading=np.zeros(4))


def test_lists_and_whole_numbers_become_arrays_of_the_declared_kind():
    track = wrists(t=[0, 1, 2], valid=np.ones((3, 2), dtype=int))
    assert track.t.dtype == np.float64
    assert track.valid.dtype == np.bool_


@pytest.mark.parametrize(
    ("field", "shape"),
    [("p_SH", (3, 2)), ("p_SH", (3, 3, 2)), ("p_SH", (4, 2, 3)), ("heading", (3, 1)), ("heading", ()), ("valid", (2,))],
)
def test_a_wrong_shape_is_reported_with_what_was_given_and_expected(field, shape):
    with pytest.raises(ContractError) as error:
        wrists(**{field: np.zeros(shape)})
    text = str(error.value)
    assert f"WristTrack.{field}" in text
    assert str(shape) in text
    assert "expected (3" in text


def test_a_record_of_no_rows_is_a_record():
    assert wrists(rows=0).p_SH.shape == (0, 2, 3)


def test_joint_arrays_have_a_column_for_each_joint():
    columns = {name: np.zeros((2, 12)) for name in ("q", "dq", "tau", "q_des")}
    assert JointSamples(t=np.zeros(2), **columns).q.shape[1] == len(JOINTS)
    with pytest.raises(ContractError, match=r"JointSamples\.tau"):
        JointSamples(t=np.zeros(2), **(columns | {"tau": np.zeros((2, 11))}))


def test_a_command_has_two_velocities_and_two_toes():
    with pytest.raises(ContractError, match=r"CommandTrack.v has shape \(5, 3\)"):
        CommandTrack(t=np.zeros(5), v=np.zeros((5, 3)), heading=np.zeros(5), p_BE=np.zeros((5, 2, 3)))


def pose(names: tuple[str, ...]) -> PoseTrack:
    n = len(names)
    return PoseTrack(
        t=np.zeros(1),
        landmarks=np.zeros((1, n, 3)),
        image=np.zeros((1, n, 2)),
        score=np.zeros((1, n)),
        valid=np.zeros((1, n), dtype=bool),
        swapped=np.zeros(1, dtype=bool),
        names=names,
    )


def test_a_pose_may_have_other_landmarks_than_those_of_the_detector():
    track = pose(("left_wrist", "right_wrist"))
    assert track.index("right_wrist") == 1


def test_an_unknown_landmark_is_reported_with_those_that_exist():
    with pytest.raises(ContractError, match=r"left_antenna.*it has nose, left_eye_inner"):
        pose(LANDMARKS).index("left_antenna")


def test_times_that_decrease_are_refused_with_their_row():
    still = {"v": np.zeros((3, 2)), "heading": np.zeros(3), "p_BE": np.zeros((3, 2, 3))}
    with pytest.raises(ContractError, match=r"CommandTrack\.t decreases: row 2 is at 0\.01 s, after 0\.02 s"):
        CommandTrack(t=np.array([0.0, 0.02, 0.01]), **still)

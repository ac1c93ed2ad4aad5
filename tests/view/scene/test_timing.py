import numpy as np
import pytest

from mimic.records import PHASES, RunLog
from mimic.view.scene.timing import camera_path, frame_numbers, hold_first_row, nearest, shared_time


def test_zero_is_the_first_tick_of_tracking(log: RunLog) -> None:
    clock = shared_time(log)
    first = np.flatnonzero(log.phase == PHASES.index("track"))[0]
    assert clock[first] == 0.0
    assert clock[0] == pytest.approx(-first * 0.02)
    np.testing.assert_allclose(np.diff(clock), np.diff(log.t))


def test_nearest_row_of_each_time() -> None:
    t = np.array([0.0, 1.0, 3.0])
    np.testing.assert_array_equal(nearest(t, np.array([-5.0, 0.4, 0.6, 1.9, 2.1, 9.0])), [0, 0, 1, 1, 2, 2])
    np.testing.assert_array_equal(nearest(t[:1], np.array([-1.0, 1.0])), [0, 0])


def test_first_row_is_repeated_at_an_earlier_start_only() -> None:
    t, rows = hold_first_row(np.array([0.0, 0.1]), -2.0)
    np.testing.assert_array_equal(t, [-2.0, 0.0, 0.1])
    np.testing.assert_array_equal(rows, [0, 0, 1])
    np.testing.assert_array_equal(hold_first_row(np.array([0.0, 0.1]), 0.0)[1], [0, 1])


def test_camera_follows_steps_of_the_base_smoothly(log: RunLog) -> None:
    path = camera_path(log, log.p_WB)
    assert path.shape == (len(log.t), 2)
    assert np.abs(np.diff(path[:, 0])).max() < np.abs(np.diff(log.p_WB[:, 0])).max()
    assert log.p_WB[0, 0] <= path[0, 0] <= path[-1, 0] <= log.p_WB[-1, 0]


def test_frame_numbers_follow_the_frames_and_stay_beside_them() -> None:
    frames = np.array([0.0, 0.1, 0.2, 0.4, 0.5])
    at = np.array([-0.25, -0.05, 0.0, 0.0999, 0.15, 0.35, 0.4, 0.5, 0.65])
    assert frame_numbers(at, frames).tolist() == [0, 0, 0, 1, 1, 2, 3, 4, 4]
    assert frame_numbers(np.array([0.0]), np.array([0.0])).tolist() == [0]

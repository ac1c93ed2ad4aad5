from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.errors import ConfigError
from mimic.policy.walks import corrected
from mimic.records import CommandTrack

TABLE = "[walks]\nasked = [-0.3, 0.3]\nwalked = [-0.2, 0.4]\nlost = [0.5, 1.0]\nreversed = [1.5, 2.0]\n"


@pytest.fixture
def policy(tmp_path):
    (tmp_path / "own.toml").write_text(TABLE)
    return tmp_path / "own.onnx"


def track(*pieces: tuple[float, float]) -> CommandTrack:
    v = np.concatenate([np.full(round(seconds / 0.02), speed) for speed, seconds in pieces])
    zeros = np.zeros((len(v), 2, 3))
    return CommandTrack(t=0.02 * np.arange(len(v)), v=np.stack([v, 0 * v], 1), heading=0 * v, p_BE=zeros)


def test_it_is_asked_for_the_speed_that_covers_the_distance_in_what_is_left_of_the_time(policy):
    v = corrected(track((0.0, 1.0), (0.25, 4.0)), policy).v
    assert np.all(v[:50] == 0.0)
    lost = np.interp(0.25, [-0.2, 0.4], [0.5, 1.0])
    np.testing.assert_allclose(v[50:, 0], np.interp(1.0 / (4.0 - lost), [-0.2, 0.4], [-0.3, 0.3]))


def test_a_walk_after_one_in_the_other_direction_has_its_own_time(policy):
    v = corrected(track((0.2, 4.0), (-0.05, 4.0)), policy).v
    np.testing.assert_allclose(v[-1, 0], np.interp(-0.2 / 2.5, [-0.2, 0.4], [-0.3, 0.3]))


def test_it_is_never_asked_for_more_than_was_measured(policy):
    assert np.abs(corrected(track((-0.3, 1.0)), policy).v).max() == 0.3


def test_without_a_table_nothing_changes(tmp_path):
    given = track((0.2, 1.0))
    assert corrected(given, tmp_path / "other.onnx") is given


def test_a_table_that_is_none_is_refused(policy):
    policy.with_suffix(".toml").write_text(TABLE.replace("[-0.2, 0.4]", "[0.4, -0.2]"))
    with pytest.raises(ConfigError, match="rising"):
        corrected(dataclasses.replace(track((0.2, 1.0))), policy)

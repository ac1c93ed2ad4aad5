"""Speed and turning reached by what is asked."""

from __future__ import annotations

import numpy as np
import pytest

from lab.policies.studies import walking
from lab.policies.studies.walking import ARMS, evaluate_walking, swing_heights
from mimic.config.evaluation import EpisodeSettings
from mimic.io.assets import shipped


@pytest.fixture(scope="module")
def walked():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(walking, "SPEEDS", (-0.3, 0.0, 0.6))
        patch.setattr(walking, "TURNS", (-1.0,))
        patch.setattr(walking, "SECONDS", 5.5)
        return evaluate_walking(
            shipped("policies", "stand_track.onnx"), range(1, 2), EpisodeSettings(episodes=1, seconds=5.5, workers=1)
        )


def test_every_speed_and_turn_is_walked_with_still_and_with_moving_arms(walked):
    asked = [(w["asked_m_s"], w["arms"]) for w in walked["walking"]]
    assert asked == [(v, arms) for v in (-0.3, 0.0, 0.6) for arms in ARMS]
    asked = [(w["asked_rad_s"], w["arms"]) for w in walked["turning"]]
    assert asked == [(-1.0, arms) for arms in ARMS]


def test_the_shipped_policy_walks_the_way_it_is_reported_also_beyond_its_training(walked):
    reached = {(w["asked_m_s"], w["arms"]): w["reached_m_s"] for w in walked["walking"]}
    assert not any(w["fell"] for w in walked["walking"])
    assert reached[-0.3, "still"] < -0.1
    assert abs(reached[0.0, "still"]) < 0.1
    assert reached[0.6, "still"] > 0.35  # faster than the 0.3 m/s that other commands are clamped to


def test_the_shipped_policy_turns_as_asked(walked):
    for turn in walked["turning"]:
        assert turn["reached_rad_s"] == pytest.approx(turn["asked_rad_s"], abs=0.2)
        assert not turn["fell"]


def test_the_error_is_against_what_was_asked(walked):
    for rows, unit in ((walked["walking"], "m_s"), (walked["turning"], "rad_s")):
        for row in rows:
            error = abs(row[f"reached_{unit}"] - row[f"asked_{unit}"])
            assert row[f"worst_error_{unit}"] == pytest.approx(error)
            assert np.isfinite(error)


def test_who_walks_faster_lifts_its_feet_higher(walked):
    height = {(w["asked_m_s"], w["arms"]): w["step_height_m"] for w in walked["walking"]}
    assert height[0.6, "still"] > 0.01
    assert height[0.6, "still"] > (height[0.0, "still"] or 0.0)


def test_a_step_is_as_high_as_its_highest_point_and_counts_only_if_it_begins_and_ends():
    left = [0.0, 0.01, 0.03, 0.02, 0.0, 0.0, 0.004, 0.0]
    right = [0.02, 0.0, 0.0, 0.0005, 0.0, 0.0, 0.05, 0.05]
    assert swing_heights(np.array([left, right]).T) == pytest.approx([0.03, 0.004])
    assert swing_heights(np.zeros((5, 2))) == []


def test_nothing_is_walked_without_a_seed():
    nothing = evaluate_walking(
        shipped("policies", "stand_track.onnx"), range(0), EpisodeSettings(episodes=1, seconds=5.5)
    )
    assert nothing == {"walking": [], "turning": []}

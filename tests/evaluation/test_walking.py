"""Speed reached by speed asked."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.config.play import AS_DESCRIBED
from mimic.evaluation import walking
from mimic.evaluation.walking import ARMS, evaluate_walking
from mimic.io.assets import shipped


@pytest.fixture(scope="module")
def walked():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(walking, "SPEEDS", (-0.3, 0.0, 0.6))
        patch.setattr(walking, "SECONDS", 5.5)
        return evaluate_walking(shipped("policies", "stand_track.onnx"), range(1, 2), AS_DESCRIBED, workers=1)


def test_every_speed_is_walked_with_still_and_with_moving_arms(walked):
    assert [(w["asked_m_s"], w["arms"]) for w in walked] == [(v, arms) for v in (-0.3, 0.0, 0.6) for arms in ARMS]


def test_the_shipped_policy_walks_the_way_it_is_reported_also_beyond_its_training(walked):
    reached = {(w["asked_m_s"], w["arms"]): w["reached_m_s"] for w in walked}
    assert not any(w["fell"] for w in walked)
    assert reached[-0.3, "still"] < -0.1
    assert abs(reached[0.0, "still"]) < 0.1
    assert reached[0.6, "still"] > 0.35  # faster than the 0.3 m/s that other commands are clamped to


def test_the_error_is_against_what_was_asked(walked):
    for walk in walked:
        assert walk["worst_error_m_s"] == pytest.approx(abs(walk["reached_m_s"] - walk["asked_m_s"]))
    assert np.isfinite([walk["worst_error_m_s"] for walk in walked]).all()


def test_nothing_is_walked_without_a_seed():
    assert evaluate_walking(shipped("policies", "stand_track.onnx"), range(0), AS_DESCRIBED) == []

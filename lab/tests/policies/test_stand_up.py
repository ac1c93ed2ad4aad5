from __future__ import annotations

import json
from dataclasses import replace

import pytest

from lab.policies.studies.settings import StandUpSettings
from lab.policies.studies.stand_up import evaluate_stand_up, summarise
from mimic.errors import AssetError
from mimic.io.assets import shipped
from mimic.io.store import plain

FEW = StandUpSettings(episodes=3, still_episodes=1, still_seconds=2.0, workers=1)


@pytest.fixture(scope="module")
def evaluated() -> dict:
    return evaluate_stand_up(shipped("policies", "stand_track.onnx"), FEW)


def test_every_start_and_every_standing_robot_is_evaluated(evaluated):
    kinds = [row["kind"] for row in evaluated["episodes"]]
    assert kinds.count("rise") == 3
    assert kinds.count("still") == 1
    assert [row["seed"] for row in evaluated["episodes"] if row["kind"] == "rise"] == [1, 2, 3]


def test_the_shipped_policy_stands_up_and_stays_inside_its_motors(evaluated):
    s = evaluated["summary"]
    assert s["upright_in_time"] == 1.0
    assert 0.1 < s["stand_up_median_s"] <= s["stand_up_p95_s"] < 1.5
    assert 1.0 < s["joint_speed_max_rad_s"] <= s["joint_speed_limit_rad_s"]
    assert 4.0 < s["torque_max_nm"] <= s["torque_limit_nm"] + 1e-9
    assert s["still_drift_mean_m"] <= s["still_drift_max_m"] <= s["still_farthest_m"] < 0.5


def test_the_same_seeds_give_the_same_figures(evaluated):
    one = replace(FEW, episodes=1)
    again = evaluate_stand_up(shipped("policies", "stand_track.onnx"), one)["episodes"]
    assert json.dumps(plain(again)) == json.dumps(plain([e for e in evaluated["episodes"] if e["seed"] == 1]))


def test_a_start_counts_when_it_is_upright_in_time_and_kept_when_it_stays_so(description):
    def rise(time: float, stands: bool) -> dict:
        figures = {"joint_speed_max_rad_s": 5.0, "torque_max_nm": 9.0}
        return {"kind": "rise", "stand_up_s": time, "stands_at_end": stands} | figures

    s = summarise([rise(0.8, True), rise(0.9, False), rise(1.6, True), rise(float("inf"), False)], description)
    assert s["upright_in_time"] == 0.5
    assert s["upright_in_time_and_kept"] == 0.25
    assert s["stand_up_median_s"] == pytest.approx(1.25)


def test_a_policy_that_only_falls_is_evaluated_too(tmp_path, constant_onnx):
    s = evaluate_stand_up(constant_onnx(tmp_path / "useless.onnx"), replace(FEW, episodes=1))["summary"]
    assert s["upright_in_time_and_kept"] == 0.0
    assert s["still_drift_mean_m"] == float("inf")


def test_a_policy_that_is_not_there_is_refused_at_once(tmp_path):
    with pytest.raises(AssetError, match="there is no policy"):
        evaluate_stand_up(tmp_path / "nowhere.onnx", FEW)

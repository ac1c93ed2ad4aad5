from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import pytest

from mimic.config.evaluation import EvaluateSettings
from mimic.control.arms import arm_joints
from mimic.errors import AssetError, ContractError
from mimic.evaluation import policy
from mimic.evaluation.policy import GOAL_SECONDS, command_script, evaluate, goal_path
from mimic.io.assets import shipped
from mimic.io.store import plain
from mimic.robot.description import load_description
from mimic.robot.goals import draw_goals
from mimic.robot.reach import Reach

FEW = EvaluateSettings(episodes=2, seconds=2.0, workers=1)

FIGURES = {
    "episodes",
    "stood_up_and_kept",
    "stood_up",
    "stand_up_median_s",
    "stand_up_p95_s",
    "randomised_toe_error_cm",
    "nominal_toe_error_cm",
    "nominal_drift_m",
    "nominal_knee_torque_rms_nm",
    "nominal_minutes_to_limit",
    "walk_m_s",
    "turn_error_rad",
    "nominal_falls",
}


def test_a_goal_path_goes_through_its_goals_in_time(description):
    goals = draw_goals(description, 4, np.random.default_rng(0))
    path = goal_path(goals, 600, 0.02, description)
    at = round(GOAL_SECONDS / 0.02)
    assert np.allclose(path[[0, at, 2 * at, 3 * at]], goals)
    assert np.array_equal(path[-1], path[3 * at])


def script(description, seed: int = 0, **options: float):
    return command_script(description, 20.0, np.random.default_rng(seed), **options)


@pytest.mark.parametrize("robot", ["cyberdog2", "go2"])
def test_scripts_ask_for_toes_within_reach_all_the_way_and_no_arm_jumps(robot):
    description = load_description(robot)
    for seed in range(5):
        track = script(description, seed)
        q, out_of_reach = arm_joints(track.p_BE, Reach(description), description.poses["upright"][:6])
        margin = np.minimum(q - description.q_min[:6], description.q_max[:6] - q).min()
        assert out_of_reach == 0
        assert margin > np.deg2rad(7.0) - 1e-9
        assert np.abs(np.diff(q, axis=0)).max() < 0.1


def test_scripts_are_those_of_their_seed(description):
    one, same, other = script(description, 1), script(description, 1), script(description, 2)
    assert np.array_equal(one.p_BE, same.p_BE)
    assert np.array_equal(one.v, same.v)
    assert not np.array_equal(one.p_BE, other.p_BE)


def test_scripts_walk_and_turn_as_in_the_paper_unless_given(description):
    free = script(description)
    assert np.abs(free.v[:, 0]).max() <= 0.3 + 1e-9
    assert not free.v[:, 1].any()
    assert len(np.unique(free.heading)) == 2
    fixed = script(description, speed=-0.3, turn=1.0)
    assert np.all(fixed.v[:, 0] == -0.3)
    assert np.all(fixed.heading == 1.0)


@pytest.fixture(scope="module")
def few_nominal_episodes() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(policy, "TOE_EPISODES", 1)
        patch.setattr(policy, "COMMAND_EPISODES", 1)
        yield


@pytest.fixture(scope="module")
def evaluated(few_nominal_episodes) -> tuple[dict, list]:
    seen: list[tuple[int, int]] = []
    path = shipped("policies", "stand_track.onnx")
    return evaluate(path, FEW, progress=lambda done, total: seen.append((done, total))), seen


@pytest.mark.slow
def test_a_policy_is_evaluated_by_these_figures(evaluated):
    result, _ = evaluated
    assert set(result["summary"]) == FIGURES
    assert result["policy"] == "stand_track.onnx"
    assert result["summary"]["episodes"] == 2
    assert 0.0 <= result["summary"]["stood_up_and_kept"] <= result["summary"]["stood_up"] <= 1.0
    assert set(result["summary"]["walk_m_s"]) == {"-0.3", "+0.3"}
    assert set(result["summary"]["turn_error_rad"]) == {"+90", "-60"}


@pytest.mark.slow
def test_every_kind_of_episode_is_played(evaluated):
    kinds = [row["kind"] for row in evaluated[0]["episodes"]]
    assert kinds.count("randomised") == 2
    assert {"toes", "walk", "turn"} < set(kinds)


@pytest.mark.slow
def test_progress_counts_all_episodes(evaluated):
    result, seen = evaluated
    total = len(result["episodes"])
    assert seen == [(i + 1, total) for i in range(total)]


@pytest.mark.slow
def test_episodes_are_numbered_by_their_seeds(evaluated):
    assert [row["seed"] for row in evaluated[0]["episodes"] if row["kind"] == "randomised"] == [1, 2]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # no walk has no mean
def test_the_same_seeds_give_the_same_figures(evaluated, monkeypatch):
    monkeypatch.setattr(policy, "COMMAND_EPISODES", 0)
    again = evaluate(shipped("policies", "stand_track.onnx"), FEW)["episodes"]
    first = [row for row in evaluated[0]["episodes"] if row["kind"] in ("randomised", "toes")]
    assert json.dumps(plain(again)) == json.dumps(plain(first))


@pytest.mark.slow
def test_a_policy_that_only_falls_is_evaluated_too(tmp_path, constant_onnx, few_nominal_episodes):
    result = evaluate(constant_onnx(tmp_path / "useless.onnx"), FEW)
    assert result["summary"]["stood_up_and_kept"] == 0.0
    assert result["summary"]["nominal_falls"] > 0
    assert all(row["falls"] for row in result["episodes"] if row["kind"] == "walk")


def test_a_policy_that_cannot_run_is_refused_at_once(tmp_path, constant_onnx):
    with pytest.raises(AssetError, match="there is no policy"):
        evaluate(tmp_path / "nowhere.onnx", FEW)
    with pytest.raises(ContractError, match="declares no contract"):
        evaluate(constant_onnx(tmp_path / "a.onnx", metadata=None), FEW)

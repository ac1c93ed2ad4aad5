from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.config.evaluation import SitDownEvaluateSettings
from mimic.control.plant import damping_command
from mimic.errors import ContractError
from mimic.evaluation.contact_recorder import ContactRecorder
from mimic.evaluation.sit_down import evaluate_sit_down, lies, summarise, time_to_lie
from mimic.policy.runtime import load_policy
from mimic.records import JointCommand
from mimic.simulation.plant import SimulatedPlant

FEW = SitDownEvaluateSettings(episodes=3, seconds=2.5, workers=1)

LYING = {"tilt_rad": 0.05, "height_m": 0.108, "moved_m": 0.01, "pose_error_rad": 0.05, "pose_error_max_rad": 0.12}


@pytest.fixture
def sinking_onnx(constant_onnx, contract, description, tmp_path):
    """A policy that asks for the lying pose at once."""
    lie = tuple(description.poses["lie"].tolist())
    metadata = dataclasses.replace(contract, task="sit_down", default_q=lie).to_json()
    return constant_onnx(tmp_path / "sinking.onnx", metadata=metadata)


def test_policy_switches_are_evaluated_and_repeat(sinking_onnx):
    result = evaluate_sit_down(sinking_onnx, FEW)
    assert result == evaluate_sit_down(sinking_onnx, FEW)
    assert len(result["episodes"]) == 3
    s = result["summary"]
    assert s["hand_overs"] + s["falling_before"] == 3
    for row in result["episodes"]:
        assert 1.5 <= row["at_s"] <= 2.6
        assert 1.0 < row["sinking_speed"] < 3.0  # nothing brakes it
        assert 0.2 < row["lying_after_s"] < 2.0


def test_time_to_lie_ends_where_the_base_stays_down():
    t = np.arange(6) * 0.1
    bounces = np.array([0.42, 0.30, 0.11, 0.15, 0.12, 0.11])
    assert time_to_lie(t, bounces, begin=0.1, final=0.11) == pytest.approx(0.2)
    assert time_to_lie(t, bounces, begin=0.4, final=0.11) == 0.0


def test_a_policy_for_something_else_is_refused(constant_onnx, tmp_path):
    with pytest.raises(ContractError, match="expected a policy for sit_down"):
        evaluate_sit_down(constant_onnx(tmp_path / "other.onnx"), FEW)


@pytest.mark.parametrize(
    "wrong", [{"tilt_rad": 2.8}, {"height_m": 0.3}, {"moved_m": 0.3}, {"pose_error_max_rad": 1.0}, {}]
)
def test_lying_means_level_low_still_and_folded(wrong):
    assert lies(LYING | wrong) is (not wrong)


def test_robots_that_fell_before_are_counted_apart():
    figures = {
        "impact_speed": 0.1,
        "lying_after_s": 1.1,
        "sinking_speed": 0.4,
        "acceleration": 9.0,
        "head_touched": False,
    }
    row = LYING | figures | {"trunk_touched": True, "gentle": True, "lies": True, "success": True, "handed_over": True}
    summary = summarise([row, row | {"success": False, "gentle": False}, row | {"handed_over": False}])
    assert summary["hand_overs"] == 2
    assert summary["falling_before"] == 1
    assert summary["success"] == 0.5
    assert summary["trunk_contacts"] == 2
    assert summary["impact_speed"]["max"] == 0.1


def test_what_touches_and_how_fast_is_seen_at_each_physics_step(description):
    """A robot that is dropped falls at a known speed, and sinks onto its belly when its legs go limp."""
    recorder = ContactRecorder(description)
    plant = SimulatedPlant(description, samples=False, observer=recorder)
    state = plant.start()
    plant.data.qpos[2] += 0.2
    folded = np.where(np.arange(12) % 3 == 0, 0.0, np.where(np.arange(12) % 3 == 1, 1.3, -2.5))
    stiff = JointCommand(
        q_des=folded, dq_des=np.zeros(12), kp=np.full(12, 30.0), kd=np.full(12, 3.0), tau_ff=np.zeros(12)
    )
    for _ in range(8):
        plant.step(stiff)
    flying = recorder.touchdown(0.0)
    assert not flying.trunk_touched
    assert flying.impact_speed == 0.0
    assert flying.sinking_speed == pytest.approx(9.81 * 0.16, rel=0.05)
    for _ in range(60):
        state = plant.step(damping_command(state.q, 0.2)).state
    down = recorder.touchdown(0.0)
    assert down.trunk_touched
    assert not down.head_touched
    assert 0.0 < down.impact_speed < down.sinking_speed
    assert down.acceleration > 9.0


@pytest.mark.slow
def test_the_shipped_policy_comes_down_gently(description):
    path = load_policy(None, description, task="sit_down").path
    s = evaluate_sit_down(path, SitDownEvaluateSettings(episodes=4, seconds=5.0, seed=7001, workers=1))["summary"]
    assert s["hand_overs"] == 4
    assert s["success"] == 1.0
    assert s["head_contacts"] == 0
    assert s["sinking_speed"]["p95"] < 0.9
    assert s["lying_after_s"]["p95"] < 1.2

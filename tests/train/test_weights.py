"""Weights of reward terms over a training."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mimic.cli import main
from mimic.config.rewards import FinishFactors, RewardWeights
from mimic.config.training import MdpSettings
from mimic.train.weights import REWARD_SCALE, SIT_DOWN, weight_table, weights_at

SETTINGS = MdpSettings(
    rewards=RewardWeights(gait=3.0, torque=-2.0, slip=-4.0, drift=-5.0, velocity=1.0),
    finish=FinishFactors(velocity=3.0, slip=2.0),
    finish_steps=(2_000.0, 4_000.0),
    rest_steps=(10_000.0, 20_000.0),
    curriculum_latest=1_000.0,
    curriculum_steps=500.0,
)


@pytest.mark.parametrize(
    ("steps", "ramp", "wanted"),
    [
        (0, 0.0, {"gait": 3.0, "torque": -2.0, "slip": -0.2, "drift": 0.0, "velocity": 1.0}),
        (3_000, 1.0, {"gait": 3.0, "torque": -2.5, "slip": -6.0, "drift": 0.0, "velocity": 2.0}),
        (15_000, 1.0, {"gait": 3.0, "torque": -4.0, "slip": -8.0, "drift": -2.5, "velocity": 3.0}),
        (50_000, 1.0, {"gait": 3.0, "torque": -4.0, "slip": -8.0, "drift": -5.0, "velocity": 3.0}),
    ],
)
def test_weights_grow_with_what_the_robot_has_learned(steps, ramp, wanted):
    weights = weights_at(SETTINGS, steps, ramp)
    assert {name: weights[name] for name in wanted} == pytest.approx(wanted)


def test_the_table_has_a_column_for_each_step_at_which_a_ramp_begins_or_ends():
    table = weight_table(SETTINGS)
    assert list(table) == [0, 1_000, 1_500, 2_000, 4_000, 10_000, 12_000, 20_000]
    assert table[1_000]["slip"] == pytest.approx(-0.2 * REWARD_SCALE)
    assert table[1_500]["slip"] == pytest.approx(-4.0 * REWARD_SCALE)
    assert table[20_000]["drift"] == pytest.approx(-5.0 * REWARD_SCALE)


def test_sitting_down_has_weights_of_its_own_that_only_the_regularisers_change():
    table = weight_table(replace(SETTINGS, task="sit_down"))
    assert list(table) == [0, 12_000]
    changed = {name for name in SIT_DOWN if table[0][name] != table[12_000][name]}
    assert changed == {"action_rate", "torque", "joint_velocity", "joint_acceleration"}


def test_the_command_shows_the_weights_without_a_folder_and_trains_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["train", "--show-weights", "--set", "rewards.gait=25"]) == 0
    told = [line.split() for line in capsys.readouterr().out.splitlines() if " gait " in line]
    assert [cell for cell in told[0] if cell[0].isdigit()] == ["0.2"] * 6
    assert not list(tmp_path.iterdir())


def test_a_training_without_a_folder_is_refused(capsys):
    assert main(["train"]) == 2
    assert "no folder for the training" in capsys.readouterr().err

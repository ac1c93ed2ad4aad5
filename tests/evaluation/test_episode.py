"""The rules of an evaluated episode."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.config.play import RAMP, TRIM, RunSettings
from mimic.errors import PlantError
from mimic.evaluation.episode import play_episode
from mimic.records import PHASES

SHORT = RunSettings(stand_up=1.0, blend=0.2, hold_last=0.1, sit_down=1.5, hold_position=False)
LEANING, FALLEN = np.deg2rad(78.7 - 35.0), np.deg2rad(10.0)
"""Angles of base x above the ground of a robot that is about to fall, and of one that has fallen [rad]."""


START = round((RAMP + TRIM) / 0.02)
"""Ticks until the policy begins; a robot in memory counts them too, a simulated one begins before 0."""


def tips(angle: float):
    return lambda tick: np.pi / 2 if tick < START + 65 else angle


@pytest.fixture
def sitter(fixed_policy, contract):
    policy = fixed_policy()
    policy.contract = dataclasses.replace(contract, task="sit_down")
    return policy


def test_a_tracking_episode_goes_on_while_the_robot_only_leans(memory_plant, fixed_policy, track):
    result = play_episode(memory_plant(pitch=tips(LEANING)), fixed_policy(), track(20), SHORT)
    assert result.fell_at is None
    assert len(result.log.t) == 50 + 10 + 20 + 5


def test_a_tracking_episode_ends_at_the_fall(memory_plant, fixed_policy, track):
    plant = memory_plant(pitch=tips(FALLEN))
    result = play_episode(plant, fixed_policy(), track(20), SHORT)
    assert result.fell_at == pytest.approx((START + 65) * 0.02)
    assert len(result.log.t) == 65
    assert plant.closed


def test_a_robot_about_to_fall_sits_down_in_an_episode_that_ends_so(memory_plant, fixed_policy, track, sitter):
    result = play_episode(memory_plant(pitch=tips(LEANING)), fixed_policy(), track(20), SHORT, sit_down=sitter)
    assert result.fell_at == pytest.approx((START + 65) * 0.02)
    assert {PHASES[i] for i in result.log.phase[65:]} == {"sit_down"}
    assert len(result.log.t) == 65 + 75


def test_rules_of_the_bus_do_not_end_an_episode(memory_plant, fixed_policy, track):
    def hot(tick, health):
        return dataclasses.replace(health, temperature=np.full(12, 90.0), imu_valid=False)

    result = play_episode(memory_plant(health=hot), fixed_policy(), track(20), SHORT)
    assert [event.rule for event in result.events] == ["finished"]


def test_what_fails_is_raised(memory_plant, fixed_policy, track):
    def fail(tick: int) -> None:
        if tick == 10:
            raise PlantError("no longer finite")

    with pytest.raises(PlantError, match="no longer finite"):
        play_episode(memory_plant(fail=fail), fixed_policy(), track(20), SHORT)

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.control.desired import clamp_desired
from mimic.control.plant import damping_command
from mimic.control.safety.supervisor import SafetyMode
from mimic.control.signals import Signals
from mimic.control.tick import Run, clamp_command
from mimic.records import JointCommand
from mimic.robot.goals import draw_goals
from mimic.robot.leg_kinematics import front_legs


def test_goals_of_the_training_pass_as_they_are(description):
    goals = draw_goals(description, 300, np.random.default_rng(0))
    for toes in goals:
        v, kept, moved = clamp_desired(description.commands.velocity, toes, description)
        assert moved == 0
        assert np.array_equal(kept, toes)
        assert np.array_equal(v, description.commands.velocity)


@pytest.mark.parametrize("away", [0.5, 5.0])
def test_toes_beyond_the_legs_are_drawn_to_them_and_counted(away, description, contract):
    toes = np.array(contract.neutral_toes).reshape(2, 3)
    toes[1] += away
    _, kept, moved = clamp_desired(np.zeros(2), toes, description)
    assert moved == 1
    assert np.array_equal(kept[0], toes[0])
    leg = front_legs(description)[1]
    assert np.linalg.norm(kept[1] - leg.origin - [0.0, leg.offset, 0.0]) < 0.4
    assert clamp_desired(np.zeros(2), kept + 1e-9 * np.sign(leg.origin - kept), description)[2] == 0


def test_a_walk_faster_than_trained_is_slowed_and_a_walk_sideways_is_not_played(description, contract):
    toes = np.array(contract.neutral_toes).reshape(2, 3)
    v, _, moved = clamp_desired(np.array([-0.9, 0.2]), toes, description)
    assert np.array_equal(v, [-0.3, 0.0])
    assert moved == 2


def command(**changes) -> JointCommand:
    zeros = np.zeros(12)
    fields = {"q_des": zeros, "dq_des": zeros, "kp": np.full(12, 30.0), "kd": np.full(12, 3.0), "tau_ff": zeros}
    return JointCommand(**{**fields, **changes})


def test_a_command_inside_passes_untouched(description):
    given = command(q_des=description.poses["upright"])
    assert clamp_command(given, description) == (given, 0)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [("q_des", 9.0, None), ("q_des", -9.0, None), ("kp", 600.0, 500.0), ("kd", 7.0, 5.0), ("tau_ff", -20.0, -12.0)],
)
def test_what_is_outside_is_clamped_and_counted(name, value, expected, description):
    base = command(q_des=description.poses["upright"])
    changed = getattr(base, name).copy()
    changed[5] = value
    kept, moved = clamp_command(dataclasses.replace(base, **{name: changed}), description)
    limit = (description.q_max if value > 0 else description.q_min)[5] if expected is None else expected
    assert moved == 1
    assert getattr(kept, name)[5] == limit
    assert np.array_equal(np.delete(getattr(kept, name), 5), np.delete(getattr(base, name), 5))


def test_what_a_rule_decides_reaches_the_plant_before_anybody_sees_the_tick(memory_plant, forgiving, description):
    signals = Signals()
    plant = memory_plant()
    seen = []
    run = Run(plant, 1, lambda tick: seen.append(plant.damped_after), None, forgiving(signals=signals))
    run.begin()
    still = damping_command(description.poses["lie"], 1.0)
    run.hold(still, 0)
    signals.terminated = True
    run.hold(still, 0)
    assert seen == [None, 2]


def test_what_the_loop_decides_reaches_the_plant_at_once(memory_plant, forgiving):
    plant = memory_plant()
    run = Run(plant, 1, None, None, forgiving())
    run.begin()
    run.decide("test", SafetyMode.SIT_DOWN, "it sits down")
    assert plant.damped_after is None
    run.decide("test", SafetyMode.DAMP, "it is damped")
    assert plant.damped_after == 0

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.control.plant import damping_command
from mimic.control.safety.supervisor import SafetyMode
from mimic.control.signals import Signals
from mimic.control.tick import Run, clamp_command
from mimic.records import JointCommand


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

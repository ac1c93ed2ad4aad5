from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.errors import ContractError, PlantError, SourceError
from mimic.metrics import run_metrics
from mimic.run.loop import run_policy
from mimic.settings import RunSettings
from mimic.types import PHASES, RunLog

SHORT = RunSettings(stand_up=1.0, blend=0.2, hold=0.1, sit_down=1.5)
BEFORE, LAST = 50 + 10 + 20 + 5, 75
"""Ticks until the sitting down, and of it, with a track of 20."""


@pytest.fixture
def sitter(told_policy, contract):
    """Return a policy that sits down."""
    policy = told_policy(says=lambda call: np.full(12, 0.25))
    policy.contract = dataclasses.replace(contract, task="sit_down", neutral_toes=(0.1,) * 6)
    return policy


def names(log: RunLog) -> list[str]:
    return [PHASES[i] for i in log.phase]


def once(error: BaseException, at: int):
    raised = []

    def fail(tick: int) -> None:
        if tick == at and not raised:
            raised.append(error)
            raise error

    return fail


def test_a_run_ends_by_sitting_down_and_damped(memory_plant, told_policy, sitter, track, contract):
    plant, tracker = memory_plant(), told_policy()
    result = run_policy(plant, tracker, track(20), SHORT, sit_down=sitter)
    assert names(result.log)[BEFORE - 5 :] == ["hold"] * 5 + ["sit_down"] * LAST
    assert len(tracker.seen) == BEFORE
    assert len(sitter.seen) == LAST
    assert np.array_equal(result.log.action[BEFORE:], np.full((LAST, 12), 0.25))
    assert not plant.sent[-1].kp.any()
    assert np.all(plant.sent[-1].kd == contract.kd)
    assert plant.closed
    assert result.log.metadata["sit_down"] == "told.onnx"
    assert result.fell_at is None
    assert not result.interrupted


@pytest.mark.parametrize(("frames", "sitting"), [(6, 3), (3, 6)])
def test_policies_of_a_run_may_remember_differently(
    memory_plant, told_policy, sitter, track, contract, frames, sitting
):
    tracker = told_policy()
    tracker.contract = dataclasses.replace(contract, history=frames)
    sitter.contract = dataclasses.replace(sitter.contract, history=sitting)
    seen = run_policy(memory_plant(), tracker, track(20), SHORT, sit_down=sitter).log.observation
    widths = tracker.contract.observation_size, sitter.contract.observation_size
    assert seen.shape == (BEFORE + LAST, max(widths))
    for rows, policy, width in zip(np.split(seen, [BEFORE]), (tracker, sitter), widths, strict=True):
        assert np.array_equal(rows[:, :width], policy.seen)
        assert np.isnan(rows[:, width:]).all()


def test_it_keeps_its_heading_and_is_asked_for_nothing(memory_plant, told_policy, sitter, track):
    log = run_policy(memory_plant(heading=0.7), told_policy(), track(20, turn=0.3), SHORT, sit_down=sitter).log
    rows = log.phase == PHASES.index("sit_down")
    assert np.allclose(log.heading_des[rows], 0.7)
    assert not log.v_des[rows].any()
    assert np.allclose(log.p_BE_des[rows], 0.1)


def test_it_begins_with_a_history_of_its_own(memory_plant, told_policy, sitter, track):
    run_policy(memory_plant(), told_policy(says=lambda call: np.full(12, 0.1)), track(20), SHORT, sit_down=sitter)
    frames = sitter.seen[0].reshape(3, -1)
    assert np.array_equal(frames[0], frames[2])
    assert not frames[0][18:30].any()  # no action before
    assert np.allclose(frames[0][-2:], [0.0, 1.0])  # its clock begins


def test_the_figures_of_a_run_do_not_see_the_sitting_down(memory_plant, told_policy, sitter, track, description):
    with_it = run_policy(memory_plant(), told_policy(), track(20), SHORT, sit_down=sitter).log
    without = run_policy(memory_plant(), told_policy(), track(20), SHORT).log
    assert int(with_it.aimed.sum()) == int(without.aimed.sum()) == BEFORE - 50
    one, other = run_metrics(with_it, description), run_metrics(without, description)
    for name in ("toe_error_cm", "standing_share", "heading_error_rad", "torque_nm", "minutes_to_limit"):
        assert one[name] == other[name]


@pytest.mark.parametrize("tick", [1, 30, 70])
def test_ctrl_c_sits_down_and_keeps_the_whole_log(tick, memory_plant, told_policy, sitter, track):
    plant = memory_plant(fail=once(KeyboardInterrupt(), tick))
    result = run_policy(plant, told_policy(), track(20), SHORT, sit_down=sitter)
    assert result.interrupted
    assert len(result.log.t) == tick + LAST
    assert names(result.log)[tick:] == ["sit_down"] * LAST
    assert plant.closed


def test_another_ctrl_c_ends_it_at_once(memory_plant, told_policy, sitter, track):
    first, second = once(KeyboardInterrupt(), 30), once(KeyboardInterrupt(), 40)

    def fail(tick: int) -> None:
        first(tick)
        second(tick)

    plant = memory_plant(fail=fail)
    result = run_policy(plant, told_policy(), track(20), SHORT, sit_down=sitter)
    assert result.interrupted
    assert len(result.log.t) == 40
    assert not plant.sent[-1].kp.any()
    assert plant.closed


def test_an_error_of_what_feeds_the_run_sits_down_and_is_told(memory_plant, told_policy, sitter, track):
    seen = []

    def sink(tick: object) -> None:
        seen.append(tick)
        if len(seen) == 60:
            raise SourceError("the camera is gone")

    plant = memory_plant()
    result = run_policy(plant, told_policy(), track(20), SHORT, sit_down=sitter, sink=sink)
    assert isinstance(result.error, SourceError)
    assert len(seen) == 60
    assert len(result.log.t) == 60 + LAST
    assert plant.closed


def test_a_policy_that_fails_is_followed_by_the_other_one(memory_plant, told_policy, sitter, track):
    def says(call: int) -> np.ndarray:
        if call == 65:
            raise RuntimeError("no idea")
        return np.zeros(12)

    result = run_policy(memory_plant(), told_policy(says=says), track(20), SHORT, sit_down=sitter)
    assert isinstance(result.error, RuntimeError)
    assert names(result.log)[65:] == ["sit_down"] * LAST


def test_a_plant_that_fails_is_not_asked_again(memory_plant, told_policy, sitter, track):
    plant = memory_plant(fail=once(PlantError("no answer"), 60))
    with pytest.raises(PlantError, match="no answer"):
        run_policy(plant, told_policy(), track(20), SHORT, sit_down=sitter)
    assert len(plant.sent) == 60
    assert plant.closed


def test_a_robot_about_to_fall_is_caught_before_it_has_fallen(memory_plant, told_policy, sitter, track):
    leaning = np.deg2rad(78.7 - 35.0)  # 35 degrees forward of the upright direction

    def pitch(tick: int) -> float:
        return np.pi / 2 if tick < 65 else leaning

    result = run_policy(memory_plant(pitch=pitch), told_policy(), track(20), SHORT, sit_down=sitter)
    assert result.fell_at == pytest.approx(65 * 0.02)
    assert names(result.log)[65:] == ["sit_down"] * LAST
    without = run_policy(memory_plant(pitch=pitch), told_policy(), track(20), SHORT)
    assert without.fell_at is None


def test_policies_do_what_they_were_trained_for(memory_plant, told_policy, sitter, track):
    with pytest.raises(ContractError, match="was trained for sit_down; expected stand_track"):
        run_policy(memory_plant(), sitter, track(20), SHORT)
    with pytest.raises(ContractError, match="was trained for stand_track; expected sit_down"):
        run_policy(memory_plant(), told_policy(), track(20), SHORT, sit_down=told_policy())

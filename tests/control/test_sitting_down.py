from __future__ import annotations

import dataclasses
import signal

import numpy as np
import pytest

from mimic.config.play import RunSettings
from mimic.control.loop import run_policy
from mimic.control.odometry import ARRIVAL
from mimic.errors import ContractError, SourceError
from mimic.metrics import run_metrics
from mimic.records import PHASES, RunLog

SHORT = RunSettings(stand_up=1.0, blend=0.2, hold_last=0.1, sit_down=1.5, hold_position=False)
BEFORE, LAST = 50 + 10 + 20 + 5, 75
"""Ticks until the sitting down, and of it, with a track of 20."""


@pytest.fixture
def sitter(fixed_policy, contract):
    """Return a policy that sits down."""
    policy = fixed_policy(answer=lambda call: np.full(12, 0.25))
    policy.contract = dataclasses.replace(contract, task="sit_down", neutral_toes=(0.1,) * 6, clock_fade=0.0)
    return policy


def names(log: RunLog) -> list[str]:
    return [PHASES[i] for i in log.phase]


def test_a_run_ends_by_sitting_down(play, memory_plant, fixed_policy, sitter, track):
    plant, tracker = memory_plant(), fixed_policy()
    result = play(plant, tracker, track(20), SHORT, sit_down=sitter)
    assert names(result.log)[BEFORE - 5 :] == ["hold"] * 5 + ["sit_down"] * LAST
    assert len(tracker.seen) == BEFORE
    assert len(sitter.seen) == LAST
    assert np.array_equal(result.log.action[BEFORE:], np.full((LAST, 12), 0.25))
    assert [event.rule for event in result.events] == ["finished"]
    assert plant.closed
    assert result.log.metadata["sit_down"] == "fixed.onnx"
    assert result.fell_at is None
    assert not result.interrupted


def test_a_robot_that_has_not_come_far_enough_walks_on_for_a_while(play, memory_plant, fixed_policy, sitter, track):
    kept = dataclasses.replace(SHORT, hold_position=True)
    log = play(memory_plant(), fixed_policy(), track(20), kept, sit_down=sitter).log
    held = names(log).count("hold")
    assert held == pytest.approx(ARRIVAL / 0.02, abs=1)


@pytest.mark.parametrize(("frames", "sitting"), [(6, 3), (3, 6)])
def test_policies_of_a_run_may_remember_differently(
    play, memory_plant, fixed_policy, sitter, track, contract, frames, sitting
):
    tracker = fixed_policy()
    tracker.contract = dataclasses.replace(contract, history=frames)
    sitter.contract = dataclasses.replace(sitter.contract, history=sitting)
    seen = play(memory_plant(), tracker, track(20), SHORT, sit_down=sitter).log.observation
    widths = tracker.contract.observation_size, sitter.contract.observation_size
    assert seen.shape == (BEFORE + LAST, max(widths))
    for rows, policy, width in zip(np.split(seen, [BEFORE]), (tracker, sitter), widths, strict=True):
        assert np.array_equal(rows[:, :width], policy.seen)
        assert np.isnan(rows[:, width:]).all()


def test_it_keeps_its_heading_and_is_asked_for_nothing(play, memory_plant, fixed_policy, sitter, track):
    log = play(memory_plant(heading=0.7), fixed_policy(), track(20, turn=0.3), SHORT, sit_down=sitter).log
    rows = log.phase == PHASES.index("sit_down")
    assert np.allclose(log.heading_des[rows], 0.7)
    assert not log.v_des[rows].any()
    assert np.allclose(log.p_BE_des[rows], 0.1)


def test_it_begins_with_a_history_of_its_own(play, memory_plant, fixed_policy, sitter, track):
    play(memory_plant(), fixed_policy(answer=lambda call: np.full(12, 0.1)), track(20), SHORT, sit_down=sitter)
    contract = sitter.contract
    frames = sitter.seen[0][: contract.history * contract.frame_size].reshape(contract.history, -1)
    assert np.array_equal(frames[0], frames[-1])
    assert not frames[0][contract.columns("last_action")].any()
    assert np.allclose(frames[0][contract.columns("clock")], [0.0, 1.0])  # it begins


def test_the_figures_of_a_run_do_not_see_the_sitting_down(play, memory_plant, fixed_policy, sitter, track, description):
    with_it = play(memory_plant(), fixed_policy(), track(20), SHORT, sit_down=sitter).log
    without = play(memory_plant(), fixed_policy(), track(20), SHORT).log
    assert int(with_it.aimed.sum()) == int(without.aimed.sum()) == BEFORE - 50
    one, other = run_metrics(with_it, description), run_metrics(without, description)
    for name in ("toe_error_cm", "standing_share", "heading_error_rad", "torque_nm", "minutes_to_limit"):
        assert one[name] == other[name]


def ctrl_c(*ticks: int):
    """Return what presses Ctrl-C at control steps."""

    def press(tick: int) -> None:
        if tick in ticks:
            signal.raise_signal(signal.SIGINT)

    return press


@pytest.mark.parametrize("tick", [1, 30, 70])
def test_ctrl_c_sits_down_and_keeps_the_whole_log(tick, play, memory_plant, fixed_policy, sitter, track, forgiving):
    plant, safety = memory_plant(fail=ctrl_c(tick)), forgiving()
    with safety.signals.interrupts_counted():
        result = play(plant, fixed_policy(), track(20), SHORT, sit_down=sitter, safety=safety)
    assert result.interrupted
    assert names(result.log)[tick + 1 :] == ["sit_down"] * LAST
    assert plant.closed


def test_another_ctrl_c_damps(play, memory_plant, fixed_policy, sitter, track, forgiving):
    plant, safety = memory_plant(fail=ctrl_c(30, 40)), forgiving()
    with safety.signals.interrupts_counted():
        result = play(plant, fixed_policy(), track(20), SHORT, sit_down=sitter, safety=safety)
    assert result.interrupted
    assert names(result.log)[31:41] == ["sit_down"] * 10
    assert set(names(result.log)[41:]) == {"damp"}
    assert not plant.sent[-1].kp.any()
    assert plant.closed


def test_without_supervision_of_its_own_a_run_counts_ctrl_c(memory_plant, fixed_policy, sitter, track):
    before = signal.getsignal(signal.SIGINT)
    result = run_policy(memory_plant(fail=ctrl_c(0)), fixed_policy(), track(20), SHORT, sit_down=sitter)
    assert result.interrupted
    assert result.events[0].rule == "asked_to_end"
    assert signal.getsignal(signal.SIGINT) is before


def test_an_error_of_the_sink_damps_and_is_in_the_result(play, memory_plant, fixed_policy, sitter, track):
    seen = []

    def sink(tick: object) -> None:
        seen.append(tick)
        if len(seen) == 60:
            raise SourceError("the camera is gone")

    plant = memory_plant()
    result = play(plant, fixed_policy(), track(20), SHORT, sit_down=sitter, sink=sink)
    assert isinstance(result.error, SourceError)
    assert len(seen) == 60
    assert set(names(result.log)[60:]) == {"damp"}
    assert plant.closed


def test_a_robot_about_to_fall_is_damped_before_it_has_fallen(play, memory_plant, fixed_policy, sitter, track):
    leaning = np.deg2rad(78.7 - 35.0)  # 35 degrees forward of the upright direction

    def pitch(tick: int) -> float:
        return np.pi / 2 if tick < 65 else leaning

    result = play(memory_plant(pitch=pitch), fixed_policy(), track(20), SHORT, sit_down=sitter)
    assert result.fell_at == pytest.approx(65 * 0.02)
    assert set(names(result.log)[65:]) == {"damp"}


def test_policies_do_what_they_were_trained_for(play, memory_plant, fixed_policy, sitter, track):
    with pytest.raises(ContractError, match="was trained for sit_down; expected stand_track"):
        play(memory_plant(), sitter, track(20), SHORT)
    with pytest.raises(ContractError, match="was trained for stand_track; expected sit_down"):
        play(memory_plant(), fixed_policy(), track(20), SHORT, sit_down=fixed_policy())

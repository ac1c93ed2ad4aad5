from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.config.play import RunSettings
from mimic.errors import ContractError, PlantError
from mimic.records import PHASES, RunLog

SHORT = RunSettings(stand_up=1.0, blend=0.2, hold_last=0.1, hold_position=False)
STAND, BLEND, HOLD = 50, 10, 5
"""Ticks of each phase of SHORT."""


def names(log: RunLog) -> list[str]:
    return [PHASES[i] for i in log.phase]


def test_phases_come_in_order_and_last_as_long_as_they_should(play, memory_plant, fixed_policy, track):
    log = play(memory_plant(), fixed_policy(), track(20), SHORT).log
    assert names(log) == ["stand_up"] * STAND + ["blend"] * BLEND + ["track"] * 20 + ["hold"] * HOLD


def test_the_log_has_a_row_for_each_tick(play, memory_plant, fixed_policy, track, description):
    plant, policy = memory_plant(), fixed_policy()
    log = play(plant, policy, track(), SHORT).log
    assert len(log.t) == len(plant.sent) == len(policy.seen)
    assert np.allclose(np.diff(log.t), description.dt)
    assert np.all(np.diff(log.t_host) >= 0)
    assert np.array_equal(log.observation, policy.seen)


def test_a_row_holds_the_state_that_the_policy_saw(play, memory_plant, fixed_policy, track, description):
    log = play(memory_plant(), fixed_policy(answer=lambda call: np.full(12, 0.01 * call)), track(), SHORT).log
    assert np.array_equal(log.q[0], description.poses["lie"])
    assert np.array_equal(log.q[1:], log.q_sent[:-1])


def test_standing_up_asks_for_neutral_toes_and_nothing_else(play, memory_plant, fixed_policy, track, contract):
    log = play(memory_plant(), fixed_policy(), track(), SHORT).log
    rows = log.phase == PHASES.index("stand_up")
    assert np.array_equal(log.p_BE_des[rows].reshape(-1, 6), np.tile(contract.neutral_toes, (STAND, 1)))
    assert not log.v_des[rows].any()


def test_tracking_asks_for_the_track_row_by_row(play, memory_plant, fixed_policy, track):
    wanted = track(20)
    log = play(memory_plant(heading=0.7), fixed_policy(), wanted, SHORT).log
    rows = log.phase == PHASES.index("track")
    assert np.array_equal(log.p_BE_des[rows], wanted.p_BE)
    assert np.array_equal(log.v_des[rows], wanted.v)
    assert np.allclose(log.heading_des[rows], 0.7 + wanted.heading)


def test_at_the_end_it_stands_still_with_the_last_toes(play, memory_plant, fixed_policy, track):
    wanted = track(20)
    log = play(memory_plant(), fixed_policy(), wanted, SHORT).log
    rows = log.phase == PHASES.index("hold")
    assert np.array_equal(log.p_BE_des[rows], np.tile(wanted.p_BE[-1:], (HOLD, 1, 1)))
    assert not log.v_des[rows].any()


def test_desired_toes_go_from_the_measured_ones_to_the_first_target_without_a_jump(
    play, memory_plant, fixed_policy, track
):
    settings = RunSettings(stand_up=1.0, blend=0.5, hold_last=0.1)
    log = play(memory_plant(), fixed_policy(answer=lambda call: np.full(12, -0.4)), track(20), settings).log
    first = names(log).index("blend")
    from_here, to_there = log.p_BE[first], log.p_BE_des[names(log).index("track")]
    way = np.linalg.norm(to_there - from_here, axis=-1).max()
    assert way > 0.05
    path = np.concatenate([from_here[None], log.p_BE_des[first:]])
    fastest = np.linalg.norm(np.diff(path, axis=0), axis=-1).max() / 0.02
    assert fastest < 2.0 * way / settings.blend


def test_headings_are_relative_to_the_start(play, memory_plant, fixed_policy, track):
    turned = play(memory_plant(heading=-2.0), fixed_policy(), track(turn=0.0), SHORT).log
    assert np.allclose(turned.heading_des, -2.0)


def test_it_stands_up_before_it_turns(play, memory_plant, fixed_policy, track):
    log = play(memory_plant(heading=0.7), fixed_policy(), track(turn=0.3), SHORT).log
    up = log.phase == PHASES.index("stand_up")
    assert np.allclose(log.heading_des[up], 0.7)
    assert np.allclose(log.heading_des[~up], 1.0)


def test_what_was_commanded_and_what_went_out_are_logged_apart(play, memory_plant, fixed_policy, track):
    plant = memory_plant(limit=1.0)
    log = play(plant, fixed_policy(), track(), SHORT).log
    assert np.abs(log.q_sent).max() == 1.0
    assert np.abs(log.q_des).max() > 1.0
    assert np.array_equal(log.q_sent, [command.q_des for command in plant.sent])


def test_a_wild_policy_cannot_leave_the_joint_limits(play, memory_plant, fixed_policy, track, description):
    wild = np.random.default_rng(0).normal(scale=100.0, size=(200, 12))
    log = play(memory_plant(), fixed_policy(answer=lambda call: wild[call]), track(), SHORT).log
    assert np.all(log.q_des >= description.q_min)
    assert np.all(log.q_des <= description.q_max)


def test_commands_carry_the_gains_of_the_contract(play, memory_plant, fixed_policy, track, contract):
    log = play(memory_plant(), fixed_policy(), track(), SHORT).log
    assert np.all(log.kp == contract.kp)
    assert np.all(log.kd == contract.kd)


def test_the_log_names_robot_policy_step_and_settings(play, memory_plant, fixed_policy, track):
    metadata = play(memory_plant(), fixed_policy(), track(), SHORT).log.metadata
    assert metadata["robot"] == "cyberdog2"
    assert metadata["policy"] == "fixed.onnx"
    assert metadata["dt"] == 0.02
    assert metadata["settings"]["blend"] == SHORT.blend
    assert metadata["fell_at"] is None


@pytest.mark.parametrize("dt", [0.01, 0.1])
def test_commands_at_another_rate_are_refused_before_the_robot_moves(play, dt, memory_plant, fixed_policy, track):
    plant, commands = memory_plant(), track(20)
    with pytest.raises(ContractError, match=f"every {dt} s; the policy needs one every 0.02 s"):
        play(plant, fixed_policy(), dataclasses.replace(commands, t=dt * np.arange(20)), SHORT)
    assert not plant.sent


def test_no_commands_at_all_are_refused(play, memory_plant, fixed_policy, track):
    with pytest.raises(ContractError, match="no commands to play"):
        play(memory_plant(), fixed_policy(), track(0), SHORT)


def test_a_single_command_is_played(play, memory_plant, fixed_policy, track):
    log = play(memory_plant(), fixed_policy(), track(1), SHORT).log
    assert names(log).count("track") == 1


def test_sink_and_progress_see_every_tick(play, memory_plant, fixed_policy, track):
    ticks, steps = [], []
    result = play(
        memory_plant(),
        fixed_policy(),
        track(),
        SHORT,
        sink=ticks.append,
        progress=lambda done, total: steps.append((done, total)),
    )
    total = len(result.log.t)
    assert len(ticks) == total
    assert steps == [(i + 1, total) for i in range(total)]


# ---------------------------------------------------------------------- when it goes wrong


def tipping_at(tick: int):
    return lambda now: np.pi / 2 if now < tick else 0.0


def test_a_robot_that_tips_over_is_damped_until_it_rests(play, memory_plant, fixed_policy, track, description):
    plant = memory_plant(pitch=tipping_at(65))
    result = play(plant, fixed_policy(), track(), SHORT)
    assert result.fell_at == pytest.approx(65 * 0.02)
    assert result.log.metadata["fell_at"] == result.fell_at
    assert [event.rule for event in result.events] == ["falling", "at_rest"]
    damped = result.log.phase[65:]
    assert len(damped)
    assert set(damped) == {PHASES.index("damp")}
    last = plant.sent[-1]
    assert not last.kp.any()
    assert np.all(last.kd == description.kd_max)
    assert not last.dq_des.any()
    assert not last.tau_ff.any()
    assert plant.closed
    assert not result.interrupted


def test_a_robot_that_never_gets_up_is_damped_once_it_should_stand(play, memory_plant, fixed_policy, track):
    plant = memory_plant(pitch=lambda tick: 0.0)
    result = play(plant, fixed_policy(), track(), SHORT)
    assert result.fell_at is not None
    assert SHORT.stand_up <= result.fell_at <= SHORT.stand_up + 0.05


def test_a_robot_that_stays_up_is_closed_without_a_fall(play, memory_plant, fixed_policy, track):
    plant = memory_plant()
    result = play(plant, fixed_policy(), track(), SHORT)
    assert result.fell_at is None
    assert plant.closed
    assert all(command.kp.all() for command in plant.sent)


def raising(error: BaseException, at: int):
    def fail(tick: int) -> None:
        if tick == at:
            raise error

    return fail


def test_a_plant_that_fails_is_closed_and_its_error_is_in_the_result(play, memory_plant, fixed_policy, track):
    plant = memory_plant(fail=raising(PlantError("no answer"), 10))
    result = play(plant, fixed_policy(), track(), SHORT)
    assert isinstance(result.error, PlantError)
    assert result.events[-1].text == "no answer"
    assert len(plant.sent) == 10
    assert plant.closed


def test_a_plant_that_fails_while_it_is_damped_is_closed(play, memory_plant, fixed_policy, track):
    plant = memory_plant(pitch=tipping_at(65), fail=raising(PlantError("no answer"), 65))
    result = play(plant, fixed_policy(), track(), SHORT)
    assert isinstance(result.error, PlantError)
    assert result.fell_at == pytest.approx(65 * 0.02)
    assert plant.closed


def test_a_plant_whose_start_fails_is_closed(play, memory_plant, fixed_policy, track, monkeypatch):
    plant = memory_plant()
    plant.start = lambda: raising(PlantError("not lying"), 0)(0)
    with pytest.raises(PlantError, match="not lying"):
        play(plant, fixed_policy(), track(), SHORT)
    assert plant.closed


def test_a_policy_that_fails_is_followed_by_damping(play, memory_plant, fixed_policy, track):
    def answer(call: int) -> np.ndarray:
        raising(RuntimeError("no idea"), 10)(call)
        return np.zeros(12)

    plant = memory_plant()
    result = play(plant, fixed_policy(answer=answer), track(), SHORT)
    assert isinstance(result.error, RuntimeError)
    assert names(result.log)[10:] == ["damp"] * (len(result.log.t) - 10)
    assert plant.closed


@pytest.mark.parametrize("tick", [1, 7, 60])
def test_ctrl_c_that_is_raised_damps_and_keeps_the_log(play, tick, memory_plant, fixed_policy, track):
    raised = []

    def fail(now: int) -> None:
        if now == tick and not raised:
            raised.append(now)
            raise KeyboardInterrupt

    plant = memory_plant(fail=fail)
    result = play(plant, fixed_policy(), track(), SHORT)
    assert result.interrupted
    assert result.error is None
    assert result.fell_at is None
    assert names(result.log)[tick + 1 :] == ["damp"] * (len(result.log.t) - tick - 1)
    assert plant.closed


def test_ctrl_c_before_the_first_tick_is_passed_on(play, memory_plant, fixed_policy, track):
    plant = memory_plant(fail=raising(KeyboardInterrupt(), 0))
    with pytest.raises(KeyboardInterrupt):
        play(plant, fixed_policy(), track(), SHORT)
    assert plant.closed

"""A run under supervision on a robot that lives in memory: phases, decisions, what is logged, and how it ends."""

from __future__ import annotations

import dataclasses
import errno
import json
import signal
import threading

import numpy as np
import pytest

from mimic.config.play import RunSettings
from mimic.control.loop import run_policy
from mimic.control.recorder import EVENTS, ROWS, RunRecorder, salvage
from mimic.control.row_file import RowFile
from mimic.control.safety.supervisor import SafetyMode
from mimic.control.signals import Signals
from mimic.errors import PlantError
from mimic.records import PHASES, Health, HealthLog, JointCommand, RunLog, Tick

SHORT = RunSettings(stand_up=1.0, blend=0.2, hold_last=0.1, sit_down=1.5, hold_position=False)
MOVES = 20
RAMP, BEFORE, LAST = MOVES + 25, 50 + 10 + 20 + 5, 75
"""Ticks of the ramp, of the run, and of sitting down, with a track of 20."""


def lean(tick: int) -> float:
    """Angle of base x above the ground: lies through the ramp, then stands up slowly enough for the IMU's check."""
    return float(np.clip(0.05 * (tick - RAMP), 0.0, 1.37))


@pytest.fixture
def supervised(memory_plant, fixed_policy, contract, track, description, forgiving, tmp_path):
    """Return a function that plays a supervised run on a robot that stands in the upright pose."""

    def play(*, health=lambda tick, health: health, fail=lambda tick: None, answer=None, endless=False, **options):
        upright = (description.poses["upright"] - np.array(contract.default_q)) / np.array(contract.action_scale)
        answer = answer or (lambda call: upright)
        sitter = fixed_policy(answer=lambda call: upright)
        sitter.contract = dataclasses.replace(contract, task="sit_down")
        plant = memory_plant(pitch=lean, fail=fail, health=health)
        signals = options.pop("signals", Signals())
        kind = options.pop("recorder", RunRecorder)
        recorder = kind(tmp_path / "run", contract.observation_size, {"dt": 0.02})
        safety = forgiving(signals=signals, recorder=recorder, ramp=MOVES * 0.02, endless=endless, damp_at_end=True)
        supervisor = safety.supervisor
        result = run_policy(
            plant, fixed_policy(answer=answer), track(20), SHORT, sit_down=sitter, safety=safety, **options
        )
        recorder.close()
        return result, plant, supervisor

    return play


def phases(log: RunLog) -> list[str]:
    return [PHASES[i] for i in log.phase]


def test_it_ramps_runs_sits_down_and_damps_until_it_rests(supervised, contract):
    result, plant, supervisor = supervised()
    names = phases(result.log)
    assert names[:RAMP] == ["lie"] * RAMP
    assert names[RAMP : RAMP + BEFORE] == ["stand_up"] * 50 + ["blend"] * 10 + ["track"] * 20 + ["hold"] * 5
    assert names[RAMP + BEFORE : RAMP + BEFORE + LAST] == ["sit_down"] * LAST
    rest = names[RAMP + BEFORE + LAST :]
    assert set(rest) == {"damp"}
    assert 25 <= len(rest) <= 28
    assert supervisor.mode == SafetyMode.STOPPED
    assert [e.rule for e in result.events] == ["finished", "at_rest"]
    assert result.fell_at is None
    assert not result.interrupted
    assert plant.closed
    assert len(result.log.t) == len(plant.sent)


def test_gains_and_targets_ramp_from_where_the_joints_are(supervised, description):
    result, _, _ = supervised()
    kp, q_des = result.log.kp[:RAMP], result.log.q_des[:RAMP]
    assert 0 < kp[0, 0] <= description.start.kp * 2.1 / MOVES
    assert np.all(np.diff(kp, axis=0) >= 0)
    assert np.all(kp[MOVES // 2 :] == description.start.kp)
    begin = result.log.q[0]
    assert np.allclose(q_des[: MOVES // 2], begin)
    assert np.allclose(q_des[-1], description.poses["lie"])


def test_damping_has_no_stiffness_and_the_most_the_motors_brake_with(supervised, description):
    result, plant, _ = supervised()
    damped = result.log.phase == PHASES.index("damp")
    assert not result.log.kp[damped].any()
    assert np.all(result.log.kd[damped] == description.kd_max)
    assert not plant.sent[-1].kp.any()


def after(signals: Signals, interrupts: dict[int, int]):
    """Return a health function that presses Ctrl-C at ticks."""

    def press(tick: int, health: Health) -> Health:
        signals.interrupts = max([n for at, n in interrupts.items() if tick >= at], default=0)
        return health

    return press


@pytest.mark.parametrize("tick", [RAMP + 5, RAMP + 55, RAMP + 75])
def test_ctrl_c_sits_down_in_the_next_tick_and_then_damps(tick, supervised):
    signals = Signals()
    result, _, _ = supervised(signals=signals, health=after(signals, {tick: 1}))
    names = phases(result.log)
    assert names[tick] == "sit_down"
    assert names.count("sit_down") == LAST
    assert names[-1] == "damp"
    assert result.interrupted
    assert [e.rule for e in result.events] == ["asked_to_end", "finished", "at_rest"]


def test_another_ctrl_c_damps_in_the_next_tick(supervised):
    signals = Signals()
    result, _, _ = supervised(signals=signals, health=after(signals, {60: 1, 70: 2}))
    assert phases(result.log)[60:71] == ["sit_down"] * 10 + ["damp"]


def test_a_hold_without_end_goes_on_until_ctrl_c(supervised):
    signals = Signals()
    result, _, _ = supervised(signals=signals, health=after(signals, {400: 1}), endless=True)
    names = phases(result.log)
    assert names[RAMP + BEFORE : 400] == ["hold"] * (400 - RAMP - BEFORE)
    assert names[400] == "sit_down"


def test_a_rule_that_damps_is_followed_in_the_next_tick(supervised):
    result, _, _ = supervised(health=lambda tick, health: dataclasses.replace(health, imu_valid=tick < 60))
    assert phases(result.log)[60] == "damp"
    assert result.events[0].rule == "imu_silent"


def test_a_rule_that_sits_down_is_followed_in_the_next_tick(supervised):
    faults = np.zeros(12, dtype=int)
    faults[3] = 1
    result, _, _ = supervised(
        health=lambda tick, health: dataclasses.replace(health, faults=faults) if tick >= 90 else health
    )
    assert phases(result.log)[90] == "sit_down"
    assert result.events[0].rule == "motor_failed"


def test_an_answer_that_is_not_a_number_never_goes_out(supervised):
    result, plant, _ = supervised(answer=lambda call: np.full(12, np.nan if call == 30 else 0.0))
    assert phases(result.log)[RAMP + 30] == "damp"
    assert result.events[0].rule == "failure"
    assert all(np.isfinite(command.q_des).all() for command in plant.sent)
    assert np.isnan(result.log.action[RAMP + 30]).all()


def test_a_wild_policy_is_clamped_and_counted(supervised, description):
    result, _, _ = supervised(answer=lambda call: np.full(12, 500.0 * (-1) ** call))
    assert "clamped" in [e.rule for e in result.events]
    assert result.health.clamped.max() >= 12
    assert np.all(result.log.q_sent <= description.q_max + 1e-9)


def raising(error: BaseException, at: int):
    raised = []

    def fail(tick: int) -> None:
        if tick == at and not raised:
            raised.append(error)
            raise error

    return fail


@pytest.mark.parametrize("error", [PlantError("no answer"), RuntimeError("a bug"), KeyboardInterrupt()])
@pytest.mark.parametrize("at", [3, 60, 130])
def test_whatever_is_raised_ends_damped_with_the_whole_log(error, at, supervised, tmp_path):
    result, plant, _ = supervised(fail=raising(error, at))
    assert plant.closed
    assert len(result.log.t) >= at + 1
    assert np.isnan(result.log.q_sent[at]).all()  # asked for, but never sent
    decisive = next(e for e in result.events if e.mode > SafetyMode.RUN)
    assert decisive.rule == "failure"
    if isinstance(error, PlantError):
        assert result.error is error
        assert len(result.log.t) == at + 1  # the bus is left to the plant's own close
    else:
        assert phases(result.log)[-1] == "damp"


def test_what_fails_before_the_first_tick_is_raised(supervised):
    with pytest.raises(PlantError, match="no answer"):
        supervised(fail=raising(PlantError("no answer"), 0))


def test_a_sink_that_fails_damps(supervised):
    def sink(tick: Tick) -> None:
        raise RuntimeError("the viewer is gone")

    result, _, _ = supervised(sink=sink)
    assert result.events[0].text == "the viewer is gone"
    assert phases(result.log)[1] == "damp"


# ---------------------------------------------------------------------- the log on disk


def test_every_tick_and_event_is_on_disk_as_it_is_in_the_result(supervised, tmp_path):
    result, _, _ = supervised()
    log, health = salvage(tmp_path / "run")
    for f in dataclasses.fields(RunLog):
        if "axes" in f.metadata:
            assert np.array_equal(getattr(log, f.name), getattr(result.log, f.name), equal_nan=True), f.name
    for f in dataclasses.fields(HealthLog):
        assert np.array_equal(getattr(health, f.name), getattr(result.health, f.name), equal_nan=True), f.name
    lines = (tmp_path / "run" / EVENTS).read_text().splitlines()
    assert [json.loads(line)["rule"] for line in lines] == [e.rule for e in result.events]


def test_the_tick_in_which_the_plant_failed_is_on_disk(supervised, tmp_path):
    supervised(fail=raising(PlantError("no answer"), 60))
    log, _ = salvage(tmp_path / "run")
    assert len(log.t) == 61
    assert np.isfinite(log.q_des[60]).all()
    assert np.isnan(log.q_sent[60]).all()


def test_a_disk_that_stands_still_holds_no_tick_and_loses_nothing(supervised, tmp_path, monkeypatch):
    goes_on, write = threading.Event(), RowFile.write
    monkeypatch.setattr(RowFile, "write", lambda self, rows: goes_on.wait() and write(self, rows))
    monkeypatch.setattr(RunRecorder, "close", lambda self, close=RunRecorder.close: goes_on.set() or close(self))
    result, _, supervisor = supervised()
    assert [event.rule for event in supervisor.events] == ["finished", "at_rest"]
    log, _ = salvage(tmp_path / "run")
    np.testing.assert_array_equal(log.t, result.log.t)


def test_a_disk_that_is_too_slow_for_good_is_named_and_the_rows_stay_in_memory(supervised, tmp_path, monkeypatch):
    goes_on = threading.Event()
    monkeypatch.setattr("mimic.control.recorder.MOST_WAITING", 60)
    monkeypatch.setattr(RowFile, "write", lambda self, rows: goes_on.wait())
    monkeypatch.setattr(RunRecorder, "close", lambda self, close=RunRecorder.close: goes_on.set() or close(self))
    result, _, supervisor = supervised()
    assert supervisor.decisive.text == "the log cannot be written: the disk is too slow: 60 rows wait for it"
    assert phases(result.log)[-1] == "damp"
    assert np.isfinite(result.log.q).all()


def test_rows_are_gone_once_they_are_discarded(tmp_path, contract):
    recorder = RunRecorder(tmp_path, contract.observation_size, {})
    assert (tmp_path / ROWS).exists()
    recorder.discard()
    assert not (tmp_path / ROWS).exists()
    assert (tmp_path / EVENTS).exists()


def test_a_run_that_never_began_leaves_nothing(tmp_path, contract):
    RunRecorder(tmp_path / "run", contract.observation_size, {}).abandon()
    assert not (tmp_path / "run").exists()


def test_a_run_that_began_is_kept(tmp_path, supervised):
    supervised()
    assert (tmp_path / "run" / ROWS).exists()


# ---------------------------------------------------------------------- joints that did not answer


def test_a_joint_that_did_not_answer_is_nan_in_the_log_and_estimated_for_the_policy(
    memory_plant, fixed_policy, track, forgiving
):
    plant = memory_plant(pitch=lean)
    step_of_plant = plant.step

    def step(command: JointCommand) -> Tick:
        done = step_of_plant(command)
        if len(plant.sent) in (60, 61):
            q = done.state.q.copy()
            q[4] = np.nan
            done = dataclasses.replace(done, state=dataclasses.replace(done.state, q=q))
        return done

    plant.step = step
    policy = fixed_policy()
    log = run_policy(plant, policy, track(20), SHORT, safety=forgiving(ramp=MOVES * 0.02)).log
    assert np.flatnonzero(np.isnan(log.q[:, 4])).tolist() == [60, 61]
    assert np.isfinite(policy.seen).all()
    newest = (policy.contract.history - 1) * policy.contract.frame_size
    held = np.array([seen[newest + 4] for seen in policy.seen])
    assert np.allclose(held[60 - RAMP : 62 - RAMP], held[59 - RAMP], atol=1e-9)


def full_after(rows: int, *, events: bool = False) -> type[RunRecorder]:
    """Return a recorder on a disk that is full after some rows."""

    class FullDisk(RunRecorder):
        written = 0

        def row(self, values, health):
            if self.written >= rows and not events:
                raise OSError(errno.ENOSPC, "No space left on device")
            self.written += 1
            super().row(values, health)

        def event(self, event):
            if self.written >= rows:
                raise OSError(errno.ENOSPC, "No space left on device")
            super().event(event)

    return FullDisk


@pytest.mark.parametrize("tick", [RAMP + 30, RAMP + 65])
def test_a_full_disk_makes_the_robot_sit_down_and_loses_no_row(tick, supervised, tmp_path):
    result, plant, supervisor = supervised(recorder=full_after(tick))
    assert result.error is None
    assert supervisor.decisive.rule == "failure"
    assert "No space left" in supervisor.decisive.text
    names = phases(result.log)
    assert names[tick + 1] == "sit_down"
    assert names[-1] == "damp"
    assert plant.closed
    assert len(result.log.t) == len(plant.sent)
    assert len(salvage(tmp_path / "run")[0].t) == tick


def test_a_full_disk_while_it_still_lies_damps(supervised):
    result, _, supervisor = supervised(recorder=full_after(5))
    assert (supervisor.decisive.rule, supervisor.decisive.mode) == ("failure", SafetyMode.DAMP)
    assert set(phases(result.log)[6:]) == {"damp"}


def test_events_that_cannot_be_written_do_not_keep_it_from_being_damped(supervised):
    def broken(tick: int) -> None:
        if tick == RAMP + 40:
            raise PlantError("it broke")

    result, plant, _ = supervised(recorder=full_after(RAMP + 40, events=True), fail=broken)
    assert plant.closed
    assert str(result.error) == "it broke"
    assert [event.rule for event in result.events] == ["failure"]


def test_a_closed_terminal_makes_it_sit_down(supervised):
    signals = Signals()

    def close(tick: int, health: Health) -> Health:
        if tick == RAMP + 55:
            signal.raise_signal(signal.SIGHUP)
        return health

    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests run under nohup
    try:
        with signals.caught():
            result, _, supervisor = supervised(signals=signals, health=close, endless=True)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert "SIGHUP" in supervisor.decisive.text
    assert phases(result.log).count("sit_down") == LAST


def test_under_nohup_a_closed_terminal_changes_nothing():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signals = Signals()
    try:
        with signals.caught():
            signal.raise_signal(signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert (signals.interrupts, signals.hung_up) == (0, False)


def test_however_often_ctrl_c_is_pressed_it_is_damped_until_it_rests(supervised):
    signals = Signals()

    def press(tick: int, health: Health) -> Health:
        if tick >= RAMP + 55:
            signal.raise_signal(signal.SIGINT)
        return health

    with signals.caught():
        result, plant, _ = supervised(signals=signals, health=press, endless=True)
    names = phases(result.log)
    assert signals.interrupts > 20
    assert result.error is None
    assert [event.rule for event in result.events][-1] == "at_rest"
    assert names.count("damp") >= 25
    assert plant.closed


def test_five_ctrl_c_that_nobody_reads_end_what_hangs():
    signals = Signals()
    with signals.caught():
        for _ in range(4):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

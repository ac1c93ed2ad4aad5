"""Targets that were late or lost: which ones is read off the log, and only where the joints agree."""

from dataclasses import replace

import numpy as np
import pytest

from mimic.config.sysid import CalibrateSettings, LogSettings
from mimic.dynamics.catalogue import BASELINE
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel
from mimic.io.joint_log import JointLog
from mimic.sysid.calibrate import calibrate
from mimic.sysid.fit.least_squares import fit, left_out
from mimic.sysid.fit.problem import Point, Problem
from mimic.sysid.fit.replay import Replay
from mimic.sysid.log.pool import make_blocks
from mimic.sysid.predict import simulate_log
from mimic.sysid.result import Calibration
from mimic.sysid.select.lateness import late_targets
from mimic.sysid.select.models import compare

TIMING = ("lost_commands", "delay_jitter")


def log_of(pair: MachineModel, *hidden: EffectValues, held: bool = False, size: float = 0.4) -> JointLog:
    """Return 11 s of sines, a target each 20 ms; with ``held`` each is sent five times in every other second."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 11.0, 0.02)
    phase = rng.uniform(0, 2 * np.pi, (4, 2))
    rates = (0.4, 0.9, 1.7, 3.1)
    q_des = sum(size / (1 + k) * np.sin(2 * np.pi * f * t[:, None] + phase[k]) for k, f in enumerate(rates))
    if held:
        rows = np.arange(len(t))
        q_des = q_des[np.where(t % 2.0 < 1.0, rows - rows % 5, rows)]
    delay = EffectValues(name="delay", values={"time": 0.011})
    return replace(
        simulate_log(pair, t, q_des, EffectSet((delay, *hidden)), LogSettings(seed=4, timestep=0.001)), tau=None
    )


def calibrated(pair: MachineModel, *hidden: EffectValues) -> Calibration:
    return calibrate(log_of(pair, *hidden), pair, CalibrateSettings(effects=TIMING, timestep=0.005))


def found(result: Calibration) -> list[str]:
    return [s.added for s in result.stages if s.added not in ("", "baseline")]


@pytest.mark.slow
def test_lost_commands_are_named_with_their_share(pair: MachineModel) -> None:
    """Of 13 % many are lost in a row, which is not the sum of what each loss does."""
    share = 0.13
    result = calibrated(pair, EffectValues(name="lost_commands", values={"share": share}))
    assert found(result) == ["lost_commands"]
    effect = next(e for e in result.effects if e.name == "lost_commands")
    low, high = effect.intervals["share"][0]
    assert low < share < high
    assert np.all(result.stages[-1].errors.held_out < 1.15 * result.noise)


@pytest.mark.slow
def test_lost_commands_are_named_where_a_log_hardly_tells_which_were_lost(pair: MachineModel) -> None:
    log = log_of(pair, EffectValues(name="lost_commands", values={"share": 0.13}), size=0.04)
    result = calibrate(log, pair, CalibrateSettings(effects=TIMING, timestep=0.005))
    assert found(result) == ["lost_commands"]
    assert np.all(result.stages[-1].errors.held_out < 1.15 * result.noise)


@pytest.mark.slow
def test_a_target_that_is_sent_again_may_be_lost_each_time(pair: MachineModel) -> None:
    hidden = EffectValues(name="lost_commands", values={"share": 0.15})
    log = log_of(pair, hidden, held=True)
    result = calibrate(log, pair, CalibrateSettings(effects=TIMING, timestep=0.005))
    assert found(result) == ["lost_commands"]
    assert np.all(result.stages[-1].errors.held_out < 1.15 * result.noise)


@pytest.mark.slow
def test_jitter_is_named_with_its_width_and_the_delay_below_it(pair: MachineModel) -> None:
    result = calibrated(pair, EffectValues(name="delay_jitter", values={"spread": 0.012}))
    assert found(result) == ["delay_jitter"]
    values = {e.name: e.values for e in result.effects}
    assert values["delay_jitter"]["spread"][0] == pytest.approx(0.012, rel=0.15)
    assert values["delay"]["time"][0] == pytest.approx(0.011, abs=0.001)
    assert np.all(result.stages[-1].errors.held_out < 1.2 * result.noise)  # each target's lateness is an estimate


@pytest.mark.slow
def test_joints_agree_on_jitter_of_which_each_by_itself_shows_less_than_its_noise(pair: MachineModel) -> None:
    log = log_of(pair, EffectValues(name="delay_jitter", values={"spread": 0.002}))
    replay = Replay(pair, log, timestep=0.0025)
    problem = Problem(replay, np.full(2, 0.37e-3), None, make_blocks(log.t, replay.counts))
    fitted = fit(problem, Point.of(BASELINE, pair), BASELINE, {}, most=4)
    (found,) = late_targets(problem, fitted, ["delay_jitter"])
    assert compare(problem, found.squares, left_out(fitted, problem)[0], 1).better
    assert found.point.values["delay_jitter", "spread"][0] == pytest.approx(0.002, rel=0.3)
    assert found.interval[0] > 0.001


@pytest.mark.slow
def test_what_one_joint_shows_alone_is_no_late_target(pair: MachineModel) -> None:
    log = log_of(pair, EffectValues(name="stribeck", joints=("a",), values={"level": 0.15, "speed": 0.2}))
    replay = Replay(pair, log, timestep=0.005)
    problem = Problem(replay, np.full(2, 0.37e-3), None, make_blocks(log.t, replay.counts))
    fitted = fit(problem, Point.of(BASELINE, pair), BASELINE, {}, most=4)
    judged = left_out(fitted, problem)[0]
    found = late_targets(problem, fitted, TIMING)
    assert not any(compare(problem, late.squares, judged, 1).better for late in found)


def test_a_target_that_is_a_period_late_is_never_seen(pair: MachineModel) -> None:
    log = log_of(pair)
    assert log.q_des is not None
    replay = Replay(pair, log, timestep=0.0025)
    late = np.zeros(len(replay.sent))
    late[[100, 200]] = 0.02
    begin = replay.sent[[100, 200]]
    held = log.q_des.copy()
    for row in begin:
        held[row : row + 4] = held[row - 1]
    without = Replay(pair, replace(log, q_des=held), timestep=0.0025)
    none = {("delay", "time"): np.zeros((1, 1))}
    assert np.allclose(
        replay.with_late(late).run(none, 1).residual, without.run(none, 1).residual, equal_nan=True, atol=1e-7
    )

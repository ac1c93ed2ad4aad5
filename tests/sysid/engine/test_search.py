"""Effects hidden in logs are found, and nothing where nothing is hidden."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.signal import lfilter

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.effect_set import EffectValues, read_effects, write_effects
from mimic.dynamics.machine import read_machine
from mimic.io.joint_log import JointLog
from mimic.sysid.engine.data import data_of
from mimic.sysid.engine.effects import dependences, effects_of, motion_of
from mimic.sysid.engine.laws import ROW
from mimic.sysid.engine.model import STEP, setting_of
from mimic.sysid.engine.search import Hunt, Outcome, baseline, describe, fitted_baseline, search, spread

BASELINE = CalibrateSettings().baseline
ONE_WAY = EffectValues(name="asymmetric_friction", joints=("a",), values={"level": np.array([0.02])})
SPRING = EffectValues(name="spring", joints=("a",), values={"stiffness": np.array([0.5])})
FRICTION = ("stribeck", "asymmetric_friction", "quadratic_drag", "spring")


def found(logs, machine) -> Outcome:
    null = fitted_baseline(baseline(setting_of(data_of(logs, machine)), BASELINE))
    return search(null, Hunt(effects=FRICTION, say=lambda text: None))


def test_predictions_of_the_true_machine_miss_by_its_noise(pair, log_of):
    data = data_of([log_of(pair)], pair)
    model = baseline(setting_of(data), BASELINE).settled()
    np.testing.assert_allclose(model.scale[0], 0.0003, rtol=0.4)


def test_errors_of_a_model_that_lacks_something_are_not_independent(pair, log_of):
    true, lacking = (data_of([log_of(pair, *hidden)], pair) for hidden in ((), (SPRING,)))
    assert baseline(setting_of(true), BASELINE).settled().repeats() < 3.0
    assert baseline(setting_of(lacking), BASELINE).settled().repeats() > 4.0


def test_a_pull_is_less_sure_where_a_slow_torque_pushes(pair, log_of):
    """It goes on from block to block, so that a thousand readings tell little of its mean."""
    log = log_of(pair)
    kicks = np.random.default_rng(1).standard_normal(500)
    walk = 0.3 * np.sqrt(1.0 - 0.99**2) * lfilter([1.0], [1.0, -0.99], kicks)
    pushed = log_of(pair, push=np.stack([walk, 0.0 * walk], -1) / pair.drives.kp)
    spread = []
    for one in (log, pushed):
        model = baseline(setting_of(data_of([one], pair)), (*BASELINE, "spring")).settled()
        k = [(f.key, f.joint) for f in model.free].index((("spring", "moment"), 0))
        independent = np.linalg.inv(model.differentiated().normal()[0] + model.plausibility(model.values())[0])
        spread.append(np.sqrt(model.covariance()[k, k] / independent[k, k]))
    assert spread[0] < 2.0
    assert spread[1] > 5.0


def test_a_machine_that_flies_apart_does_so_for_a_block_only(pair, log_of):
    data = data_of([log_of(pair)], pair)
    model = baseline(setting_of(data), BASELINE)
    table = model.table.copy()
    table[ROW["spring", "stiffness"], 0] = -60.0
    e = np.abs(replace(model, table=table).evaluated().e[:, 0])
    begins = np.flatnonzero(np.diff(data.block) > 0)[:-1] + 1
    ends = np.flatnonzero(np.diff(data.block) > 0)[1:]
    assert (e[begins] < 1.0).all()
    assert (e[ends] > 100.0).all()


def test_steps_are_short_enough_where_targets_jump_and_torques_reach_their_limits(pair, log_of):
    model = baseline(setting_of(data_of([log_of(pair, fast=1.0)], pair)), BASELINE)
    table = model.table.copy()
    table[ROW["delay", "time"]] = 0.0107
    table[ROW["torque_speed", "torque"]] = 3.0
    coarse, fine = (replace(model, table=table).evaluated(step).e for step in (STEP, STEP / 32.0))
    assert (np.nanmean((coarse - fine) ** 2, axis=0) < 5e-5**2).all()


def test_what_is_named_is_confirmed_by_whole_logs_left_out(pair, log_of):
    logs = [log_of(pair, SPRING, fast=fast) for fast in (0.0, 0.1, 0.2)]
    outcome = found(logs, pair)
    assert describe(outcome.best.model) == "spring (a)"
    new, old = (np.nanstd(one.model.left_out(one.model.data.apart)[:, 0]) for one in (outcome.best, outcome.null))
    assert new < 0.2 * old


def test_nothing_is_found_where_nothing_is_hidden(pair, log_of):
    outcome = found([log_of(pair)], pair)
    assert describe(outcome.best.model) == "nothing"
    assert outcome.explained


def test_a_constant_torque_is_a_pull_or_a_difference_of_friction(pair, log_of):
    outcome = found([log_of(pair, ONE_WAY)], pair)
    explanations = {outcome.best.model.effects, *(tied.effects for tied, _ in outcome.ties)}
    assert explanations >= {(("asymmetric_friction", (0,)),), (("spring", (0,)),)}


def test_a_hidden_effect_is_named_in_its_joint_and_can_be_written(pair, log_of, tmp_path):
    outcome = found([log_of(pair, SPRING)], pair)
    assert describe(outcome.best.model) == "spring (a)"
    stiffness = outcome.best.model.table[ROW["spring", "stiffness"], 0]
    assert stiffness == pytest.approx(0.5, rel=0.1)
    write_effects(effects_of(outcome.best.model), tmp_path / "effects.toml")
    read = {e.name: e for e in read_effects(tmp_path / "effects.toml")}
    low, high = read["spring"].intervals["stiffness"][0]
    assert low < stiffness < high


def test_an_unknown_torque_says_that_it_depends_on_position(pair, log_of):
    data = data_of([log_of(pair, SPRING)], pair)
    model = baseline(setting_of(data), BASELINE).settled()
    motion = motion_of(model)
    assert dependences(model, motion)[0][0][0] == "position"
    assert motion.unknown[:, 0].std() > 3 * motion.unknown[:, 1].std()


HANGING = """<mujoco><option timestep="0.0005" integrator="RK4"/><worldbody><body>
<joint name="upper" axis="0 1 0" damping="0.01" armature="0.002"/><inertial pos="0 0 -0.2" mass="0.55"
diaginertia="0.002 0.002 0.0005"/><body pos="0 0 -0.2"><joint name="lower" axis="0 1 0" damping="0.01"
armature="0.002"/><inertial pos="0 0 -0.28" mass="0.6" diaginertia="0.008 0.008 0.0005"/></body></body></worldbody>
<actuator><motor joint="upper"/><motor joint="lower"/></actuator></mujoco>"""


def test_links_that_no_drive_holds_are_followed(tmp_path: Path) -> None:
    """Each gives way to a torque on the other: with the gains of one that is held the start of a block is lost."""
    path = tmp_path / "hanging.xml"
    path.write_text(HANGING)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    t = np.arange(0.0, 8.0, 0.004)
    force = 0.15 * np.stack([np.sin(4.0 * t), np.sin(5.5 * t + 1.0)], -1)
    q = np.zeros_like(force)
    for i, torque in enumerate(force):
        q[i] = data.qpos
        data.ctrl[:] = torque
        mujoco.mj_step(model, data, 8)
    q += 2e-4 * np.random.default_rng(0).standard_normal(q.shape)
    log = JointLog(joints=("upper", "lower"), t=t, q=q, force=force)
    start = baseline(setting_of(data_of([log], read_machine(path))), BASELINE).evaluated()
    assert spread(start).max() < 0.05

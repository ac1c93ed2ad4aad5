"""Where an effect is looked for, and how blocks are judged without themselves."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mimic.config.sysid import CalibrateSettings, LogSettings
from mimic.dynamics.catalogue import BASELINE, CATALOGUE
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.dynamics.servo import neutral
from mimic.io.joint_log import JointLog
from mimic.sysid.calibrate import calibrate
from mimic.sysid.evidence import evaluate
from mimic.sysid.hypotheses import Hypothesis, elsewhere_too, further, pruned
from mimic.sysid.least_squares import Fit, fit, left_out
from mimic.sysid.logs import make_blocks
from mimic.sysid.noise import coarse_steps, noise_floor
from mimic.sysid.predict import simulate_log
from mimic.sysid.replay import Replay
from mimic.sysid.residuals import Point, Problem
from mimic.sysid.search import PredictedMotion, Search, starting_points, starts_of

PAIR = """<mujoco><worldbody>
<body name="a"><joint name="a" axis="0 1 0" armature="0.003" damping="0.05" frictionloss="0.04"/>
<inertial pos="0 0 -0.08" mass="0.3" diaginertia="0.001 0.001 0.0003"/></body>
<body name="b" pos="0 1 0"><joint name="b" axis="0 1 0" armature="0.003" damping="0.05" frictionloss="0.04"/>
<inertial pos="0 0 -0.06" mass="0.4" diaginertia="0.001 0.001 0.0003"/></body></worldbody></mujoco>"""


@pytest.fixture
def pair(tmp_path: Path) -> MachineModel:
    path = tmp_path / "pair.xml"
    path.write_text(PAIR)
    return read_machine(path, {"kp": 20.0, "kd": 0.8})


def log_of(pair: MachineModel, *hidden: EffectValues, fast: float = 0.0, timestep: float = 0.001) -> JointLog:
    """Return 10 s of sines; with ``fast``, in the seventh second only there is also a swing of this size at 4 Hz."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 10.0, 0.02)
    phase = rng.uniform(0, 2 * np.pi, (3, 2))
    q_des = sum(0.4 / (1 + k) * np.sin(2 * np.pi * f * t[:, None] + phase[k]) for k, f in enumerate((0.4, 0.9, 1.7)))
    q_des = np.asarray(q_des)[:, : len(pair.joints)]
    swing = np.where((t > 6.0) & (t < 7.0), fast * np.sin(8 * np.pi * t), 0.0)
    made = simulate_log(pair, t, q_des + swing[:, None], EffectSet(hidden), LogSettings(seed=4, timestep=timestep))
    return replace(made, tau=None)


def problem_of(pair: MachineModel, log: JointLog, timestep: float = 0.005) -> tuple[Problem, Point]:
    replay = Replay(pair, log, timestep=timestep)
    problem = Problem(replay, np.full(len(pair.joints), 0.35e-3), None, make_blocks(log.t, replay.counts))
    return problem, Point.of(BASELINE, pair)


def hypothesis(problem: Problem, fitted: Fit, name: str, joints) -> Hypothesis:
    """Return a set of one effect, on these joints."""
    mask = np.array(joints, dtype=bool)
    return Hypothesis(problem=problem, fitted=fitted, names=(*BASELINE, name), joints={name: mask})


def silent(text: str) -> None:
    """Report nothing."""


@pytest.mark.slow
def test_a_block_that_alone_shows_a_limit_is_not_judged_by_a_linear_model(pair: MachineModel) -> None:
    """Without it nothing determines the limit: what a straight line makes of that is worse than any replay."""
    weak = EffectValues(name="torque_speed", joints=("a", "b"), values={"torque": 2.5, "speed": 9.0, "flat": 0.0})
    problem, baseline = problem_of(pair, log_of(pair, weak, fast=1.0))
    start = baseline.with_effect("torque_speed", pair, {"torque": 3.5, "speed": 12.0, "flat": 0.0})
    fitted = fit(problem, start, [*BASELINE, "torque_speed"], {}, most=3)
    squares, _ = left_out(fitted, problem)
    without = problem.block_squares(fit(problem, baseline, BASELINE, {}, most=3).residual)[problem.blocks.train]
    assert squares.sum() < 0.5 * without.sum()
    assert np.all(squares < 10.0 * without.max())


def test_fine_replays_of_a_point_are_made_once(pair: MachineModel) -> None:
    problem, point = problem_of(pair, log_of(pair))
    once = problem.in_fine_steps(point)
    made = problem.replay.replays
    again = problem.in_fine_steps(point.moved([], np.zeros(0)))
    assert np.array_equal(again, once, equal_nan=True)
    assert problem.replay.replays == made
    other = problem.in_fine_steps(point.with_effect("coulomb", pair, {"level": 0.1}))
    assert problem.replay.replays > made
    assert np.nanmax(np.abs(other - once)) > 1.0
    late = problem.changed(replay=problem.replay.with_late(np.full(len(problem.replay.sent), 0.01)))
    assert np.nanmax(np.abs(late.in_fine_steps(point) - once)) > 1.0
    assert np.array_equal(problem.in_fine_steps(point), once, equal_nan=True)


@pytest.mark.slow
def test_the_shorter_of_two_fine_replays_is_the_same_whether_both_were_made_or_not(pair: MachineModel) -> None:
    """What the extrapolation adds hardly depends on the point: so steps on the way take the shorter one alone."""
    problem, point = problem_of(pair, log_of(pair))
    near = point.moved([], np.zeros(0)).with_effect("coulomb", pair, {"level": 0.051})
    alone = problem.in_steps_of_columns(point)
    both = problem.in_fine_steps(point)
    made = problem.replay.replays
    assert np.array_equal(problem.in_steps_of_columns(point), alone, equal_nan=True)
    assert problem.replay.replays == made
    there = problem.in_steps_of_columns(near)
    assert problem.replay.replays == made + 5
    moved = np.nanstd(there - alone)
    assert np.nanstd(problem.in_fine_steps(near) - (there + both - alone)) < 0.1 * moved


def test_cogging_is_looked_for_near_its_order(pair: MachineModel) -> None:
    """Two thirds of a wave in the range of motion is near enough for the fit that begins there."""
    ripple = {"cosine": np.array([0.03, 0.05]), "sine": np.array([0.04, -0.02]), "order": np.array([37.0, 61.0])}
    log = log_of(pair, EffectValues(name="cogging", joints=pair.joints, values=ripple))
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=1)
    motion = PredictedMotion(t=log.t, q=log.q, dq=np.gradient(log.q, log.t, axis=0), tau=np.zeros_like(log.q))
    order = starts_of("cogging", fitted, problem, motion)[0].values["cogging", "order"]
    assert order == pytest.approx(ripple["order"], abs=4.0 / np.ptp(log.q, axis=0).max())


def test_cogging_is_not_looked_for_beyond_its_bound(pair: MachineModel) -> None:
    """The range of motion would allow orders up to 180; here ripple of another 700 is left."""
    log = log_of(pair)
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=1)
    left = replace(fitted, residual=np.cos(700.0 * log.q))
    slow = 0.1 * log.q
    motion = PredictedMotion(t=log.t, q=slow, dq=np.gradient(slow, log.t, axis=0), tau=np.zeros_like(log.q))
    order = starts_of("cogging", left, problem, motion)[0].values["cogging", "order"]
    assert np.all(order <= CATALOGUE["cogging"].parameter("order").high)


def test_a_payload_is_extended_to_ends_of_chains_only(pair: MachineModel, tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    inner = '<body name="b" pos="0 1 0">'
    path.write_text(
        PAIR.replace("</body>\n" + inner, inner.replace("0 1 0", "0 0 -0.1")).replace(
            "</body></world", "</body></body></world"
        )
    )
    arm = read_machine(path, {"kp": 20.0, "kd": 0.8})
    assert arm.last.tolist() == [False, True]
    problem, baseline = problem_of(arm, log_of(arm, EffectValues(name="payload", joints=("b",), values={"mass": 0.4})))
    unfitted = fit(problem, baseline, list(BASELINE), {}, most=1)
    assert further(hypothesis(problem, unfitted, "armature", [False, False])).tolist() == [True, True]
    assert further(hypothesis(problem, unfitted, "payload", [False, False])).tolist() == [False, True]


def test_the_step_of_an_encoder_is_read_off_where_it_makes_most_of_the_noise(pair: MachineModel) -> None:
    log = log_of(pair, EffectValues(name="encoder_step", joints=("a",), values={"angle": np.array([0.0025])}))
    noise = noise_floor(log.q, log.rate)
    assert noise[0] > 1.3 * noise[1]
    assert coarse_steps(log.q, noise)[0] == pytest.approx([0.0025, 0.0], abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("also", "joints"), [("torque_speed", [True, True]), ("spring", [True, False])])
def test_an_effect_is_extended_to_a_joint_that_has_it_and_to_no_other(pair: MachineModel, also: str, joints) -> None:
    """The second joint's friction compensates for what it lacks; it gets the effect only if that is the same."""
    weak = {"torque": 1.0, "speed": 6.0, "flat": 0.0}
    other = {"torque_speed": weak, "spring": {"stiffness": 0.8, "moment": 0.1}}[also]
    hidden = [EffectValues(name="torque_speed", joints=("a",), values=weak)]
    hidden += [EffectValues(name=also, joints=("b",), values=other)]
    if also == "torque_speed":
        hidden = [EffectValues(name="torque_speed", joints=("a", "b"), values=weak)]
    problem, baseline = problem_of(pair, log_of(pair, *hidden, fast=1.0))
    start = baseline.with_effect("torque_speed", pair, {"torque": 1.2, "speed": 7.0, "flat": 0.0})
    names, mask = [*BASELINE, "torque_speed"], np.array([True, False])
    none = neutral("torque_speed", "torque", pair)
    values = dict(start.values)
    values["torque_speed", "torque"] = np.where(mask, values["torque_speed", "torque"], none)
    narrow = fit(problem, Point(values), names, {"torque_speed": mask}, most=6)
    found = hypothesis(problem, narrow, "torque_speed", mask)
    assert further(found).tolist() == [False, True]
    wide = elsewhere_too(found, silent)
    assert wide.joints["torque_speed"].tolist() == joints
    if all(joints):
        assert wide.fitted.point.values["torque_speed", "torque"] == pytest.approx([1.0, 1.0], rel=0.1)


@pytest.mark.slow
def test_an_effect_of_all_joints_is_extended_to_none(pair: MachineModel) -> None:
    problem, baseline = problem_of(pair, log_of(pair, fast=1.0))
    unfitted = fit(problem, baseline, list(BASELINE), {}, most=1)
    assert further(hypothesis(problem, unfitted, "torque_speed", [False, False])).any()
    assert not further(hypothesis(problem, unfitted, "torque_speed", [True, True])).any()
    assert not further(hypothesis(problem, unfitted, "lost_commands", [False, False])).any()


def heavy_log(pair: MachineModel, folder: Path, *joints: str) -> JointLog:
    """Return the log of a machine of which one link is a little heavier than three times the model's, which is the
    bound, and some joints stick.
    """
    real = folder / "real.xml"
    real.write_text(PAIR.replace('mass="0.4" diaginertia="0.001 0.001', 'mass="1.216" diaginertia="0.00304 0.00304'))
    values = {"level": np.full(len(joints), 0.25), "speed": np.full(len(joints), 0.15)}
    sticky = EffectValues(name="stribeck", joints=joints, values=values)
    return log_of(read_machine(real, {"kp": 20.0, "kd": 0.8}), sticky)


@pytest.mark.slow
def test_a_chain_that_lacks_an_effect_does_not_bend_what_all_share(pair: MachineModel) -> None:
    """A slow current loop in one chain looks like a delay of the machine; the other chain then seems early."""
    lag = EffectValues(name="torque_lag", joints=("a",), values={"time": np.array([0.03])})
    delay = EffectValues(name="delay", values={"time": np.array([0.011])})
    problem, start = problem_of(pair, log_of(pair, lag, delay, fast=1.0), 0.0025)
    first = fit(problem, start, BASELINE, {}, most=5)
    weighed = problem.weighed(first.residual)
    assert weighed is not problem
    again = fit(weighed, first.point, BASELINE, {}, most=5)
    errors = [abs(f.point.values["delay", "time"][0] - 0.011) for f in (first, again)]
    assert errors[1] < 0.5 * errors[0]
    left = [problem.mean_squares(f.residual, True)[1] for f in (first, again)]
    assert left[0] > 10.0
    assert left[1] < 1.3


@pytest.mark.slow
def test_chains_alike_have_equal_weights(pair: MachineModel) -> None:
    problem, start = problem_of(pair, log_of(pair))
    fitted = fit(problem, start, BASELINE, {}, most=5)
    assert problem.weighed(fitted.residual) is problem
    assert problem.weight == pytest.approx([1.0, 1.0], abs=0.2)


@pytest.mark.slow
def test_a_name_beside_which_much_is_left_stays_with_its_share_on_its_joint(pair: MachineModel, monkeypatch) -> None:
    """It is never fitted to the joint that has no sign of it."""
    asked, free_parameters = [], Problem.free_parameters

    def recorded(self, point, joints, names):
        asked.append(joints.get("stribeck") if "stribeck" in names else np.array([True, False]))
        return free_parameters(self, point, joints, names)

    monkeypatch.setattr(Problem, "free_parameters", recorded)
    sticky = EffectValues(name="stribeck", joints=("a",), values={"level": np.array([0.15]), "speed": np.array([0.2])})
    wave = {"cosine": np.array([0.06]), "sine": np.array([0.0]), "order": np.array([37.0])}
    log = log_of(pair, sticky, EffectValues(name="cogging", joints=("a",), values=wave))
    alone = calibrate(log, pair, CalibrateSettings(effects=("stribeck",), timestep=0.005))
    assert [s.added for s in alone.stages if s.added not in ("", "baseline")] == ["stribeck"]
    assert next(e for e in alone.effects if e.name == "stribeck").joints == ("a",)
    assert all(mask is not None and not mask[1] for mask in asked)
    assert not any("rejected" in line for line in alone.warnings)
    assert next(r for r in alone.unexplained if r.joint == "a").verdict != "explained"
    before, after, floor = (
        np.sum(np.square(x)) for x in (alone.stages[0].errors.held_out, alone.stages[-1].errors.held_out, alone.noise)
    )
    assert "Stribeck friction in a (" in alone.sentence
    assert f"({100 * (before - after) / (before - floor):.0f} % of the unexplained error)" in alone.sentence


@pytest.mark.slow
def test_a_delay_of_one_joint_is_separated_from_that_of_the_machine(pair: MachineModel) -> None:
    late = EffectValues(name="joint_delay", joints=("a",), values={"time": np.array([0.012])})
    delay = EffectValues(name="delay", values={"time": np.array([0.011])})
    result = calibrate(
        log_of(pair, late, delay, fast=1.0), pair, CalibrateSettings(effects=("joint_delay",), timestep=0.005)
    )
    found = {e.name: e for e in result.effects}
    assert found["joint_delay"].joints == ("a",)
    for name, true in (("joint_delay", 0.012), ("delay", 0.011)):
        low, high = found[name].intervals["time"][0]
        assert found[name].values["time"] == pytest.approx([true], abs=2e-4), name
        assert 0.0 < high - low < 0.002


@pytest.mark.slow
def test_what_goes_together_without_a_change_has_derivatives_that_cancel(pair: MachineModel) -> None:
    """Gains, masses, rotors and friction times the same number move alike; a fit may not seem sure of that number."""
    problem, _ = problem_of(pair, log_of(pair, fast=1.0), 0.0025)
    names = ["coulomb", "viscous", "link_mass", "armature", "gains"]
    point = Point.of(names, pair)
    free_parameters = problem.free_parameters(point, {}, names)
    left = []
    for both_sides in (False, True):
        columns = problem.columns_in_fine_steps(point, free_parameters, both_sides)
        together = sum(value * column for value, column in zip(point.read(free_parameters), columns, strict=True))
        left.append(float(np.sqrt(np.nanmean(np.square(together)))))
    assert left[0] > 1.0
    assert left[1] < 0.2 * left[0]


@pytest.mark.slow
def test_backlash_begins_near_its_gap(pair: MachineModel) -> None:
    """The sum of squares over it is rough: a fit finds it only from nearby, and the derivative there may lead away."""
    log = log_of(pair, EffectValues(name="backlash", joints=("a",), values={"gap": np.array([0.03])}))
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=3)
    motion = PredictedMotion(t=log.t, q=log.q, dq=np.gradient(log.q, log.t, axis=0), tau=np.zeros_like(log.q))
    start = starting_points(problem, fitted, ["backlash"], motion)[0]
    assert start.joints[0]
    assert start.point.values["backlash", "gap"][0] == pytest.approx(0.03, rel=0.2)


def what_stays(pair: MachineModel, log: JointLog, joints: tuple[bool, bool] = (True, True)) -> Hypothesis:
    """Fit a log with Stribeck friction in some joints, and return what stays of it."""
    problem, baseline = problem_of(pair, log)
    has = np.array(joints)
    bare = fit(problem, baseline, BASELINE, {})
    root = Hypothesis(problem=problem, fitted=bare, names=BASELINE, joints={})
    start = bare.point.with_effect("stribeck", pair, {"level": np.where(has, 0.02, 0.0), "speed": 0.2})
    final = fit(problem, start, [*BASELINE, "stribeck"], {"stribeck": has})
    found = evaluate(problem, bare, root.squares, "stribeck", final, has)
    grown = hypothesis(problem, final, "stribeck", has)
    return pruned(replace(grown, parent=root, found=found), silent)


@pytest.mark.slow
def test_a_name_whose_numbers_end_as_those_of_none_is_rejected(pair: MachineModel) -> None:
    """What it explained when it was found was that the others had not been fitted to the end."""
    made = what_stays(pair, log_of(pair))
    assert [s.added for s in made.stages(())] == ["baseline", ""]
    assert "stribeck" not in made.names
    assert not any(k.key[0] == "stribeck" for k in made.fitted.free_parameters)
    assert "in the final fit its parameters are those of a machine without it" in made.rejections[0]


@pytest.mark.slow
def test_nothing_is_named_where_a_baseline_parameter_stops_at_its_bound(pair: MachineModel, tmp_path: Path) -> None:
    """The friction is there, but so is a link heavier than any that can be fitted."""
    made = what_stays(pair, heavy_log(pair, tmp_path, "b"), (False, True))
    assert made.names == BASELINE
    assert made.rejections[0].startswith("Stribeck friction was rejected: link_mass.factor of b, in the same chain,")


@pytest.mark.slow
def test_where_a_baseline_parameter_stops_at_its_bound_an_effect_is_named_elsewhere_only(
    pair: MachineModel, tmp_path: Path
) -> None:
    made = what_stays(pair, heavy_log(pair, tmp_path, "a", "b"))
    assert made.names[-1] == "stribeck"
    assert made.joints["stribeck"].tolist() == [True, False]
    assert made.rejections[0].startswith("Stribeck friction was rejected in b: link_mass.factor of b, in the same")


def test_a_joint_alone_is_not_coupled_to_itself_nor_later_than_the_machine(tmp_path: Path) -> None:
    """Where viscous friction stops at nothing, a coupling to itself would go on below."""
    path = tmp_path / "one.xml"
    path.write_text(PAIR[: PAIR.index('<body name="b"')] + "</worldbody></mujoco>")
    one = read_machine(path, {"kp": 20.0, "kd": 0.8})
    problem, baseline = problem_of(one, log_of(one))
    alone = Hypothesis(problem=problem, fitted=fit(problem, baseline, BASELINE, {}, most=1), names=BASELINE, joints={})
    settings = CalibrateSettings(effects=("coupling", "joint_delay", "quadratic_drag"))
    assert Search(settings=settings, tick=silent, torques=()).candidates(alone) == ["quadratic_drag"]

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

pytest.importorskip("numba")

from lab.hidden_effects import physics, suite, summary
from lab.hidden_effects.agreement import disagreement
from lab.hidden_effects.families import ALIEN_CAPS, FAMILIES, alien, hidden_effect
from lab.hidden_effects.generator import (
    ALIENS,
    CLOCKS,
    DESCRIBED,
    ENCODER,
    FLOOR,
    OTHER_LAWS,
    STEP,
    Machine,
    Truth,
    links,
    measured,
    read_by,
    simulate,
)
from lab.hidden_effects.scenarios import (
    Scenario,
    balanced,
    build,
    differs,
    for_choosing,
    ordered,
    reachable,
    sizes,
)
from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.excitation import Excitation, hung_ranges, probe_targets
from mimic.records import JOINTS, LEGS
from mimic.robot.description import load_description
from mimic.sysid.result import Calibration, Errors, Traces, UnexplainedResidual

DESCRIPTION = load_description("cyberdog2")
LOW, HIGH, CENTRE = hung_ranges(DESCRIPTION)
MOTION = probe_targets(LOW, HIGH, CENTRE, seconds=10.0, seed=1)
COARSE = 4 * STEP
"""Physics step where motions are compared with each other, not with the truth [s]."""
SMOOTH = Machine(friction=np.zeros(12), damping=np.full(12, 0.05), mass=np.ones(12), delay=0.01)
PLAIN = Machine.drawn(np.random.default_rng(0))


@cache
def rest() -> Truth:
    """Return the motion of the machine that has no hidden effect."""
    return moved(PLAIN)


def moved(machine: Machine) -> Truth:
    return simulate(machine, MOTION, 0, COARSE)


def still(q: np.ndarray, seconds: float = 3.0) -> Excitation:
    t = np.arange(round(50 * seconds)) / 50
    return Excitation(t=t, q_des=np.repeat(q[None], len(t), 0))


def bare_model() -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(DESCRIPTION.mjcf))
    spec.delete(spec.joint("base"))
    for group in (spec.actuators, spec.keys, spec.sensors):
        for item in list(group):
            spec.delete(item)
    for joint in spec.joints:
        joint.damping, joint.frictionloss = 0.0 * np.array(joint.damping), 0.0
    model = spec.compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return model


@pytest.mark.slow
def test_leg_dynamics_are_those_of_mujoco():
    model = bare_model()
    model.dof_armature[:] = 0.0
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(20):
        data.qpos[:], data.qvel[:] = rng.uniform(DESCRIPTION.q_min, DESCRIPTION.q_max), rng.normal(0, 4, 12)
        data.qacc[:] = rng.normal(0, 30, 12)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        wanted, found = np.zeros(12), np.zeros(3)
        mujoco.mj_rne(model, data, 1, wanted)
        for i, leg in enumerate(LEGS):
            at = slice(3 * i, 3 * i + 3)
            gravity = np.array([0.0, 0.0, -9.81])
            physics.leg_torque(data.qpos[at], data.qvel[at], data.qacc[at], gravity, links(DESCRIPTION, leg), found)
            assert np.abs(found - wanted[at]).max() < 1e-12


@pytest.mark.slow
def test_motion_without_friction_is_that_of_mujoco_at_a_tenth_of_the_step():
    whole = probe_targets(LOW, HIGH, CENTRE, seconds=10.0, seed=5, kind="random")
    motion = replace(whole, t=whole.t[:125], q_des=whole.q_des[:125])  # half a second more than is compared
    truth = simulate(replace(SMOOTH, damping=np.zeros(12)), motion, 0)
    model = bare_model()
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 1e-4
    data = mujoco.MjData(model)
    data.qpos[:] = truth.q[0]
    worst = 0.0
    for step in range(20_000):
        if step % 50 == 0:
            worst = max(worst, float(np.abs(data.qpos - truth.q[step // 50]).max()))
        row = max(0, int((step * 1e-4 - 0.01) / 0.02 + 1e-9))
        data.qfrc_applied[:] = 30.0 * (motion.q_des[row] - data.qpos) - 3.0 * data.qvel
        mujoco.mj_step(model, data)
    assert np.ptp(truth.q[:400], axis=0).min() > 0.05  # it moved
    assert worst < 0.1e-3


@pytest.mark.slow
def test_at_rest_the_error_is_gravity_over_kp():
    q = LOW + 0.3 * (HIGH - LOW)
    truth = simulate(SMOOTH, still(q), 0)
    model = bare_model()
    data = mujoco.MjData(model)
    data.qpos[:] = truth.q[-1]
    mujoco.mj_forward(model, data)
    assert np.allclose(q - truth.q[-1], data.qfrc_bias / 30.0, atol=1e-7)
    assert np.abs(data.qfrc_bias).max() > 0.5


@pytest.mark.slow
def test_a_joint_pushed_by_less_than_its_friction_does_not_move_at_all():
    q = LOW + 0.4 * (HIGH - LOW)
    heavy = replace(SMOOTH, friction=np.full(12, 3.0))
    motion = still(q)
    targets = np.array(motion.q_des)
    targets[75:] += 0.04  # 1.2 N m beside gravity
    truth = simulate(heavy, replace(motion, q_des=targets), 0)
    assert np.abs(truth.q - q).max() < 1e-12
    light = simulate(replace(heavy, friction=np.full(12, 0.1)), replace(motion, q_des=targets), 0)
    assert np.abs(light.q[-1] - q).min() > 0.01


@pytest.mark.slow
def test_a_stiff_transmission_without_play_moves_as_none():
    """Legs do not influence each other: two are elastic, the others have play."""
    stiff = EffectValues(name="compliance", joints=JOINTS[:6], values={"compliance": 2e-5})
    tight = EffectValues(name="backlash", joints=JOINTS[6:], values={"gap": 1e-7})
    truth = moved(replace(PLAIN, hidden=EffectSet((stiff, tight))))
    assert np.sqrt(((truth.q - rest().q) ** 2).mean(0)).max() < 0.1e-3


@pytest.mark.slow
def test_a_loaded_elastic_joint_reads_the_motor_and_sags_behind_it():
    q = LOW + 0.3 * (HIGH - LOW)
    soft = EffectSet((EffectValues(name="compliance", joints=JOINTS, values={"compliance": 0.1}),))
    rigid = simulate(SMOOTH, still(q), 0)
    truth = simulate(replace(SMOOTH, hidden=soft), still(q, 6.0), 0)
    load = 30.0 * (q - truth.q[-1])
    model = bare_model()
    data = mujoco.MjData(model)
    data.qpos[:] = truth.q[-1] - 0.1 * load  # the links hang lower than the motors say
    mujoco.mj_forward(model, data)
    assert np.allclose(load, data.qfrc_bias, atol=1e-3)
    assert np.abs(truth.q[-1] - rigid.q[-1]).max() > 2e-4


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["probe", "random"])
def test_motions_keep_clear_of_the_end_stops(kind):
    truth = simulate(PLAIN, probe_targets(LOW, HIGH, CENTRE, seconds=20.0, seed=2, kind=kind), 0, COARSE)
    assert np.all(truth.q > DESCRIPTION.q_min + 0.05)
    assert np.all(truth.q < DESCRIPTION.q_max - 0.05)


def by_leg(names: Sequence[str], whole: Sequence[str]) -> list[dict[str, tuple[str, ...]]]:
    """Return what to simulate at once: each name with its joints, those of a leg, of all legs if it is in ``whole``.

    Legs that are left over are those of the last name.
    """
    of_legs = [name for name in names if name not in whole]
    groups = [of_legs[i : i + 4] for i in range(0, len(of_legs), 4)]
    together = [{n: JOINTS[3 * leg : 3 * leg + 3 if n != g[-1] else None] for leg, n in enumerate(g)} for g in groups]
    return [*together, *({name: JOINTS} for name in names if name in whole)]


def apart(one: Truth, other: Truth, joints: Sequence[str]) -> float:
    """Return how far two motions are apart in some joints (rms of the joint where it is most) [rad]."""
    index = [JOINTS.index(j) for j in joints]
    return float(np.sqrt(((one.q - other.q)[:, index] ** 2).mean(0)).max())


OF_MACHINE = [name for name in FAMILIES if CATALOGUE[name].scope == "machine"]


def sized(name: str, joints: Sequence[str], size: float) -> EffectValues:
    own = {j: size for j in joints if j.split("_")[1] in FAMILIES[name].parts}
    return hidden_effect(name, own, PLAIN, np.random.default_rng(3), spread=False)


@pytest.mark.slow
@pytest.mark.parametrize("group", by_leg(list(FAMILIES), OF_MACHINE), ids="-".join)
def test_every_effect_of_the_catalogue_acts(group):
    hidden = EffectSet(tuple(sized(name, joints, FAMILIES[name].cap) for name, joints in group.items()))
    truth = moved(replace(PLAIN, hidden=hidden))
    for name, joints in group.items():
        assert apart(truth, rest(), joints) > FLOOR, name


@pytest.mark.slow
def test_effects_of_no_size_do_not_act():
    other_machines = ("torque_speed", "compliance", "backlash")  # their least value is another machine
    none = EffectSet(tuple(sized(name, JOINTS, 0.0) for name in FAMILIES if name not in other_machines))
    assert apart(moved(replace(PLAIN, hidden=none)), rest(), JOINTS) < 1e-9


def test_every_catalogued_effect_that_is_not_declared_has_a_family():
    """Load-dependent friction of a gear, and voltage drives, are judged by logs of real servos."""
    elsewhere = {"gear_load_friction", "motor", *DESCRIBED.values()}
    assert set(FAMILIES) == {*CATALOGUE} - {*CalibrateSettings().baseline} - elsewhere
    assert set(DESCRIBED) <= set(ALIENS)


@pytest.mark.slow
@pytest.mark.parametrize("group", by_leg(list(OTHER_LAWS), ()), ids="-".join)
def test_a_law_that_is_not_the_catalogues_moves_the_machine_otherwise(group):
    hidden = EffectSet(tuple(sized(name, joints, 0.3 * FAMILIES[name].cap) for name, joints in group.items()))
    machine = replace(PLAIN, hidden=hidden)
    as_catalogued = moved(machine)
    other = moved(replace(machine, other_laws=tuple(group)))
    for name, joints in group.items():
        assert 0.1 * FLOOR < apart(other, as_catalogued, joints) < apart(as_catalogued, rest(), joints), name


@pytest.mark.slow
@pytest.mark.parametrize("group", by_leg(list(ALIENS), ["base_swing"]), ids="-".join)
def test_every_alien_acts(group):
    aliens = [one for n, joints in group.items() for one in alien(n, dict.fromkeys(joints, 0.8 * ALIEN_CAPS[n][0]))]
    truth = moved(replace(PLAIN, aliens=tuple(aliens)))
    for name, joints in group.items():
        assert apart(truth, rest(), joints) > 0.3 * FLOOR, name


@pytest.mark.slow
def test_readings_are_steps_of_the_encoder_around_the_truth():
    log = measured(rest(), 7)
    assert np.allclose(log.q / ENCODER, np.round(log.q / ENCODER), atol=1e-6)
    assert abs((log.q - rest().q).std() / FLOOR - 1.0) < 0.03
    assert log.rate == pytest.approx(200.0)
    assert log.q_des is not None
    assert np.array_equal(log.q_des[::4], MOTION.q_des)


def test_a_scenario_is_drawn_from_its_name():
    first, *others = list(ordered(2, 20.0))
    assert len({first.key, *(s.key for s in others)}) == 1 + len(others)
    for scenario in (first, *others[::17]):
        again = Scenario.of(scenario.key)
        assert again == scenario
        a, b = build(scenario), build(again)
        assert np.array_equal(a.machine.friction, b.machine.friction)
        assert np.array_equal(a.motion.q_des, b.motion.q_des)
        assert a.where == b.where


def test_half_of_the_scenarios_is_for_choosing_whatever_the_clock():
    every = list(ordered(2, 20.0))
    chosen = [for_choosing(s.key) for s in every]
    assert 0.4 < np.mean(chosen) < 0.6
    for scenario, half in zip(every[::23], chosen[::23], strict=True):
        other = replace(scenario, clock="187")
        assert Scenario.of(other.key) == other
        assert for_choosing(other.key) == half
        assert np.array_equal(build(other).machine.friction, build(scenario).machine.friction)


def test_a_third_of_the_machines_with_effects_differ_from_the_catalogue():
    every = [s for s in ordered(4, 20.0) if s.group in ("single", "pair", "clean")]
    with_effects = [s for s in every if s.group != "clean"]
    assert 0.25 < np.mean([differs(s.key) for s in with_effects]) < 0.42
    assert not any(differs(s.key) for s in every if s.group == "clean")
    for scenario in with_effects[::29]:
        built = build(scenario)
        assert bool(built.differs) is differs(scenario.key)
        assert bool(built.machine.other_laws or built.small) is differs(scenario.key)
        assert {e.name for e in built.machine.hidden} == {*scenario.names, *built.small}


def test_all_that_is_hidden_is_in_the_leg_of_the_log():
    pairs = [s for s in ordered(2, 20.0) if s.group in ("pair", "alien")]
    for scenario in pairs[::3]:
        one_leg = replace(scenario, joints="leg")
        assert Scenario.of(one_leg.key) == one_leg
        assert for_choosing(one_leg.key) == for_choosing(scenario.key)
        built = build(one_leg)
        assert all(set(joints) <= set(built.leg) or joints == JOINTS for joints in built.where.values())


def test_a_leg_by_itself_is_the_leg_of_the_robot():
    robot, leg = suite.hung(JOINTS), suite.hung(JOINTS[6:9])
    index = [robot.joints.index(j) for j in leg.joints]
    assert leg.joints == JOINTS[6:9]
    assert np.allclose(leg.model.body_mass[leg.body], robot.model.body_mass[robot.body[index]])
    for name in ("kp", "kd", "torque", "speed", "flat", "armature", "friction"):
        assert np.allclose(getattr(leg.drives, name), getattr(robot.drives, name)[index]), name


@pytest.mark.parametrize("beginning", [64, 160, 320])
def test_any_beginning_of_the_balanced_order_has_all_clocks_halves_and_groups(beginning):
    first = list(balanced(6, 20.0))[:beginning]
    assert len({s.key for s in first}) == beginning
    for clock in CLOCKS:
        mine = [s for s in first if s.clock == clock]
        assert len(mine) == beginning // 4
        assert [s.group for s in mine].count("clean") == 3 * beginning // 32
        assert abs(np.mean([for_choosing(s.key) for s in mine]) - 0.5) < 0.15


@pytest.mark.parametrize("name", ["beside", "187", "50"])
def test_a_clock_of_its_own_reads_the_same_motion_with_the_newest_target(name):
    t = np.arange(0.0, MOTION.t[-1] + 0.02, 1e-3)
    q = np.sin(3 * t)[:, None] * np.ones(12)
    sent = np.searchsorted(MOTION.t, t + 1e-9, side="right") - 1
    read = read_by(CLOCKS[name], Truth(t=t, q=q, tau=0 * q, q_des=MOTION.q_des[sent]), MOTION, 0)
    assert np.abs(read.q - np.sin(3 * read.t)[:, None]).max() < 2e-6
    assert 1 / np.diff(read.t).mean() == pytest.approx(CLOCKS[name].rate_hz, rel=1e-3)
    last = np.floor(read.t / MOTION.t[1] + 1e-6).astype(int)
    assert np.array_equal(read.q_des, MOTION.q_des[last])


def test_the_table_has_both_halves_and_every_clock():
    right = judged(stages=[("cogging", [])])
    keys = [s.key for s in ordered(1, 20.0) if s.group == "single" and s.strength == "strong"]
    base = {**right, "group": "single", "strength": "strong", "change": [9.0] * 12, "truth": None, "effects": []}
    records = [{**base, "key": k + c} for k in keys for c in ("", "/187")]
    text = summary.markdown([{**r, "truth": {"hidden": [], "declared": {}}} for r in records])
    halves = [sum(for_choosing(k) == half for k in keys) for half in (True, False)]
    named = [line for line in text.splitlines() if line.startswith("| one effect, strong or medium: named")]
    together, *each = named
    assert together.count(f"| {halves[0]}/{halves[0]} · {halves[1]}/{halves[1]} |".strip("| ")) == 2
    assert len(each) == 2
    assert all(f"({n} of {n};" in line for line in each for n in halves)
    assert "clock '187'" in text


@pytest.mark.slow
def test_an_effect_that_cannot_be_so_strong_is_refused():
    assert not reachable("kt_gain", "strong")
    with pytest.raises(ValueError, match="cannot be strong"):
        build(Scenario(group="single", names=("kt_gain",), strength="strong"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "strength"), [("torque_speed", "medium"), ("velocity_lag", "medium"), ("payload", "weak")]
)
def test_the_replay_of_mimic_with_the_true_numbers_is_the_truth(name, strength):
    scenario = Scenario(group="single", names=(name,), strength=strength, seconds=10.0)
    without, with_it = disagreement(scenario)
    assert without.max() > 3.0
    assert with_it.max() < 1.0


def silent(log) -> Calibration:
    """A calibration that finds nothing."""
    rows = np.zeros((1, 12))
    errors = Errors(train=np.full(12, FLOOR), held_out=np.full(12, FLOOR))
    rest = tuple(UnexplainedResidual(joint=j, ratio=2.0, torque=0.1, depends_on=()) for j in JOINTS)
    empty = np.zeros(1)
    return Calibration(
        joints=JOINTS,
        unit="rad",
        noise=np.full(12, FLOOR),
        nominal=errors,
        baseline=errors,
        final=errors,
        found=(),
        effects=EffectSet(),
        unexplained=rest,
        sentence="",
        traces=Traces(t=empty, q=rows, dq=rows, tau=rows, before=rows, after=rows),
    )


def broken(log) -> Calibration:
    raise ValueError("no")


def slow(log) -> Calibration:
    time.sleep(60.0)
    return silent(log)


SHORT = [Scenario.of(f"{what}/0/10s") for what in ("clean/nothing/none/probe", "single/cogging/weak/random")]


@pytest.mark.slow
def test_suite_writes_a_line_each_and_goes_on_where_it_stopped(tmp_path, capsys):
    assert suite.run_suite(SHORT[:1], tmp_path, 2, 60.0, silent) == 1
    assert suite.run_suite(SHORT, tmp_path, 2, 60.0, broken) == 1
    clean, single = summary.read_results([tmp_path / "results.jsonl"])
    assert summary.nothing_named(clean)
    assert "ValueError: no" in single["error"]
    assert single["truth"]["hidden"][0]["name"] == "cogging"


@pytest.mark.slow
def test_suite_stops_at_its_limit(tmp_path):
    assert suite.run_suite(SHORT, tmp_path, 1, 1.5, slow) == 0
    assert (tmp_path / "results.jsonl").read_text() == ""


@pytest.mark.slow
def test_a_log_that_takes_too_long_is_an_error_and_the_next_one_is_run(tmp_path):
    assert suite.run_suite(SHORT, tmp_path, 1, 60.0, slow, log_limit=1.0) == 2
    results = summary.read_results([tmp_path / "results.jsonl"])
    assert [r["error"] for r in results] == ["not done after 1 s"] * 2
    assert summary.goals(results)[-1][2:] == (2, 2)


def judged(**values) -> dict:
    joint = {"joint": "FL_knee", "explained": True}
    stages = dict(values.pop("stages"))
    return {
        "names": ["cogging"], "where": {"cogging": ["FL_knee"]}, "belongs": True,
        "unexplained": [joint], "floor": FLOOR,
        "named": list(stages), "rivals": stages, "baseline": [FLOOR] * 12, "final": [FLOOR] * 12,
        **values,
    }  # fmt: skip


def test_judging_separates_right_from_rival_from_wrong():
    right = judged(stages=[("cogging", [])])
    rival = judged(stages=[("spring", ["cogging"])])
    more = judged(stages=[("cogging", []), ("spring", [])])
    nothing = judged(stages=[])
    assert [summary.right(r) for r in (right, rival, more, nothing)] == [True, False, False, False]
    assert [summary.right_or_rival(r) for r in (right, rival, more, nothing)] == [True, True, False, False]
    assert [summary.all_found(r) for r in (right, rival, more, nothing)] == [True, False, True, False]
    assert not summary.unexplained(nothing)
    assert summary.unexplained(judged(stages=[], unexplained=[{"joint": "FL_knee", "explained": False}]))
    assert not summary.right({"names": ["cogging"], "error": "x"})
    assert summary.right({**more, "small": ["spring"]})
    assert summary.right({**right, "small": ["spring"]})
    assert not summary.right({**right, "small": ["cogging"]})


@pytest.mark.slow
def test_a_trace_is_a_quarter_of_weak():
    built = build(Scenario(group="single", names=("cogging",), strength="trace", seconds=10.0))
    (cogging,) = built.machine.hidden
    made = np.hypot(cogging.values["cosine"], cogging.values["sine"])
    weak = np.array([sizes("cogging", "weak")[joint.split("_")[1]] for joint in cogging.joints])
    assert np.all((made > 0.25 * 0.84 * weak) & (made < 0.25 * 1.21 * weak))
    keys = [s.key for s in ordered(1)]
    assert "single/cogging/trace/probe/0/60s" in keys
    assert len(keys) == len(set(keys))


def test_what_a_motion_does_not_show_is_not_expected():
    two = {"names": ["cogging", "torque_speed"], "changes": {"cogging": [0.0, 3.0], "torque_speed": [0.0, 0.01]}}
    one = judged(stages=[("cogging", [])], **two)
    both = judged(stages=[("cogging", []), ("torque_speed", [])], **two)
    assert summary.expected(one) == {"cogging"}
    assert not summary.whole(one)
    assert [summary.right(r) for r in (one, both)] == [True, False]
    assert summary.whole(judged(stages=[], names=["cogging", "spring"]))  # not measured: all are expected


@pytest.mark.slow
def test_changes_are_those_of_each_effect_alone():
    built = build(
        Scenario(group="pair", names=("torque_speed", "stribeck"), strength="medium", kind="random", seconds=10.0)
    )
    found = suite.changes(built, simulate(built.machine, built.motion, built.seed))
    assert max(found["torque_speed"]) < summary.SHOWN < 1.0 < max(found["stribeck"])


def test_coverage_counts_intervals_that_hold_the_truth():
    record = judged(
        stages=[("cogging", [])],
        truth={
            "declared": {"delay.time": [0.01]},
            "hidden": [{"name": "cogging", "joints": ["FL_knee"], "cosine": [0.1], "sine": [0.2]}],
        },
        effects=[
            {"name": "delay", "joints": [], "intervals": {"time": [[0.009, 0.011]]}},
            {"name": "cogging", "joints": ["FL_knee"], "intervals": {"cosine": [[0.05, 0.15]], "sine": [[0.3, 0.4]]}},
        ],
    )
    assert summary.coverage([record], declared=True) == [("delay.time", True)]
    assert dict(summary.coverage([record], declared=False)) == {"cogging.cosine": True, "cogging.sine": False}
    assert json.dumps(summary.goals([{**record, "key": "single/cogging/weak/probe/0/10s", "group": "single"}]))


def test_the_detection_limit_of_an_effect_is_between_what_is_missed_and_what_is_found() -> None:
    sizes = {"spring": (1.1, 1.2, 1.5, 2.0, 4.0, 8.0), "cogging": (1.1, 1.5, 2.0, 2.8, 4.0, 8.0)}
    found_from = {"spring": 1.4, "cogging": 2.5}
    singles = [
        {
            "names": [name],
            "where": {name: ["FL_hip"]},
            "belongs": True,
            "named": [name] if size > found_from[name] else [],
            "baseline": [size] * 12,
            "floor": 1.0,
        }
        for name, row in sizes.items()
        for size in row
    ]
    limits = summary.detection_limits(singles, ["spring", "cogging"])
    assert np.all(np.diff(limits["spring"]) > 0)
    assert limits["spring"][1] == pytest.approx(1.4, rel=0.15)
    assert limits["cogging"][1] == pytest.approx(2.4, rel=0.15)

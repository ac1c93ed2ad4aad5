"""The paper's figures on logs whose answers are known."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lab.policies.studies.ground_contacts import GroundFacts, ground_facts, ground_parts
from lab.policies.studies.paper_columns import COLUMNS, PAPER, TERMINATIONS, WEIGHTS, terminations, terms
from lab.policies.studies.paper_table import STATUE, Episode, evaluate_episode, evaluate_table, over_seeds
from lab.policies.studies.settings import TableSettings
from mimic.dynamics.robot_model import load_model
from mimic.errors import AssetError
from mimic.evaluation.paper_reward import STAND_STEPS
from mimic.io.assets import shipped
from mimic.io.store import plain
from mimic.records import LEGS, RunLog
from mimic.robot.description import load_description
from mimic.robot.leg_kinematics import front_toes

TICKS = 101
EVERYTHING = tuple(dict.fromkeys(kind for kinds in TERMINATIONS.values() for kind in kinds))


def safe_pose(description) -> np.ndarray:
    """Joint positions far from every limit."""
    return (description.q_min + description.q_max) / 2


@pytest.fixture
def standing_log(description) -> Callable[..., RunLog]:
    """Return a function that makes the log of a robot that stands like a statue and is where it should be."""

    def make(ticks: int = TICKS, **changes: Any) -> RunLog:
        d = description
        lean = -np.arctan2(d.upright_direction[2], d.upright_direction[0])
        quat = Rotation.from_euler("Y", lean).as_quat(scalar_first=True)
        q = np.tile(safe_pose(d), (ticks, 1))
        toes = front_toes(q, d)
        zeros = np.zeros((ticks, 12))
        columns = {
            "t": d.dt * np.arange(ticks),
            "t_host": d.dt * np.arange(ticks),
            "phase": np.full(ticks, 3),
            "q": q,
            "dq": zeros,
            "tau": zeros,
            "quat_WB": np.tile(quat, (ticks, 1)),
            "omega_B": np.zeros((ticks, 3)),
            "p_WB": np.tile([0.0, 0.0, 0.45], (ticks, 1)),
            "v_WB": np.zeros((ticks, 3)),
            "p_BE": toes,
            "v_des": np.zeros((ticks, 2)),
            "heading_des": np.zeros(ticks),
            "p_BE_des": toes,
            "observation": np.zeros((ticks, 1)),
            "action": zeros,
            "q_des": q,
            "q_sent": q,
            "kp": np.full((ticks, 12), d.kp),
            "kd": np.full((ticks, 12), d.kd),
        }
        return RunLog(**(columns | changes), metadata={"dt": d.dt})

    return make


@pytest.fixture
def still(description) -> Callable[..., GroundFacts]:
    """Return a function that makes the ground facts of planted hind toes and lifted front toes, all at rest."""

    def make(ticks: int = TICKS, **touching: np.ndarray) -> GroundFacts:
        no = np.zeros(ticks, dtype=bool)
        contacts = {part: no for part in ground_parts(description)} | {"RL_foot": ~no, "RR_foot": ~no}
        height = np.tile([0.5, 0.5, description.toe_radius, description.toe_radius], (ticks, 1))
        return GroundFacts(
            toe_height=height,
            toe_velocity=np.zeros((ticks, 4, 2)),
            toe_yaw_rate=np.zeros((ticks, 4)),
            touching=contacts | touching,
        )

    return make


def at(tick: int, ticks: int = TICKS) -> np.ndarray:
    return np.arange(ticks) == tick


# ---------------------------------------------------------------------- terms


def test_a_robot_that_follows_every_command_earns_every_weight(standing_log, still, description):
    log = standing_log()
    found = evaluate_episode(log, still(), description, steps=TICKS - 1, kinds=EVERYTHING)
    assert found.ended_by == "time"
    assert found.steps == TICKS - 1
    for name in ("velocity", "heading", "height", "upright"):
        assert found.columns[name] == pytest.approx(WEIGHTS[name]), name
    tracked = 1 - STAND_STEPS / (TICKS - 1)
    assert found.columns["toes"] == pytest.approx(WEIGHTS["toes"] * tracked)
    costs = [name for name, weight in WEIGHTS.items() if weight < 0]
    assert all(found.columns[name] == pytest.approx(0.0, abs=1e-12) for name in costs)
    assert found.toe_error_cm == found.velocity_error == found.heading_error == 0.0
    assert found.reward == pytest.approx(sum(found.columns.values()) * (TICKS - 1) * description.dt)


def test_tracking_is_worth_half_at_the_paper_s_half_widths(standing_log, still, description):
    half = np.sqrt(np.log(2))
    toes = standing_log().p_BE + [half * np.sqrt(0.02), 0.0, 0.0] * np.array([[1.0], [0.0]])
    log = standing_log(
        v_WB=np.tile([0.0, half * np.sqrt(0.05), 0.0], (TICKS, 1)),
        heading_des=np.full(TICKS, np.pi * half * np.sqrt(0.05)),
        p_BE_des=toes,
    )
    found = terms(log, still(), description)
    for name in ("velocity", "heading", "toes"):
        assert found[name][-1] == pytest.approx(0.5), name


def test_velocities_are_those_along_the_heading(standing_log, still, description):
    turned = Rotation.from_euler("Z", 1.0) * Rotation.from_quat(standing_log().quat_WB[0], scalar_first=True)
    log = standing_log(
        quat_WB=np.tile(turned.as_quat(scalar_first=True), (TICKS, 1)),
        v_WB=np.tile(Rotation.from_euler("Z", 1.0).apply([0.3, 0.0, 0.0]), (TICKS, 1)),
        v_des=np.tile([0.3, 0.0], (TICKS, 1)),
        heading_des=np.full(TICKS, 1.0),
    )
    found = terms(log, still(), description)
    assert found["velocity"] == pytest.approx(1.0)
    assert found["heading"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("z", "height", "standing"), [(0.15, 0.0, 0.0), (0.285, 0.5, 0.35), (0.30, None, 0.5), (0.5, 1, 1)]
)
def test_height_counts_by_itself_and_scales_tracking(z, height, standing, standing_log, still, description):
    found = terms(standing_log(p_WB=np.tile([0.0, 0.0, z], (TICKS, 1))), still(), description)
    if height is not None:
        assert found["height"] == pytest.approx(height)
    assert found["velocity"] == pytest.approx(standing)
    assert found["heading"] == pytest.approx(standing)
    assert found["toes"].any() == (z > 0.37)


def test_lying_on_four_feet_tracks_nothing(standing_log, still, description):
    log = standing_log(quat_WB=np.tile([1.0, 0.0, 0.0, 0.0], (TICKS, 1)))
    found = terms(log, still(), description)
    assert not any(found[name].any() for name in ("velocity", "heading", "toes"))


def test_a_step_is_evaluated_by_the_command_of_its_beginning(standing_log, still, description):
    ahead = standing_log().v_des.copy()
    ahead[60:] = 1.0
    found = terms(standing_log(v_des=ahead), still(), description)["velocity"]
    assert np.flatnonzero(found < 0.5)[0] == 60  # the 61st step, the first that began at tick 60


def test_only_low_toes_slip_and_turning_counts_too(standing_log, still, description):
    facts = still()
    velocity, rate = facts.toe_velocity.copy(), facts.toe_yaw_rate.copy()
    velocity[:, 0] = 5.0  # a lifted front toe
    velocity[:, 2] = [3.0, 4.0]
    rate[:, 3] = 2 * np.pi
    moving = dataclasses.replace(facts, toe_velocity=velocity, toe_yaw_rate=rate)
    assert terms(standing_log(), moving, description)["slip"] == pytest.approx(25.0 + 4.0)


# ---------------------------------------------------------------------- how episodes end


@pytest.mark.parametrize(
    ("part", "kind"),
    [
        ("base", "base"),
        ("head", "head"),
        ("FL_foot", "front_leg"),
        ("FR_calf", "front_leg"),
        ("RR_thigh", "hind_thigh"),
    ],
)
def test_contacts_end_an_episode_once_it_should_stand(part, kind, standing_log, still, description):
    log = standing_log()
    late = evaluate_episode(log, still(**{part: at(40)}), description, steps=100, kinds=TERMINATIONS["contacts"])
    assert (late.steps, late.ended_by) == (40, kind)
    early = evaluate_episode(log, still(**{part: at(30)}), description, steps=100, kinds=TERMINATIONS["contacts"])
    assert (early.steps, early.ended_by) == (100, "time")


def test_hind_toes_and_calves_may_touch(standing_log, still, description):
    found = evaluate_episode(standing_log(), still(RL_calf=at(70)), description, steps=100, kinds=EVERYTHING)
    assert found.ended_by == "time"
    assert found.columns["collision"] < 0


def test_a_joint_near_its_limit_ends_an_episode_where_that_is_a_rule(standing_log, still, description):
    q = standing_log().q.copy()
    q[60:, 4] = description.q_max[4] - np.deg2rad(4.9)
    log = standing_log(q=q)
    strict = evaluate_episode(log, still(), description, steps=100, kinds=TERMINATIONS["contacts and joint limits"])
    assert (strict.steps, strict.ended_by) == (60, "joint_limit")
    assert strict.near_limit[4] == pytest.approx(1 / 60)
    lenient = evaluate_episode(log, still(), description, steps=100, kinds=TERMINATIONS["contacts"])
    assert (lenient.steps, lenient.ended_by) == (100, "time")


def test_the_first_steps_have_rules_of_their_own(standing_log, still, description):
    facts = still()
    height = facts.toe_height.copy()
    height[10, 3] = height[50, 3] = 0.07
    q = standing_log().q.copy()
    q[20] += 0.31
    found = terminations(standing_log(q=q), dataclasses.replace(facts, toe_height=height), description)
    assert np.flatnonzero(found["early_foot"]).tolist() == [9]
    assert np.flatnonzero(found["early_joint"]).tolist() == [19, 20]


def test_a_robot_that_falls_early_earns_nothing_for_the_rest(standing_log, still, description):
    whole = evaluate_episode(standing_log(), still(), description, steps=100, kinds=EVERYTHING)
    fell = evaluate_episode(standing_log(51), still(51), description, steps=100, kinds=EVERYTHING)
    assert (fell.steps, fell.ended_by) == (50, "fall")
    assert fell.columns["height"] == pytest.approx(whole.columns["height"] / 2)
    assert np.isnan(fell.toe_error_cm)


def test_no_step_earns_less_than_nothing(standing_log, still, description):
    torque = np.zeros((TICKS, 12))
    torque[51:] = 1e4
    found = evaluate_episode(standing_log(tau=torque), still(), description, steps=100, kinds=EVERYTHING)
    first = evaluate_episode(standing_log(51), still(51), description, steps=100, kinds=EVERYTHING)
    assert found.reward == pytest.approx(first.reward)
    assert found.columns["height"] == pytest.approx(WEIGHTS["height"])


def test_figures_of_seeds_are_averaged_and_spread(standing_log, still, description):
    one = evaluate_episode(standing_log(), still(), description, steps=100, kinds=EVERYTHING)
    none = evaluate_episode(standing_log(51), still(51), description, steps=100, kinds=EVERYTHING)
    found = over_seeds({0: [one, one], 1: [none, none]})
    assert found["columns"]["steps"] == {"mean": 75.0, "std": 25.0}
    assert np.isnan(found["unweighted"]["toe_error_cm"]["mean"])
    assert found["ended_by"] == {"fall": 2, "time": 2}
    mixed = over_seeds({0: [one, none], 1: [one, none]})
    assert mixed["unweighted"]["toe_error_cm"] == {"mean": 0.0, "std": 0.0}


# ---------------------------------------------------------------------- the ground


def posed(standing_log, description, name: str, height: float, up: bool) -> RunLog:
    q = np.tile(description.poses[name], (3, 1))
    quat = standing_log().quat_WB[:3] if up else np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    return standing_log(3, q=q, quat_WB=quat, p_WB=np.tile([1.0, -2.0, height], (3, 1)))


def touched(facts: GroundFacts) -> set[str]:
    return {part for part, rows in facts.touching.items() if rows.any()}


def test_the_ground_is_touched_by_what_stands_on_it(standing_log, description):
    upright = posed(standing_log, description, "upright", description.pose_height["upright"] - 0.002, up=True)
    assert touched(ground_facts(upright, description)) == {"RL_foot", "RR_foot"}
    four = posed(standing_log, description, "four", description.pose_height["four"] - 0.002, up=False)
    assert touched(ground_facts(four, description)) == {f"{leg}_foot" for leg in LEGS}
    dropped = posed(standing_log, description, "lie", 0.05, up=False)
    assert "base" in touched(ground_facts(dropped, description))
    assert not touched(ground_facts(posed(standing_log, description, "four", 1.0, up=False), description))


def test_toe_velocities_are_those_of_the_toes(standing_log, description):
    h, ticks = 1e-4, 3
    rng = np.random.default_rng(0)
    dq, v, omega = rng.normal(size=12), rng.normal(size=3), rng.normal(size=3)
    turn = Rotation.from_euler("ZY", [0.4, -1.2])
    steps = h * np.arange(-1, 2)
    log = standing_log(
        ticks,
        q=safe_pose(description) + steps[:, None] * dq,
        dq=np.tile(dq, (ticks, 1)),
        p_WB=[0.0, 0.0, 1.0] + steps[:, None] * v,
        v_WB=np.tile(v, (ticks, 1)),
        quat_WB=np.array([(turn * Rotation.from_rotvec(omega * s)).as_quat(scalar_first=True) for s in steps]),
        omega_B=np.tile(omega, (ticks, 1)),
    )
    facts = ground_facts(log, description)
    moved = np.array(
        [
            Rotation.from_quat(x, scalar_first=True).apply(p)
            for x, p in zip(log.quat_WB, front_toes(log.q, description), strict=True)
        ]
    )
    moved = (moved + log.p_WB[:, None])[[0, 2]]
    assert facts.toe_velocity[1, :2] == pytest.approx((moved[1] - moved[0])[:, :2] / (2 * h), abs=1e-4)
    assert facts.toe_height[[0, 2], :2] == pytest.approx(moved[..., 2])
    spinning = standing_log(
        ticks, omega_B=turn.inv().apply(np.tile([0.0, 0.0, 1.5], (ticks, 1))), quat_WB=log.quat_WB[[1, 1, 1]]
    )
    assert ground_facts(spinning, description).toe_yaw_rate == pytest.approx(1.5)


# ---------------------------------------------------------------------- a whole policy

NOISE = "the paper's noise"
FEW = TableSettings(episodes=2, seeds=2, seconds=3.0, workers=1, walks=0, senses=(NOISE, "deaf to velocity"))


@pytest.fixture(scope="module")
def evaluated() -> dict[str, Any]:
    return evaluate_table(shipped("policies", "stand_track.onnx"), FEW)


def test_the_table_has_the_paper_s_columns_for_each_row_and_set_of_terminations(evaluated):
    assert list(evaluated["table"]) == list(evaluated["episodes"]) == [*FEW.senses, STATUE]
    for row in evaluated["table"].values():
        assert set(row) == set(TERMINATIONS)
        for found in row.values():
            assert set(found["columns"]) == set(PAPER) == set(evaluated["paper"])
            assert sum(found["ended_by"].values()) == 4
    assert [episode["group"] for episode in evaluated["episodes"][NOISE]["contacts"]] == [0, 0, 1, 1]


def test_more_terminations_never_make_an_episode_longer(evaluated):
    steps = [[episode["steps"] for episode in evaluated["episodes"][NOISE][name]] for name in TERMINATIONS]
    assert np.all(np.diff(steps, axis=0) <= 0)
    assert max(steps[0]) <= 150


def test_the_columns_of_the_shipped_policy_lie_inside_their_weights(evaluated):
    for name in COLUMNS:
        low, high = sorted((0.0, WEIGHTS[name]))
        value = evaluated["table"][NOISE]["contacts"]["columns"][name]["mean"]
        assert (low if name != "slip" else -np.inf) <= value <= high


def test_a_statue_earns_all_but_what_walking_and_turning_are_worth(evaluated):
    found = evaluated["table"][STATUE]["all of the paper's"]
    assert found["ended_by"] == {"time": 4}
    columns = {name: value["mean"] for name, value in found["columns"].items()}
    assert columns["height"] == pytest.approx(WEIGHTS["height"])
    assert columns["toes"] == pytest.approx(WEIGHTS["toes"] * 100 / 150)
    assert columns["slip"] == 0.0
    assert columns["velocity"] < WEIGHTS["velocity"]


def test_the_same_seeds_give_the_same_table(evaluated):
    one = dataclasses.replace(FEW, seeds=1, senses=(NOISE,))
    again = evaluate_table(shipped("policies", "stand_track.onnx"), one)["episodes"][NOISE]
    first = {name: rows[: FEW.episodes] for name, rows in evaluated["episodes"][NOISE].items()}
    assert json.dumps(plain(again)) == json.dumps(plain(first))


def test_a_policy_that_only_lies_has_a_table_too(tmp_path, constant_onnx):
    one = dataclasses.replace(FEW, episodes=1, seeds=1, senses=(NOISE,))
    result = evaluate_table(constant_onnx(tmp_path / "useless.onnx"), one)
    assert result["table"][NOISE]["contacts"]["columns"]["toes"]["mean"] < 0.5
    assert len(result["episodes"][NOISE]["contacts"]) == 1


@pytest.mark.parametrize("robot", ["cyberdog2", "go2"])
def test_the_parts_that_may_touch_are_collision_shapes_of_the_robot(robot):
    of_robot = load_description(robot)
    model = load_model(of_robot)
    shapes = {model.geom(g).name for g in range(model.ngeom)}
    assert set().union(*ground_parts(of_robot).values()) <= shapes


def test_a_policy_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(AssetError, match="there is no policy"):
        evaluate_table(tmp_path / "nowhere.onnx", FEW)


def test_an_episode_is_plain_data(standing_log, still, description):
    found = evaluate_episode(standing_log(), still(), description, steps=100, kinds=EVERYTHING)
    assert Episode(**json.loads(json.dumps(dataclasses.asdict(found)))).steps == found.steps

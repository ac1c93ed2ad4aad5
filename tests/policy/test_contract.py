from __future__ import annotations

import dataclasses
import json
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mimic.errors import ContractError
from mimic.policy.contract import (
    AVERAGED,
    PAPER_TERMS,
    SLOW_SECONDS,
    TERMS,
    ObservationBuilder,
    PolicyContract,
    joint_command,
)
from mimic.policy.runtime import load_policy

UPRIGHT = np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0])
HISTORY = 5
numbers = st.floats(allow_nan=False, allow_infinity=False)


@pytest.fixture(scope="module", params=[PAPER_TERMS, TERMS], ids=["paper", "sensing"])
def contract(request, description) -> PolicyContract:
    """The contract of the shipped policy, with few frames of either kind."""
    noise = tuple((name, 0.01 * width) for name, width in request.param[:3])
    return changed(load_policy(None, description).contract, terms=request.param, once=(), history=HISTORY, noise=noise)


def changed(contract: PolicyContract, **changes: object) -> PolicyContract:
    return dataclasses.replace(contract, **changes)


def term(observation: np.ndarray, name: str, frame: int = -1) -> np.ndarray:
    """One term of one frame of an observation."""
    begin = 0
    paper = observation.size == HISTORY * sum(width for _, width in PAPER_TERMS)
    for other, width in PAPER_TERMS if paper else TERMS:
        if other == name:
            return observation.reshape(HISTORY, -1)[frame, begin : begin + width]
        begin += width
    raise KeyError(name)


def observe(builder: ObservationBuilder, **changes: object) -> np.ndarray:
    values = {
        "q": np.zeros(12),
        "quat_WB": UPRIGHT,
        "v_des": np.zeros(2),
        "heading_des": 0.0,
        "p_BE_des": np.zeros((2, 3)),
        "omega_B": np.zeros(3),
        "dq": np.zeros(12),
    }
    return builder.observe(**(values | changes))


# ---------------------------------------------------------------------- the contract as text


def test_a_contract_survives_json(contract):
    assert PolicyContract.from_json(contract.to_json()) == contract


@given(kp=numbers, default=st.lists(numbers, min_size=12, max_size=12))
def test_no_digit_is_lost_in_json(kp, default, contract):
    saved = changed(contract, kp=(kp,) * 12, default_q=tuple(default))
    read = PolicyContract.from_json(saved.to_json())
    assert read == saved
    assert [v.hex() for v in read.default_q] == [v.hex() for v in saved.default_q]


def test_one_gain_for_all_joints_is_read_as_twelve(contract):
    fields = json.loads(contract.to_json()) | {"kp": 30.0, "torque_max": 12.0}
    read = PolicyContract.from_json(json.dumps(fields))
    assert (read.kp, read.torque_max) == ((30.0,) * 12, (12.0,) * 12)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "3", "{}", '{"terms": 7}'])
def test_what_is_no_contract_is_reported(text):
    with pytest.raises(ContractError, match=r"cannot be read.*export the policy again"):
        PolicyContract.from_json(text)


@pytest.mark.parametrize("field", ["kd", "interpolate", "clock_fade", "walk_turn", "task"])
def test_a_contract_with_a_missing_field_is_refused_with_its_name(field, contract):
    data = json.loads(contract.to_json())
    del data[field]
    with pytest.raises(ContractError, match=f"{field} is missing"):
        PolicyContract.from_json(json.dumps(data))


def test_a_contract_with_an_unknown_field_is_refused(contract):
    with pytest.raises(ContractError, match="mood"):
        PolicyContract.from_json(json.dumps(json.loads(contract.to_json()) | {"mood": "good"}))


def test_the_shipped_contract_fits_the_robot(contract, description):
    contract.check(description)
    frames = contract.history * sum(width for _, width in contract.terms)
    assert contract.observation_size == frames + sum(width for _, width in contract.once)


@pytest.mark.parametrize(
    ("what", "change"),
    [
        (
            "the policy was trained for cyberdog9; it cannot drive the robot cyberdog2 (--robot-model)",
            lambda c: {"robot": "cyberdog9"},
        ),
        ("joint order", lambda c: {"joints": c.joints[3:] + c.joints[:3]}),
        ("control step is 0.01; this robot expects 0.02", lambda c: {"dt": 0.01}),
        ("observation terms", lambda c: {"terms": c.terms[:-1]}),
        ("observation terms", lambda c: {"terms": (c.terms[1], c.terms[0], *c.terms[2:])}),
        ("number of action scales is 11", lambda c: {"action_scale": c.action_scale[1:]}),
        ("number of default positions is 13", lambda c: {"default_q": (*c.default_q, 0.0)}),
        ("outside this robot's limits", lambda c: {"q_max": (3.0, *c.q_max[1:])}),
        ("outside this robot's limits", lambda c: {"q_min": (*c.q_min[:-1], -3.0)}),
    ],
)
def test_a_contract_that_does_not_fit_is_refused_with_what_was_given(what, change, contract, description):
    with pytest.raises(ContractError) as error:
        changed(contract, **change(contract)).check(description)
    assert what in str(error.value)


# ---------------------------------------------------------------------- actions


def test_no_action_is_the_default_pose(contract):
    assert np.array_equal(joint_command(contract, np.zeros(12)), contract.default_q)


def test_an_action_moves_each_joint_by_its_own_scale(contract):
    scales = tuple(0.01 * (i + 1) for i in range(12))
    moved = joint_command(changed(contract, action_scale=scales), np.ones(12)) - np.array(contract.default_q)
    assert np.allclose(moved, scales)


@given(action=st.lists(st.floats(-1e6, 1e6), min_size=12, max_size=12))
def test_commands_stay_inside_the_limits_whatever_the_policy_says(action, contract):
    q_des = joint_command(contract, np.array(action))
    assert np.all(q_des >= contract.q_min)
    assert np.all(q_des <= contract.q_max)


def test_actions_are_clipped_before_they_are_scaled(contract):
    gentle = changed(contract, action_clip=0.1)
    assert np.array_equal(joint_command(gentle, np.full(12, 50.0)), joint_command(gentle, np.full(12, 0.1)))


# ---------------------------------------------------------------------- observations


@pytest.fixture
def sensing(contract) -> PolicyContract:
    return changed(contract, terms=TERMS)


def test_turning_and_moving_joints_are_seen_scaled_and_limited(sensing):
    turning, moving = np.array([1.0, -2.0, 100.0]), np.array([4.0, -2.0, 1000.0, *[0.0] * 9])
    seen = observe(ObservationBuilder(sensing), omega_B=turning, dq=moving)
    assert term(seen, "gyro") == pytest.approx([0.25, -0.5, 5.0])
    assert term(seen, "joint_velocity")[:3] == pytest.approx([0.2, -0.1, 2.0])


def test_the_slow_mean_begins_with_what_is_seen_and_follows_it_slowly(sensing):
    builder = ObservationBuilder(sensing)
    q = np.array(sensing.default_q)
    first = term(observe(builder, q=q), "slow_mean")
    assert len(first) == sum(dict(TERMS)[name] for name in AVERAGED)
    assert np.allclose(first[:12], 0.0)
    assert np.allclose(
        first[12:18], np.concatenate([term(observe(builder, q=q), name) for name in ("down", "forward")])
    )
    for _ in range(round(SLOW_SECONDS / sensing.dt)):
        seen = observe(builder, q=q + 1.0, v_des=np.array([0.3, 0.0]))
    assert np.allclose(term(seen, "slow_mean")[:12], 1 - np.exp(-1), atol=0.01)
    assert term(seen, "slow_mean")[18] == pytest.approx(0.3 * (1 - np.exp(-1)), abs=0.003)


def test_a_policy_of_the_paper_s_terms_sees_neither(contract):
    paper = changed(contract, terms=PAPER_TERMS)
    moving = {"omega_B": np.ones(3), "dq": np.ones(12)}
    assert np.array_equal(observe(ObservationBuilder(paper), **moving), observe(ObservationBuilder(paper)))
    for name in ("gyro", "joint_velocity", "slow_mean"):
        assert paper.columns(name).size == 0


def test_the_first_observation_repeats_its_frame(contract):
    frames = observe(ObservationBuilder(contract), q=np.arange(12.0)).reshape(HISTORY, -1)
    assert len(frames) == contract.history
    assert np.array_equal(frames, np.tile(frames[:1], (contract.history, 1)))


def test_frames_go_from_old_to_new(contract):
    builder = ObservationBuilder(contract)
    steps = contract.history + 2
    for i in range(steps):
        observation = observe(builder, v_des=np.array([i, 0.0]))
    speeds = [term(observation, "velocity_command", frame)[0] for frame in range(contract.history)]
    assert speeds == list(range(2, steps))
    assert builder.steps == steps


def test_joints_are_seen_from_the_default_pose(contract):
    seen = observe(ObservationBuilder(contract), q=np.array(contract.default_q) + np.arange(12))
    assert np.allclose(term(seen, "joint_position"), np.arange(12))


def test_on_four_feet_down_is_under_the_belly_and_upright_behind_the_tail(contract):
    lying = observe(ObservationBuilder(contract), quat_WB=np.array([1.0, 0.0, 0.0, 0.0]))
    assert np.allclose(term(lying, "down"), (0, 0, -1))
    assert np.allclose(term(lying, "forward"), (1, 0, 0))
    standing = observe(ObservationBuilder(contract), quat_WB=UPRIGHT)
    assert np.allclose(term(standing, "down"), (-1, 0, 0))
    assert np.allclose(term(standing, "forward"), (0, 0, -1))


def test_the_action_of_the_step_before_is_seen_as_it_was_used(contract):
    builder = ObservationBuilder(contract)
    assert not term(observe(builder), "last_action").any()
    builder.acted(np.full(12, 0.3))
    assert np.allclose(term(observe(builder), "last_action"), 0.3)
    builder.acted(np.full(12, 1e3))
    assert np.allclose(term(observe(builder), "last_action"), contract.action_clip)


@pytest.mark.parametrize(
    ("heading", "wanted", "seen"),
    [(0.0, 0.3, 0.3), (3.0, -3.0, 2 * np.pi - 6.0), (-3.0, 3.0, 6.0 - 2 * np.pi), (0.0, 2.0, 1.0), (0.5, -2.0, -1.0)],
)
def test_the_heading_error_takes_the_short_way_and_is_limited(heading, wanted, seen, contract):
    quat = (Rotation.from_euler("z", heading) * Rotation.from_quat(UPRIGHT, scalar_first=True)).as_quat(
        scalar_first=True
    )
    observation = observe(ObservationBuilder(contract), quat_WB=quat, heading_des=wanted)
    assert term(observation, "heading_error")[0] == pytest.approx(seen)


def test_toes_are_seen_left_then_right(contract):
    asked = changed(contract, terms=PAPER_TERMS)
    observation = observe(ObservationBuilder(asked), p_BE_des=np.arange(6.0).reshape(2, 3))
    assert np.array_equal(term(observation, "toe_command"), np.arange(6.0))


def test_the_clock_starts_at_zero_and_comes_round(contract):
    builder = ObservationBuilder(changed(contract, clock_fade=0.0))
    rounds = Fraction(contract.clock_hz * contract.dt).limit_denominator(1000)  # a step, such as 2/25
    clocks = [term(observe(builder), "clock") for _ in range(rounds.denominator + 1)]
    assert np.allclose(clocks[0], (0, 1))
    assert np.allclose(clocks[-1], clocks[0])
    assert np.allclose(np.linalg.norm(clocks, axis=1), 1.0)
    assert clocks[1][0] > 0


def gaits(contract: PolicyContract, steps: int, **asked: object) -> np.ndarray:
    """How strong the clock is in each of so many steps after ten of standing."""
    builder = ObservationBuilder(changed(contract, clock_fade=0.1))
    for _ in range(10):
        assert np.array_equal(term(observe(builder), "clock"), (0, 0))
    return np.linalg.norm([term(observe(builder, **asked), "clock") for _ in range(steps)], axis=1)


def test_a_clock_that_fades_comes_when_the_robot_is_asked_to_walk(contract):
    assert np.allclose(gaits(contract, 7, v_des=np.array([-0.1, 0.0])), [0.2, 0.4, 0.6, 0.8, 1, 1, 1])
    assert np.allclose(gaits(contract, 3, v_des=np.array([0.04, 0.0])), 0)


def test_it_comes_when_the_heading_is_off_and_stays_until_half_of_that_is_left(contract):
    assert np.allclose(gaits(contract, 3, heading_des=-0.21), [0.2, 0.4, 0.6])
    assert np.allclose(gaits(contract, 3, heading_des=0.15), 0)
    builder = ObservationBuilder(changed(contract, clock_fade=0.1))
    for _ in range(6):
        observe(builder, heading_des=0.21)
    assert np.allclose(np.linalg.norm(term(observe(builder, heading_des=0.15), "clock")), 1)
    assert np.allclose(np.linalg.norm(term(observe(builder, heading_des=0.09), "clock")), 0.8)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"kp": (500.0,) * 12}, "kp is 500 N m/rad; expected more than 0, at most 150"),
        ({"kp": (float("nan"),) * 12}, "kp is nan"),
        ({"kp": (-50.0,) * 12}, "kp is -50"),
        ({"kd": (0.0,) * 12}, "kd is 0 N m s/rad; expected more than 0"),
        ({"kd": (50.0,) * 12}, "kd is 50"),
        ({"action_clip": 1e9}, r"action_clip is 1e\+09"),
        ({"action_scale": (float("inf"),) * 12}, "action_scale holds a number that is not finite"),
        ({"default_q": (float("nan"),) * 12}, "default_q holds a number that is not finite"),
    ],
)
def test_numbers_that_no_policy_has_are_refused_before_they_reach_a_motor(description, change, expected):
    contract = load_policy(None, description).contract
    with pytest.raises(ContractError, match=expected):
        dataclasses.replace(contract, **change).check(description)

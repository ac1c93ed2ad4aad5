from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimic.io.store import plain
from mimic.metrics import (
    LONGEST_LAG,
    PARTS,
    run_metrics,
    stand_up_time,
    standing,
    toe_error,
    toe_lag,
    uprightness,
    wanted_to_reached,
)
from mimic.records import JOINTS, PHASES, RunLog, TargetTrack

STAND_UP, BLEND, TRACK, HOLD = (PHASES.index(name) for name in ("stand_up", "blend", "track", "hold"))
LYING = np.array([1.0, 0.0, 0.0, 0.0])


def upright(heading: float = 0.0, lean: float = 0.0) -> np.ndarray:
    """Base x along the description's upright direction (wxyz), tipped back by ``lean``."""
    pitch = np.arctan2(1.0, 0.2) + lean
    return Rotation.from_euler("ZY", [heading, -pitch]).as_quat(scalar_first=True)


def make_log(rows: int, *, dt: float = 0.02, **columns: object) -> RunLog:
    """A log of a robot that stands still and tracks all the time, with other columns where given."""
    values = {name: np.zeros((rows, 12)) for name in ("q", "dq", "tau", "action", "q_des", "q_sent", "kp", "kd")}
    values |= {name: np.zeros((rows, 3)) for name in ("omega_B", "v_WB")}
    values |= {
        "t": dt * np.arange(rows),
        "t_host": dt * np.arange(rows),
        "phase": np.full(rows, TRACK),
        "quat_WB": np.tile(upright(), (rows, 1)),
        "p_WB": np.tile([0.0, 0.0, 0.43], (rows, 1)),
        "p_BE": np.zeros((rows, 2, 3)),
        "v_des": np.zeros((rows, 2)),
        "heading_des": np.zeros(rows),
        "p_BE_des": np.zeros((rows, 2, 3)),
        "observation": np.zeros((rows, 5)),
    }
    return RunLog(**(values | columns))


def test_toe_error_is_the_distance_of_each_toe_while_tracking():
    phase = np.repeat([STAND_UP, BLEND, TRACK, HOLD], 10)
    p_BE = np.full((40, 2, 3), 9.0)
    p_BE[phase == TRACK] = [[0.03, 0.0, 0.04], [0.0, 0.01, 0.0]]
    error = toe_error(make_log(40, phase=phase, p_BE=p_BE))
    assert error.shape == (10, 2)
    assert np.allclose(error, [0.05, 0.01])


@pytest.mark.parametrize("lag_ticks", [0, 1, 5, 12])
def test_a_late_toe_is_explained_by_its_lag(lag_ticks, description):
    t = 0.02 * np.arange(400)
    path = 0.1 * np.stack([np.sin(3 * t), np.cos(2 * t), np.sin(t)], -1)
    desired = np.stack([path, -path], 1)
    reached = np.concatenate([np.repeat(desired[:1], lag_ticks, 0), desired[: 400 - lag_ticks]])
    log = make_log(400, p_BE=reached, p_BE_des=desired)
    lag, left = toe_lag(log)
    assert lag == pytest.approx(0.02 * lag_ticks)
    assert left == pytest.approx(0.0, abs=1e-9)
    assert run_metrics(log, description)["lag_s"] == lag


def test_a_lag_of_more_than_the_longest_is_not_looked_for():
    desired = np.zeros((400, 2, 3))
    desired[..., 0] = (0.001 * np.arange(400))[:, None]
    reached = np.concatenate([np.repeat(desired[:1], 35, 0), desired[:-35]])
    lag, left = toe_lag(make_log(400, p_BE=reached, p_BE_des=desired))
    assert lag == pytest.approx(LONGEST_LAG)
    assert left > 0.01


def make_targets(person: np.ndarray, **columns: np.ndarray) -> TargetTrack:
    rows = len(person)
    values = {"t": 0.02 * np.arange(rows), "p_BE": person, "wanted": person, "person": person, "within_reach": person}
    values |= {"heading": np.zeros(rows), "valid": np.ones((rows, 2), dtype=bool), "moved": np.zeros((rows, 2))}
    return TargetTrack(**(values | {"limited": np.zeros((rows, 2), dtype=bool)} | columns))


def test_each_step_between_person_and_robot_has_its_part_and_they_add_up():
    t = 0.02 * np.arange(400)
    person = np.zeros((400, 2, 3))
    person[..., 1] = 0.1 * np.sin(2 * np.pi * t / 4)[:, None]
    up = np.array([0.01, 0.0, 0.0])
    targets = make_targets(person, wanted=person + up, within_reach=person + 3 * up, p_BE=person + 6 * up)
    log = make_log(400, p_BE=targets.p_BE + 4 * up, p_BE_des=targets.p_BE)
    found = wanted_to_reached(log, targets)
    assert [found[name] for name in PARTS] == pytest.approx([1.0, 2.0, 3.0, 4.0, 0.0])
    assert found["apart"] == pytest.approx(10.0)
    assert found["p95"] == pytest.approx(10.0)
    assert found["wanted"] == pytest.approx(10.0 / np.sqrt(2), rel=1e-2)
    assert found["reached"] == pytest.approx(found["wanted"])


def test_toes_that_come_late_are_lag_and_not_policy():
    t = 0.02 * np.arange(400)
    person = np.zeros((400, 2, 3))
    person[..., 1] = 0.1 * np.sin(3 * t)[:, None]
    late = np.concatenate([np.repeat(person[:1], 5, 0), person[:-5]])
    found = wanted_to_reached(make_log(400, p_BE=late, p_BE_des=person), make_targets(person))
    assert found["policy"] == pytest.approx(0.0, abs=0.05)
    assert found["lag"] == pytest.approx(found["apart"], abs=0.05)
    assert found["lag"] > 1.5


def test_what_was_not_seen_does_not_count():
    person = np.zeros((100, 2, 3))
    valid = np.ones((100, 2), dtype=bool)
    valid[:, 0] = False
    log = make_log(100, p_BE=person + [[0.5, 0.0, 0.0], [0.02, 0.0, 0.0]], p_BE_des=person)
    assert wanted_to_reached(log, make_targets(person, valid=valid))["apart"] == pytest.approx(2.0)
    assert wanted_to_reached(log, make_targets(person, valid=np.zeros((100, 2), dtype=bool))) is None


def test_an_offset_that_no_lag_explains_is_left():
    t = 0.02 * np.arange(400)
    desired = np.zeros((400, 2, 3))
    desired[..., 0] = 0.1 * np.sin(3 * t)[:, None]
    lag, left = toe_lag(make_log(400, p_BE=desired + [0.0, 0.02, 0.0], p_BE_des=desired))
    assert lag == 0.0
    assert left == pytest.approx(0.02)


def test_a_log_that_never_tracked_has_no_lag():
    lag, left = toe_lag(make_log(50, phase=np.full(50, STAND_UP)))
    assert lag == 0.0
    assert np.isnan(left)


@pytest.mark.parametrize("heading", [-2.5, 0.0, 1.3])
def test_uprightness_is_one_along_the_wanted_direction_whatever_the_heading(heading, description):
    assert uprightness(upright(heading), description) == pytest.approx(1.0)
    tipped = uprightness(upright(heading, 0.5), description)
    assert tipped == pytest.approx(uprightness(upright(heading, -0.5), description))
    assert tipped < 0.9


def test_standing_needs_both_posture_and_height(description):
    quat = np.stack([upright(), upright(), LYING, upright(), LYING])
    height = np.array([0.43, 0.2, 0.43, np.nan, np.nan])
    p_WB = np.stack([np.zeros(5), np.zeros(5), height], -1)
    assert standing(make_log(5, quat_WB=quat, p_WB=p_WB), description).tolist() == [True, False, False, True, False]


def test_stand_up_time_counts_from_the_start_of_the_log(description):
    quat = np.stack([LYING] * 30 + [upright()] * 20)
    log = make_log(50, quat_WB=quat, t=7.0 + 0.02 * np.arange(50))
    assert stand_up_time(log, description) == pytest.approx(0.6)


def test_a_robot_that_never_stands_takes_forever(description):
    assert stand_up_time(make_log(50, quat_WB=np.tile(LYING, (50, 1))), description) == np.inf


def test_heat_is_reported_of_the_motor_that_warms_most(description, overload):
    tau = np.zeros((3000, 12))
    tau[:, 8], tau[:, 2] = 8.0, -5.0
    metrics = run_metrics(make_log(3000, tau=tau), description)
    assert metrics["hottest_motor"] == JOINTS[8]
    assert metrics["minutes_to_limit"] == pytest.approx(overload[1][4] / 60, rel=0.1)
    assert metrics["winding_rise"]["FL_abad"] == 0.0
    assert metrics["winding_rise"]["RL_knee"] > metrics["winding_rise"]["FL_knee"] > 0.1


def test_figures_of_a_known_run(description):
    rows = 200
    phase = np.repeat([STAND_UP, BLEND, TRACK, HOLD], 50)
    p_BE = np.zeros((rows, 2, 3))
    p_BE[:, 0, 0], p_BE[:, 1, 2] = 0.02, 0.04
    p_WB = np.tile([0.0, 0.0, 0.43], (rows, 1))
    p_WB[-1, :2] = 0.3, 0.4
    quat = np.tile(upright(0.25), (rows, 1))
    quat[:40] = LYING
    tau = np.zeros((rows, 12))
    tau[:, [8, 11]] = 3.0
    tau[10, 0] = -7.0
    m = run_metrics(make_log(rows, phase=phase, p_BE=p_BE, p_WB=p_WB, quat_WB=quat, tau=tau), description)
    assert m["duration_s"] == pytest.approx(4.0)
    assert m["stand_up_s"] == pytest.approx(0.8)
    assert m["standing_share"] == 1.0
    assert m["toe_error_cm"]["left"] == pytest.approx(2.0)
    assert m["toe_error_cm"]["right"] == pytest.approx(4.0)
    assert m["toe_error_cm"]["mean"] == pytest.approx(3.0)
    assert m["drift_m"] == pytest.approx(0.5)
    assert m["heading_error_rad"] == pytest.approx(0.25)
    assert m["torque_nm"]["knee_rms"] == pytest.approx(3.0)
    assert m["torque_nm"]["max"] == 7.0
    assert m["falls"] == 0


def test_a_fall_is_read_from_the_log(description):
    m = run_metrics(make_log(20, metadata={"fell_at": 0.38}), description)
    assert (m["falls"], m["fell_at_s"]) == (1, 0.38)


@pytest.mark.parametrize("rows", [1, 2, 3])
@pytest.mark.parametrize("phase", [STAND_UP, TRACK])
def test_the_shortest_log_has_figures_that_json_can_hold(rows, phase, description):
    m = run_metrics(make_log(rows, phase=np.full(rows, phase), metadata={"dt": 0.02}), description)
    assert m["duration_s"] == pytest.approx(0.02 * rows)
    assert json.loads(json.dumps(plain(m), allow_nan=False))["falls"] == 0

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mimic.dynamics.excitation import SECTIONS, hung_ranges, probe_targets
from mimic.errors import ConfigError
from mimic.robot.description import load_description

DESCRIPTION = load_description("cyberdog2")
LOW, HIGH, CENTRE = hung_ranges(DESCRIPTION)


@pytest.mark.parametrize("kind", ["probe", "random", *SECTIONS])
@pytest.mark.parametrize("seconds", [10.0, 60.0, 97.3, 120.0])
def test_targets_fill_the_time_and_stay_in_the_ranges(kind, seconds):
    motion = probe_targets(LOW, HIGH, CENTRE, seconds=seconds, seed=3, kind=kind)
    assert motion.q_des.shape == (round(seconds * 50), 12)
    assert np.allclose(np.diff(motion.t), 0.02)
    assert np.all((motion.q_des >= LOW) & (motion.q_des <= HIGH))
    assert np.array_equal(motion.q_des[0], CENTRE)


@pytest.mark.parametrize("kind", ["probe", "random"])
def test_same_seed_same_motion_other_seed_another(kind):
    first = probe_targets(LOW, HIGH, CENTRE, seconds=30.0, seed=5, kind=kind)
    again = probe_targets(LOW, HIGH, CENTRE, seconds=30.0, seed=5, kind=kind)
    other = probe_targets(LOW, HIGH, CENTRE, seconds=30.0, seed=6, kind=kind)
    assert np.array_equal(first.q_des, again.q_des)
    assert np.abs(first.q_des - other.q_des).max() > 0.1


@pytest.mark.parametrize("seconds", [60.0, 83.0, 120.0])
def test_probe_ends_as_it_began_for_ten_seconds(seconds):
    motion = probe_targets(LOW, HIGH, CENTRE, seconds=seconds, seed=1)
    rows = 525  # it rests for half a second before
    assert np.array_equal(motion.q_des[:rows], motion.q_des[-rows:])
    assert np.ptp(motion.q_des[:rows], axis=0).min() > 0.1


def test_probe_sweeps_most_of_the_range_and_asks_for_more_than_the_peak_torque():
    motion = probe_targets(LOW, HIGH, CENTRE, seconds=60.0, seed=2)
    swept = motion.q_des.max(0) - motion.q_des.min(0)
    assert np.all(swept > 0.9 * (HIGH - LOW))
    knees = [2, 5, 8, 11]
    step = np.abs(np.diff(motion.q_des, axis=0)).max(0)
    assert np.all((DESCRIPTION.kp * step > DESCRIPTION.torque_max)[knees])


def test_smaller_size_moves_in_proportion():
    whole = probe_targets(LOW, HIGH, CENTRE, seconds=30.0, seed=4)
    half = probe_targets(LOW, HIGH, CENTRE, seconds=30.0, seed=4, size=0.5)
    assert np.allclose(half.q_des - CENTRE, 0.5 * (whole.q_des - CENTRE))


def test_ranges_of_the_suspended_robot_keep_clear_of_limits_and_mirror():
    assert np.all(np.minimum(LOW - DESCRIPTION.q_min, DESCRIPTION.q_max - HIGH) >= np.radians(4.5))
    assert np.allclose(LOW[[0, 6]], -HIGH[[3, 9]])
    assert np.allclose(LOW[[1, 2, 7, 8]], LOW[[4, 5, 10, 11]])


def test_no_two_parts_come_near_each_other_anywhere_in_the_ranges():
    model = mujoco.MjModel.from_xml_path(str(DESCRIPTION.mjcf))
    data = mujoco.MjData(model)
    shapes = [g for g in range(model.ngeom) if model.geom_group[g] == 3]
    body, parent = model.geom_bodyid, model.body_parentid
    moved = {b for b in range(model.nbody) if model.body(b).name.endswith(("hip", "knee"))}
    pairs = [
        (a, b)
        for a in shapes
        for b in shapes
        if a < b and {body[a], body[b]} & moved and body[a] not in (body[b], parent[body[b]])
    ]
    rng = np.random.default_rng(0)
    for row in range(1500):
        u = rng.random(12)
        data.qpos[7:] = LOW + (np.round(u) if row % 2 else u) * (HIGH - LOW)  # inside, and corners
        mujoco.mj_kinematics(model, data)
        gaps = [mujoco.mj_geomDistance(model, data, a, b, 0.1, None) for a, b in pairs]
        assert min(gaps) > 0.015


def test_impossible_motions_are_refused_with_the_reason():
    with pytest.raises(ConfigError, match="takes 10 s to"):
        probe_targets(LOW, HIGH, CENTRE, seconds=5.0)
    with pytest.raises(ConfigError, match="of nan s"):
        probe_targets(LOW, HIGH, CENTRE, seconds=float("nan"))
    with pytest.raises(ConfigError, match="between its low and its high"):
        probe_targets(LOW, HIGH, HIGH)
    with pytest.raises(ConfigError, match="it is probe, random"):
        probe_targets(LOW, HIGH, CENTRE, kind="wild")

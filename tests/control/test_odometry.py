from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.control.odometry import (
    ARRIVAL,
    CORRECTED,
    HOLDING,
    MOST,
    MOST_STEERED,
    RESPONSE,
    SLOWEST,
    HeldPosition,
    KeptDistance,
    LegOdometry,
)
from mimic.records import Command, CommandTrack

UPRIGHT = np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0])
"""Base x is up."""


def walk(speed: float, seconds: float) -> CommandTrack:
    n = round(seconds / 0.02)
    zeros = np.zeros(n)
    v = np.stack([np.full(n, speed), zeros], axis=1)
    return CommandTrack(t=0.02 * np.arange(n), v=v, heading=zeros, p_BE=np.zeros((n, 2, 3)))


def command(speed: float) -> Command:
    return Command(v=np.array([speed, 0.0]), heading=0.0, p_BE=np.zeros((2, 3)))


def test_a_robot_whose_legs_rest_has_not_moved(description):
    odometry = LegOdometry(description)
    q = description.poses["upright"]
    assert not np.any([odometry.step(q, UPRIGHT) for _ in range(5)])


def leant(degrees: float) -> np.ndarray:
    """Return the orientation of an upright base that leans forward, or backward."""
    half = np.deg2rad(degrees) / 2
    w, _, y, _ = UPRIGHT
    return np.array([w * np.cos(half) - y * np.sin(half), 0.0, y * np.cos(half) + w * np.sin(half), 0.0])


def test_a_base_that_leans_over_planted_feet_moves_where_it_leans(description):
    odometry = LegOdometry(description)
    q = description.poses["upright"]
    odometry.step(q, UPRIGHT)
    assert odometry.step(q, leant(5.0))[0] > 0.0


@pytest.mark.parametrize("speed", [0.1, -0.1])
def test_a_robot_that_does_not_come_forward_is_asked_for_more(description, speed):
    kept = KeptDistance(walk(speed, 3.0), description)
    q = description.poses["upright"]
    asked = [kept.corrected(command(speed), q, UPRIGHT).v[0] for _ in range(150)]
    assert asked[-1] / speed > asked[0] / speed > 1.0
    assert np.max(np.abs(asked)) <= description.commands.velocity_max[0]


@pytest.mark.parametrize(("speed", "turn", "side"), [(0.1, 0.3, -1), (0.1, -0.3, 1), (-0.1, 0.3, -1), (0.1, 0.0, 0)])
def test_a_robot_that_is_off_to_the_side_heads_back_to_its_way(description, speed, turn, side):
    track = walk(speed, 3.0)
    bent = dataclasses.replace(track, heading=turn * track.t)
    kept = KeptDistance(bent, description)
    q = description.poses["upright"]
    for heading in bent.heading[:100]:
        asked = dataclasses.replace(command(speed), heading=heading)
        steered = kept.corrected(asked, q, UPRIGHT).heading - heading
    assert np.sign(steered) == side
    assert abs(steered) <= MOST_STEERED


def test_behind_its_track_a_robot_still_walks_the_rest(description):
    kept = KeptDistance(walk(0.1, 1.0), description)
    q = description.poses["upright"]
    for _ in range(50):
        kept.corrected(command(0.1), q, UPRIGHT)
    assert kept.corrected(command(0.0), q, UPRIGHT).v[0] >= 0.1


def test_a_walk_is_over_where_it_should_end_or_after_a_while(description):
    kept = KeptDistance(walk(0.1, 1.0), description)
    q = description.poses["upright"]
    assert kept.arrived
    longest = round((1.0 + ARRIVAL) / description.dt)
    over = []
    for row in range(longest + 5):
        kept.corrected(command(0.1 if row < 50 else 0.0), q, UPRIGHT)
        over.append(kept.arrived)
    assert not any(over[49 : longest - 2])
    assert over[-1]


def test_a_robot_is_told_to_stop_before_its_track_ends(description):
    kept = KeptDistance(walk(0.5 * CORRECTED, 3.0), description)
    q = description.poses["upright"]
    asked = [kept.corrected(command(0.5 * CORRECTED), q, UPRIGHT).v[0] for _ in range(120)]
    stopping = round((3.0 - RESPONSE) / description.dt)
    assert asked[stopping - 2] < SLOWEST  # it follows its track
    assert asked[stopping] == SLOWEST  # what is lacking is walked as fast as it walks at least


def test_a_robot_that_is_where_it_should_be_stands(description):
    kept = KeptDistance(walk(0.5 * CORRECTED, 1.0), description)
    q = description.poses["upright"]
    for _ in range(50):
        kept.corrected(command(0.5 * CORRECTED), q, UPRIGHT)
    assert kept.corrected(command(0.0), q, UPRIGHT).v[0] == 0.0


def held(description, orientations, *, speed: float = 0.0) -> list[float]:
    """Return the velocities [m/s] asked of a robot whose base has these orientations over planted feet."""
    position = HeldPosition(description)
    q = description.poses["upright"]
    return [position.corrected(command(speed), q, quat_WB).v[0] for quat_WB in orientations]


@pytest.mark.parametrize("degrees", [4.0, -4.0])
def test_a_robot_that_was_moved_is_asked_to_come_back(description, degrees):
    before = round(RESPONSE / description.dt) + 5
    asked = held(description, [UPRIGHT] * before + [leant(degrees)] * 100)
    assert not np.any(asked[:before])
    assert asked[-1] * degrees < 0.0
    assert np.max(np.abs(asked)) <= HOLDING * MOST


def test_where_a_robot_comes_to_a_stand_it_stays(description):
    seconds = round(0.5 * RESPONSE / description.dt)
    assert not np.any(held(description, [UPRIGHT] * 5 + [leant(4.0)] * seconds))


def test_a_walk_is_as_fast_as_asked(description):
    assert set(held(description, [UPRIGHT] * 100 + [leant(4.0)] * 100, speed=0.2)) == {0.2}

"""A person whose landmarks are made up, on a clock of the test's own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.config.pose import LiveSettings
from mimic.config.retarget import RetargetSettings
from mimic.records import LANDMARKS, Command, LiveCommands, PoseTrack
from mimic.retargeting.live import LiveRetarget, LiveTarget, LiveTargets
from mimic.retargeting.targets import target_track
from mimic.retargeting.wrists import wrist_track
from mimic.robot.arm_mapping import toes_of_arms
from mimic.robot.description import load_description
from mimic.robot.reach import Reach

ASPECT = 640 / 480
FOCAL = 0.87


@pytest.fixture(scope="module")
def reach() -> Reach:
    return Reach(load_description("cyberdog2"))


def person(
    left=(0.4, 0.1, 0.2), right=(0.3, -0.1, -0.3), *, heading: float = 0.0, away: float = 2.5, aside: float = 0.0
):
    """Landmarks in camera axes, their place in the picture, and which are seen, of someone whose hands are there."""
    c, s = np.cos(heading), np.sin(heading)

    def at(x: float, y: float, z: float) -> np.ndarray:
        forward, leftward, up = np.array([s, 0, -c]), np.array([c, 0, s]), np.array([0, -1, 0])
        return x * forward + y * leftward + z * up

    places = {
        "left_shoulder": at(0, 0.18, 0.5),
        "right_shoulder": at(0, -0.18, 0.5),
        "left_hip": at(0, 0.1, 0),
        "right_hip": at(0, -0.1, 0),
    }
    places["left_wrist"] = places["left_shoulder"] + at(*left)
    places["right_wrist"] = places["right_shoulder"] + at(*right)
    landmarks, valid = np.zeros((33, 3)), np.zeros(33, dtype=bool)
    for name, place in places.items():
        landmarks[LANDMARKS.index(name)], valid[LANDMARKS.index(name)] = place, True
    image = 0.5 + FOCAL * (landmarks[:, :2] + [aside, 0]) / away * [1, ASPECT]
    return landmarks, image, valid


def watch(retarget: LiveRetarget, seconds: float, t0: float = 0.0, **options) -> LiveTarget:
    asked = None
    for t in np.arange(t0, t0 + seconds, 1 / 30):
        values = {name: value(t) if callable(value) else value for name, value in options.items()}
        asked = retarget.see(t, *person(**values), ASPECT)
    assert asked is not None
    return asked


# ---------------------------------------------------------------------- rows


@pytest.mark.parametrize(
    "settings",
    [
        RetargetSettings(),
        RetargetSettings(mirror=True),
        RetargetSettings(scale=0.7),
        RetargetSettings(heading=50.0),
    ],
)
@pytest.mark.parametrize("heading", [0.0, 0.6])
def test_a_pose_that_is_held_gives_the_targets_of_a_clip(settings, heading, reach):
    hands = {"left": (0.5, 0.1, 0.3), "right": (0.2, -0.2, -0.4), "heading": heading}
    asked = watch(LiveRetarget(reach, settings, LiveSettings()), 1.0, **hands)
    rows = [person(**hands) for _ in range(30)]
    clip = PoseTrack(
        t=np.arange(30) / 30,
        landmarks=np.array([row[0] for row in rows]),
        image=np.array([row[1] for row in rows]),
        score=np.ones((30, 33)),
        valid=np.array([row[2] for row in rows]),
        swapped=np.zeros(30, dtype=bool),
    )
    batch = target_track(wrist_track(clip, settings), reach, settings)
    np.testing.assert_allclose(reach.toes(asked.q), batch.p_BE[-1], atol=1e-3)


def test_a_hand_that_is_not_seen_stays_and_the_other_one_goes_on(reach):
    retarget = LiveRetarget(reach, RetargetSettings(), LiveSettings())
    before = watch(retarget, 1.0)
    landmarks, image, valid = person(right=(0.3, -0.1, 0.4))
    valid[LANDMARKS.index("left_wrist")] = False
    landmarks[LANDMARKS.index("left_wrist")] = np.nan
    for t in np.arange(1.0, 1.3, 1 / 30):
        asked = retarget.see(t, landmarks, image, valid, ASPECT)
    assert asked.seen.tolist() == [False, True]
    np.testing.assert_allclose(asked.q[:3], before.q[:3], atol=0.02)
    assert np.abs(asked.q[3:] - before.q[3:]).max() > 0.3


def test_nobody_in_the_picture_asks_for_nothing_new(reach):
    retarget = LiveRetarget(reach, RetargetSettings(), LiveSettings())
    nothing = np.full((33, 3), np.nan), np.full((33, 2), np.nan), np.zeros(33, dtype=bool)
    first = retarget.see(0.0, *nothing, ASPECT)
    assert not first.seen.any()
    assert np.isfinite(first.q).all()
    before = watch(retarget, 0.5, 0.1)
    asked = retarget.see(1.0, *nothing, ASPECT)
    assert np.array_equal(asked.q, before.q)


# ---------------------------------------------------------------------- following


def test_walking_and_turning_are_not_followed_unless_asked_for(reach):
    retarget = LiveRetarget(reach, RetargetSettings(), LiveSettings())
    asked = watch(retarget, 3.0, away=lambda t: 3.0 - 0.3 * t, heading=lambda t: 0.2 * t)
    assert asked.heading == 0.0
    assert not asked.v.any()


@pytest.mark.parametrize(("speed", "expected"), [(0.25, 0.25), (-0.25, -0.25), (1.5, 0.3), (0.03, 0.0), (0.0, 0.0)])
def test_a_person_who_comes_nearer_lets_the_robot_walk_forward(speed, expected, reach):
    retarget = LiveRetarget(reach, RetargetSettings(), LiveSettings(follow=True))
    asked = watch(retarget, 3.0, away=lambda t: 6.0 - speed * t)
    assert asked.v[0] == pytest.approx(expected, abs=0.08)
    assert asked.v[1] == 0.0


def test_a_person_who_walks_across_the_picture_where_they_face_walks_forward(reach):
    retarget = LiveRetarget(reach, RetargetSettings(), LiveSettings(follow=True))
    asked = watch(retarget, 3.0, away=4.0, heading=np.pi / 2, aside=lambda t: 0.25 * t - 0.4)
    assert asked.v[0] == pytest.approx(0.25, abs=0.08)


def test_a_turn_is_followed_from_the_first_heading_on(reach):
    retarget = LiveRetarget(reach, RetargetSettings(), LiveSettings(follow=True))
    asked = watch(retarget, 6.0, heading=lambda t: 0.5 + 0.2 * min(t, 3.0))
    assert asked.heading == pytest.approx(0.6, abs=0.05)
    mirrored = LiveRetarget(reach, RetargetSettings(mirror=True), LiveSettings(follow=True))
    assert watch(mirrored, 6.0, heading=lambda t: 0.2 * min(t, 3.0)).heading == pytest.approx(-0.6, abs=0.05)


# ---------------------------------------------------------------------- commands


class Clock:
    """Goes on by a control step whenever a command is asked for."""

    def __init__(self) -> None:
        self.t = 100.0

    def __call__(self) -> float:
        return self.t


@pytest.fixture
def clock() -> Clock:
    return Clock()


def commands(targets: LiveTargets, clock: Clock, seconds: float) -> list[Command]:
    got = []
    for _ in range(round(seconds / 0.02)):
        command = targets.newest()
        assert command is not None
        got.append(command)
        clock.t += 0.02
    return got


@pytest.fixture
def up(reach, clock) -> LiveTarget:
    """Both hands up, seen now."""
    q = reach.closest(reach.toes(reach.description.poses["upright"]) + [0.12, 0.0, 0.03]).q
    return LiveTarget(t=clock.t, q=q, seen=np.ones(2, dtype=bool), heading=0.0, v=np.zeros(2))


def test_they_are_live_commands(reach):
    assert isinstance(LiveTargets(reach, LiveSettings()), LiveCommands)


@pytest.fixture
def hanging(reach) -> np.ndarray:
    """Toes of arms that hang, a little bent (2, 3), base axes [m]."""
    left = np.array([0.25, 0.1, -0.75])
    return reach.closest(toes_of_arms(np.stack([left, left * [1, -1, 1]]), reach)).p_BE


def test_hands_hang_until_someone_is_seen_and_the_beginning_is_reported_once(reach, clock, hanging):
    begun = []
    targets = LiveTargets(reach, LiveSettings(), clock=clock, begin=lambda: begun.append(clock.t))
    for command in commands(targets, clock, 1.0):
        np.testing.assert_allclose(command.p_BE, hanging, atol=1e-3)
    assert begun == [100.0]


def test_a_target_is_reached_within_the_limits_of_the_motors(reach, clock, up):
    targets = LiveTargets(reach, LiveSettings(lost_hold=10.0), clock=clock)
    targets.put(up)
    toes = np.array([command.p_BE for command in commands(targets, clock, 2.0)])
    np.testing.assert_allclose(toes[-1], reach.toes(up.q), atol=1e-3)
    q = np.array([reach.inverse(p, up.q) for p in toes])
    assert np.all(np.nanmax(np.abs(np.diff(q, axis=0)), axis=0) <= reach.speed_max * 0.02 + 1e-6)


def test_who_is_lost_is_held_then_lowered_to_hang_and_followed_again(reach, clock, up, hanging):
    targets = LiveTargets(reach, LiveSettings(), clock=clock)
    there = reach.toes(up.q)
    for _ in range(60):  # seen at each tick for 1.2 s
        targets.put(dataclasses.replace(up, t=clock.t))
        commands(targets, clock, 0.02)
    held = commands(targets, clock, 0.46)
    np.testing.assert_allclose(held[-1].p_BE, there, atol=0.01)
    np.testing.assert_allclose(commands(targets, clock, 1.2)[-1].p_BE, hanging, atol=1e-3)
    back = []
    for _ in range(60):
        targets.put(dataclasses.replace(up, t=clock.t))
        back += commands(targets, clock, 0.02)
    np.testing.assert_allclose(back[-1].p_BE, there, atol=1e-3)
    first_step = np.linalg.norm(back[0].p_BE - hanging, axis=-1).max()
    assert first_step < 0.005  # eased, not jumped


def test_one_lost_arm_hangs_alone(reach, clock, up, hanging):
    targets = LiveTargets(reach, LiveSettings(), clock=clock)
    for tick in range(150):
        seen = np.array([True, tick < 60])
        targets.put(dataclasses.replace(up, t=clock.t, seen=seen))
        last = commands(targets, clock, 0.02)[-1]
    np.testing.assert_allclose(last.p_BE[0], reach.toes(up.q)[0], atol=1e-3)
    np.testing.assert_allclose(last.p_BE[1], hanging[1], atol=1e-3)


def test_who_is_lost_stops_walking_and_the_heading_stays(reach, clock, up):
    targets = LiveTargets(reach, LiveSettings(), clock=clock)
    for _ in range(25):
        targets.put(dataclasses.replace(up, t=clock.t, heading=0.2, v=np.array([0.2, 0.0])))
        walking = commands(targets, clock, 0.02)[-1]
    assert walking.v[0] == 0.2
    assert walking.heading == pytest.approx(0.2)
    later = commands(targets, clock, 1.0)[-1]
    assert not later.v.any()
    assert later.heading == pytest.approx(0.2)


def test_a_heading_that_jumps_is_turned_to_slowly_and_the_short_way(reach, clock, up):
    targets = LiveTargets(reach, LiveSettings(lost_hold=10.0), clock=clock)
    targets.put(dataclasses.replace(up, heading=-3.0))
    turned = [command.heading for command in commands(targets, clock, 1.0)]
    assert max(abs(np.diff(turned))) <= 0.6 * 0.02 + 1e-9
    assert turned[-1] == pytest.approx(-0.6, abs=0.02)


def test_only_the_newest_counts(reach, clock, up):
    targets = LiveTargets(reach, LiveSettings(lost_hold=10.0), clock=clock)
    home = reach.description.poses["upright"][:6]
    targets.put(up)
    targets.put(dataclasses.replace(up, q=home))
    np.testing.assert_allclose(commands(targets, clock, 1.0)[-1].p_BE, reach.toes(home), atol=1e-6)


def test_the_end_is_reported(reach, clock, up):
    targets = LiveTargets(reach, LiveSettings(), clock=clock)
    targets.put(up)
    commands(targets, clock, 0.1)
    targets.end()
    assert targets.newest() is None

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mimic.config.retarget import RetargetSettings
from mimic.errors import SourceError
from mimic.records import WristTrack
from mimic.retargeting.commands import command_track
from mimic.retargeting.targets import target_track, wanted_toes
from mimic.robot.description import load_description
from mimic.robot.reach import Reach

REACH = Reach(load_description("cyberdog2"))
RENDERED = Path(__file__).parents[3] / "shared" / "data" / "videos" / "rendered"
MIRROR = np.array([1.0, -1.0, 1.0])


def track(
    t: np.ndarray, left: np.ndarray, right: np.ndarray | None = None, valid: np.ndarray | None = None
) -> WristTrack:
    p_SH = np.stack([left, left * MIRROR if right is None else right], axis=1)
    valid = np.ones((len(t), 2), dtype=bool) if valid is None else valid
    p_SH = np.where(valid[..., None], p_SH, np.nan)
    return WristTrack(t=t, p_SH=p_SH, heading=0.1 + 0.05 * t, valid=valid)


def boxing(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    def arm(phase: float) -> np.ndarray:
        out = np.exp(-0.5 * (((t + phase) % 1.2 - 0.6) / 0.1) ** 2)
        return np.stack([0.4 + 0.55 * out, 0 * t, 0.1 + 0.05 * out], axis=1)

    return arm(0.0), arm(0.6)


T = np.arange(0.0, 6.0, 1 / 30)


def crossing(t: np.ndarray) -> np.ndarray:
    """The left hand of a person who crosses and opens the arms, quickly and too far for the robot."""
    return np.stack([0.6 + 0 * t, -0.3 + 0.6 * np.sin(6 * t), 0.3 * np.sin(2 * t)], axis=1)


@pytest.mark.slow
def test_every_row_is_reachable_even_after_the_speed_limit():
    wild = np.stack([1.2 * np.cos(3 * T), 0.9 * np.sin(5 * T), 1.2 * np.sin(3 * T)], axis=1)
    for arms in ((wild, wild), boxing(2.0 * T), (crossing(T), None)):
        targets = target_track(track(T, *arms), REACH, RetargetSettings())
        assert REACH.closest_track(targets.p_BE).moved.max() < 1e-6
        distance = np.linalg.norm(targets.p_BE - targets.wanted, axis=-1)
        kept = ~targets.limited
        assert np.allclose(targets.moved[kept], distance[kept], atol=2e-3)
        assert not targets.report["clamped_share"] or targets.report["moved_max_cm"] > 0.1


def test_motors_can_follow():
    for arms in (boxing(2.0 * T), (crossing(T), None)):
        targets = target_track(track(T, *arms), REACH, RetargetSettings())
        q = REACH.closest_track(targets.p_BE).q
        assert np.all(np.abs(np.diff(q, axis=0)) / 0.02 <= REACH.speed_max * 1.01)
        assert np.all(np.abs(np.diff(q, 2, axis=0)) / 0.02**2 <= REACH.acceleration_max * 1.01)


@pytest.mark.parametrize("rate", [0.05, 0.1, 0.3, 1.0])
def test_rows_come_at_the_control_rate_whatever_the_target_rate(rate):
    targets = target_track(track(T, *boxing(T)), REACH, RetargetSettings(rate=rate))
    assert np.allclose(np.diff(targets.t), 0.02)
    assert targets.t[0] == 0.0
    assert T[-1] - 0.02 < targets.t[-1] <= T[-1]
    assert targets.report["targets"] == round(T[-1] / rate) + 1
    assert np.isfinite(targets.p_BE).all()
    assert targets.valid.all()


def test_slow_targets_keep_a_punch():
    wrists = track(T, *boxing(T))
    asked = wanted_toes(wrists.p_SH, REACH, RetargetSettings())
    travel = np.median(asked[..., 2], axis=0) - asked[..., 2].min(axis=0)
    targets = target_track(wrists, REACH, RetargetSettings(rate=0.3))
    got = np.median(asked[..., 2], axis=0) - targets.p_BE[..., 2].min(axis=0)
    assert np.all(got >= 0.95 * travel)


def test_common_postures_keep_their_meaning():
    arms = {
        "hang": (0.05, 0.1, -0.98),
        "forward": (0.97, 0.05, 0.0),
        "up": (0.05, 0.1, 0.98),
        "guard": (0.45, -0.2, 0.1),
    }
    at = {}
    for name, arm in arms.items():
        p = wanted_toes(np.array([arm, arm * MIRROR]), REACH, RetargetSettings())
        found = REACH.closest(p)
        assert found.moved.max() < 0.01, name
        at[name] = found.p_BE[0]
    assert at["up"][0] > at["guard"][0] > at["hang"][0]
    assert at["forward"][2] < at["guard"][2] < at["up"][2]


def test_mirror_swaps_sides_and_turns_the_other_way():
    left, right = boxing(T)
    right = right + [0.0, 0.1, 0.0]
    plain = target_track(track(T, left, right), REACH, RetargetSettings())
    mirrored = target_track(track(T, left, right), REACH, RetargetSettings(mirror=True))
    assert np.abs(mirrored.p_BE[:, ::-1] * MIRROR - plain.p_BE).max() < 2e-3
    assert np.allclose(mirrored.heading, -plain.heading)
    assert plain.heading[0] == 0.0
    assert plain.heading[-1] > 0.2


def test_gaps_are_filled_and_stay_marked():
    valid = np.ones((len(T), 2), dtype=bool)
    valid[60:120, 0] = False
    targets = target_track(track(T, *boxing(T), valid=valid), REACH, RetargetSettings())
    unseen = (targets.t > T[60]) & (targets.t < T[119])
    assert not targets.valid[unseen, 0].any()
    assert targets.valid[:, 1].all()
    assert np.isfinite(targets.p_BE).all()
    assert 0.1 < targets.report["filled_share"] < 0.2


def test_an_arm_that_is_never_seen_hangs_and_is_quiet():
    valid = np.ones((len(T), 2), dtype=bool)
    valid[:, 0] = False
    targets = target_track(track(T, *boxing(T), valid=valid), REACH, RetargetSettings())
    left = targets.p_BE[:, 0]
    assert np.ptp(left, axis=0).max() < 1e-3
    arms = np.array([(0.2, 0.1, -0.9), (0.2, -0.1, -0.9)])
    hanging = REACH.closest(wanted_toes(arms, REACH, RetargetSettings())).p_BE[0]
    assert np.linalg.norm(left[0] - hanging) < 0.05
    assert left[0, 0] < targets.p_BE[:, 1, 0].min() - 0.1  # base x is up: it is below a guard and a punch


def test_glimpses_of_a_hidden_arm_do_not_jerk_it():
    valid = np.ones((len(T), 2), dtype=bool)
    valid[:, 0] = False
    valid[[30, 31, 90, 91, 92, 150], 0] = True
    targets = target_track(track(T, *boxing(T), valid=valid), REACH, RetargetSettings())
    assert np.ptp(targets.p_BE[:, 0], axis=0).max() < 1e-3
    assert not targets.valid[:, 0].any()


def test_slowing_down_stretches_time_and_nothing_else():
    wrists = track(T, *boxing(T))
    plain, slow = (target_track(wrists, REACH, RetargetSettings(slow_down=factor)) for factor in (1.0, 2.0))
    assert slow.t[-1] == pytest.approx(2.0 * T[-1], abs=0.02)
    assert slow.report["slow_down"] == 2.0
    half = np.stack([np.interp(2.0 * plain.t, slow.t, axis) for axis in slow.p_BE[:, 0].T], axis=-1)
    assert np.linalg.norm(half - plain.p_BE[:, 0], axis=-1).mean() < 0.01
    fastest = [np.abs(np.diff(targets.p_BE, axis=0)).max() for targets in (slow, plain)]
    assert fastest[0] < 0.7 * fastest[1]


def test_a_motion_that_is_too_fast_says_so_and_is_slowed_down_no_more_than_needed():
    wrists = track(T, *boxing(3.0 * T))
    fast = target_track(wrists, REACH, RetargetSettings())
    assert fast.report["limited_share"] > 0.05
    assert "--slow-down auto" in fast.warnings[-1]
    slow = target_track(wrists, REACH, RetargetSettings(slow_down="auto"))
    assert slow.report["limited_share"] <= 0.05
    assert not slow.warnings
    factor = slow.report["slow_down"]
    assert 1.0 < factor < 5.0
    less = target_track(wrists, REACH, RetargetSettings(slow_down=factor / 1.1))
    assert less.report["limited_share"] > 0.05


def test_a_motion_that_is_slow_enough_is_left_as_it_is():
    targets = target_track(track(T, *boxing(T)), REACH, RetargetSettings(slow_down="auto"))
    assert targets.report["slow_down"] == 1.0
    assert targets.t[-1] == pytest.approx(T[-1], abs=0.02)


def test_too_short_and_empty_sources_say_so():
    with pytest.raises(SourceError, match="shorter than one step"):
        target_track(track(T[:3], *(arm[:3] for arm in boxing(T))), REACH, RetargetSettings(rate=0.1))
    with pytest.raises(SourceError, match="shorter than one step"):
        target_track(track(T[:1], *(arm[:1] for arm in boxing(T))), REACH, RetargetSettings())
    with pytest.raises(SourceError, match="no hand"):
        target_track(track(T, *boxing(T), valid=np.zeros((len(T), 2), dtype=bool)), REACH, RetargetSettings())


def test_commands_stand_still_and_turn_with_the_track():
    targets = target_track(track(T, *boxing(T)), REACH, RetargetSettings())
    commands = command_track(targets)
    assert not commands.v.any()
    assert np.array_equal(commands.p_BE, targets.p_BE)
    assert np.array_equal(commands.heading, targets.heading)


@pytest.mark.skipif(not RENDERED.is_dir(), reason="the rendered clips with truth are not beside this checkout")
@pytest.mark.parametrize(("clip", "clamped", "moved_cm"), [("boxing", 0.10, 0.2), ("wave", 0.02, 0.05)])
def test_little_of_a_real_motion_is_clamped(clip, clamped, moved_cm):
    data = np.load(RENDERED / f"{clip}.npz")
    joints = {str(name): data["joints"][:, i] for i, name in enumerate(data["names"])}
    camera = np.stack([joints[f"wrist{side}"] - joints[f"shoulder{side}"] for side in "LR"], axis=1)
    torso = np.stack([-camera[..., 2], camera[..., 0], -camera[..., 1]], axis=-1)
    torso /= np.quantile(np.linalg.norm(torso, axis=-1), 0.98)
    wrists = WristTrack(
        t=data["t"], p_SH=torso, heading=np.zeros(len(torso)), valid=np.ones(torso.shape[:2], dtype=bool)
    )
    report = target_track(wrists, REACH, RetargetSettings()).report
    assert report["clamped_share"] <= clamped
    assert report["moved_mean_cm"] <= moved_cm

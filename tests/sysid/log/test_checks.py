"""Logs of a small machine that is known exactly, and what can be wrong with them."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mimic.errors import CalibrationError
from mimic.io.joint_log import JointLog, read_log, write_log
from mimic.records import FloatArray
from mimic.sysid.log.checks import check_log, targets_match_log, units
from mimic.sysid.log.noise import following
from mimic.sysid.log.pool import valid_samples

JOINTS = ("hip", "knee", "ankle")
NOISE = 0.0004


def targets(t: FloatArray) -> FloatArray:
    """Different sums of sines for three joints, held for 20 ms."""
    held = np.floor(t / 0.02 + 1e-9) * 0.02
    frequencies = ((0.31, 1.7, 4.1), (0.43, 1.3, 3.7), (0.37, 2.1, 5.3))
    columns = [sum(0.4 / (1 + f) * np.sin(2 * np.pi * f * held + k) for k, f in enumerate(fs)) for fs in frequencies]
    return np.stack(columns, -1)


def made_log(seconds: float = 30.0, rate: float = 200.0, noise: float = NOISE, q_des: Any = None) -> JointLog:
    """Return the log of the machine; ``q_des`` takes times and returns targets."""
    dt = 0.001
    fine = np.arange(0.0, seconds + dt / 2, dt)
    wanted = (q_des or targets)(fine)
    q, dq, rows = wanted[0].copy(), np.zeros(3), []
    for target in wanted:
        rows.append(q.copy())
        dq += dt * (30.0 * (target - q) - 1.5 * dq) / 0.02
        q += dt * dq
    every = round(1.0 / rate / dt)
    read = np.array(rows)[::every]
    read = read + noise * np.random.default_rng(3).standard_normal(read.shape)
    return JointLog(joints=JOINTS, t=fine[::every], q=read, q_des=wanted[::every], metadata={"kp": 30.0, "kd": 1.5})


def changed(log: JointLog, channel: str, joint: str, values: Any) -> JointLog:
    """Return the log with one column replaced by ``values(column)``."""
    array = np.array(getattr(log, channel))
    i = log.joints.index(joint)
    array[:, i] = values(array[:, i])
    return replace(log, **{channel: array})


LIMITS = np.array([[-1.0, 1.0]] * 3)


@pytest.fixture(scope="module")
def log() -> JointLog:
    return made_log()


def only(warnings: tuple[str, ...], word: str) -> str:
    """Return the one warning, which has the word in it."""
    assert len(warnings) == 1, warnings
    assert word in warnings[0]
    return warnings[0]


def test_a_good_log_has_no_warnings(log: JointLog) -> None:
    facts = check_log(log, LIMITS)
    assert facts.warnings == ()
    assert targets_match_log(log) == (True, "")


def test_the_noise_floor_is_that_of_the_readings(log: JointLog) -> None:
    assert check_log(log).noise == pytest.approx([NOISE] * 3, rel=0.2)


def test_the_noise_floor_is_no_less_than_the_step_allows() -> None:
    clean = made_log(noise=0.0)
    coarse = replace(clean, q=0.002 * np.round(clean.q / 0.002))
    assert (check_log(coarse).noise >= 0.002 / np.sqrt(12) - 1e-12).all()


def test_missing_readings_do_not_hide_the_step_of_an_encoder() -> None:
    clean = made_log(noise=0.0)
    q = 0.002 * np.round(clean.q / 0.002)
    q[50::100] = np.nan
    assert (check_log(replace(clean, q=q)).noise >= 0.002 / np.sqrt(12) - 1e-12).all()


def test_the_lag_is_that_of_the_drive(log: JointLog) -> None:
    late = replace(log, q_des=np.roll(log.q_des, -6, axis=0))  # type: ignore[arg-type]
    lags = [following(one.t, one.q, one.q_des).lag for one in (late, log)]  # type: ignore[arg-type]
    assert lags[0] - lags[1] == pytest.approx([0.03] * 3, abs=0.002)


def test_a_short_log_is_one_of_several(log: JointLog) -> None:
    short = log.part(slice(0, 60))
    resting = replace(short, q_des=np.zeros_like(short.q))
    for one in (short, resting):
        assert any("lasts 0.2" in line and "5 s are needed in all" in line for line in check_log(one).warnings)
    assert not any("needed" in line for line in check_log(log.part(slice(0, 997))).warnings)  # simulated for 5 s


def test_one_row(log: JointLog) -> None:
    with pytest.raises(CalibrationError, match="has 1 rows"):
        check_log(log.part(slice(0, 1)))


def test_milliseconds(log: JointLog) -> None:
    with pytest.raises(CalibrationError, match=r"divide it by 1000"):
        check_log(replace(log, t=1000 * log.t))


def test_a_clock_that_goes_back_is_named_with_its_row(log: JointLog) -> None:
    t = np.array(log.t)
    t[500:] -= 1.0
    with pytest.raises(CalibrationError, match=r"goes back in row 501, from 2\.4950 s to 1\.5000 s"):
        check_log(replace(log, t=t))


def test_lost_rows_are_counted_and_placed(log: JointLog) -> None:
    facts = check_log(log.part(np.delete(np.arange(len(log.t)), np.arange(1000, 1100))))
    warning = only(facts.warnings, "about 100 readings are missing (1.7%)")
    assert "505 ms at t = 5.00 s" in warning


def test_rows_with_the_same_time_are_left_out(log: JointLog) -> None:
    facts = check_log(log.part(np.sort(np.concatenate([np.arange(len(log.t)), np.arange(100, 110)]))))
    only(facts.warnings, "10 rows have the same time")
    assert np.array_equal(facts.log.t, log.t)


def test_rows_that_repeat_the_reading_before(log: JointLog) -> None:
    slow = replace(log, q=np.repeat(log.q[::2], 2, axis=0)[: len(log.t)])
    assert any("repeat the reading before" in w for w in check_log(slow).warnings)


def test_some_nan_rows_are_left_out_and_many_refused(log: JointLog) -> None:
    def broken(rows: slice) -> JointLog:
        q = np.array(log.q)
        q[rows, 1] = np.nan
        return replace(log, q=q)

    facts = check_log(broken(slice(200, 204)))
    assert facts.log.q_des is not None
    assert np.array_equal(facts.log.q_des, log.q_des), "what was asked acted all the same"
    assert np.flatnonzero(~valid_samples(facts.log)).tolist() == [200, 201, 202, 203]
    assert np.isfinite(facts.log.q).all()
    assert "4 rows (0.1%) hold something that is not a number" in facts.warnings[0]
    with pytest.raises(CalibrationError, match=r"q\.knee is not a number in 67% of the rows"):
        check_log(broken(slice(0, 4000)))


def test_a_log_begins_with_its_first_reading(log: JointLog) -> None:
    unread = changed(log, "q", "knee", lambda x: np.where(np.arange(len(x)) < 3, 9999.0, x))
    facts = check_log(unread)
    assert facts.log.t[0] == log.t[3]
    assert valid_samples(facts.log).all()


def test_rows_without_a_target_are_left_out(log: JointLog) -> None:
    facts = check_log(changed(log, "q_des", "knee", lambda x: np.where(np.arange(len(x)) == 300, np.nan, x)))
    assert len(facts.log.t) == len(log.t) - 1


def test_answers_of_another_time_are_left_out_but_not_their_targets(log: JointLog) -> None:
    rng = np.random.default_rng(0)
    came = log.t + 0.003 + 1e-4 * rng.standard_normal(len(log.t))
    came[500] += 0.004  # waited for
    came[700] -= 0.0025  # the answer to the row before
    facts = check_log(replace(log, extra={"t_receive.knee": came}))
    assert np.flatnonzero(~valid_samples(facts.log)).tolist() == [500, 700]
    assert np.array_equal(facts.log.t, log.t)
    assert any("answered at another time than the others; left out" in w for w in facts.warnings)


def test_a_channel_of_nan_is_as_good_as_none(log: JointLog) -> None:
    assert check_log(replace(log, tau=np.full_like(log.q, np.nan))).log.tau is None


def held(x: FloatArray, until: int) -> FloatArray:
    """Return readings (T,) that stay where they are in row 2000, and go on from 40 mrad beside it."""
    return np.concatenate([x[:2000], np.full(until - 2000, x[2000]), x[until:] - x[until] + x[2000] + 0.04])


def test_frozen_and_clipped_readings_are_distinguished(log: JointLog) -> None:
    warning = only(check_log(changed(log, "q", "knee", lambda x: held(x, 2200))).warnings, "q.knee is frozen")
    assert "from t = 10.00 s" in warning
    clipped = check_log(changed(log, "q", "hip", lambda x: np.minimum(x, 0.1)))
    only(clipped.warnings, "q.hip stays at its highest value, 0.1")
    with pytest.raises(CalibrationError, match=r"q\.hip jumps by .* \(t = 11\.000 s\)"):
        check_log(changed(log, "q", "hip", lambda x: np.where(np.abs(log.t - 10.5) < 0.5, x[2100], x)))


def test_a_joint_that_rests_until_it_is_asked_to_move_is_not_frozen(log: JointLog) -> None:
    def asked(x: np.ndarray) -> np.ndarray:
        x[2000:2080] = x[2080] - 0.5 * np.ptp(x)
        return x

    facts = check_log(changed(changed(log, "q_des", "knee", asked), "q", "knee", lambda x: held(x, 2084)))
    assert not any("q.knee is frozen" in w for w in facts.warnings)


def test_a_target_that_wraps_around(log: JointLog) -> None:
    with pytest.raises(CalibrationError, match=r"q_des\.hip jumps by .* unwrap"):
        check_log(changed(log, "q_des", "hip", lambda x: np.where(x > 0.2, x - 2 * np.pi, x)))


def test_a_dead_encoder(log: JointLog) -> None:
    facts = check_log(changed(log, "q", "ankle", lambda x: 0 * x + 0.3))
    assert any("q.ankle reads 0.3 for the whole log" in w for w in facts.warnings)


def test_a_wrong_sign_is_named_with_its_joint(log: JointLog) -> None:
    with pytest.raises(CalibrationError, match=r"knee moves against its target .* multiply q\.knee") as refusal:
        check_log(changed(log, "q", "knee", lambda x: -x))
    assert "hip" not in str(refusal.value)


def test_swapped_joints_are_named(log: JointLog) -> None:
    with pytest.raises(CalibrationError, match=r"exchange q\.hip and q\.ankle"):
        check_log(replace(log, q=log.q[:, [2, 1, 0]]))


def test_swapped_joints_with_a_sign(log: JointLog) -> None:
    q = np.stack([-log.q[:, 1], log.q[:, 0], log.q[:, 2]], -1)
    with pytest.raises(CalibrationError, match=r"hip follows the target of knee, with the other sign .* exchange"):
        check_log(replace(log, q=q))


def test_three_joints_in_a_circle_are_each_named(log: JointLog) -> None:
    with pytest.raises(CalibrationError, match=r"name q\.hip q\.knee") as refusal:
        check_log(replace(log, q=log.q[:, [1, 2, 0]]))
    assert len(str(refusal.value).splitlines()) == 3


def test_degrees(log: JointLog) -> None:
    degrees = replace(log, q=np.rad2deg(log.q), q_des=np.rad2deg(log.q_des))  # type: ignore[arg-type]
    with pytest.raises(
        CalibrationError, match=r"the joint's limit is 1\.00 rad: not radians, .* but degrees"
    ) as refusal:
        check_log(degrees, LIMITS)
    assert "wraps" not in str(refusal.value)
    with pytest.raises(CalibrationError, match=r"not radians, .* but degrees"):
        check_log(degrees)


def test_many_turns_are_no_degrees_if_the_notes_say_so(log: JointLog) -> None:
    far = replace(log, q=60 * log.q, q_des=60 * log.q_des)  # type: ignore[operator]
    with pytest.raises(CalibrationError, match='note "units": "deg" or "rad"'):
        check_log(far)
    check_log(replace(far, metadata={**log.metadata, "units": "rad"}))


def test_a_torque_that_never_changes_is_none(log: JointLog) -> None:
    facts = check_log(replace(log, tau=np.zeros_like(log.q)))
    assert facts.log.tau is None
    assert any("torque never changes" in w for w in facts.warnings)


def test_a_torque_with_missing_values_in_each_joint_is_kept(log: JointLog) -> None:
    tau = np.where(np.arange(len(log.t))[:, None] == [100, 200, 300], np.nan, log.q)
    facts = check_log(replace(log, tau=tau))
    assert facts.log.tau is not None
    assert not any("torque never changes" in w for w in facts.warnings)


def test_a_single_corrupt_reading_is_left_out_and_reported(log: JointLog) -> None:
    q = np.array(log.q)
    q[501, 1] = 1e6
    q[900, 0] += 2.0
    facts = check_log(replace(log, q=q), LIMITS)
    assert any("2 rows" in w and "such as q.knee 1e+06 at t = 2.505 s" in w for w in facts.warnings)
    assert not valid_samples(facts.log)[[501, 900]].any()
    assert valid_samples(facts.log).sum() == len(log.t) - 2
    assert np.abs(facts.log.q).max() < 1.0


def test_readings_that_drop_to_zero_are_left_out_wherever_the_joint_is(log: JointLog) -> None:
    rng = np.random.default_rng(1)
    lost = np.sort(rng.choice(np.arange(10, len(log.t) - 10, 5), 30, replace=False))
    q = np.array(log.q)
    q[lost, 1] = 0.0
    left_out = ~valid_samples(check_log(replace(log, q=q), LIMITS).log)
    assert set(np.flatnonzero(left_out)) <= set(lost)
    assert np.abs(log.q[lost, 1][~left_out[lost]]).max(initial=0.0) < 0.02


def test_fast_moves_are_no_corrupt_readings(log: JointLog) -> None:
    assert valid_samples(check_log(log, LIMITS).log).all()


def test_what_is_not_a_number_is_reported_by_its_first_place(log: JointLog) -> None:
    gap = changed(log, "q_des", "knee", lambda x: np.where(np.arange(len(x)) == 400, np.nan, x))
    assert any("first of them q_des.knee at t = 2.000 s" in w for w in check_log(gap, LIMITS).warnings)


def test_joints_that_do_not_move_are_in_no_other_unit(log: JointLog) -> None:
    noise = 1e-3 * np.random.default_rng(0).standard_normal(log.q.shape)
    with contextlib.suppress(CalibrationError):
        assert not any("thousandths" in w for w in check_log(replace(log, q=noise), LIMITS).warnings)
    assert not list(units(replace(log, q=noise)))


def test_one_joint_in_degrees(log: JointLog) -> None:
    knee = changed(changed(log, "q", "knee", np.rad2deg), "q_des", "knee", np.rad2deg)
    with pytest.raises(CalibrationError, match=r"q\.knee is up to .* but degrees"):
        check_log(knee, LIMITS)


def test_velocities_that_are_missing_lose_no_rows(log: JointLog) -> None:
    facts = check_log(replace(log, dq=np.where(np.arange(len(log.t))[:, None] % 3, np.nan, log.q)))
    assert len(facts.log.t) == len(log.t)
    assert not any("not a number" in w for w in facts.warnings)


def test_degrees_in_one_channel(log: JointLog) -> None:
    with pytest.raises(CalibrationError, match=r"divide q by 57\.2958"):
        check_log(changed(log, "q", "hip", np.rad2deg))


def test_an_encoder_that_wraps_around(log: JointLog) -> None:
    with pytest.raises(CalibrationError, match=r"q\.hip jumps by .* unwrap"):
        check_log(changed(log, "q", "hip", lambda x: np.where(x > 0.2, x - 2 * np.pi, x)))


def test_an_idle_joint_and_a_still_machine(log: JointLog) -> None:
    facts = check_log(changed(log, "q_des", "knee", lambda x: 0 * x))
    assert any("the target of knee never moves" in w for w in facts.warnings)
    with pytest.raises(CalibrationError, match="no target of the log moves"):
        check_log(replace(log, q_des=0 * log.q))


def test_targets_beyond_the_limits(log: JointLog) -> None:
    tight = np.array([[-1.0, 1.0], [-0.3, 0.3], [-np.inf, np.inf]])
    only(check_log(log, tight).warnings, "the target of knee is beyond its limits (-0.300 to 0.300)")


def test_all_reasons_are_given_at_once(log: JointLog) -> None:
    bad = changed(changed(log, "q", "hip", lambda x: -x), "q", "ankle", lambda x: -x)
    with pytest.raises(CalibrationError) as refusal:
        check_log(bad)
    assert len(str(refusal.value).splitlines()) == 2


def test_targets_of_another_time_do_not_belong(log: JointLog) -> None:
    targets_ = log.q_des
    assert targets_ is not None
    shuffled = np.random.default_rng(0).permutation(targets_)
    for wrong, reason in (
        (targets_[::-1], "backwards"),
        (shuffled, "do not follow"),
        (np.roll(targets_, 1000, axis=0), "s after them"),
    ):
        fits, why = targets_match_log(replace(log, q_des=wrong))
        assert not fits
        assert reason in why
    fits, why = targets_match_log(replace(log, q=log.q[::-1], q_des=targets_[::-1]))
    assert not fits
    assert "backwards in time" in why


def test_a_log_of_forces_has_no_targets_to_follow(log: JointLog) -> None:
    forces = replace(log, q_des=None, force=log.q)
    check_log(forces)
    assert targets_match_log(forces) == (True, "")


@pytest.fixture(scope="module")
def go2() -> JointLog:
    path = Path("../shared/data/logs/go2_air_chirp/log.parquet")
    if not path.exists():
        pytest.skip(f"{path} is not here")
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    joints = tuple(n[2:] for n in table.column_names if n.startswith("q_"))
    columns = {c: np.stack([table[f"{c}_{j}"].to_numpy() for j in joints], -1) for c in ("q", "qdes")}
    return JointLog(joints=joints, t=table["t"].to_numpy(), q=columns["q"], q_des=columns["qdes"])


def test_a_suspended_quadruped_is_usable(go2: JointLog) -> None:
    facts = check_log(go2)
    assert ((facts.noise > 2e-4) & (facts.noise < 2e-3)).all()
    assert go2.q_des is not None
    assert (np.diag(following(go2.t, go2.q, go2.q_des).correlation) > 0.95).all()
    assert targets_match_log(go2) == (True, "")


def test_its_targets_in_another_order_are_refused(go2: JointLog) -> None:
    assert go2.q_des is not None
    shuffled = np.random.default_rng(0).permutation(go2.q_des)
    assert not targets_match_log(replace(go2, q_des=shuffled))[0]
    assert not targets_match_log(replace(go2, q_des=go2.q_des[::-1]))[0]


@pytest.mark.parametrize("gain", [200, 800])
def test_a_slow_servo_that_gravity_pulls_ahead_does_not_move_before_its_target(gain: int) -> None:
    path = Path(f"../shared/data/logs/xl330/up_and_down_kp{gain}.parquet")
    if not path.exists():
        pytest.skip(f"{path} is not here")
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    t, q, target = (table[name].to_numpy() for name in ("timestamp", "position", "goal_position"))
    real = JointLog(joints=("j",), t=t, q=q[:, None], q_des=target[:, None])
    assert targets_match_log(real) == (True, "")
    assert not any("before its target" in line for line in check_log(real).warnings)


def test_a_stored_log_is_the_log_checked(log: JointLog, tmp_path: Path) -> None:
    again = read_log(write_log(log, tmp_path / "log.csv"))
    assert again.joints == JOINTS
    assert check_log(again).noise == pytest.approx(check_log(log).noise, rel=1e-4)


def test_joints_that_follow_badly_share_a_line(log: JointLog) -> None:
    assert log.q_des is not None
    shuffled = replace(log, q_des=np.random.default_rng(0).permutation(log.q_des))
    warning = only(check_log(shuffled).warnings, "hip, knee, ankle: target badly followed")
    assert "do not belong" in warning

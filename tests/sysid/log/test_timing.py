"""Sending times that rows on another clock bracket."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.io.joint_log import JointLog
from mimic.sysid.log.timing import SendingTimes, sending_times


def logged(
    rate: float,
    beside: float,
    jitter: float = 0.0,
    *,
    drift: float = 0.0,
    late: float = 0.0,
    held: bool = False,
    lost: float = 0.0,
    **notes: object,
) -> tuple[JointLog, np.ndarray]:
    """Return 30 s of rows beside targets sent every 20 ms, and when each row's target was sent first (T,)."""
    rng = np.random.default_rng(1)
    sent = np.arange(0.0, 30.0, 0.02) * (1.0 + drift)
    sent = sent + late * rng.uniform(0.0, 1.0, len(sent))
    t = np.arange(beside, 29.9, 1.0 / rate)
    t = np.sort(t + jitter * rng.standard_normal(len(t)))[rng.random(len(t)) >= lost]
    number = np.arange(len(sent))
    if held:
        number = np.repeat(number, rng.integers(1, 30, len(number)))[: len(number)]
    newest = np.clip(np.searchsorted(sent, t, side="right") - 1, 0, None)
    first = sent[np.searchsorted(number, number[newest])]
    log = JointLog(joints=("a",), t=t, q=np.zeros((len(t), 1)), q_des=1.0 * number[newest][:, None], metadata=notes)
    return log, first


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize(
    ("rate", "beside", "jitter", "drift", "within"),
    [
        (200.0, 0.004, 0.0003, 0.0, 0.1e-3),
        (187.0, 0.001, 0.0, 0.0, 0.1e-3),
        (187.0, 0.001, 0.0003, 1e-4, 0.1e-3),
        (333.0, 0.001, 0.0003, -5e-5, 0.1e-3),
        (1000.0, 0.0003, 0.0001, 0.0, 0.05e-3),
    ],
)
def test_a_steady_clock_is_found_between_rows_of_another(
    rate: float, beside: float, jitter: float, drift: float, within: float, held: bool
) -> None:
    """Beside a shift of all, which its slack contains, it is known to a fraction of the time between two rows."""
    log, truth = logged(rate, beside, jitter, drift=drift, held=held)
    found = sending_times(log)[0]
    error = found.at[1:] - (truth[found.rows] - log.t[0])[1:]
    assert found.how == "periodic"
    assert np.std(error) < within
    assert -found.later - within < np.mean(error) < found.earlier + within


def test_rows_that_are_lost_widen_no_bracket_of_the_clock() -> None:
    log, truth = logged(187.0, 0.001, 0.0002, lost=0.1)
    found = sending_times(log)[0]
    error = found.at[1:] - (truth[found.rows] - log.t[0])[1:]
    assert found.how == "periodic"
    assert np.abs(error).max() < 0.3e-3


def test_a_sender_that_jitters_stays_in_its_brackets() -> None:
    log, truth = logged(200.0, 0.004, 0.0003, late=0.002)
    found = sending_times(log)[0]
    assert found.how == "periodic"
    rows = found.rows[1:]
    low, high = log.t[rows - 1] - log.t[0], log.t[rows] - log.t[0]
    assert np.all((found.at[1:] >= low - 1e-9) & (found.at[1:] <= high + 1e-9))
    assert np.std((found.at - truth[found.rows])[1:]) < 0.75e-3


@pytest.mark.parametrize(("rate", "beside"), [(200.0, 0.0), (200.0, 0.004), (50.0, 0.004)])
def test_where_rows_and_targets_share_a_clock_the_delay_is_open_by_a_row(rate: float, beside: float) -> None:
    log, truth = logged(rate, beside)
    (found,) = sending_times(log)
    late = found.at[1:] - (truth[found.rows] - log.t[0])[1:]
    assert found.how == "row"
    assert found.later == 0.0
    assert found.earlier == pytest.approx(1.0 / rate)
    assert np.all((late >= -1e-9) & (late <= found.earlier))


def test_a_log_that_says_so_is_believed() -> None:
    log, _ = logged(187.0, 0.001, sent="row")
    (found,) = sending_times(log)
    assert np.array_equal(found.at, (log.t - log.t[0])[found.rows])
    assert found.earlier == found.later == 0.0


def test_stamps_of_sending_are_taken_and_those_of_another_clock_are_not() -> None:
    log, truth = logged(187.0, 0.001)
    stamped = JointLog(joints=log.joints, t=log.t, q=log.q, q_des=log.q_des, extra={"t_send.a": truth})
    (found,) = sending_times(stamped)
    assert found.how == "t_send"
    assert found.at[1:] == pytest.approx((truth[found.rows] - log.t[0])[1:])
    other = JointLog(joints=log.joints, t=log.t, q=log.q, q_des=log.q_des, extra={"t_send.a": truth + 1000.0})
    assert sending_times(other)[0].how == "periodic"


def test_targets_at_any_time_are_sent_in_the_middle_or_with_the_row() -> None:
    rng = np.random.default_rng(0)
    sent = np.cumsum(rng.uniform(0.015, 0.2, 200))
    t = np.arange(0.0, sent[-1], 0.005) + 0.0003 * rng.standard_normal(int(np.ceil(sent[-1] / 0.005)))
    newest = np.searchsorted(sent, t, side="right")
    log = JointLog(joints=("a",), t=t, q=np.zeros((len(t), 1)), q_des=1.0 * newest[:, None])
    row, between = sending_times(log)
    assert (row.how, between.how) == ("row", "bracket")
    error = between.at[1:] - (sent[newest[between.rows] - 1] - t[0])[1:]
    assert np.abs(error).max() < 0.0035
    assert between.earlier == pytest.approx(0.0025, rel=0.05)


def test_a_lost_target_that_stays_arrives_a_period_later() -> None:
    at = np.array([0.0, 0.02, 0.04, 0.06, 0.2, 0.22])
    times = SendingTimes(how="row", rows=np.arange(6), at=at)
    found = times.without(np.array([1, 3]))
    np.testing.assert_allclose(found.at, [0.0, 0.04, 0.08, 0.2, 0.22])
    assert found.rows.tolist() == [0, 2, 3, 4, 5]
    assert found.lost == 2

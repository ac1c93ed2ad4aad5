"""Which second of a log is shown, and the phases of a motion."""

from dataclasses import replace

import numpy as np
import pytest

from mimic.sysid.result import Traces
from mimic.view.report.motion import phases, worst_second

T = np.arange(0.0, 20.0, 0.01)


@pytest.fixture
def traces() -> Traces:
    """Return a joint that swings at 0.25 Hz for 16 s and then rests; its error is largest from 5.0 to 5.5 s."""
    moves = T < 16.0
    q = np.where(moves, np.sin(0.5 * np.pi * T), 0.0)[:, None]
    dq = np.where(moves, 0.5 * np.pi * np.cos(0.5 * np.pi * T), 0.0)[:, None]
    after = np.where((T >= 5.0) & (T < 5.5), 0.2, 0.01)[:, None]
    return Traces(t=T, q=q, dq=dq, tau=dq, before=after, after=after)


def test_the_worst_second_holds_the_largest_error(traces: Traces) -> None:
    rows = worst_second(traces, 0)
    t = T[rows]
    assert t[0] <= 5.0
    assert t[-1] >= 5.49
    assert t[-1] - t[0] == pytest.approx(1.0, abs=0.02)


def test_no_second_lies_across_two_logs(traces: Traces) -> None:
    log = (T >= 5.25).astype(int)
    rows = worst_second(replace(traces, log=log), 0)
    assert len(set(log[rows])) == 1


def test_missing_errors_count_as_none(traces: Traces) -> None:
    after = np.array(traces.after)
    after[(T >= 5.0) & (T < 5.5)] = np.nan
    after[(T >= 9.0) & (T < 9.2)] = 0.1
    t = T[worst_second(replace(traces, after=after), 0)]
    assert t[0] <= 9.0 < t[-1]


def test_a_log_shorter_than_a_second_is_shown_whole(traces: Traces) -> None:
    short = {k: getattr(traces, k)[:50] for k in ("t", "q", "dq", "tau", "before", "after")}
    assert worst_second(Traces(**short), 0) == slice(0, 50)


def test_each_row_is_in_one_phase(traces: Traces) -> None:
    found = phases(traces, 0)
    assert np.all(sum(rows.astype(int) for rows in found.values()) == 1)
    assert np.all(found["at rest"][T >= 16.1])
    for turn in (1.0, 3.0, 5.0):
        assert found["reversing"][np.abs(T - turn) < 0.04].all()
    assert found["slowing down"][(T > 0.2) & (T < 0.8)].all()
    assert found["speeding up"][(T > 1.2) & (T < 1.8)].all()

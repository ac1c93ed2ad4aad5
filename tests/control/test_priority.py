"""Real-time priority where a system has none, as macOS."""

from __future__ import annotations

import os

import pytest

from mimic.control.priority import LOOP, real_time
from mimic.jobs.local import cores


@pytest.fixture
def macos(monkeypatch):
    """Take away what Linux has."""
    monkeypatch.setattr("sys.platform", "darwin")
    for name in ("sched_getaffinity", "sched_getscheduler", "sched_getparam", "sched_setscheduler", "sched_param"):
        monkeypatch.delattr(os, name, raising=False)
    for name in ("SCHED_FIFO", "SCHED_RESET_ON_FORK"):
        monkeypatch.delattr(os, name, raising=False)


def test_without_real_time_priority_work_is_done_and_that_is_said(macos):
    with real_time(LOOP) as allowed:
        assert not allowed


def test_cores_are_counted_without_affinity(macos):
    assert cores() == os.cpu_count()

"""Progress without a terminal."""

from __future__ import annotations

import threading

import pytest

from mimic.cli.terminal import console
from mimic.cli.terminal.console import ConsoleReporter


@pytest.fixture
def printed(monkeypatch):
    """Return the lines that are printed, often, and a function that waits for so many of them."""
    lines: list[str] = []
    more = threading.Condition()

    def note(text: str) -> None:
        with more:
            lines.append(text)
            more.notify_all()

    def wait(count: int) -> list[str]:
        with more:
            assert more.wait_for(lambda: len(lines) >= count, timeout=60)
        return lines

    monkeypatch.setattr(console, "LINE_INTERVAL", 0.01)
    monkeypatch.setattr(console, "note", note)
    return wait


def test_work_that_reports_nothing_new_still_prints_lines(printed):
    with ConsoleReporter().activity("replays") as show:
        show("refining the step size", 113)
        before = len(printed(1))
        lines = printed(before + 2)[before:]
    assert all(line.endswith(" s  refining the step size, 113 replays so far") for line in lines)


def test_work_that_has_reported_nothing_yet_is_named(printed):
    with ConsoleReporter().progress("scene"):
        lines = printed(2)
    assert all(line.endswith(" s  scene") for line in lines)


def test_the_newest_line_is_printed_and_none_afterwards(printed):
    with ConsoleReporter().progress("episodes") as show:
        show(1, 5)
        printed(1)
        show(2, 5)
        lines = printed(len(printed(1)) + 2)
    assert lines[-1].endswith("episodes: 2 of 5")
    assert not any(thread.name == "progress" for thread in threading.enumerate())

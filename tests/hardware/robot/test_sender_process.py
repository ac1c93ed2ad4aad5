"""What the control loop makes of the process that sends, which these tests play: its words, its silence, its end."""

from __future__ import annotations

import os
import pickle
import socket

import numpy as np
import pytest

from mimic.errors import BusError, PlantError
from mimic.hardware.robot import process
from mimic.hardware.robot.checks import Check, CheckOptions
from mimic.hardware.robot.driver import REPORT, DriverSettings
from mimic.hardware.robot.process import SenderProcess, packed
from mimic.hardware.robot.sender import State

READS = 30
"""More reads than this wait for something that never comes."""


class Played:
    """In place of the process: it has opened the robot, and says what it is told to."""

    pid = 1

    def __init__(self, command: list[str], pass_fds: list[int], **_: object) -> None:
        self.theirs = socket.socket(fileno=os.dup(pass_fds[0]))
        self.theirs.setblocking(False)
        self.killed = False
        self.says("answer", None)

    def says(self, kind: str, what: object) -> None:
        self.theirs.send(packed(kind, what))

    def reports(self, state: State) -> None:
        report = np.zeros(1, REPORT)
        report["state"] = state
        self.says("report", report.tobytes())

    def heard(self) -> list[tuple[str, object]]:
        found = []
        while True:
            try:
                found.append(pickle.loads(self.theirs.recv(1 << 17)))
            except BlockingIOError:
                return found

    def poll(self) -> int | None:
        return -9 if self.killed else None

    def wait(self, timeout: float | None = None) -> int:
        return 0

    def kill(self) -> None:
        self.killed = True


@pytest.fixture
def played(monkeypatch, description):
    """Return the loop's end of a sender, and the process that this test plays; it reads no more than READS times."""
    left = [READS]
    whole = process.select.select

    def counted(*arguments):
        left[0] -= 1
        assert left[0] > 0, "it waits for something that never comes"
        return whole(*arguments)

    monkeypatch.setattr(process.select, "select", counted)
    monkeypatch.setattr(process.subprocess, "Popen", Played)
    link = SenderProcess(DriverSettings(bus_url="can0", robot="cyberdog2"), description)
    yield link, link._process
    link.close()


def test_a_request_goes_out_and_its_answer_comes_back(played):
    link, sender = played
    found = Check("motors", "ok", "all twelve")
    sender.says("answer", [found])
    assert link.checks(CheckOptions(rate_hz=50.0)) == [found]
    (request,) = sender.heard()
    assert request == ("check", CheckOptions(rate_hz=50.0))
    sender.says("answer", None)
    link.start(suspended=True)
    assert sender.heard() == [("start", True)]


def test_what_the_sender_raises_is_raised_once_with_its_class_and_words(played):
    link, sender = played
    sender.says("answer", BusError("nobody listens"))
    with pytest.raises(BusError, match="nobody listens"):
        link.start()
    sender.says("answer", None)
    link.start()


def test_a_sender_that_does_not_answer_or_has_ended_is_said(played, monkeypatch):
    link, sender = played
    monkeypatch.setattr(process, "ANSWER_WITHIN", 0.01)
    with pytest.raises(PlantError, match="does not answer"):
        link.start()
    sender.theirs.close()
    with pytest.raises(PlantError, match="has ended"):
        link.start()
    assert link.problem
    assert link.left


def test_reports_are_handed_over_once_and_a_damped_robot_takes_no_orders(played):
    link, sender = played
    sender.reports(State.LISTEN)
    sender.reports(State.LISTEN)
    assert len(link.wait(0.0)) == 2
    assert link.wait(0.0) == []
    assert not link.problem
    sender.reports(State.DAMP)
    link.wait(0.0)
    assert link.problem


def test_why_the_sender_took_over_is_the_problem(played):
    link, sender = played
    sender.says("taken over", "no order for 0.1 s")
    link.wait(0.0)
    assert "no order for 0.1 s" in link.problem


def test_finishing_has_the_robot_damped_and_returns_how_it_was_left(played):
    link, sender = played
    assert link.finish() == "nothing was switched on"
    assert sender.heard() == []
    sender.says("answer", None)
    link.start()
    sender.heard()
    sender.says("ending", "the robot was damped and all motors are off")
    assert link.finish() == "the robot was damped and all motors are off"
    assert sender.heard() == [("damp", None)]
    assert not sender.killed


class Direct:
    """A driver that this process opens itself, and the sender that damps with it."""

    def __init__(self, *_: object) -> None:
        self.closed = False

    def run(self) -> str:
        return "damped from here"

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize("ends", [False, True])
def test_a_sender_that_hangs_or_has_ended_is_killed_and_the_robot_damped_from_here(ends, played, monkeypatch):
    link, sender = played
    sender.says("answer", None)
    link.start()
    driver = Direct()

    def opened(settings, *, quick):
        assert sender.killed
        assert quick
        return driver

    monkeypatch.setattr(process, "HANGS", 0.01)
    monkeypatch.setattr(process, "open_driver", opened)
    monkeypatch.setattr(process, "Sender", Direct)
    if ends:
        sender.theirs.close()
    assert link.finish() == "damped from here"
    assert driver.closed


def test_where_the_robot_cannot_be_opened_any_more_it_says_to_cut_the_power(played, monkeypatch):
    link, sender = played
    sender.says("answer", None)
    link.start()
    tries = []

    def refused(settings, *, quick):
        tries.append(quick)
        raise BusError("can0 is gone")

    monkeypatch.setattr(process, "HANGS", 0.01)
    monkeypatch.setattr(process, "GIVE_UP", 0.05)
    monkeypatch.setattr(process, "OPEN_EVERY", 0.01)
    monkeypatch.setattr(process, "open_driver", refused)
    assert link.finish() == "the robot could not be damped: can0 is gone; cut the power"
    assert len(tries) > 1

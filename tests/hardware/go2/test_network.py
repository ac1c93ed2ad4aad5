"""The network of a Go2: its interface, its wiring file, and other writers, over DDS on this computer."""

from __future__ import annotations

import dataclasses
import random
import time

import pytest

from mimic.errors import BusError, ConfigError
from mimic.hardware.go2.dds_bus import DdsBus, check_network
from mimic.hardware.go2.messages import LOWCMD, LOWSTATE, blank, encode
from mimic.hardware.go2.wiring import load_go2
from mimic.io.assets import shipped

PATIENCE = 20.0
"""Something that has not happened by then does not happen [s]."""


def test_an_interface_that_does_not_exist_is_named_with_those_that_do():
    with pytest.raises(ConfigError, match="there is no network interface 'eth99'; this computer has lo"):
        check_network(load_go2(), "eth99")


def test_without_an_interface_on_the_robots_network_the_command_that_sets_one_up_is_said():
    nowhere = dataclasses.replace(load_go2(), host="203.0.113.9/30")
    with pytest.raises(BusError, match=r"network 203\.0\.113\.8/30; to set one up: sudo ip addr add 203\.0\.113\.9/30"):
        check_network(nowhere, None)


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ('board = "go2"', 'board = "cyberdog2"', "board is 'cyberdog2'; expected go2"),
        ("motion_switcher = true", "motion_switcher = 1", "motion_switcher is 1; expected true or false"),
        ("domain = 0 ", "domain = 231 ", "domain is 231; it must be from 0 to 230"),
        ("sign = [1, 1, 1]", "sign = [1, 1, 0]", "sign is"),
    ],
)
def test_a_wiring_file_that_is_wrong_says_what_was_expected(before, after, expected, tmp_path):
    text = shipped("assets", "go2", "board.toml").read_text(encoding="utf-8")
    assert before in text
    path = tmp_path / "board.toml"
    path.write_text(text.replace(before, after), encoding="utf-8")
    with pytest.raises(ConfigError, match=expected):
        load_go2(path)


def eventually(reached, *buses: DdsBus) -> None:
    end = time.monotonic() + PATIENCE
    while not reached():
        assert time.monotonic() < end, "it never happened"
        for bus in buses:
            bus.listen(time.monotonic() + 0.01)


@pytest.mark.slow
def test_messages_pass_and_another_writer_is_seen_before_it_sends_anything():
    pytest.importorskip("cyclonedds")
    wiring, heard = dataclasses.replace(load_go2(), domain=random.SystemRandom().randrange(1, 200)), []
    robot, host, other = (
        DdsBus(wiring, "lo", lambda *message, who=who: heard.append((who, *message[:2])), robot=who == "robot")
        for who in ("robot", "host", "other")
    )
    assert host.others() == []
    eventually(lambda: host.ready(LOWCMD), robot, host)
    command, state = encode(LOWCMD, blank(LOWCMD)), encode(LOWSTATE, blank(LOWSTATE))
    host.publish(LOWCMD, command)
    eventually(lambda: ("robot", LOWCMD, command) in heard, robot)
    eventually(lambda: robot.ready(LOWSTATE), robot, host)
    robot.publish(LOWSTATE, state)
    eventually(lambda: ("host", LOWSTATE, state) in heard, host)
    assert ("host", LOWCMD, command) not in heard  # own commands do not come back
    assert host.others() == []
    other.ready(LOWCMD)
    eventually(lambda: len(host.others()) == 1, host)
    assert "pid" in host.others()[0]
    for bus in (robot, host, other):
        bus.close()
        bus.close()

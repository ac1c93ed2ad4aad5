"""The watchdog: what it makes of beats and silence, and the process itself on an emulated robot."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from mimic.config.emulator import EmulateSettings
from mimic.emulator.faults import parse_fault
from mimic.emulator.link import EmulatedLink
from mimic.emulator.robot import EmulatedRobot
from mimic.emulator.server import EmulatorServer
from mimic.errors import BusError, PlantError
from mimic.hardware.cybergear.messages import Mode
from mimic.hardware.plant import CanRobot
from mimic.hardware.watchdog import BEAT_TIMEOUT, HeartbeatMonitor, WatchdogProcess, allows_second_socket, damp_and_stop
from mimic.hardware.wiring import load_wiring

WIRING = load_wiring()
IDLE, ARMED, DAMP, EXIT = HeartbeatMonitor.State


def beats(monitor: HeartbeatMonitor, times: list[float]) -> HeartbeatMonitor.State:
    for t in times:
        monitor.update(b".", t)
    return monitor.state


def test_it_waits_until_it_is_armed_however_long():
    monitor = HeartbeatMonitor()
    assert monitor.update(b"", 1000.0) is IDLE
    assert monitor.update(b"A", 2000.0) is ARMED


def test_it_watches_as_long_as_beats_come():
    monitor = HeartbeatMonitor()
    monitor.update(b"A", 0.0)
    assert beats(monitor, [0.02 * n for n in range(1, 500)]) is ARMED


def test_it_acts_when_no_beat_comes_and_says_why():
    monitor = HeartbeatMonitor()
    monitor.update(b"A.", 0.0)
    assert monitor.update(b"", BEAT_TIMEOUT) is ARMED
    assert monitor.update(b"", BEAT_TIMEOUT + 0.01) is DAMP
    assert "no heartbeat for 0.11 s" in monitor.reason


def test_it_acts_at_once_when_the_pipe_closes():
    monitor = HeartbeatMonitor()
    monitor.update(b"A.", 0.0)
    assert monitor.update(None, 0.001) is DAMP
    assert "ended" in monitor.reason


def test_it_leaves_when_the_pipe_closes_before_it_was_armed():
    assert HeartbeatMonitor().update(None, 0.0) is EXIT


def test_it_leaves_when_the_motors_are_off():
    monitor = HeartbeatMonitor()
    monitor.update(b"A..", 0.0)
    assert monitor.update(b".D", 0.02) is EXIT


def test_it_acts_when_it_is_asked_to():
    monitor = HeartbeatMonitor()
    monitor.update(b"A..", 0.0)
    assert monitor.update(b"..T", 0.02) is DAMP


@pytest.mark.parametrize(
    ("bus_url", "allowed"),
    [
        ("can0", True),
        ("can0,can1", True),
        ("socketcand://127.0.0.1:1/can0", True),
        ("slcan:/dev/ttyACM0", False),
        ("can0,slcan:/dev/ttyACM0", False),
        ("pcan:PCAN_USBBUS1", False),
        ("virtual:x", False),
    ],
)
def test_serial_adapters_and_vendors_drivers_cannot_be_opened_twice(bus_url, allowed):
    assert allows_second_socket(bus_url) is allowed


# ---------------------------------------------------------------------- what it does


def running(description, *faults: str) -> tuple[EmulatedRobot, CanRobot]:
    robot = EmulatedRobot(description, WIRING, EmulateSettings(zeroed=True), faults=[parse_fault(f) for f in faults])
    plant = CanRobot(EmulatedLink(robot), WIRING, description)
    plant.start()
    return robot, plant


def test_it_damps_and_switches_off(description):
    robot, _ = running(description)
    assert damp_and_stop("", WIRING, EmulatedLink(robot)) == "the robot was damped and all motors are off"
    assert {motor.mode for motor in robot.motors} == {Mode.RESET}


def test_a_bus_that_is_dead_is_opened_again_soon_while_the_robot_still_stands(description):
    robot, _ = running(description)
    dead = EmulatedLink(robot)

    def refuse(bus: int, frame: object) -> None:
        raise BusError("it is gone")

    dead.send = refuse
    begin = robot.now
    opened: list[float] = []

    def again(bus_url: str, bitrate: int) -> EmulatedLink:
        opened.append(robot.now - begin)
        return EmulatedLink(robot)

    assert "all motors are off" in damp_and_stop("can0", WIRING, dead, again)
    assert opened[0] < 0.5


def test_it_opens_a_bus_that_failed_again(description):
    robot, _ = running(description)
    tries = []

    def opened(bus_url: str, bitrate: int) -> EmulatedLink:
        tries.append(bus_url)
        if len(tries) < 3:
            raise BusError("not there yet")
        return EmulatedLink(robot)

    assert "all motors are off" in damp_and_stop("can0", WIRING, None, opened)
    assert tries == ["can0"] * 3
    assert {motor.mode for motor in robot.motors} == {Mode.RESET}


@pytest.fixture
def served(description) -> Iterator[tuple[EmulatedRobot, str]]:
    """A robot served from a thread, and the word for its bus."""
    robot = EmulatedRobot(description, WIRING, EmulateSettings(zeroed=True))
    server = EmulatorServer(robot)
    over = threading.Event()
    thread = threading.Thread(target=lambda: server.run(over.is_set), daemon=True)
    thread.start()
    yield robot, server.addresses[0]
    over.set()
    thread.join(10.0)
    server.close()


@pytest.fixture
def watchdog(served) -> Iterator[WatchdogProcess]:
    made = WatchdogProcess(served[1], WIRING.path)
    yield made
    made.close()


@pytest.mark.slow
def test_a_watchdog_that_was_never_armed_leaves_quietly(watchdog):
    assert watchdog.alive()
    assert watchdog.close() == "ready"
    assert not watchdog.alive()


@pytest.mark.slow
def test_a_watchdog_that_is_disarmed_leaves_quietly(watchdog):
    watchdog.arm()
    watchdog.beat()
    watchdog.disarm()
    assert watchdog.close() == "ready"


@pytest.mark.slow
def test_a_watchdog_whose_pipe_closes_stops_the_motors(watchdog, served, description):
    from mimic.hardware.can.python_can import open_link

    robot, bus_url = served
    link = open_link(bus_url)
    plant = CanRobot(link, WIRING, description)
    plant.start()
    assert {motor.mode for motor in robot.motors} == {Mode.RUN}
    watchdog.arm()
    told = watchdog.close()  # as if this process were killed
    link.close()
    assert "took over: the process that drives the robot has ended" in told
    assert told.endswith("the robot was damped and all motors are off")
    assert {motor.mode for motor in robot.motors} == {Mode.RESET}


@pytest.mark.slow
def test_a_watchdog_without_beats_takes_over_and_is_seen_to(watchdog):
    watchdog.arm()
    watchdog._process.wait(60.0)
    assert not watchdog.alive()
    assert "took over: no heartbeat" in watchdog.close()


@pytest.mark.slow
def test_a_watchdog_that_cannot_open_the_bus_is_refused_with_what_to_do():
    with pytest.raises(PlantError, match="--no-watchdog"):
        WatchdogProcess("socketcand://127.0.0.1:9/can0", WIRING.path)

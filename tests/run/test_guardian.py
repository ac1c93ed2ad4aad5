"""The guardian: what it makes of beats and silence, and the process itself on an emulated robot."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from mimic.errors import BusError, PlantError
from mimic.robot.wiring import load_wiring
from mimic.run.can_robot import CanRobot
from mimic.run.emulated_faults import parse_fault
from mimic.run.emulated_link import EmulatedLink
from mimic.run.emulator import EmulatedRobot
from mimic.run.emulator_server import EmulatorServer
from mimic.run.guardian import BEAT_WITHIN, Guardian, Vigil, allows_second_socket, end_safely
from mimic.run.motor_messages import Mode
from mimic.settings import EmulateSettings

WIRING = load_wiring()
WAIT, WATCH, ACT, LEAVE = Vigil.State


def beats(vigil: Vigil, times: list[float]) -> Vigil.State:
    for t in times:
        vigil.hear(b".", t)
    return vigil.state


def test_it_waits_until_it_is_armed_however_long():
    vigil = Vigil()
    assert vigil.hear(b"", 1000.0) is WAIT
    assert vigil.hear(b"A", 2000.0) is WATCH


def test_it_watches_as_long_as_beats_come():
    vigil = Vigil()
    vigil.hear(b"A", 0.0)
    assert beats(vigil, [0.02 * n for n in range(1, 500)]) is WATCH


def test_it_acts_when_no_beat_comes_and_says_why():
    vigil = Vigil()
    vigil.hear(b"A.", 0.0)
    assert vigil.hear(b"", BEAT_WITHIN) is WATCH
    assert vigil.hear(b"", BEAT_WITHIN + 0.01) is ACT
    assert "no beat for 0.11 s" in vigil.reason


def test_it_acts_at_once_when_the_pipe_closes():
    vigil = Vigil()
    vigil.hear(b"A.", 0.0)
    assert vigil.hear(None, 0.001) is ACT
    assert "gone" in vigil.reason


def test_it_leaves_when_the_pipe_closes_before_it_was_armed():
    assert Vigil().hear(None, 0.0) is LEAVE


def test_it_leaves_when_the_motors_are_off():
    vigil = Vigil()
    vigil.hear(b"A..", 0.0)
    assert vigil.hear(b".D", 0.02) is LEAVE


def test_it_acts_when_it_is_asked_to():
    vigil = Vigil()
    vigil.hear(b"A..", 0.0)
    assert vigil.hear(b"..T", 0.02) is ACT


@pytest.mark.parametrize(
    ("words", "allowed"),
    [
        ("can0", True),
        ("can0,can1", True),
        ("socketcand://127.0.0.1:1/can0", True),
        ("slcan:socket://127.0.0.1:1", True),
        ("slcan:/dev/ttyACM0", False),
        ("can0,slcan:/dev/ttyACM0", False),
        ("pcan:PCAN_USBBUS1", False),
        ("virtual:x", False),
    ],
)
def test_serial_adapters_and_vendors_drivers_cannot_be_opened_twice(words, allowed):
    assert allows_second_socket(words) is allowed


# ---------------------------------------------------------------------- what it does


def running(description, *faults: str) -> tuple[EmulatedRobot, CanRobot]:
    robot = EmulatedRobot(description, WIRING, EmulateSettings(homed=True), faults=[parse_fault(f) for f in faults])
    plant = CanRobot(EmulatedLink(robot), WIRING, description)
    plant.start()
    return robot, plant


def test_it_damps_and_switches_off(description):
    robot, _ = running(description)
    assert end_safely("", WIRING, EmulatedLink(robot)) == "the robot was damped and all motors are off"
    assert {motor.mode for motor in robot.motors} == {Mode.RESET}


def test_it_opens_a_bus_that_failed_again(description):
    robot, _ = running(description)
    tries = []

    def opened(words: str, bitrate: int) -> EmulatedLink:
        tries.append(words)
        if len(tries) < 3:
            raise BusError("not there yet")
        return EmulatedLink(robot)

    assert "all motors are off" in end_safely("can0", WIRING, None, opened)
    assert tries == ["can0"] * 3
    assert {motor.mode for motor in robot.motors} == {Mode.RESET}


@pytest.fixture
def served(description) -> Iterator[tuple[EmulatedRobot, str]]:
    """A robot served from a thread, and the word for its bus."""
    robot = EmulatedRobot(description, WIRING, EmulateSettings(homed=True))
    server = EmulatorServer(robot)
    over = threading.Event()
    thread = threading.Thread(target=lambda: server.run(over.is_set), daemon=True)
    thread.start()
    yield robot, server.addresses[0]
    over.set()
    thread.join(10.0)
    server.close()


@pytest.fixture
def guardian(served) -> Iterator[Guardian]:
    made = Guardian(served[1], WIRING.path)
    yield made
    made.close()


def test_a_guardian_that_was_never_armed_leaves_quietly(guardian):
    assert guardian.alive()
    assert guardian.close() == "ready"
    assert not guardian.alive()


def test_a_guardian_that_is_disarmed_leaves_quietly(guardian):
    guardian.arm()
    guardian.beat()
    guardian.disarm()
    assert guardian.close() == "ready"


def test_a_guardian_whose_pipe_closes_stops_the_motors(guardian, served, description):
    from mimic.run.buses import open_link

    robot, words = served
    link = open_link(words)
    plant = CanRobot(link, WIRING, description)
    plant.start()
    assert {motor.mode for motor in robot.motors} == {Mode.RUN}
    guardian.arm()
    told = guardian.close()  # as if this process were killed
    link.close()
    assert "took over: the process that drives the robot is gone" in told
    assert told.endswith("the robot was damped and all motors are off")
    assert {motor.mode for motor in robot.motors} == {Mode.RESET}


def test_a_guardian_without_beats_takes_over_and_is_seen_to(guardian):
    guardian.arm()
    guardian._process.wait(60.0)
    assert not guardian.alive()
    assert "took over: no beat" in guardian.close()


def test_a_guardian_that_cannot_open_the_bus_is_refused_with_what_to_do():
    with pytest.raises(PlantError, match="--no-guardian"):
        Guardian("socketcand://127.0.0.1:9/can0", WIRING.path)

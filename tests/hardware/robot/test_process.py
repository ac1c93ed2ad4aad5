"""The process that sends, over socketcand and LCM on this computer: it drives, and whoever is left damps the robot."""

from __future__ import annotations

import os
import random
import re
import signal
import socket
import sys
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

from mimic.config.emulator import EmulateSettings
from mimic.config.hardware import BusSettings
from mimic.control.priority import EMULATOR, LOOP, real_time
from mimic.emulator.boards.board import EmulatedBoard
from mimic.emulator.faults import parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.emulator.server import EmulatorServer
from mimic.errors import BusError, ConfigError, MimicError, SenderError
from mimic.flows.watching import watch_robot
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.robot import process
from mimic.hardware.robot.checks import CheckOptions
from mimic.hardware.robot.driver import DriverSettings
from mimic.hardware.robot.opening import open_driver
from mimic.hardware.robot.plant import Robot
from mimic.hardware.robot.process import SenderProcess
from mimic.hardware.robot.sender import Sender
from mimic.hardware.stock.lcm_bus import LcmBus, check_network
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.wiring import load_board
from mimic.io.assets import shipped
from mimic.records import JointCommand
from mimic.robot.description import load_description

PATIENCE = 60.0
"""Something that has not happened by then does not happen [s]; an idle computer takes a second."""

BUSY = 20.0
"""How much longer a computer may take here that other tests keep busy; lab/faults holds the times themselves."""


@pytest.fixture
def wiring(tmp_path):
    """Return the shipped wiring at two ports that nobody else uses; messages do not leave this computer."""
    text = shipped("assets", "cyberdog2", "board.toml").read_text()
    for name in ("port", "state_port"):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.bind(("", 0))
            text = re.sub(rf"^{name} = \d+", f"{name} = {sock.getsockname()[1]}", text, flags=re.M)
    path = tmp_path / "board.toml"
    path.write_text(text)
    board = load_board(path)
    try:
        check_network(board, "lo")
    except BusError as reason:
        pytest.skip(f"no multicast on this computer: {reason}")
    return board


class Served:
    """An emulated robot that is served from a thread, and what reaches it."""

    def __init__(self, robot, server, settings: DriverSettings) -> None:
        self.robot, self.settings, self._server = robot, settings, server
        self.description = load_description(settings.robot)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        with real_time(EMULATOR):
            self._server.run(self._over.is_set)

    def driven(self) -> bool:
        """Return whether a motor has stiffness or torque."""
        return bool(self.robot.driven())

    def close(self) -> None:
        self._over.set()
        self._thread.join(10.0)
        if isinstance(self._server, EmulatorServer) or self.settings.bus_url == "go2":
            self._server.close()


@pytest.fixture
def board(wiring, description):
    pytest.importorskip("lcm")
    from mimic.emulator.boards.board_server import BoardServer

    robot = EmulatedBoard(description, wiring, EmulateSettings(placement=0.0))
    settings = DriverSettings(bus_url="cyberdog2", robot="cyberdog2", wiring=str(wiring.path), interface="lo")
    made = Served(robot, BoardServer(robot, LcmBus(wiring, 0)), settings)
    yield made
    made.close()


@pytest.fixture
def motors(description):
    robot = EmulatedRobot(description, load_wiring(), EmulateSettings(zeroed=True, placement=0.0))
    server = EmulatorServer(robot)
    settings = DriverSettings(bus_url=server.addresses[0], robot="cyberdog2", zeroed=True)
    made = Served(robot, server, settings)
    yield made
    made.close()


@pytest.fixture
def go2(tmp_path):
    pytest.importorskip("cyclonedds")
    from mimic.emulator.boards.board_server import BoardServer
    from mimic.emulator.boards.go2 import EmulatedGo2
    from mimic.hardware.go2.dds_bus import DdsBus
    from mimic.hardware.go2.wiring import load_go2

    path = tmp_path / "board.toml"
    domain = f"domain = {random.SystemRandom().randrange(1, 200)}"  # one that nobody else uses
    path.write_text(re.sub(r"^domain = \d+", domain, shipped("assets", "go2", "board.toml").read_text(), flags=re.M))
    wiring = load_go2(path)
    robot = EmulatedGo2(load_description("go2"), wiring, EmulateSettings(placement=0.0))
    settings = DriverSettings(bus_url="go2", robot="go2", wiring=str(path), interface="lo")
    made = Served(robot, BoardServer(robot, DdsBus(wiring, "lo", robot=True)), settings)
    yield made
    made.close()


@pytest.fixture(params=["motors", "board", "go2"])
def served(request):
    """Return a robot on CAN, then a stock one, then a Go2."""
    return request.getfixturevalue(request.param)


@pytest.fixture
def link(served):
    made = SenderProcess(served.settings, served.description)
    with real_time(LOOP):
        yield made
    made.close()


def eventually(reached, patience: float = PATIENCE) -> bool:
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if reached():
            return True
        time.sleep(0.005)
    return False


def hold(q) -> JointCommand:
    zeros = np.zeros(12)
    return JointCommand(q_des=q, dq_des=zeros, kp=np.full(12, 20.0), kd=np.full(12, 2.0), tau_ff=zeros)


def driven(plant, served):
    """Start a robot and drive it until its motors obey."""
    state = plant.start()
    end = time.monotonic() + PATIENCE
    while not served.driven() and time.monotonic() < end:
        plant.step(hold(np.nan_to_num(state.q)))
    assert served.driven()
    return np.nan_to_num(state.q)


@pytest.mark.slow
def test_it_checks_and_drives_a_robot_and_leaves_it_damped(link, served):
    found = link.checks(CheckOptions(rate_hz=50.0))
    assert [check.text for check in found if check.verdict == "stop"] == []
    plant = Robot(link, served.description)
    driven(plant, served)
    plant.close()
    assert plant.ending.startswith("the robot was damped")
    assert eventually(lambda: not served.driven())


@pytest.mark.slow
@pytest.mark.parametrize(("number", "within"), [(signal.SIGKILL, 0.15), (signal.SIGSTOP, 0.35)])
def test_the_loop_damps_the_robot_where_the_sender_is_killed_or_hangs(number, within, link, served):
    plant = Robot(link, served.description)
    q = driven(plant, served)
    os.kill(link.pid, number)
    begin, damped = time.monotonic(), []
    watch = threading.Thread(target=lambda: damped.append(eventually(lambda: not served.driven()) and time.monotonic()))
    watch.start()

    def go_on() -> None:
        for _ in range(1000):
            plant.step(hold(q))

    with pytest.raises(SenderError, match=r"has ended|hangs"):
        go_on()
    plant.close()
    watch.join()
    assert damped[0] - begin < BUSY * within
    assert plant.ending.startswith("the robot was damped")
    assert not served.driven()


@pytest.mark.slow
def test_a_loop_that_stands_still_loses_the_robot_to_the_sender(link, served):
    plant = Robot(link, served.description)
    q = driven(plant, served)
    begin = time.monotonic()
    assert eventually(lambda: not served.driven())
    assert time.monotonic() - begin < BUSY * 0.15
    with pytest.raises(SenderError, match=r"damped the robot: no order for 0\.1"):
        plant.step(hold(q))
    plant.close()
    assert "damped" in plant.ending


@pytest.mark.slow
def test_the_sender_damps_the_robot_where_the_loop_has_ended(link, served):
    driven(Robot(link, served.description), served)
    link._ours.close()  # as if this process were killed
    begin = time.monotonic()
    assert eventually(lambda: not served.driven())
    assert time.monotonic() - begin < BUSY * 0.15


@pytest.mark.slow
@pytest.mark.parametrize("out", [1.0, 5.0])
def test_a_bus_that_is_gone_and_comes_back_damps_with_the_first_frames_that_get_through(out, motors, description):
    link = SenderProcess(motors.settings, description)
    plant = Robot(link, description)
    q = driven(plant, motors)
    back = time.monotonic() + out
    motors.robot.inject(parse_fault(f"unplugged@{motors.robot.now}-{motors.robot.now + out}"))
    for _ in range(8):
        plant.step(hold(q))
    assert motors.driven()
    plant.damp()
    while motors.driven() and time.monotonic() < back + PATIENCE:
        plant.step(hold(q))
    assert time.monotonic() - back < BUSY * 0.15
    plant.close()
    link.close()
    assert plant.ending == "the robot was damped and all motors are off"


BREAKS = """#!{python}
import sys, time
sys.path[:] = {path}
import mimic.hardware.can.driver as can
from mimic.hardware.robot import process
from mimic.hardware.robot.sender import Sender
begun = []
def breaks(whole):
    def broken(self, *arguments, **more):
        begun.append(time.monotonic())
        if {when}:
            raise KeyError("what")
        return whole(self, *arguments, **more)
    return broken
{kind}.{name} = breaks({kind}.{name})
sys.exit(process.main(sys.argv[3:]))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "name", "when", "alone"),
    [
        ("can.CanDriver", "drive", "len(begun) == 20", False),
        ("can.CanDriver", "listen", "begun[-1] > begun[0] + 1.0", False),
        ("can.CanDriver", "end", "True", False),
        ("can.CanDriver", "damp", "True", False),
        ("Sender", "order", "len(begun) > 20", False),
        ("can.CanDriver", "damp", "len(begun) < 5", True),
        ("can.CanDriver", "end", "len(begun) < 3", True),
    ],
)
def test_a_sender_that_breaks_anywhere_ends_with_a_status_and_the_robot_damped(
    kind, name, when, alone, motors, description, tmp_path, monkeypatch
):
    script = tmp_path / "breaks"
    script.write_text(BREAKS.format(python=sys.executable, path=sys.path, kind=kind, name=name, when=when))
    script.chmod(0o755)
    for attempts_left in (2, 1, 0):
        with monkeypatch.context() as patched:
            patched.setattr(process.sys, "executable", str(script))
            link = SenderProcess(motors.settings, description)
        plant = Robot(link, description)
        try:
            q = driven(plant, motors)
            break
        except SenderError as reason:  # this computer was busy for longer than a sender waits
            plant.close()
            if not attempts_left or "no order for" not in str(reason):
                raise
    if alone:
        link._ours.close()  # as if this process were killed
    else:
        with suppress(SenderError):
            for _ in range(100):
                plant.step(hold(q))
        plant.close()
        assert plant.ending == "the robot was damped and all motors are off"
    assert eventually(lambda: not motors.driven())
    assert link._process.wait(PATIENCE) != 0
    assert eventually(lambda: not motors.robot.switched_on())


@pytest.mark.slow
def test_a_computer_that_has_slept_damps_the_robot(motors, description, monkeypatch):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    theirs.setblocking(False)
    driver = open_driver(motors.settings)
    sender, asleep = Sender(driver, description), [0.0]
    sender.start()
    monkeypatch.setattr(process, "_clocks_apart", lambda: asleep[0])
    served = threading.Thread(target=process._Server(theirs, sender).run, daemon=True)
    served.start()
    asleep[0] = 3.0  # as after a lid was closed
    served.join(30.0)
    ours.close()
    driver.close()
    assert sender.reason == "this computer slept for 3.0 s"
    assert sender.ending == "the robot was damped and all motors are off"


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"bus_url": "socketcand://127.0.0.1:9/can0"}, "nobody listens"),
        ({"bus_url": "can0", "wiring": "/nowhere/bus.toml"}, "there is no wiring file"),
        ({"bus_url": "cyberdog2", "interface": "eth99"}, "there is no network interface 'eth99'"),
    ],
)
@pytest.mark.slow
def test_a_sender_that_cannot_open_the_robot_says_why(settings, expected, description):
    with pytest.raises(MimicError, match=expected):
        SenderProcess(DriverSettings(robot="cyberdog2", **settings), description)


@pytest.mark.slow
def test_messages_are_those_of_lcm(wiring):
    pytest.importorskip("lcm")
    heard = []
    one, other = (LcmBus(wiring, 0, lambda *message: heard.append(message)) for _ in range(2))
    one.publish(MOTOR_CTRL.channel, MOTOR_CTRL.encode())
    assert eventually(lambda: other.listen(time.monotonic() + 0.01) or heard)
    assert heard[0][:2] == ("motor_ctrl", MOTOR_CTRL.encode())


def test_an_interface_that_does_not_exist_is_named_with_those_that_do(wiring):
    with pytest.raises(ConfigError, match=r"there is no network interface 'eth99'; this computer has lo"):
        check_network(wiring, "eth99")


@pytest.mark.slow
def test_watching_shows_joints_and_orientation_and_sends_nothing(board, wiring):
    seen = []
    settings = BusSettings(wiring=str(wiring.path), interface="lo")
    watch_robot("cyberdog2", settings, seconds=1.0, every=0.5, show=seen.append)
    np.testing.assert_allclose(seen[-1].report["q"], board.robot.body.data.qpos[-12:], atol=0.02)
    np.testing.assert_allclose(seen[-1].rpy[:2], 0.0, atol=0.02)
    assert "not in motor mode" in seen[-1].notes
    assert board.robot.err_flag == 0

"""The process at the board over LCM on this computer: it starts, drives, and whoever is left damps the robot."""

from __future__ import annotations

import os
import re
import signal
import socket
import threading
import time

import numpy as np
import pytest

from mimic.config.emulator import EmulateSettings
from mimic.config.hardware import BusSettings
from mimic.emulator.board import EmulatedBoard
from mimic.errors import BusError, ConfigError, PlantError
from mimic.flows.watching import watch_robot
from mimic.hardware.stock.lcm_bus import LcmBus, check_network
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.plant import StockRobot
from mimic.hardware.stock.process import BoardProcess
from mimic.hardware.stock.wiring import load_board
from mimic.io.assets import shipped
from mimic.records import JointCommand

pytest.importorskip("lcm")

from mimic.emulator.board_server import BoardServer

PATIENCE = 60.0
"""Something that has not happened by then does not happen [s]; an idle computer takes a second."""


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


@pytest.fixture
def served(wiring, description):
    """Return an emulated board that is served from a thread."""
    board = EmulatedBoard(description, wiring, EmulateSettings(placement=0.0))
    server, over = BoardServer(board, wiring), threading.Event()
    thread = threading.Thread(target=server.run, args=(over.is_set,), daemon=True)
    thread.start()
    yield board
    over.set()
    thread.join(10.0)


@pytest.fixture
def link(wiring, served, description):
    process = BoardProcess(wiring, "lo", description)
    yield process
    process.close()


def eventually(reached) -> bool:
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if reached():
            return True
        time.sleep(0.01)
    return False


def hold(q) -> JointCommand:
    zeros = np.zeros(12)
    return JointCommand(q_des=q, dq_des=zeros, kp=np.full(12, 20.0), kd=np.full(12, 2.0), tau_ff=zeros)


def driven(plant, board):
    """Start a robot and drive it until the board obeys."""
    state = plant.start()
    end = time.monotonic() + PATIENCE
    while not board.applied.kp.any() and time.monotonic() < end:
        plant.step(hold(np.nan_to_num(state.q)))
    assert board.applied.kp.any()
    return state


@pytest.mark.slow
def test_it_drives_a_robot_and_leaves_it_damped_and_without_torque(link, served, wiring, description):
    plant = StockRobot(link, wiring, description)
    driven(plant, served)
    plant.close()
    assert plant.ending == "the robot was damped until it rested, and its motors are without torque"
    assert eventually(lambda: not served.applied.kp.any())


@pytest.mark.slow
def test_a_sender_that_is_killed_is_found_and_the_control_loop_damps_the_robot_itself(
    link, served, wiring, description
):
    plant = StockRobot(link, wiring, description)
    state = driven(plant, served)
    os.kill(link.pid, signal.SIGKILL)

    def go_on():
        for _ in range(1000):
            plant.step(hold(np.nan_to_num(state.q)))

    with pytest.raises(PlantError, match="has ended or has taken over"):
        go_on()
    plant.close()
    assert not served.applied.kp.any()
    assert plant.ending == "the robot was damped until it rested, and its motors are without torque"


@pytest.mark.slow
def test_a_control_loop_that_stands_still_loses_the_robot_to_the_sender(link, served, wiring, description):
    plant = StockRobot(link, wiring, description)
    state = driven(plant, served)
    assert eventually(lambda: not served.applied.kp.any())
    with pytest.raises(PlantError, match="has ended or has taken over"):
        plant.step(hold(np.nan_to_num(state.q)))
    plant.close()
    assert "damped" in plant.ending


@pytest.mark.slow
def test_a_sender_that_cannot_start_says_why(wiring, description, tmp_path):
    wiring.path.write_text("board = 'spot'")
    with pytest.raises(PlantError, match=r"does not start: .*board is 'spot'"):
        BoardProcess(wiring, "lo", description)


@pytest.mark.slow
def test_messages_are_those_of_lcm(wiring):
    heard = []
    one, other = (LcmBus(wiring, 0, lambda *message: heard.append(message)) for _ in range(2))
    one.publish(MOTOR_CTRL.channel, MOTOR_CTRL.encode())
    assert eventually(lambda: other.listen(time.monotonic() + 0.01) or heard)
    assert heard[0][:2] == ("motor_ctrl", MOTOR_CTRL.encode())


def test_an_interface_that_does_not_exist_is_named_with_those_that_do(wiring):
    with pytest.raises(ConfigError, match=r"there is no network interface 'eth99'; this computer has lo"):
        check_network(wiring, "eth99")


@pytest.mark.slow
def test_watching_shows_joints_and_orientation_and_sends_nothing(served, wiring, description):
    seen = []
    settings = BusSettings(wiring=str(wiring.path), interface="lo")
    watch_robot("cyberdog2", settings, seconds=1.0, every=0.5, show=seen.append)
    np.testing.assert_allclose(seen[-1].q, served.body.data.qpos[-12:], atol=0.02)
    np.testing.assert_allclose(seen[-1].rpy[:2], 0.0, atol=0.02)
    assert "not in motor mode" in seen[-1].notes
    assert served.err_flag == 0

"""What is sent to a stock robot: the cut, the torque, own messages and those of others, and how it is left."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mimic.errors import FrameError
from mimic.hardware.robot.board import PERIOD
from mimic.hardware.robot.board_wiring import PARTS
from mimic.hardware.robot.sender import Sender, State
from mimic.hardware.stock.driver import StockDriver
from mimic.hardware.stock.messages import MOTOR_CTRL, SPI_DATA
from mimic.hardware.stock.wiring import load_board
from mimic.records import JointCommand
from mimic.robot.description import load_description

BOARD = load_board()
D = load_description("cyberdog2")
LIE = D.poses["lie"]


class Wire:
    """A bus that keeps what is sent, with a clock of its own."""

    def __init__(self) -> None:
        self.t, self.sent = 0.0, []
        self.heard = lambda channel, data, t: None
        self.spoken = lambda: None

    def now(self) -> float:
        return self.t

    def publish(self, channel: str, data: bytes) -> None:
        self.sent.append(data)
        self.heard(channel, data, self.t)

    def listen(self, until: float, wake: int | None = None) -> None:
        self.t = max(until, self.t)
        self.spoken()

    def close(self) -> None: ...


def reading(q, dq=None) -> bytes:
    """Return an spi_data message of joint angles and velocities (12,)."""
    wire = BOARD.wire_angles(np.asarray(q)).reshape(4, 3)
    speed = BOARD.wire(np.zeros(12) if dq is None else np.asarray(dq)).reshape(4, 3)
    values = {f"q_{part}": wire[:, i] for i, part in enumerate(PARTS)}
    return SPI_DATA.encode(**values, **{f"qd_{part}": speed[:, i] for i, part in enumerate(PARTS)})


def command(q, kp=30.0, kd=3.0, **more) -> JointCommand:
    values = {"dq_des": np.zeros(12), "tau_ff": np.zeros(12), **more}
    return JointCommand(q_des=np.asarray(q, dtype=float), kp=np.full(12, kp), kd=np.full(12, kd), **values)


def driving(q, target, **more) -> tuple[StockDriver, np.ndarray]:
    """Return a driver that drives from angles to targets, and the fields of its message."""
    driver = StockDriver(Wire(), BOARD, D)
    driver.heard("spi_data", reading(q), 0.0)
    driver.drive(command(target, **more))
    return driver, MOTOR_CTRL.decode(driver.bus.sent[-1])


def torque(message, q, dq) -> np.ndarray:
    """Return the torque of the documented law (12,) in joint order and sign, before any limit."""
    wire_q, wire_dq = BOARD.wire_angles(q), BOARD.wire(dq)
    tau = message["tau_des"] + message["kp_des"] * (message["q_des"] - wire_q)
    return BOARD.joints(tau + message["kd_des"] * (message["qd_des"] - wire_dq))


offsets = st.lists(st.floats(-0.9, 0.9), min_size=12, max_size=12)


@given(offsets, offsets)
def test_desired_positions_stay_inside_the_cut_and_the_torque_is_the_policys(away, speeds):
    q, dq = LIE, np.array(speeds)
    _, message = driving(q, q + np.array(away))
    distance = np.abs(BOARD.angles(message["q_des"]) - q)
    assert np.all(distance < np.deg2rad(np.tile([8.0, 10.0, 12.0], 4)))
    wanted = 30.0 * np.array(away) - 3.0 * dq
    np.testing.assert_allclose(torque(message, q, dq), wanted, atol=1e-3)


def test_the_cut_part_is_held_to_the_boards_velocity_limit():
    _, message = driving(LIE, LIE + 2.5)
    assert np.abs(message["qd_des"]).max() == BOARD.limits.velocity


def test_without_damping_the_cut_part_is_torque_held_to_the_boards_limit():
    _, message = driving(LIE, LIE + 0.3, kd=0.0)
    np.testing.assert_allclose(torque(message, LIE, np.zeros(12)), 9.0, atol=1e-3)
    _, message = driving(LIE, LIE + 2.0, kd=0.0)
    assert np.abs(message["tau_des"]).max() == BOARD.limits.torque


def test_gains_that_the_board_does_not_take_are_refused():
    with pytest.raises(FrameError, match="Kp 500 and Kd 50; the stock board takes up to 200 and 10"):
        driving(LIE, LIE, kp=500.0, kd=50.0)


def test_a_command_that_is_not_finite_is_refused():
    with pytest.raises(FrameError, match="not finite"):
        driving(LIE, np.full(12, np.nan))


def test_damping_has_no_stiffness_and_all_of_the_velocity_gain():
    driver, _ = driving(LIE, LIE)
    driver.damp()
    message = MOTOR_CTRL.decode(driver.bus.sent[-1])
    assert not message["kp_des"].any()
    assert np.all(message["kd_des"] == 5.0)


def test_own_messages_come_back_unnoticed_and_those_of_others_are_counted():
    driver, _ = driving(LIE, LIE)
    for _ in range(5):
        driver.drive(command(LIE))
    assert driver.report["foreign"] == 0
    driver.heard("motor_ctrl", MOTOR_CTRL.encode(kp_des=np.ones(12)), 0.0)
    assert driver.report["foreign"] == 1


def ended(spoken) -> tuple[Sender, Wire]:
    """Damp a robot to the end, which says something every cycle; return the sender and its wire."""
    driver, _ = driving(LIE, LIE)
    driver.bus.spoken = lambda: spoken(driver)
    sender = Sender(driver, D)
    sender.run()
    return sender, driver.bus


def test_a_robot_is_damped_until_it_rests_and_left_with_zero_messages():
    def moves_for_a_second(driver) -> None:
        driver.heard("spi_data", reading(LIE, np.full(12, 2.0 if driver.now() < 1.0 else 0.0)), driver.now())

    sender, wire = ended(moves_for_a_second)
    gains = [MOTOR_CTRL.decode(data)["kd_des"].max() for data in wire.sent[1:]]
    assert gains[0] == 5.0
    assert gains.count(0.0) == pytest.approx(0.2 / PERIOD, abs=2)
    assert sorted(gains, reverse=True) == gains
    assert 1.6 < wire.t < 1.8
    assert sender.ending == "the robot was damped until it rested, and its motors are without torque"


def test_a_robot_that_does_not_answer_is_damped_as_long_as_it_takes_and_that_is_said():
    sender, wire = ended(lambda driver: None)
    assert wire.t == pytest.approx(8.0, abs=0.02)
    assert "does not answer" in sender.ending


def test_beside_another_program_that_goes_on_it_does_not_say_that_the_motors_are_without_torque():
    def held_by_another(driver) -> None:
        driver.heard("spi_data", reading(LIE), driver.now())
        driver.heard("motor_ctrl", MOTOR_CTRL.encode(kp_des=np.ones(12)), driver.now())

    sender, _ = ended(held_by_another)
    assert sender.ending.startswith("another program still commands the robot, which obeys it")


def test_a_robot_that_stands_by_its_own_order_is_not_said_to_be_damped():
    driver = StockDriver(Wire(), BOARD, D)
    driver.bus.spoken = lambda: driver.heard("spi_data", reading(D.poses["four"]), driver.now())
    sender = Sender(driver, D)
    with pytest.raises(Exception, match="does not enter motor mode"):
        sender.start()
    assert (sender.state, sender.ending) == (State.DONE, "it has followed no message of this program, and is as it was")

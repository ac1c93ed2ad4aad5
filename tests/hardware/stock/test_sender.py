"""What is sent to the board: the cut, the torque, interpolation, and when the sender damps by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mimic.errors import ContractError
from mimic.hardware.stock.messages import MOTOR_CTRL, SPI_DATA
from mimic.hardware.stock.sender import BEAT_TIMEOUT, PERIOD, Order, Sender, State
from mimic.hardware.stock.wiring import PARTS, load_board
from mimic.records import JointCommand
from mimic.robot.description import load_description

BOARD = load_board()
D = load_description()
LIE = D.poses["lie"]


def reading(q, dq=None) -> bytes:
    """Return an spi_data message of joint angles and velocities (12,)."""
    wire = BOARD.wire_angles(np.asarray(q)).reshape(4, 3)
    speed = BOARD.wire(np.zeros(12) if dq is None else np.asarray(dq)).reshape(4, 3)
    values = {f"q_{part}": wire[:, i] for i, part in enumerate(PARTS)}
    return SPI_DATA.encode(**values, **{f"qd_{part}": speed[:, i] for i, part in enumerate(PARTS)})


def command(q, kp=30.0, kd=3.0, **more) -> JointCommand:
    values = {"dq_des": np.zeros(12), "tau_ff": np.zeros(12), **more}
    return JointCommand(q_des=np.asarray(q, dtype=float), kp=np.full(12, kp), kd=np.full(12, kd), **values)


def driving(q, target, **more) -> tuple[Sender, np.ndarray]:
    """Return a sender that drives from angles to targets, and the fields of its message."""
    sender = Sender(BOARD, D)
    sender.heard("spi_data", reading(q), 0.0)
    sender.order(Order(state=State.DRIVE, command=command(target, **more)), 0.0)
    data = sender.message(0.0)
    assert data is not None
    return sender, MOTOR_CTRL.decode(data)


def sent(sender: Sender, t: float) -> bytes:
    """Return the message that a sender sends at a time [s]."""
    data = sender.message(t)
    assert data is not None
    return data


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
    assert np.abs(message["qd_des"]).max() == BOARD.velocity_max


def test_without_damping_the_cut_part_is_torque_held_to_the_boards_limit():
    _, message = driving(LIE, LIE + 0.3, kd=0.0)
    np.testing.assert_allclose(torque(message, LIE, np.zeros(12)), 9.0, atol=1e-3)
    _, message = driving(LIE, LIE + 2.0, kd=0.0)
    assert np.abs(message["tau_des"]).max() == BOARD.torque_max


def test_gains_beyond_the_board_are_clipped():
    _, message = driving(LIE, LIE, kp=500.0, kd=50.0)
    assert message["kp_des"].max() == 200.0
    assert message["kd_des"].max() == 10.0


def test_a_command_that_is_not_finite_damps():
    sender, _ = driving(LIE, LIE)
    with pytest.raises(ContractError, match="not finite"):
        sender.order(Order(state=State.DRIVE, command=command(np.full(12, np.nan))), 0.01)
    message = MOTOR_CTRL.decode(sent(sender, 0.01))
    assert sender.state == State.DAMP
    assert not message["kp_des"].any()
    assert np.all(message["kd_des"] == 5.0)


def test_targets_are_taken_at_once_or_on_a_line():
    for ramp, expected in ((0.0, 0.1), (0.02, 0.05)):
        sender, _ = driving(LIE, LIE)
        sender.order(Order(state=State.DRIVE, command=command(LIE + 0.1, ramp=ramp)), 0.02)
        message = MOTOR_CTRL.decode(sent(sender, 0.03))
        np.testing.assert_allclose(BOARD.angles(message["q_des"]), LIE + expected, atol=1e-6)


def test_a_line_that_is_not_finished_goes_on_from_where_it_was():
    sender, _ = driving(LIE, LIE)
    sender.order(Order(state=State.DRIVE, command=command(LIE + 0.1, ramp=0.02)), 0.02)
    sender.order(Order(state=State.DRIVE, command=command(LIE, ramp=0.02)), 0.03)
    message = MOTOR_CTRL.decode(sent(sender, 0.03))
    np.testing.assert_allclose(BOARD.angles(message["q_des"]), LIE + 0.05, atol=1e-6)


def test_nothing_is_sent_while_listening():
    sender = Sender(BOARD, D)
    sender.order(Order(state=State.LISTEN), 0.0)
    assert sender.message(0.0) is None


def test_silence_of_the_control_loop_damps_and_it_is_not_obeyed_again():
    sender, _ = driving(LIE, LIE)
    assert sender.message(BEAT_TIMEOUT) is not None
    assert sender.state == State.DRIVE
    sender.message(BEAT_TIMEOUT + 2 * PERIOD)
    assert (sender.state, sender.reason) == (State.DAMP, "no order for 0.10 s")
    sender.order(Order(state=State.DRIVE, command=command(LIE)), 0.2)
    assert sender.state == State.DAMP


def test_the_end_of_the_control_loop_damps_until_rest_and_ends_with_zero_messages():
    sender, _ = driving(LIE, LIE)
    sender.closed(0.01)
    t, gains = 0.01, []
    while sender.state != State.DONE and t < 10.0:
        sender.heard("spi_data", reading(LIE, np.full(12, 2.0 if t < 1.0 else 0.0)), t)
        data = sender.message(t)
        if data is not None:
            message = MOTOR_CTRL.decode(data)
            assert not message["kp_des"].any()
            gains += [] if gains[-1:] == [message["kd_des"].max()] else [message["kd_des"].max()]
        t += PERIOD
    assert gains == [5.0, 0.0]
    assert 1.6 < t < 1.8
    assert sender.ending == "the robot was damped until it rested, and its motors are without torque"


def test_a_robot_that_does_not_answer_is_damped_as_long_as_it_takes_and_that_is_said():
    sender, _ = driving(LIE, LIE)
    sender.order(Order(state=State.DAMP), 0.0)
    t = 0.0
    while sender.state != State.DONE and t < 20.0:
        assert sender.message(t) is not None or sender.state == State.DONE
        t += PERIOD
    assert t == pytest.approx(8.0, abs=0.01)
    assert "does not answer" in sender.ending


def test_beside_another_program_that_goes_on_it_does_not_say_that_the_motors_are_without_torque():
    sender, _ = driving(LIE, LIE)
    other, _ = driving(LIE, LIE + 0.1)
    sender.order(Order(state=State.DAMP), 0.0)
    t = 0.0
    while sender.state != State.DONE and t < 10.0:
        sender.heard("spi_data", reading(LIE), t)
        sender.heard("motor_ctrl", sent(other, 0.0), t)  # holds the robot still
        sender.message(t)
        t += PERIOD
    assert sender.state == State.DONE
    assert sender.ending.startswith("another program still commands the robot, which obeys it")


def test_without_a_command_there_is_nothing_to_damp():
    sender = Sender(BOARD, D)
    sender.order(Order(state=State.ZERO), 0.0)
    sender.closed(0.1)
    assert (sender.state, sender.ending) == (State.DONE, "nothing was switched on")


def test_a_robot_that_stands_by_its_own_order_is_not_said_to_be_damped():
    sender = Sender(BOARD, D)
    sender.order(Order(state=State.ZERO), 0.0)
    sender.message(0.0)
    sender.heard("spi_data", reading(D.poses["four"]), 0.01)  # without a motor_ctrl_state: it is not in motor mode
    sender.order(Order(state=State.DAMP), 2.0)
    assert sender.message(2.0) is None
    assert (sender.state, sender.ending) == (State.DONE, "it has followed no message of this program, and is as it was")


def test_a_sender_that_steps_in_for_another_damps_without_having_driven():
    sender = Sender(BOARD, D)
    sender.order(Order(state=State.DAMP), 0.0)
    assert MOTOR_CTRL.decode(sent(sender, 0.0))["kd_des"].max() == 5.0


def test_own_messages_come_back_unnoticed_and_those_of_others_are_counted():
    sender = Sender(BOARD, D)
    other = Sender(BOARD, D)
    for one in (sender, other):
        one.order(Order(state=State.ZERO), 0.0)
    for _ in range(5):
        sender.heard("motor_ctrl", sent(sender, 0.0), 0.0)
    assert sender.readings.report["foreign"] == 0
    sender.heard("motor_ctrl", sent(other, 0.0), 0.0)
    assert sender.readings.report["foreign"] == 1


def test_an_order_survives_the_socket():
    order = Order(state=State.DRIVE, command=command(LIE, ramp=0.02))
    again = Order.from_bytes(order.to_bytes())
    assert again.state == State.DRIVE
    assert again.command is not None
    np.testing.assert_array_equal(again.command.q_des, LIE)
    assert (again.command.ramp, again.command.kp[0], again.command.kd[0]) == (0.02, 30.0, 3.0)

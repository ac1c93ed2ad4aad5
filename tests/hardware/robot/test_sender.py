"""The sender: targets on a line between two orders, damping where no order comes, and nothing after that."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from mimic.errors import FrameError, PlantError
from mimic.hardware.robot.driver import no_report
from mimic.hardware.robot.sender import GIVE_UP, ORDER_TIMEOUT, Order, Sender, State
from mimic.records import JointCommand
from mimic.robot.description import load_description

D = load_description("cyberdog2")
LIE = D.poses["lie"]


class Motors:
    """A driver that keeps what it is told, with a clock of its own."""

    period, repeats, problem = 0.005, False, ""

    def __init__(self) -> None:
        self.t, self.told, self.report = 0.0, [], no_report()
        self.moves, self.lost, self.refuses = 0.0, False, ""

    def now(self) -> float:
        return self.t

    def start(self, *, suspended: bool) -> None:
        if self.refuses:
            raise PlantError(self.refuses)

    def abandon(self) -> str:
        return "nothing was switched on"

    def drive(self, command) -> None:
        if not np.isfinite(command.q_des).all():
            raise FrameError("not finite")
        target = float(command.q_des[0] - LIE[0])
        self.told.append((round(self.t, 4), "drive", target, float(command.dq_des[0])))

    def damp(self) -> None:
        self.told.append((round(self.t, 4), "damp"))

    def speed(self) -> float:
        return self.moves

    def end(self, *, since: float, rested: bool) -> str | None:
        self.told.append((round(self.t, 4), "end"))
        return None if self.t - since < 0.1 else "off" if rested else "still moves"

    def listen(self, until: float, wake=None) -> bool:
        self.t = max(self.t, until)
        return False


def order(target: float, begin: float, ramp: float = 0.02, **more) -> Order:
    zeros, gains = np.zeros(12), np.full(12, 30.0)
    command = JointCommand(q_des=LIE + target, dq_des=zeros, kp=gains, kd=gains / 10, tau_ff=zeros, ramp=ramp)
    return Order(command=command, begin=begin, **more)


@pytest.fixture
def driving() -> tuple[Motors, Sender]:
    motors = Motors()
    sender = Sender(motors, D)
    sender.start()
    sender.order(order(0.0, 0.0))
    go(sender, 0.02)
    motors.told.clear()
    return motors, sender


def go(sender: Sender, until: float) -> None:
    while sender.driver.now() < until - 1e-9:
        sender.cycle(until)


def driven(motors: Motors) -> list[tuple[float, float]]:
    return [(t, pytest.approx(more[0])) for t, what, *more in motors.told if what == "drive"]


def test_a_command_goes_out_in_parts_on_a_line_and_not_again(driving):
    motors, sender = driving
    sender.order(order(0.1, 0.02))
    go(sender, 0.06)
    assert driven(motors) == [(0.02, 0.025), (0.025, 0.05), (0.03, 0.075), (0.035, 0.1)]


def test_an_order_that_comes_late_leaves_out_the_parts_whose_time_is_over(driving):
    motors, sender = driving
    go(sender, 0.032)
    sender.order(order(0.1, 0.02))
    go(sender, 0.06)
    assert driven(motors) == [(0.032, 0.075), (0.035, 0.1)]


def test_a_command_that_is_not_interpolated_goes_out_once(driving):
    motors, sender = driving
    sender.order(order(0.1, 0.02, ramp=0.0))
    go(sender, 0.06)
    assert driven(motors) == [(0.02, 0.1)]


@pytest.mark.parametrize("repeats", [False, True])
def test_joints_are_not_asked_to_move_on_where_the_next_order_is_late(driving, repeats):
    motors, sender = driving
    motors.repeats = repeats
    late = order(0.1, 0.02)
    sender.order(replace(late, command=replace(late.command, dq_des=np.full(12, 4.0))))
    go(sender, 0.1)
    asked = {t: told[-1] for t, what, *told in motors.told if what == "drive"}
    assert max(asked.values()) == 4.0
    np.testing.assert_allclose([asked[t] for t in (0.05, 0.055, 0.06, 0.065)], [3.0, 2.0, 1.0, 0.0], atol=1e-9)
    assert max(v for t, v in asked.items() if t > 0.065) == 0.0 if repeats else max(asked) == 0.065


def test_a_robot_that_must_be_told_again_and_again_is(driving):
    motors, sender = driving
    motors.repeats, motors.period = True, 0.002
    sender.order(order(0.1, 0.02))
    go(sender, 0.06)
    targets = [more[0] for _, what, *more in motors.told if what == "drive"]
    assert len(targets) == 20
    np.testing.assert_allclose(targets[:10], 0.01 * np.arange(1, 11))
    np.testing.assert_allclose(targets[10:], 0.1)


def test_silence_of_the_control_loop_damps_and_it_is_not_obeyed_again(driving):
    motors, sender = driving
    go(sender, ORDER_TIMEOUT - 0.001)
    assert sender.state == State.DRIVE
    go(sender, ORDER_TIMEOUT + 0.005)
    assert sender.state == State.DAMP
    assert sender.reason == "no order for 0.10 s"
    sender.order(order(0.1, motors.t))
    go(sender, motors.t + 0.1)
    assert {what for _, what, *_ in motors.told} == {"damp"}


def test_orders_that_come_in_time_are_enough(driving):
    _motors, sender = driving
    for step in range(1, 50):
        sender.order(order(0.0, 0.02 * step))
        go(sender, 0.02 * (step + 1))
    assert sender.state == State.DRIVE


def test_a_command_that_is_not_finite_damps(driving):
    _motors, sender = driving
    sender.order(order(np.nan, 0.02))
    go(sender, 0.03)
    assert sender.state == State.DAMP
    assert "not finite" in sender.reason


def test_the_end_of_the_control_loop_damps_until_rest_and_switches_off(driving):
    motors, sender = driving
    motors.moves = 2.0
    sender.closed()
    go(sender, 1.0)
    assert sender.state == State.DAMP
    motors.moves = 0.0
    go(sender, 3.0)
    assert (sender.state, sender.ending) == (State.DONE, "off")
    assert motors.told[-1][0] == pytest.approx(1.6, abs=0.06)


def test_a_robot_that_never_rests_is_damped_for_as_long_as_it_takes(driving):
    motors, sender = driving
    motors.moves = 2.0
    sender.finish()
    go(sender, 20.0)
    assert sender.ending == "still moves"
    assert motors.told[-1][0] == pytest.approx(D.safety.damp_seconds + 0.1, abs=0.1)


def test_a_robot_that_nothing_reaches_is_tried_for_longer_and_then_damped_as_long_as_any(driving):
    motors, sender = driving
    motors.moves, motors.lost = 2.0, True
    sender.finish()
    go(sender, GIVE_UP - 1.0)
    assert sender.state == State.DAMP
    motors.lost = False
    go(sender, GIVE_UP + D.safety.damp_seconds - 2.0)
    assert sender.state == State.DAMP
    go(sender, GIVE_UP + D.safety.damp_seconds + 1.0)
    assert sender.state == State.DONE


def test_what_was_never_driven_ends_without_a_word():
    motors = Motors()
    sender = Sender(motors, D)
    sender.closed()
    assert (sender.state, sender.ending, motors.told) == (State.DONE, "nothing was switched on", [])


def test_a_start_that_fails_says_so_and_nothing_is_driven_after_it():
    motors = Motors()
    motors.refuses = "no answer"
    sender = Sender(motors, D)
    with pytest.raises(PlantError, match="no answer"):
        sender.start()
    sender.order(order(0.1, 0.0))
    assert (sender.state, sender.ending, motors.told) == (State.DONE, "nothing was switched on", [])


def test_an_order_survives_the_socket():
    sent = order(0.1, 12.5)
    again = pickle.loads(pickle.dumps(sent))
    np.testing.assert_array_equal(again.command.q_des, LIE + 0.1)
    assert (again.command.ramp, again.command.kp[0], again.command.kd[0]) == (0.02, 30.0, 3.0)
    assert again.begin == 12.5

"""A Go2 as a plant, on an emulated one in its own time: release, other programs, losses, and damping at the end."""

from __future__ import annotations

import numpy as np
import pytest

from lab.in_process.board_bus import EmulatedGo2Bus
from lab.in_process.sender_link import EmulatedSenderLink
from mimic.config.emulator import EmulateSettings
from mimic.control.safety.step_history import StepReport
from mimic.control.safety.supervisor import Supervisor
from mimic.emulator.boards.go2 import EmulatedGo2
from mimic.emulator.faults import parse_fault
from mimic.errors import FrameError, PlantError, SenderError
from mimic.hardware.go2.driver import GONE_ON, RESTED, UNREACHED, Go2Driver
from mimic.hardware.go2.messages import LOWCMD, LOWSTATE, blank, decode, encode
from mimic.hardware.go2.wiring import load_go2
from mimic.hardware.robot.checks import CheckOptions, refuse
from mimic.hardware.robot.plant import Robot
from mimic.hardware.robot.sender import Sender, State
from mimic.records import JOINTS, JointCommand
from mimic.robot.description import load_description

D, WIRING = load_description("go2"), load_go2()
ANYTHING = encode(LOWCMD, blank(LOWCMD))


class Bus(EmulatedGo2Bus):
    """Keeps what is sent to the motors."""

    def __init__(self, robot) -> None:
        super().__init__(robot)
        self.sent: list[bytes] = []

    def publish(self, channel: str, data: bytes) -> None:
        if channel == LOWCMD:
            self.sent.append(data)
        super().publish(channel, data)


def made(*faults: str, released: bool = True, **settings):
    """Return an emulated robot on its bus, and the plant; its own mode is no longer active, or still is."""
    options = EmulateSettings(**{"placement": 0.0, **settings})
    robot = EmulatedGo2(D, WIRING, options, faults=[parse_fault(text) for text in faults])
    robot.mode = "" if released else robot.mode
    bus = Bus(robot)
    bus.listen(0.6)  # it settles
    return bus, Robot(EmulatedSenderLink(Go2Driver(bus, WIRING, D), D), D)


def hold(q, kp: float = 40.0) -> JointCommand:
    zeros = np.zeros(12)
    return JointCommand(q_des=np.nan_to_num(q), dq_des=zeros, kp=np.full(12, kp), kd=np.full(12, 1.0), tau_ff=zeros)


def found_by(plant):
    return {check.name: check for check in plant.link.checks(CheckOptions(rate_hz=50.0))}


def stops(found) -> str:
    return "; ".join(f"{check.name}: {check.text}" for check in found.values() if check.verdict == "stop")


# ---------------------------------------------------------------------- pre-flight


def test_preflight_sends_no_command_and_says_that_its_own_mode_will_be_released():
    bus, plant = made(released=False)
    found = found_by(plant)
    assert stops(found) == ""
    assert found["own mode"].text == "its own mode 'normal' is active: it lies down and is released when you begin"
    assert bus.sent == []


@pytest.mark.parametrize(("released", "verdict"), [(True, "stop"), (False, "note")])
def test_a_writer_that_is_only_announced_is_named_and_refused_once_the_robot_has_no_own_mode(released, verdict):
    bus, plant = made(released=released)
    bus.rivals = ["python (pid 7) on desk"]
    found = found_by(plant)
    assert found["other programs"].verdict == verdict
    assert "python (pid 7) on desk" in found["other programs"].text


def test_a_program_that_sends_is_refused_in_a_line_that_says_what_to_do():
    bus, plant = made()
    bus.hook = lambda t: bus.foreign(ANYTHING)
    with pytest.raises(PlantError, match=r"other programs: \d+ commands came; .* end that program first") as raised:
        refuse(list(found_by(plant).values()))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("service_silent@0", "own mode: its motion switcher does not answer"),
        ("bus_off@0", "messages: no message came from the robot"),
        ("imu_tilted=0.5@0", "IMU and legs: tilted by"),
    ],
)
def test_preflight_refuses_a_robot_that_does_not_answer_or_does_not_lie(fault, expected):
    _, plant = made(fault)
    assert stops(found_by(plant)).startswith(expected)


# ---------------------------------------------------------------------- start


def test_it_releases_its_own_mode_before_the_first_command_which_is_damping():
    bus, plant = made(released=False)
    state = plant.start()
    assert bus.board.mode == ""
    assert bus.board.fights == 0
    first = decode(LOWCMD, bus.sent[0])["motor_cmd"]
    assert not first["kp"].any()
    assert first["kd"][:12].min() == D.kd_max
    assert first["mode"].tolist() == [1] * 12 + [0] * 8
    np.testing.assert_allclose(state.q, bus.board.body.data.qpos[-12:], atol=5e-3)
    np.testing.assert_allclose(state.quat_WB, bus.board.body.data.qpos[3:7], atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "expected", "left"),
    [
        ("mode_refused@0", "its own mode 'normal' stays active; switch it off in its app", "it was sent no command"),
        ("service_silent@0", "its motion switcher does not answer; restart the robot", "it was sent no command"),
    ],
)
def test_a_robot_that_keeps_its_own_mode_is_not_moved(fault, expected, left):
    bus, plant = made(fault, released=False)
    with pytest.raises(PlantError, match=expected):
        plant.start()
    plant.close()
    assert plant.ending.startswith(left)
    assert bus.sent == []


def test_a_program_that_begins_to_send_before_the_robot_moves_is_refused():
    bus, plant = made()
    bus.hook = lambda t: t > 1.0 and bus.foreign(ANYTHING)
    with pytest.raises(PlantError, match=r"the robot was not moved: \d+ commands came of another program"):
        plant.start()
    assert plant.link.driver.report["sent"] == 0


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("motor_hot:FL_knee=80@0", "motor FL_knee is at 80 degC; let it cool"),
        ("motor_dead:RR_hip@0", "motor RR_hip does not switch on"),
    ],
)
def test_a_motor_that_is_hot_or_does_not_switch_on_is_named_and_the_robot_damped(fault, expected):
    bus, plant = made(fault)
    with pytest.raises(PlantError, match=expected):
        plant.start()
    plant.close()
    assert "damp" in plant.ending
    assert all(not decode(LOWCMD, data)["motor_cmd"]["kp"].any() for data in bus.sent)


# ---------------------------------------------------------------------- running and leaving


@pytest.mark.slow
def test_a_loss_of_5_percent_for_a_second_is_ridden_out_and_the_last_messages_damp():
    bus, plant = made("frames_lost=0.05@+0.5-1.5")
    state = plant.start()
    ticks = [plant.step(hold(D.poses["lie"])) for _ in range(90)]
    assert all(not tick.health.missed.any() for tick in ticks)
    assert np.abs(ticks[-1].state.q - D.poses["lie"]).max() < 0.2
    assert np.abs(state.q - D.poses["lie"]).max() < 0.6
    plant.close()
    assert plant.ending == RESTED
    assert bus.board.driven() == ()
    assert bus.board.silences == 0
    last = [decode(LOWCMD, data)["motor_cmd"] for data in bus.sent[-200:]]
    assert all(not one["kp"].any() and one["kd"][:12].min() == D.kd_max for one in last)


@pytest.mark.slow
def test_commands_of_others_are_counted_while_it_runs_and_said_at_the_end():
    bus, plant = made()
    plant.start()
    bus.hook = lambda t: bus.foreign(ANYTHING)
    plant.step(hold(D.poses["lie"]))
    assert plant.step(hold(D.poses["lie"])).health.foreign >= 10
    plant.close()
    assert plant.ending == GONE_ON


def test_a_motor_that_dies_is_silent_and_no_longer_runs():
    _, plant = made("motor_dead:RL_knee@+0.5")
    plant.start()
    for _ in range(20):
        tick = plant.step(hold(D.poses["lie"]))
    assert [JOINTS[j] for j in np.flatnonzero(~tick.health.running)] == ["RL_knee"]
    assert [JOINTS[j] for j in np.flatnonzero(tick.health.missed)] == ["RL_knee"]


# ---------------------------------------------------------------------- two robots, and its own mode


def another_speaks(bus, since: float = 0.0):
    """Let a second robot, which stands, speak on the network from a time on [s]."""
    message = blank(LOWSTATE)
    message["motor_state"]["q"][:12], message["imu_state"]["quaternion"][0] = 0.7, 1.0
    data = encode(LOWSTATE, message)

    def speak(t: float) -> None:
        if t >= since:
            bus.source, bus.robots = 7, ("go2 one", "go2 two")
            bus.heard(LOWSTATE, data, t)
            bus.source = 0

    bus.hook = speak


@pytest.mark.slow
def test_two_robots_on_one_network_are_refused_by_name():
    bus, plant = made()
    another_speaks(bus)
    assert "rt/lowstate on this network (go2 one; go2 two)" in stops(found_by(plant))
    assert "leave one robot switched on" in stops(found_by(plant))


def test_a_robot_that_is_announced_and_does_not_speak_yet_is_refused_too():
    bus, plant = made()
    bus.robots = ("go2 one", "go2 two")
    assert "go2 two" in stops(found_by(plant))


@pytest.mark.slow
def test_a_robot_that_is_switched_on_later_is_left_out_and_said_at_the_end():
    bus, plant = made()
    assert stops(found_by(plant)) == ""
    plant.start()
    another_speaks(bus)
    for _ in range(20):
        tick = plant.step(hold(D.poses["lie"]))
        assert np.abs(tick.state.q - D.poses["lie"]).max() < 0.6  # that of the other is 0.7
    plant.close()
    assert plant.ending == f"{RESTED}; another robot that speaks on this network was left out"


def test_its_own_mode_that_returns_damps_and_the_last_line_says_who_drives():
    bus, plant = made("mode_returns@+1.0")
    plant.start()
    began = bus.now()
    with pytest.raises(SenderError, match="its own mode 'normal' is active again"):  # noqa: PT012
        while bus.now() < began + 5.0:
            plant.step(hold(D.poses["lie"]))
    assert bus.now() - began < 1.5
    plant.close()
    assert plant.ending.startswith("its own mode 'normal' is active again")
    assert "damping is the last" not in plant.ending


def test_few_readings_are_mentioned_before_it_moves_and_while_it_runs():
    bus, plant = made()
    board = bus.board
    speak, board._speak = board._speak, lambda dead: board.ticks % 10 or speak(dead)  # 50 Hz
    found = found_by(plant)
    assert found["messages"].verdict == "note"
    assert "more than 400 Hz are usual" in found["messages"].text
    board._speak = speak
    plant.start()
    board._speak = lambda dead: board.ticks % 25 or speak(dead)  # 20 Hz
    supervisor = Supervisor(D)
    for _ in range(60):
        tick = plant.step(hold(D.poses["lie"]))
        supervisor.update(StepReport(state=tick.state, health=tick.health, phase=0))
    assert [event.text for event in supervisor.events if event.rule == "answers_slow"] == [
        "answers of the motors take 50 ms; it sits down at 60 ms"
    ]


def test_the_age_of_commands_at_the_motors_is_counted_and_shown():
    bus, plant = made()
    plant.start()
    for _ in range(10):
        plant.step(hold(D.poses["lie"]))
    assert bus.board.old_cycles == 0
    assert bus.board.oldest <= 0.005
    bus.listen(bus.now() + 0.03)
    assert 25e-3 < bus.board.oldest < 35e-3
    assert "cycles of 2 ms with one older than 10 ms" in bus.board.figures()["commands"]


class Wire:
    """A bus without a robot, with a clock of its own."""

    def __init__(self) -> None:
        self.t, self.sent = 0.0, []
        self.heard = lambda channel, data, t: None

    def now(self) -> float:
        return self.t

    def publish(self, channel: str, data: bytes) -> None:
        if channel == LOWCMD:
            self.sent.append(data)

    def listen(self, until: float, wake: int | None = None) -> None:
        self.t = max(until, self.t)

    def ready(self, topic: str) -> bool:
        return True

    source = 0

    def others(self, topic: str = LOWCMD) -> list[str]:
        return []

    def close(self) -> None: ...


def driver() -> Go2Driver:
    """Return a driver that has heard one message."""
    made = Go2Driver(Wire(), WIRING, D)
    message = blank(LOWSTATE)
    message["motor_state"]["q"][:12], message["imu_state"]["quaternion"][0] = np.arange(12) / 10, 1.0
    made.heard(LOWSTATE, encode(LOWSTATE, message), 0.0)
    return made


def test_legs_go_over_the_wire_right_before_left():
    one = driver()
    assert dict(zip(JOINTS, one.report["q"].round(3), strict=True))["FL_abad"] == 0.3
    one.drive(hold(one.report["q"]))
    sent = decode(LOWCMD, one.bus.sent[-1])
    np.testing.assert_allclose(sent["motor_cmd"]["q"][:12], np.arange(12) / 10, rtol=1e-6)
    assert (sent["head"].tolist(), int(sent["level_flag"])) == ([0xFE, 0xEF], 0xFF)


def test_a_robot_that_no_message_reaches_is_damped_for_half_a_minute_and_said_to_be_lost():
    one = driver()
    sender = Sender(one, D)
    sender.state = State.DRIVE
    assert sender.run() == UNREACHED
    assert one.now() > 30.0
    assert len(one.bus.sent) > 14_000


def test_a_robot_that_holds_still_because_no_command_reaches_it_is_not_said_to_be_damped():
    bus, plant = made()
    plant.start()
    for _ in range(100):
        plant.step(hold(D.poses["four"]))
    bus.board.take = lambda channel, data, t: None
    plant.close()
    assert bus.board.driven()
    assert plant.ending == UNREACHED


def test_numbers_that_are_not_finite_and_damaged_messages_are_left_out():
    one = driver()
    with pytest.raises(FrameError, match="not finite"):
        one.drive(hold(np.zeros(12), kp=np.inf))
    one.heard(LOWSTATE, bytes(1180), 1.0)
    message = blank(LOWSTATE)
    message["motor_state"]["q"][3] = np.nan
    one.heard(LOWSTATE, encode(LOWSTATE, message), 1.0)
    assert one.report["errors"] >= 2
    assert one.report["came"].max() == 0.0
    assert one.bus.sent == []


def test_a_torque_limit_is_refused():
    with pytest.raises(PlantError, match="no torque limit to set"):
        Go2Driver(Wire(), WIRING, D, torque_limit=9.0)

"""Two programs on one bus: a lock, listening before speaking, and what a robot does when somebody else commands it."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from lab.in_process.sender_link import robot_on_can
from mimic.config.emulator import EmulateSettings
from mimic.config.hardware import BusSettings
from mimic.control.safety.safety_rules import RULES
from mimic.control.safety.step_history import StepReport
from mimic.control.safety.supervisor import SafetyMode, Supervisor
from mimic.emulator.motor import encode_answer
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import BusError, PlantError
from mimic.flows.robot import commissioning
from mimic.hardware import session
from mimic.hardware.bus_lock import bus_lock
from mimic.hardware.can import open_driver
from mimic.hardware.can.frame import CanFrame, Received
from mimic.hardware.can.other_programs import look_first
from mimic.hardware.can.preflight import preflight
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.cybergear.codec import Codec, HostMessage, Kind
from mimic.hardware.motors.interface import Feedback, MotorCommand, MotorMode
from mimic.hardware.robot.checks import CheckOptions
from mimic.hardware.robot.plant import Robot
from mimic.records import DOUBLED, PHASES, JointCommand

CODEC = Codec()
BUSES = BusSettings(zeroed=True, yes=True)


@pytest.fixture(autouse=True)
def own_locks(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))


@pytest.fixture
def robot(description) -> EmulatedRobot:
    return EmulatedRobot(description, load_wiring(), EmulateSettings(zeroed=True, placement=0.02))


@pytest.fixture
def reached(robot, monkeypatch) -> EmulatedRobot:
    """Put the emulated robot behind every word for a bus."""
    monkeypatch.setattr(session, "open_buses", lambda bus_url, wiring: EmulatedLink(robot))
    return robot


def hold(description) -> JointCommand:
    zeros, q = np.zeros(12), description.poses["lie"]
    return JointCommand(q_des=q, dq_des=zeros, kp=np.full(12, 30.0), kd=np.full(12, 3.0), tau_ff=zeros)


def driven(robot, description, steps: int = 5) -> Robot:
    plant = robot_on_can(EmulatedLink(robot), load_wiring(), description)
    plant.start()
    for _ in range(steps):
        plant.step(hold(description))
    return plant


def sent_by_hosts(robot: EmulatedRobot) -> list[CanFrame]:
    """Record what hosts send from now on, other than the first, which drives the robot."""
    frames: list[CanFrame] = []
    send = robot.send

    def record(host, bus, frame, **more):
        if host.node != "host1":
            frames.append(frame)
        send(host, bus, frame, **more)

    robot.send = record
    return frames


class Beside:
    """A link whose waiting lets another program drive the robot too, once in each control step."""

    def __init__(self, robot: EmulatedRobot, plant: Robot, description) -> None:
        self._link, self._robot, self._plant, self._command = EmulatedLink(robot), robot, plant, hold(description)

    def receive(self, timeout: float):
        end, received = self._link.now() + timeout, None
        while received is None and self._link.now() < end:
            self._plant.step(self._command)
            received = self._link.receive(0.0)
        return received if received is not None else self._link.receive(max(end - self._link.now(), 0.0))

    def __getattr__(self, name: str):
        return getattr(self._link, name)


# ---------------------------------------------------------------------- before anything is sent


@pytest.mark.slow
def test_a_second_program_refuses_without_a_frame_while_one_drives_the_robot(robot, description):
    plant = driven(robot, description)
    motor_bus = MotorBus(Beside(robot, plant, description), load_wiring())
    frames = sent_by_hosts(robot)
    found = preflight(motor_bus, description, CheckOptions(rate_hz=50.0), trust_zeros=True)
    assert (found[-1].name, found[-1].verdict) == ("other programs", "stop")
    assert "another program commands the motors" in found[-1].text
    assert frames == []
    assert {motor.mode for motor in robot.motors} == {MotorMode.RUNNING}
    with pytest.raises(PlantError, match="nothing was changed"):
        look_first(motor_bus)
    plant.close()


def test_motors_that_hold_a_robot_for_a_program_that_has_ended_are_not_dropped(robot, description):
    driven(robot, description, steps=40)  # and nobody closes it
    upper = EmulatedLink(robot)
    command = HostMessage(Kind.OPERATION, 3, command=MotorCommand(q=0.4, dq=0.0, kp=30.0, kd=3.0, tau=0.0))
    upper.send(0, CODEC.encode(command))
    robot.advance(robot.now + 0.5)
    motor_bus = MotorBus(EmulatedLink(robot), load_wiring())
    motor_bus.drain()
    motor_bus.foreign = 0
    found = preflight(motor_bus, description, CheckOptions(rate_hz=50.0), trust_zeros=True)
    assert "hold a torque" in found[-1].text
    assert "mimic robot damp" in found[-1].text
    assert {motor.mode for motor in robot.motors} == {MotorMode.RUNNING}


@pytest.mark.slow
def test_damping_switches_off_what_a_program_left_on(reached, description):
    driven(reached, description)
    assert commissioning.damp_robot("can0", BUSES) == (True, "the robot was damped and all motors are off")
    assert {motor.mode for motor in reached.motors} == {MotorMode.OFF}


@pytest.mark.parametrize(
    "call",
    [
        pytest.param(commissioning.scan_robot, marks=pytest.mark.slow),
        pytest.param(commissioning.zero_robot, marks=pytest.mark.slow),
        commissioning.check_robot,
    ],
)
def test_no_command_speaks_beside_a_program_that_drives(call, robot, description, monkeypatch):
    plant = driven(robot, description)
    for module in (session, open_driver):
        monkeypatch.setattr(module, "open_buses", lambda *_, **__: Beside(robot, plant, description))
    frames = sent_by_hosts(robot)
    try:
        found = [check.text for check in call("can0", BUSES) if check.verdict == "stop"]
    except PlantError as reason:
        found = [str(reason)]
    assert any("another program" in text for text in found)
    assert frames == []
    plant.close()


def test_a_silent_bus_lets_it_speak(robot):
    motor_bus = MotorBus(EmulatedLink(robot), load_wiring())
    motor_bus.link.sleep(0.1)
    look_first(motor_bus)


# ---------------------------------------------------------------------- the lock


def test_a_bus_has_one_program_at_a_time():
    with bus_lock("can0,can1"):
        with pytest.raises(BusError, match=r"can1 is in use by mimic .*process"), bus_lock("can1"):
            pass
        with bus_lock("can2"):
            pass
    with bus_lock("can1"):
        pass


def test_a_process_that_inherits_the_lock_goes_on_holding_it():
    with bus_lock("can0") as files:
        child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, pass_fds=files)
    try:
        with pytest.raises(BusError, match="in use"), bus_lock("can0"):
            pass
    finally:
        child.communicate(b"\n", timeout=60)
    with bus_lock("can0"):
        pass


def test_where_no_lock_file_can_be_made_there_is_none(monkeypatch):
    monkeypatch.setenv("TMPDIR", "/proc/nowhere")
    with bus_lock("can0") as files:
        assert files == ()


def test_the_lock_is_let_go_when_opening_fails(monkeypatch):
    def broken(bus_url, wiring):
        raise BusError("there is no such bus")

    monkeypatch.setattr(session, "open_buses", broken)
    with pytest.raises(BusError, match="no such bus"):
        commissioning.scan_robot("can0", BUSES)
    with bus_lock("can0"):
        pass


# ---------------------------------------------------------------------- while it runs


def play(robot, description, frames: list[CanFrame], *, every: int = 10**6, ticks: int = 12) -> Supervisor:
    """Hold a lying robot while another host sends frames in every so many ticks, and return the supervisor."""
    plant, other = driven(robot, description), EmulatedLink(robot)
    supervisor = Supervisor(description, rules=[rule for rule in RULES if rule.name == "other_program"])
    for tick in range(ticks):
        if tick >= 2 and (tick - 2) % every == 0:
            for frame in frames:
                other.send(0, frame)
        done = plant.step(hold(description))
        report = StepReport(state=done.state, health=done.health, phase=PHASES.index("track"))
        supervisor.update(report)
    plant.close()
    return supervisor


@pytest.mark.parametrize(
    "message",
    [
        HostMessage(Kind.OPERATION, 3, command=MotorCommand(q=0.0, dq=0.0, kp=10.0, kd=1.0, tau=1.0)),
        pytest.param(HostMessage(Kind.STOP, 3), marks=pytest.mark.slow),
        pytest.param(HostMessage(Kind.ENABLE, 3, host=0x80), marks=pytest.mark.slow),
        pytest.param(HostMessage(Kind.SET_ZERO, 3, host=5), marks=pytest.mark.slow),
    ],
    ids=lambda message: type(message).__name__,
)
def test_a_command_of_another_program_makes_the_robot_sit_down(message, robot, description):
    supervisor = play(robot, description, [CODEC.encode(message)])
    assert supervisor.decisive is not None
    assert (supervisor.decisive.rule, supervisor.decisive.mode) == ("other_program", SafetyMode.SIT_DOWN)


@pytest.mark.slow
def test_a_program_that_goes_on_commanding_damps_the_robot(robot, description):
    frames = [
        CODEC.encode(HostMessage(Kind.OPERATION, n, command=MotorCommand(q=0.0, dq=0.0, kp=10.0, kd=1.0, tau=0.0)))
        for n in range(1, 13)
    ]
    assert play(robot, description, frames, every=1).mode == SafetyMode.DAMP


@pytest.mark.slow
@pytest.mark.parametrize(
    "message",
    [
        HostMessage(Kind.DEVICE_ID, 3),
        HostMessage(Kind.READ, 3, index=0x7019),
    ],
)
def test_a_question_of_another_program_changes_nothing(message, robot, description):
    assert play(robot, description, [CODEC.encode(message)]).mode == SafetyMode.RUN


@pytest.mark.slow
def test_a_feedback_to_another_host_is_no_answer_to_us(robot, description):
    plant, other = driven(robot, description), EmulatedLink(robot)
    other.send(0, CODEC.encode(HostMessage(Kind.ENABLE, 3, host=0x80)))  # from now on this motor answers that host
    plant.step(hold(description))
    for _ in range(3):
        done = plant.step(hold(description))
    assert np.isnan(done.state.q[2])
    assert done.health.missed[2] >= 3
    assert done.health.foreign >= 3
    plant.close()


# ---------------------------------------------------------------------- frames that do not concern us


@pytest.mark.slow
def test_frames_of_unknown_senders_and_further_outputs_of_the_imu_end_nothing(robot, description):
    plant, other = driven(robot, description), EmulatedLink(robot)
    strangers = [CanFrame(0x034, bytes(6), extended=False), CanFrame(0x041, bytes(6), extended=False)]
    strangers += [CanFrame(0x700 + n, bytes(8), extended=False) for n in range(5)]
    strangers += [CanFrame(0x1D000000 | n, bytes(8)) for n in range(5)]
    strangers += [CanFrame(0x0280_63FD, bytes(8))]  # a motor that is not in the wiring
    supervisor = Supervisor(description)
    for _ in range(30):
        for frame in strangers:
            other.send(0, frame)
        done = plant.step(hold(description))
        supervisor.update(StepReport(state=done.state, health=done.health, phase=PHASES.index("lie")))
    assert supervisor.mode == SafetyMode.RUN
    assert not supervisor.events
    assert done.health.bus_errors == 0
    plant.close()


def test_pre_flight_names_unknown_senders_and_goes_on(robot, description):
    motor_bus, other = MotorBus(EmulatedLink(robot), load_wiring()), EmulatedLink(robot)
    motor_bus.link.sleep(0.2)
    for n in range(100):
        other.send(0, CanFrame(0x700 + n % 8, bytes(8), extended=False))
    other.send(0, CanFrame(0x034, bytes(6), extended=False))
    found = {c.name: c for c in preflight(motor_bus, description, CheckOptions(rate_hz=50.0), trust_zeros=True)}
    assert found["other programs"].verdict == "note"
    assert "100 frames of unknown senders: 0x700 on" in found["other programs"].text
    assert "2 more identifiers" in found["other programs"].text
    assert "0x034" not in found["other programs"].text
    assert not [check for check in found.values() if check.verdict == "stop"]


def test_the_lock_lies_where_every_user_of_the_computer_finds_it(monkeypatch):
    monkeypatch.delenv("TMPDIR")
    name = f"socketcand://127.0.0.1:{os.getpid()}/can0"
    with bus_lock(name) as files:
        assert os.readlink(f"/proc/self/fd/{files[0]}").startswith("/tmp/mimic-socketcand-")


class EchoingLink(EmulatedLink):
    """An adapter that also hands back what it sends."""

    def __init__(self, robot: EmulatedRobot) -> None:
        super().__init__(robot)
        self._echoes: list[Received] = []

    def send(self, bus: int, frame: CanFrame) -> None:
        super().send(bus, frame)
        self._echoes.append(Received(bus, frame, self.now()))

    def receive(self, timeout: float) -> Received | None:
        return self._echoes.pop(0) if self._echoes else super().receive(timeout)


def test_an_adapter_that_echoes_is_no_other_program(robot, description):
    link = EchoingLink(robot)
    motor_bus = MotorBus(link, load_wiring())
    found = {c.name: c for c in preflight(motor_bus, description, CheckOptions(rate_hz=50.0), trust_zeros=True)}
    assert found["other programs"].verdict == "note"
    assert "the adapter echoes" in found["other programs"].text
    plant = robot_on_can(link, load_wiring(), description)
    plant.start()
    for _ in range(5):
        tick = plant.step(hold(description))
    assert tick.health.foreign == 0
    assert tick.health.missed.max() == 0
    assert plant.link.driver.motor_bus.echoes >= 5 * 12


@pytest.mark.parametrize("late", [0.03, 0.3])
def test_an_adapter_that_echoes_later_and_late_is_no_other_program(late, robot, description):
    link = EchoingLink(robot)
    plant = robot_on_can(link, load_wiring(), description)
    plant.start()
    link._echoes.clear()
    held, receive = [], link.receive

    def receive_late(timeout: float) -> Received | None:
        held.extend(link._echoes)
        link._echoes.clear()
        if held and held[0].t + late <= link.now():
            return held.pop(0)._replace(t=link.now())
        return receive(timeout)

    link.receive = receive_late
    for step in range(25):
        command = hold(description)
        tick = plant.step(replace(command, q_des=command.q_des + 0.002 * step, ramp=0.02))
    assert tick.health.foreign == 0
    assert plant.link.driver.motor_bus.echoes >= 9 * 12


class DoublingLink(EmulatedLink):
    """A bus on which a second motor answers as the one with id 2, 0.4 rad away."""

    def __init__(self, robot: EmulatedRobot) -> None:
        super().__init__(robot)
        self._second: list[Received] = []

    def receive(self, timeout: float) -> Received | None:
        if self._second:
            return self._second.pop(0)
        received = super().receive(timeout)
        if received is not None and received.frame.extended:
            message = CODEC.decode(received.frame)
            said = getattr(message, "said", None)
            if isinstance(said, Feedback) and said.motor == 2:
                second = replace(message, said=replace(said, q=said.q + 0.4))
                self._second.append(received._replace(frame=encode_answer(CODEC, second)))
        return received


@pytest.mark.slow
def test_two_motors_with_one_id_are_found_before_the_start_and_while_it_runs(robot, description):
    plant = robot_on_can(DoublingLink(robot), load_wiring(), description)
    plant.start()
    bits = [int(plant.step(hold(description)).health.faults[1]) for _ in range(10)]
    assert bits[-1] & DOUBLED
    motor_bus = plant.link.driver.motor_bus
    plant.close()
    found = {c.name: c for c in preflight(motor_bus, description, CheckOptions(rate_hz=50.0), trust_zeros=True)}
    assert found["motors"].verdict == "stop"
    assert "FL_hip: two motors have its id" in found["motors"].text

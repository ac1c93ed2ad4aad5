from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from mimic.config.emulator import EmulateSettings
from mimic.emulator.faults import parse_fault
from mimic.emulator.motor import DETAIL, ROTOR_TURN
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import BusError, ConfigError
from mimic.hardware.can.frame import CanFrame, Received
from mimic.hardware.can.load import frame_bits
from mimic.hardware.can.preflight import position_range
from mimic.hardware.can.wiring import Wiring, load_wiring
from mimic.hardware.motors.cybergear.codec import (
    CAN_TIMEOUT,
    LIMIT_SPD,
    LIMIT_TORQUE,
    MECH_POS,
    RUN_MODE,
    VBUS,
    Codec,
    Fault,
    HostMessage,
    Kind,
    MotorMessage,
    ParameterValue,
)
from mimic.hardware.motors.imu import Imu, ImuReading, make_imu
from mimic.hardware.motors.interface import FaultReport, Feedback, Identity, MotorCommand, MotorMode
from mimic.records import JOINTS

HOST = 0xFD
KNEE = JOINTS.index("FL_knee")


class Bench:
    """A robot and one host that understands it."""

    def __init__(self, description, wiring: Wiring | None = None, faults: tuple[str, ...] = (), **options) -> None:
        self.wiring = load_wiring() if wiring is None else wiring
        settings = EmulateSettings(**({"zeroed": True, "placement": 0.0} | options))
        self.robot = EmulatedRobot(description, self.wiring, settings, faults=[parse_fault(f) for f in faults])
        self.link = EmulatedLink(self.robot)
        self.codec = Codec()

    def id(self, joint: int) -> int:
        return int(self.wiring.motor[joint])

    def say(self, message: HostMessage, bus: int = 0) -> None:
        self.link.send(bus, self.codec.encode(message))

    def listen(self, seconds: float) -> list[Received]:
        until, heard = self.link.now() + seconds, []
        while (received := self.link.receive(until - self.link.now())) is not None:
            heard.append(received)
        return heard

    def messages(self, seconds: float = 0.003) -> list[Any]:
        """Return what motors say meanwhile."""
        heard = [self.codec.decode(r.frame) for r in self.listen(seconds) if r.frame.extended]
        return [m.said for m in heard if isinstance(m, MotorMessage)]

    def ask(self, message: HostMessage, seconds: float = 0.003, *, bus: int = 0) -> Any:
        """Return the answer to a message."""
        self.listen(0.0)
        self.say(message, bus)
        answers = [m for m in self.messages(seconds) if not isinstance(m, FaultReport)]
        assert len(answers) <= 1, answers
        return answers[0] if answers else None

    def read(self, joint: int, index: int) -> float:
        answer = self.ask(HostMessage(Kind.READ, self.id(joint), index=index))
        assert isinstance(answer, ParameterValue)
        return answer.value

    def write(self, joint: int, index: int, value: float) -> Feedback:
        answer = self.ask(HostMessage(Kind.WRITE, self.id(joint), index=index, value=value))
        assert isinstance(answer, Feedback)
        return answer

    def operate(self, joint: int, q: float = 0.0, *, kp: float = 0.0, kd: float = 0.0, tau: float = 0.0) -> Feedback:
        answer = self.ask(
            HostMessage(Kind.OPERATION, self.id(joint), command=MotorCommand(q=q, dq=0.0, kp=kp, kd=kd, tau=tau))
        )
        assert isinstance(answer, Feedback)
        return answer

    def enable(self, joint: int) -> Feedback:
        answer = self.ask(HostMessage(Kind.ENABLE, self.id(joint)), bus=int(self.wiring.bus[joint]))
        assert isinstance(answer, Feedback)
        return answer


@pytest.fixture
def bench(description) -> Callable[..., Bench]:
    """Return a function that switches a robot on and waits until its motors have told their ids."""

    def make(*faults: str, **options) -> Bench:
        made = Bench(description, faults=faults, **options)
        made.listen(0.1)
        return made

    return make


# ---------------------------------------------------------------------- power-up, zero


def test_at_power_up_every_motor_sends_its_id_once(description):
    told = [m for m in Bench(description).messages(0.1) if isinstance(m, Identity)]
    assert sorted(m.motor for m in told) == list(range(1, 13))
    assert len({m.uid for m in told}) == 12


@pytest.mark.parametrize("seed", range(4))
def test_after_power_up_angles_are_known_within_a_turn_of_the_rotor_only(seed, bench):
    made = bench(zeroed=False, seed=seed)
    for joint in range(12):
        answer = made.ask(HostMessage(Kind.STOP, made.id(joint)))
        assert abs(answer.q) <= ROTOR_TURN / 2 + 1e-3
        assert answer.mode is MotorMode.OFF


def test_the_encoder_stays_where_it_is_mounted(bench):
    """Off and on again, wherever the zero was set meanwhile, the same place reads the same."""
    made = bench("power_cycle:FL_knee@0.5", zeroed=False)
    first = made.ask(HostMessage(Kind.STOP, made.id(KNEE))).q
    assert made.ask(HostMessage(Kind.SET_ZERO, made.id(KNEE))).q == pytest.approx(0.0, abs=1e-3)
    made.write(KNEE, LIMIT_SPD, 7.0)
    told = made.messages(0.6)
    assert [m.motor for m in told if isinstance(m, Identity)] == [made.id(KNEE)]
    assert made.ask(HostMessage(Kind.STOP, made.id(KNEE))).q == pytest.approx(first, abs=1e-3)
    assert made.read(KNEE, LIMIT_SPD) == 0.0, "written parameters are forgotten"


def test_different_seeds_mount_encoders_differently(bench):
    readings = [bench(zeroed=False, seed=s).ask(HostMessage(Kind.STOP, 3)).q for s in (1, 2)]
    assert readings[0] != readings[1]


def test_a_zeroed_robot_reads_its_joint_angles(bench, description):
    made = bench(placement=0.1, seed=5)
    truth = made.wiring.p_of(np.array(made.robot.body.data.qpos[-12:]))
    for joint in range(12):
        assert made.ask(HostMessage(Kind.STOP, made.id(joint))).q == pytest.approx(truth[joint], abs=1e-3)


# ---------------------------------------------------------------------- answers


def test_an_answer_comes_after_the_command_the_pause_and_itself(bench):
    made = bench()
    made.listen(0.003)  # between two samples of the IMU
    command = made.codec.encode(HostMessage(Kind.STOP, 3))
    begin = made.link.now()
    made.link.send(0, command)
    (answer,) = [r for r in made.listen(0.002) if r.frame.extended]
    expected = (frame_bits(command) + frame_bits(answer.frame)) / 1e6 + 250e-6
    assert answer.t - begin == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x303, bytes(8), extended=False),
        CanFrame(0x0300FD03, bytes(4)),
        CanFrame(0x0500FD03, bytes(8)),
        CanFrame(0x0300FD63, bytes(8)),
    ],
    ids=["11 bits", "short", "unknown type", "somebody else"],
)
def test_a_frame_that_is_no_command_to_it_leaves_a_motor_alone(frame, bench):
    made = bench()
    made.link.send(0, frame)
    assert made.messages() == []
    assert {motor.mode for motor in made.robot.motors} == {MotorMode.OFF}


def test_ids_can_be_asked_for(bench):
    made = bench()
    assert isinstance(made.ask(HostMessage(Kind.DEVICE_ID, 3)), Identity)
    assert made.ask(HostMessage(Kind.DEVICE_ID, 40)) is None


def test_parameters_are_kept_and_some_are_measured(bench):
    made = bench()
    made.write(KNEE, LIMIT_TORQUE, 5.0)
    assert made.read(KNEE, LIMIT_TORQUE) == 5.0
    assert made.read(KNEE, VBUS) == 24.0
    made.write(KNEE, VBUS, 48.0)
    assert made.read(KNEE, VBUS) == 24.0
    assert made.read(KNEE, MECH_POS) == pytest.approx(made.ask(HostMessage(Kind.STOP, 3)).q, abs=1e-3)


def test_motors_of_the_other_position_range_can_be_found_out(description):
    wiring = load_wiring()
    far = wiring.offset - 10.0 * wiring.sign * (np.arange(12) == KNEE)
    made = Bench(description, dataclasses.replace(wiring, offset=far), position_range=12.5)
    made.listen(0.1)
    q = made.ask(HostMessage(Kind.STOP, 3)).q
    assert abs(q) > 9.0
    assert position_range(wiring.motors().facts, wiring.position_range, q, made.read(KNEE, MECH_POS)) == 12.5


# ---------------------------------------------------------------------- moving


def test_only_a_motor_that_is_switched_on_moves(bench):
    made = bench(suspended=True)
    made.robot.body.release()
    made.operate(KNEE, tau=-3.0)
    made.listen(0.02)
    assert made.operate(KNEE, tau=-3.0).tau == pytest.approx(0.0, abs=1e-3)
    assert made.enable(KNEE).mode is MotorMode.RUNNING
    made.operate(KNEE, tau=-3.0)
    made.listen(0.02)
    assert made.operate(KNEE, tau=-3.0).tau == pytest.approx(-3.0, abs=1e-2)
    made.say(HostMessage(Kind.STOP, 3))
    made.listen(0.02)
    stopped = made.ask(HostMessage(Kind.STOP, 3))
    assert (stopped.mode, round(stopped.tau, 2)) == (MotorMode.OFF, 0.0)


def test_the_last_command_goes_on_when_the_host_falls_silent(bench):
    made = bench(suspended=True)
    made.enable(KNEE)
    made.operate(KNEE, tau=-3.0)
    made.listen(1.0)
    assert made.robot.body.joint(KNEE, made.robot.now)[2] == pytest.approx(-3.0 * made.wiring.sign[KNEE], abs=1e-2)


@pytest.mark.parametrize("honoured", [True, False])
def test_firmware_that_honours_the_timeout_lets_go_and_other_firmware_forgets_it(honoured, bench):
    made = bench(suspended=True, can_timeout=honoured)
    made.write(KNEE, CAN_TIMEOUT, 2000)  # 0.1 s
    assert made.read(KNEE, CAN_TIMEOUT) == (2000 if honoured else 0)
    made.enable(KNEE)
    for _ in range(10):
        made.operate(KNEE, tau=-1.0)
        made.listen(0.05)
    assert made.robot.motors[KNEE].mode is MotorMode.RUNNING
    made.listen(0.3)
    assert made.robot.motors[KNEE].mode is (MotorMode.OFF if honoured else MotorMode.RUNNING)


def test_the_torque_limit_holds_from_when_it_is_written(bench):
    made = bench(suspended=True)
    made.enable(KNEE)
    made.operate(KNEE, tau=-5.0)
    made.listen(0.5)  # until it is at its stop
    made.write(KNEE, LIMIT_TORQUE, 2.0)
    made.listen(0.02)
    assert made.operate(KNEE, tau=-5.0).tau == pytest.approx(-2.0, abs=1e-2)


def test_joint_and_motor_turn_the_same_way_as_the_wiring_says(bench):
    made = bench(suspended=True)
    for joint in (KNEE, JOINTS.index("FR_knee")):
        made.enable(joint)
        target = float(made.wiring.p_of(np.full(12, -1.2))[joint])
        for _ in range(60):
            got = made.operate(joint, target, kp=40.0, kd=2.0)
            made.listen(0.02)
        assert got.q == pytest.approx(target, abs=0.05)
        assert made.robot.body.data.qpos[joint] == pytest.approx(-1.2, abs=0.05)


def test_the_run_mode_does_not_change_while_running(bench):
    made = bench()
    made.enable(KNEE)
    made.write(KNEE, RUN_MODE, 2)
    assert made.read(KNEE, RUN_MODE) == 0


def test_in_another_run_mode_a_motor_does_not_follow_commands(bench):
    made = bench(suspended=True)
    made.write(KNEE, RUN_MODE, 2)
    made.enable(KNEE)
    made.operate(KNEE, made.read(KNEE, MECH_POS) - 0.5, kp=40.0, kd=2.0)
    assert made.robot.motors[KNEE].drive.kp == 0.0


# ---------------------------------------------------------------------- IMU


def watch(made: Bench, seconds: float, imu: Imu | None = None) -> ImuReading:
    imu = imu or make_imu(made.wiring.imu)
    for received in made.listen(seconds):
        if not received.frame.extended:
            assert imu.feed(received.frame, received.t)
    return imu.reading(made.link.now())


def test_the_imu_shows_the_trunk_however_it_is_mounted(description):
    wiring = load_wiring()
    askew = np.array([0.5, 0.5, -0.5, 0.5])
    wiring = dataclasses.replace(wiring, imu=dataclasses.replace(wiring.imu, quat_BI=askew))
    made = Bench(description, wiring)
    made.robot.body.release()
    made.robot.body.data.qvel[3:6] = 0.0, 1.0, 0.0
    reading = watch(made, 0.205)
    quat, _ = made.robot.body.base()
    assert reading.problem is None
    assert reading.count == 20
    assert abs(reading.quat_WB @ quat) > 0.9999
    assert np.abs(reading.omega_B).max() < 3.0


def test_it_sends_each_message_as_often_as_requested(description):
    heard = Bench(description).listen(2.005)
    ids = [r.frame.id for r in heard if not r.frame.extended]
    assert [ids.count(i) for i in (0x021, 0x032, 0x006, 0x011)] == [200, 200, 200, 20]


@pytest.mark.parametrize(
    ("fault", "problem"),
    [
        ("imu_silent@0.5", "silent"),
        ("imu_frozen@0.5", "repeated"),
        ("imu_invalid@0.5", "invalid"),
        ("bus_off@0.5", "silent"),
        ("imu_silent@0.5-0.7", None),
        ("imu_stuck@0.5", None),
    ],
)
def test_faults_of_the_imu_show(fault, problem, description):
    made = Bench(description, faults=(fault,))
    imu = make_imu(made.wiring.imu)
    before, reading = watch(made, 0.9, imu), watch(made, 0.105, imu)
    assert (problem or "None") in str(reading.problem)
    same = np.array_equal(before.quat_WB, reading.quat_WB, equal_nan=True)
    assert same is (fault not in ("imu_invalid@0.5", "imu_silent@0.5-0.7"))


def test_an_imu_that_tilts_is_wrong_by_as_much(description):
    reading = watch(Bench(description, faults=("imu_tilted=0.5@0.5",)), 1.0)
    assert 2 * np.arccos(abs(reading.quat_WB[0])) == pytest.approx(0.5, abs=0.01)


# ---------------------------------------------------------------------- faults


def test_a_dead_motor_is_silent_and_limp(bench):
    made = bench("motor_dead:FL_knee@1", suspended=True)
    made.enable(KNEE)
    made.operate(KNEE, tau=-3.0)
    made.listen(1.0)
    made.say(HostMessage(Kind.OPERATION, 3, command=MotorCommand(q=0, dq=0, kp=0, kd=0, tau=-3.0)))
    assert made.messages() == []
    assert made.robot.body.joint(KNEE, made.robot.now)[2] == 0.0


def test_a_mute_motor_obeys(bench):
    made = bench("motor_mute:FL_knee@1", suspended=True)
    made.enable(KNEE)
    made.listen(1.0)
    made.say(HostMessage(Kind.OPERATION, 3, command=MotorCommand(q=0, dq=0, kp=0, kd=0, tau=-3.0)))
    assert made.messages(0.02) == []
    assert abs(made.robot.body.joint(KNEE, made.robot.now)[2]) == pytest.approx(3.0, abs=1e-2)


def test_a_deaf_motor_goes_on(bench):
    made = bench("motor_deaf:FL_knee@1", suspended=True)
    made.enable(KNEE)
    made.operate(KNEE, tau=-3.0)
    made.listen(1.0)
    made.say(HostMessage(Kind.STOP, 3))
    assert made.messages(0.02) == []
    assert abs(made.robot.body.joint(KNEE, made.robot.now)[2]) == pytest.approx(3.0, abs=1e-2)


@pytest.mark.parametrize(
    ("fault", "bit", "detail"),
    [
        ("motor_hot:FL_knee=90@0.5-0.6", Fault.OVER_TEMPERATURE, DETAIL[Fault.OVER_TEMPERATURE]),
        ("under_voltage=14@0.5-0.6", Fault.UNDER_VOLTAGE, DETAIL[Fault.UNDER_VOLTAGE]),
        ("motor_fault:FL_knee=2@0.5-0.6", Fault.OVER_CURRENT, DETAIL[Fault.OVER_CURRENT]),
    ],
)
def test_a_fault_switches_the_motor_off_until_it_is_cleared(fault, bit, detail, bench):
    made = bench(fault, suspended=True)
    made.enable(KNEE)
    reports = [m for m in made.messages(0.48) if isinstance(m, FaultReport) and m.motor == 3]
    assert [report.faults for report in reports] == [detail]
    state = made.operate(KNEE, tau=-3.0)
    assert (state.mode, state.faults) == (MotorMode.OFF, bit)
    made.listen(0.2)
    assert made.enable(KNEE).mode is MotorMode.OFF, "the cause is gone, the fault is not cleared yet"
    assert made.ask(HostMessage(Kind.STOP, 3, value=1)).faults == Fault(0)
    assert made.enable(KNEE).mode is MotorMode.RUNNING


def test_a_hot_motor_says_how_hot_and_a_low_supply_how_low(bench):
    made = bench("motor_hot:FL_knee=78@0", "under_voltage=14@0")
    assert made.ask(HostMessage(Kind.STOP, 3)).temperature == pytest.approx(78.0)
    assert made.read(KNEE, VBUS) == 14.0


def answered(made: Bench, count: int = 200) -> list[Any]:
    return [made.ask(HostMessage(Kind.STOP, 1 + i % 12), 0.004) for i in range(count)]


def test_frames_are_lost_in_both_directions(bench):
    made = bench("frames_lost=0.2@0.1")
    lost = [answer is None for answer in answered(made)]
    assert 0.25 < np.mean(lost) < 0.48, "0.36 of the answers miss when either way loses a fifth"


def test_late_frames_come_later_by_so_much(bench):
    made = bench("frames_late=0.02@0.1")
    begin = made.link.now()
    made.say(HostMessage(Kind.STOP, 3))
    (answer,) = [r for r in made.listen(0.1) if r.frame.extended]
    assert answer.t - begin == pytest.approx(0.0405, abs=0.0005), "late to the motor, and late back"


def test_doubled_frames_come_twice(bench):
    made = bench("frames_doubled=1@0.1")
    made.say(HostMessage(Kind.STOP, 3))
    assert len([r for r in made.listen(0.01) if r.frame.extended]) == 4, "twice heard, each answer twice"


def test_corrupted_frames_have_one_wrong_bit(description):
    made = Bench(description, faults=("frames_corrupted=1@0",), imu_noise=0.0, suspended=True)
    heard = [r.frame for r in made.listen(0.5) if r.frame.id in (0x021, 0x023, 0x025, 0x029, 0x031, 0x001, 0x061)]
    right = bytes.fromhex("7FFF000000000000")
    wrong = [
        bin(int.from_bytes(f.data, "big") ^ int.from_bytes(right, "big")).count("1") for f in heard if len(f.data) == 8
    ]
    assert len(wrong) > 20
    assert set(wrong) <= {0, 1}
    assert 1 in wrong


def test_a_stalled_adapter_lets_everything_go_at_its_end(bench):
    made = bench("stalled@0.2-0.5")
    made.listen(0.15)
    made.say(HostMessage(Kind.STOP, 3))
    assert made.listen(0.2) == []
    late = [r.t for r in made.listen(0.2)]
    assert sum(abs(t - 0.5) < 0.02 for t in late) > 20


def test_on_a_bus_that_is_off_nobody_hears_anything(bench):
    made = bench("bus_off@0.2-0.5")
    made.enable(KNEE)
    made.listen(0.15)
    made.say(HostMessage(Kind.STOP, 3))
    assert made.listen(0.2) == []
    made.listen(0.2)
    assert made.ask(HostMessage(Kind.DEVICE_ID, 3)) is not None
    assert made.robot.motors[KNEE].mode is MotorMode.RUNNING


def test_an_unplugged_adapter_is_an_error(bench):
    made = bench("unplugged@0.2")
    with pytest.raises(BusError, match="unplugged"):
        made.listen(1.0)
    with pytest.raises(BusError, match="unplugged"):
        made.say(HostMessage(Kind.STOP, 3))
    made.link.close()
    made.link.close()


def test_a_fault_may_count_from_when_the_first_motor_is_switched_on(bench):
    made = bench("imu_silent@+1")
    made.listen(2.0)
    assert watch(made, 0.1).problem is None
    made.enable(KNEE)
    assert watch(made, 0.9).problem is None
    assert "silent" in watch(made, 0.5).problem or watch(made, 0.1).count == 0
    assert next(text for _, text in made.robot.events).startswith("first motor")


def test_a_fault_on_a_bus_that_is_not_there_is_refused(description):
    with pytest.raises(ConfigError, match="bus 1"):
        Bench(description, faults=("bus_off:bus1",))


# ---------------------------------------------------------------------- buses


def test_hosts_hear_each_other_but_not_themselves(bench):
    made = bench()
    other = EmulatedLink(made.robot)
    made.say(HostMessage(Kind.ENABLE, 3))
    own = made.messages()
    heard = [made.codec.decode(r.frame) for r in iter(lambda: other.receive(0.0), None) if r.frame.extended]
    assert [type(m) for m in own] == [Feedback]
    command, answer = heard
    assert isinstance(command, HostMessage)
    assert command.kind is Kind.ENABLE
    assert isinstance(answer.said, Feedback)


def test_each_motor_is_on_its_own_bus(description):
    made = Bench(description, load_wiring(buses=2))
    told = [r for r in made.listen(0.1) if r.frame.extended]
    assert {(r.bus, made.codec.decode(r.frame).said.motor) for r in told} == {
        (int(made.wiring.bus[i]), made.id(i)) for i in range(12)
    }
    right = JOINTS.index("FR_knee")
    made.say(HostMessage(Kind.STOP, made.id(right)), bus=0)
    assert made.messages() == []
    made.say(HostMessage(Kind.STOP, made.id(right)), bus=1)
    assert len(made.messages()) == 1


def moving(made: Bench, rate: float, seconds: float) -> Iterator[list[Any]]:
    """Command all motors at a rate, in motion, and yield what is heard in each period."""
    for joint in range(12):
        made.enable(joint)
    made.listen(0.0)
    begin, ticks = made.link.now(), round(seconds * rate)
    lie = made.robot.body.description.poses["four"]
    for tick in range(ticks):
        target = made.wiring.p_of(lie + 0.3 * np.sin(6.0 * tick / rate + np.arange(12)))
        for joint in range(12):
            values = {"q": float(target[joint]), "dq": 0.0, "kp": 30.0, "kd": 3.0, "tau": 0.0}
            made.say(
                HostMessage(Kind.OPERATION, made.id(joint), command=MotorCommand(**values)),
                bus=int(made.wiring.bus[joint]),
            )
        yield made.messages(begin + (tick + 1) / rate - made.link.now())


@pytest.mark.parametrize(
    ("buses", "rate", "imu", "expected"),
    [(1, 50.0, 50.0, [0.178]), (1, 200.0, 200.0, [0.714]), (1, 100.0, 100.0, [0.357])],
)
def test_the_load_of_the_bus_is_that_of_the_arithmetic(buses, rate, imu, expected, description):
    """Twelve commands, twelve answers, orientation and rate of turn in each period; figures of the sheet of facts."""
    wiring = load_wiring(buses=buses)
    wiring = dataclasses.replace(
        wiring, imu=dataclasses.replace(wiring.imu, rate={"quaternion": imu, "rate_of_turn": imu})
    )
    made = Bench(description, wiring, suspended=True)
    made.listen(0.1)
    bits, begin = [bus.bits for bus in made.robot.buses], made.link.now()
    for heard in moving(made, rate, 1.0):
        assert sum(isinstance(m, Feedback) for m in heard) == 12, "every answer comes within its period"
    span = made.link.now() - begin
    load = [(bus.bits - before) / 1e6 / span for bus, before in zip(made.robot.buses, bits, strict=True)]
    assert load == pytest.approx(expected, rel=0.05)


def test_two_buses_carry_half_each_and_one_the_imu(description):
    made = Bench(description, load_wiring(buses=2), suspended=True)
    made.listen(0.1)
    for _ in moving(made, 100.0, 0.5):
        pass
    first, second = (bus.bits for bus in made.robot.buses)
    assert 1.05 < first / second < 1.4


def test_everything_is_the_same_again_with_the_same_seed(description):
    def play(seed: int) -> list[tuple[float, str]]:
        made = Bench(description, faults=("frames_lost=0.1@0.2", "frames_corrupted=0.1@0.2"), seed=seed)
        return [(r.t, str(r.frame)) for r in made.listen(0.1) for _ in [0]] + [
            (made.robot.now, str(m)) for heard in moving_on(made) for m in heard
        ]

    assert play(1) == play(1)
    assert play(1) != play(2)


def moving_on(made: Bench) -> Iterator[list[str]]:
    """Like moving, for links that lose and change frames."""
    for joint in range(12):
        made.say(HostMessage(Kind.ENABLE, made.id(joint)))
    for tick in range(20):
        for joint in range(12):
            values = {"q": 0.01 * tick, "dq": 0.0, "kp": 30.0, "kd": 3.0, "tau": 0.0}
            made.say(HostMessage(Kind.OPERATION, made.id(joint), command=MotorCommand(**values)))
        yield [f"{r.t} {r.frame}" for r in made.listen(0.02)]


def test_it_tells_which_motors_are_on_and_which_of_them_are_driven(bench):
    robot = bench()
    assert robot.robot.switched_on() == robot.robot.driven() == ()
    for joint in (0, KNEE):
        robot.enable(joint)
    robot.operate(0, kd=5.0)
    assert robot.robot.switched_on() == (JOINTS[0], "FL_knee")
    assert robot.robot.driven() == ()
    robot.operate(KNEE, kp=10.0)
    assert robot.robot.driven() == ("FL_knee",)

"""What mimic relies on in the motors of every maker. A new maker adds a case; see docs/manual/add-a-motor.md."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mimic.errors import ConfigError, FrameError, UnknownFrame
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.load import frame_bits
from mimic.hardware.can.preflight import position_range
from mimic.hardware.motors.bus import REPORTED
from mimic.hardware.motors.cybergear.protocol import CyberGear
from mimic.hardware.motors.interface import (
    Answer,
    FaultReport,
    Feedback,
    Identity,
    MotorCommand,
    MotorMode,
    MotorProtocol,
    OtherHost,
    Register,
    RegisterValue,
)
from mimic.hardware.motors.makers import MAKERS, MotorMaker, make_motors

ROOT = Path(__file__).parents[3]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A maker, with frames from its document."""

    maker: MotorMaker
    host: int
    position_range: float
    answers: tuple[tuple[CanFrame, Answer | None], ...]
    malformed: tuple[CanFrame, ...]

    def motors(self) -> MotorProtocol:
        return self.maker(host=self.host, position_range=self.position_range)


def example_on_the_page() -> MotorMaker:
    """Return the class of docs/manual/add-a-motor.md."""
    page = (ROOT / "docs" / "manual" / "add-a-motor.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    names: dict[str, Any] = {}
    exec(compile(code, "add-a-motor.md", "exec"), names)
    return names["Acme"]


def frame(text: str) -> CanFrame:
    """Return the frame that candump writes so."""
    identifier, data = text.split("#")
    return CanFrame(int(identifier, 16), bytes.fromhex(data), extended=len(identifier) > 3)


CASES = {
    "cybergear": Case(
        maker=CyberGear,
        host=0xFD,
        position_range=12.5,
        answers=(
            (
                frame("028A05FD#FFFF0000FFFF00FB"),
                Feedback(motor=5, q=12.5, dq=-30.0, tau=12.0, temperature=25.1, mode=MotorMode.RUNNING, faults=0b1010),
            ),
            (frame("110002FD#0B7000000000C040"), RegisterValue(motor=2, register=Register.TORQUE_LIMIT, value=6.0)),
            (frame("00007FFE#0102030405060708"), Identity(motor=0x7F, uid=0x0807060504030201)),
            (frame("150002FD#0400000001000000"), FaultReport(motor=2, faults=4, warnings=1)),
            (frame("110002FD#107000000000003E"), None),
        ),
        malformed=(frame("021#0102030405060708"), frame("028005FD#7FFF"), frame("0500FD03#0000000000000000")),
    ),
    "acme": Case(
        maker=example_on_the_page(),
        host=100,
        position_range=12.5,
        answers=(
            (
                frame("00116405#7FFF80017FFF198A"),
                Feedback(motor=5, q=12.5, dq=-30.0, tau=18.0, temperature=25.0, mode=MotorMode.RUNNING, faults=0b1010),
            ),
            (frame("00156402#010000000000C040"), RegisterValue(motor=2, register=Register.TORQUE_LIMIT, value=6.0)),
            (frame("00176402#0102030405060708"), Identity(motor=2, uid=0x0807060504030201)),
            (frame("00156402#630000000000C040"), None),
        ),
        malformed=(frame("021#0102030405060708"), frame("00116405#7FFF"), frame("00316405#0000000000000000")),
    ),
}


@pytest.fixture(params=list(CASES))
def case(request) -> Case:
    return CASES[request.param]


@pytest.fixture
def motors(case) -> MotorProtocol:
    return case.motors()


def within(motors: MotorProtocol, share: float) -> MotorCommand:
    """Return a command at this share of each range."""
    f = motors.facts
    signed = 2.0 * share - 1.0
    return MotorCommand(12.5 * signed, f.velocity * signed, f.kp * share, f.kd * share, f.torque * signed)


def test_every_maker_has_a_case():
    assert set(MAKERS) <= set(CASES)


def test_an_unknown_maker_is_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match="cybergear"):
        make_motors("nobody", host=0xFD, position_range=12.5)


def test_facts_are_consistent(motors):
    f = motors.facts
    assert min(f.velocity, f.torque, f.kp, f.kd, f.position_step) > 0.0
    assert f.voltage[0] < f.low_voltage < f.voltage[1]
    assert 0.0 <= f.position_bias <= f.position_step
    assert len(f.motor_ids) >= 12
    assert f.factory_id is None or f.factory_id in f.motor_ids
    assert len(f.host_ids) >= 10
    assert Register.TORQUE_LIMIT in f.registers
    assert all(f.registers.values())


@pytest.mark.parametrize("share", [0.0, 0.13, 0.5, 0.77, 1.0])
def test_a_command_is_sent_as_it_is_but_for_rounding(share, motors):
    wanted, ends = within(motors, share), within(motors, 1.0)
    _, sent = motors.command(3, wanted)
    for name, got, value, end in zip(MotorCommand._fields, sent, wanted, ends, strict=True):
        assert abs(got - value) <= 2e-3 * end, name


def test_a_command_that_was_read_back_is_sent_unchanged(motors):
    for share in np.linspace(0.0, 1.0, 23):
        first, sent = motors.command(3, within(motors, float(share)))
        again, same = motors.command(3, sent)
        assert (str(again), same) == (str(first), sent)


def test_a_command_beyond_the_ranges_is_limited_to_them(motors):
    end = within(motors, 1.0)
    _, most = motors.command(3, MotorCommand(*(10.0 * value for value in end)))
    _, least = motors.command(3, MotorCommand(*(-10.0 * value for value in end)))
    assert np.allclose(most, end)
    assert np.allclose(least, within(motors, 0.0))


@pytest.mark.parametrize("field", MotorCommand._fields)
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_command_that_is_not_finite_is_refused(field, value, motors):
    with pytest.raises(FrameError):
        motors.command(3, within(motors, 0.5)._replace(**{field: value}))


def frames_of_a_host(motors: MotorProtocol, motor: int) -> list[CanFrame]:
    registers = motors.facts.registers
    return [
        motors.command(motor, within(motors, 0.3))[0],
        *(make(motor) for make in (motors.enable, motors.stop, motors.ask_identity, motors.set_zero)),
        *(motors.read(motor, register) for register in registers),
        *(motors.write(motor, register, 1.0) for register in registers),
    ]


def test_each_question_to_each_motor_is_a_frame_of_its_own(motors):
    frames = [str(f) for motor in (1, 2, 3) for f in frames_of_a_host(motors, motor)]
    assert len(set(frames)) == len(frames)


def test_frames_of_another_host_are_no_answers_and_its_commands_are_told_from_its_questions(motors):
    for sent in frames_of_a_host(motors, 3):
        found = motors.decode(sent)
        assert isinstance(found, OtherHost), sent
        assert (found.motor, found.feedback) == (3, None)
        assert found.text
    commands = [
        motors.command(3, within(motors, 0.3))[0],
        *(m(3) for m in (motors.enable, motors.stop, motors.set_zero)),
    ]
    assert all(getattr(motors.decode(sent), "commands", False) for sent in commands)
    questions = [motors.ask_identity(3), *(motors.read(3, register) for register in motors.facts.registers)]
    assert not any(getattr(motors.decode(sent), "commands", True) for sent in questions)


def test_a_feedback_to_another_host_is_not_ours(case):
    mine = next(sent for sent, answer in case.answers if isinstance(answer, Feedback))
    others = case.maker(host=case.host + 1, position_range=case.position_range).decode(mine)
    assert isinstance(others, OtherHost)
    assert others.commands
    assert others.feedback == case.motors().decode(mine)


def test_frames_of_another_protocol_are_told_from_malformed_ones(motors):
    with pytest.raises(UnknownFrame):
        motors.decode(CanFrame(0x123, bytes(8), extended=False))


def test_an_id_that_no_motor_can_have_is_refused(motors):
    beyond = motors.facts.motor_ids[-1] + 1
    for make in (motors.enable, motors.stop, motors.ask_identity, motors.set_zero):
        with pytest.raises(FrameError):
            make(beyond)
    with pytest.raises(FrameError):
        motors.command(beyond, within(motors, 0.5))


def test_registers_that_the_motors_lack_are_refused(motors):
    for register in set(Register) - set(motors.facts.registers):
        with pytest.raises(FrameError, match=str(register)):
            motors.read(3, register)
        with pytest.raises(FrameError, match=str(register)):
            motors.write(3, register, 1.0)


def test_a_register_that_is_not_finite_is_refused(motors):
    with pytest.raises(FrameError):
        motors.write(3, Register.TORQUE_LIMIT, float("nan"))


def test_answers_are_read_as_the_makers_document_says(case):
    for sent, expected in case.answers:
        got = case.motors().decode(sent)
        assert type(got) is type(expected)
        if isinstance(expected, Feedback):
            assert isinstance(got, Feedback)
            assert (got.motor, got.mode, got.faults) == (expected.motor, expected.mode, expected.faults)
            assert [got.q, got.dq, got.tau] == pytest.approx([expected.q, expected.dq, expected.tau], abs=1e-9)
            assert got.temperature == pytest.approx(expected.temperature)
            assert got.faults < REPORTED
        else:
            assert got == expected


def test_malformed_frames_are_refused(case):
    for bad in case.malformed:
        with pytest.raises(FrameError):
            case.motors().decode(bad)


def test_the_length_of_a_command_on_the_bus_is_that_of_the_facts(motors):
    rng = np.random.default_rng(0)
    bits = [frame_bits(motors.command(3, within(motors, rng.uniform(0.3, 0.7)))[0]) for _ in range(500)]
    assert np.mean(bits) == pytest.approx(motors.facts.command_bits, rel=0.05)


def test_near_zero_two_readings_cannot_show_the_position_range(motors):
    assert position_range(motors.facts, 12.5, 0.0, 0.0) is None


def test_every_fault_bit_has_a_name(motors):
    assert all(motors.fault_names(1 << bit) for bit in range(6))


def test_only_the_table_of_makers_knows_a_maker():
    others = [p for p in (ROOT / "mimic" / "hardware").rglob("*.py") if p.parent.name != "cybergear"]
    assert [p.name for p in others if "motors.cybergear" in p.read_text(encoding="utf-8")] == ["makers.py"]

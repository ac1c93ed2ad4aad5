from __future__ import annotations

import math
import struct
from dataclasses import asdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mimic.emulator.motor import encode_answer
from mimic.errors import ConfigError, FrameError
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.preflight import position_range
from mimic.hardware.motors.cybergear.codec import (
    CAN_TIMEOUT,
    KD,
    KP,
    LIMIT_TORQUE,
    MECH_POS,
    PARAMETERS,
    RUN_MODE,
    TORQUE,
    VELOCITY,
    Codec,
    HostMessage,
    Kind,
    MotorMessage,
    ParameterValue,
)
from mimic.hardware.motors.cybergear.protocol import CyberGear
from mimic.hardware.motors.interface import FaultReport, Feedback, Identity, MotorCommand, MotorMode

CODEC = Codec()
HOST = 0xFD

GOLDEN = [
    (
        HostMessage(Kind.OPERATION, 1, command=MotorCommand(q=1.0, dq=0, kp=30, kd=1, tau=0)),
        "017FFF01#8A2F7FFF0F5C3333",
    ),
    (
        MotorMessage(Feedback(motor=5, q=0, dq=0, tau=0, temperature=25.1, mode=MotorMode.RUNNING, faults=0)),
        "028005FD#7FFF7FFF7FFF00FB",
    ),
    (HostMessage(Kind.DEVICE_ID, 0x7F), "0000FD7F#0000000000000000"),
    (MotorMessage(Identity(motor=0x7F, uid=0x0807060504030201), 0xFE), "00007FFE#0102030405060708"),
    (HostMessage(Kind.ENABLE, 3), "0300FD03#0000000000000000"),
    (HostMessage(Kind.STOP, 3), "0400FD03#0000000000000000"),
    (HostMessage(Kind.STOP, 3, value=1), "0400FD03#0100000000000000"),
    (HostMessage(Kind.SET_ZERO, 3), "0600FD03#0100000000000000"),
    (HostMessage(Kind.READ, 2, index=MECH_POS), "1100FD02#1970000000000000"),
    (MotorMessage(ParameterValue(motor=2, index=MECH_POS, value=1.5)), "110002FD#197000000000C03F"),
    (HostMessage(Kind.WRITE, 2, index=RUN_MODE, value=1), "1200FD02#0570000001000000"),
    (HostMessage(Kind.WRITE, 2, index=LIMIT_TORQUE, value=6.0), "1200FD02#0B7000000000C040"),
    (
        MotorMessage(FaultReport(motor=2, faults=4, warnings=1)),
        "150002FD#0400000001000000",
    ),
]
"""First two from the sheet of facts; the others are the manual's layouts (4.1) filled in by hand."""


def frame_of(text: str) -> CanFrame:
    identifier, data = text.split("#")
    return CanFrame(int(identifier, 16), bytes.fromhex(data), len(identifier) == 8)


def encoded(message: HostMessage | MotorMessage, codec: Codec = CODEC) -> CanFrame:
    return encode_answer(codec, message) if isinstance(message, MotorMessage) else codec.encode(message)


def flat(message: HostMessage | MotorMessage) -> dict[str, float]:
    """Return all numbers of a message by name."""
    numbers: dict[str, float] = {}
    for name, value in asdict(message).items():
        numbers |= value if isinstance(value, dict) else {name: value}
    command = numbers.pop("command", None)
    return numbers | (dict(zip(MotorCommand._fields, command, strict=True)) if command else {})


@pytest.mark.parametrize(("message", "text"), GOLDEN, ids=lambda v: type(v).__name__ if not isinstance(v, str) else "")
def test_messages_and_bytes_of_the_manual_are_the_same_thing(message, text):
    assert str(encoded(message)) == text
    assert flat(CODEC.decode(frame_of(text))) == pytest.approx(flat(message), abs=1e-3)


def test_the_other_position_range_gives_another_word():
    frame = Codec(position_range=12.5).encode(
        HostMessage(Kind.OPERATION, 1, command=MotorCommand(q=1.0, dq=0, kp=30, kd=1, tau=0))
    )
    assert frame.data[:2] == bytes.fromhex("8A3C")


ranges = st.sampled_from([4 * math.pi, 12.5])


@given(
    end=ranges,
    motor=st.integers(0, 127),
    q=st.floats(-12.5, 12.5),
    dq=st.floats(*VELOCITY),
    kp=st.floats(*KP),
    kd=st.floats(*KD),
    tau=st.floats(*TORQUE),
)
def test_an_operation_command_arrives_as_sent_to_one_word(end, motor, q, dq, kp, kd, tau):
    codec = Codec(position_range=end)
    got = codec.decode(
        codec.encode(HostMessage(Kind.OPERATION, motor, command=MotorCommand(q=q, dq=dq, kp=kp, kd=kd, tau=tau)))
    )
    assert (got.kind, got.motor) == (Kind.OPERATION, motor)
    spans = (2 * end, 60, 500, 5, 24)
    for sent, arrived, span in zip((q, dq, kp, kd, tau), got.command, spans, strict=True):
        assert -1e-6 * span <= sent - arrived <= span / 65535 * (1 + 1e-6), (
            "truncation only lowers, by less than a word"
        )


@given(st.binary(min_size=8, max_size=8), st.integers(0, 0xFFFF), st.integers(0, 127), ranges)
def test_decoded_commands_encode_to_the_same_frame(data, torque, motor, end):
    codec, frame = Codec(position_range=end), CanFrame(1 << 24 | torque << 8 | motor, data)
    assert codec.encode(codec.decode(frame)) == frame


@given(st.binary(min_size=8, max_size=8), st.integers(0, 63), st.sampled_from(MotorMode), st.integers(0, 127), ranges)
def test_decoded_feedback_encodes_to_the_same_frame(data, faults, mode, motor, end):
    codec, frame = Codec(position_range=end), CanFrame(2 << 24 | mode << 22 | faults << 16 | motor << 8 | HOST, data)
    got = codec.decode(frame)
    assert (got.said.mode, got.said.faults, got.said.motor) == (mode, faults, motor)
    assert encoded(got, codec) == frame


@pytest.mark.parametrize(
    ("name", "value", "end"),
    [
        ("q", 20.0, 4 * math.pi),
        ("q", -20.0, -4 * math.pi),
        ("dq", 99, 30),
        ("kp", 501, 500),
        ("kd", 10, 5),
        ("tau", -13, -12),
    ],
)
def test_what_is_beyond_its_range_goes_out_as_the_end_of_it(name, value, end):
    numbers = {"q": 0.0, "dq": 0.0, "kp": 0.0, "kd": 0.0, "tau": 0.0} | {name: value}
    got = CODEC.decode(CODEC.encode(HostMessage(Kind.OPERATION, 1, command=MotorCommand(**numbers))))
    assert getattr(got.command, name) == pytest.approx(end)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["q", "dq", "kp", "kd", "tau"])
def test_numbers_that_are_not_finite_are_never_sent(name, bad):
    numbers = {"q": 0.0, "dq": 0.0, "kp": 0.0, "kd": 0.0, "tau": 0.0} | {name: bad}
    with pytest.raises(FrameError, match="finite"):
        CODEC.encode(HostMessage(Kind.OPERATION, 1, command=MotorCommand(**numbers)))
    with pytest.raises(FrameError, match="finite"):
        CODEC.encode(HostMessage(Kind.WRITE, 1, index=LIMIT_TORQUE, value=bad))


@given(st.sampled_from(sorted(PARAMETERS)), st.floats(-1e6, 1e6))
def test_parameters_arrive_within_their_bounds(index, value):
    got = CODEC.decode(CODEC.encode(HostMessage(Kind.WRITE, 1, index=index, value=value)))
    assert (got.kind, got.index) == (Kind.WRITE, index)
    known = PARAMETERS[index]
    wanted = min(max(value, known.low), known.high)
    if known.kind == "f32":
        assert got.value == pytest.approx(wanted, rel=1e-6, abs=1e-30)
    else:
        assert got.value == int(got.value)
        assert abs(got.value - wanted) < 1 or abs(wanted) > 32767


def test_the_timeout_is_a_whole_number_of_four_bytes():
    frame = CODEC.encode(HostMessage(Kind.WRITE, 1, index=CAN_TIMEOUT, value=20000))
    assert frame.data == struct.pack("<HHI", 0x200C, 0, 20000)


MALFORMED = {
    "11-bit identifier": (CanFrame(0x101, bytes(8), extended=False), "11 bits"),
    "short": (CanFrame(0x028005FD, bytes(7)), "7 bytes"),
    "unknown type": (frame_of("0500FD01#0000000000000000"), "not public"),
    "mode 3": (frame_of("02C005FD#0000000000000000"), "mode 3"),
    "feedback of no motor": (frame_of("0280F5FD#0000000000000000"), "ids below"),
    "bits beside the host": (frame_of("0301FD01#0000000000000000"), "leaves zeros"),
    "bits beside the motor": (frame_of("150105FD#0000000000000000"), "leaves zeros"),
    "bits beside the index": (frame_of("1200FD02#0570010001000000"), "beside the parameter"),
    "parameter that is NaN": (frame_of("110002FD#197000000000C07F"), "not finite"),
    "new id of no motor": (frame_of("0784FD7F#0100000000000000"), "sets the id 132"),
    "enable from a motor": (frame_of("030005FD#0000000000000000"), "no motor sends"),
    "feedback from a host": (frame_of("0200FD05#0000000000000000"), "comes from the id 253"),
}


@pytest.mark.parametrize(("frame", "says"), MALFORMED.values(), ids=MALFORMED.keys())
def test_a_malformed_frame_is_refused_and_says_why(frame, says):
    with pytest.raises(FrameError, match=says):
        CODEC.decode(frame)


@given(st.integers(0, (1 << 29) - 1), st.binary(max_size=8))
def test_any_frame_is_a_message_or_a_frame_error(identifier, data):
    frame = CanFrame(identifier, data)
    try:
        message = CODEC.decode(frame)
    except FrameError:
        return
    if isinstance(message, HostMessage):
        asked = message.kind in (Kind.READ, Kind.WRITE) and message.index not in PARAMETERS
        nowhere = asked or message.kind is Kind.SET_ID
    else:  # fault reports have their ids in two orders
        nowhere = isinstance(message.said, FaultReport) or getattr(message.said, "value", 0.0) is None
    if nowhere:
        return
    assert encoded(message).id == frame.id


@pytest.mark.parametrize(
    ("text", "what"), [("1600FC02#0200000000000000", "a new bit rate"), ("0704FC02#0100000000000000", "a new id")]
)
def test_a_new_bit_rate_or_id_of_another_computer_is_a_command(text, what):
    said = CyberGear(host=HOST).decode(frame_of(text))
    assert (said.motor, said.commands, said.text) == (2, True, f"{what} for motor 2 by host 0xFC")


@pytest.mark.parametrize(
    "message",
    [
        HostMessage(Kind.ENABLE, 128),
        HostMessage(Kind.ENABLE, 1, host=256),
        HostMessage(Kind.READ, 1, index=0x1234),
    ],
)
def test_a_message_that_cannot_be_is_never_sent(message):
    with pytest.raises(FrameError, match=r"expected|known"):
        CODEC.encode(message)


@pytest.mark.parametrize("true_end", [4 * math.pi, 12.5])
@pytest.mark.parametrize("assumed", [4 * math.pi, 12.5])
def test_far_from_zero_the_range_of_a_motor_can_be_determined(true_end, assumed):
    for position in (9.8, -10.2):
        word = position / true_end
        facts = CyberGear(host=HOST, position_range=assumed).facts
        assert position_range(facts, assumed, word * assumed, position) == true_end


def test_near_zero_it_cannot_be_determined_and_elsewhere_nonsense_is_named():
    facts = CyberGear(host=HOST).facts
    assert position_range(facts, 4 * math.pi, 0.5, 0.5) is None
    with pytest.raises(FrameError, match="0x7019"):
        position_range(facts, 4 * math.pi, 10.0, 9.0)


def test_a_range_that_no_motor_has_is_refused():
    with pytest.raises(ConfigError, match="position_range"):
        Codec(position_range=720.0)


def test_a_fault_report_is_understood_in_the_manuals_order_of_ids_and_in_that_of_libraries():
    expected = MotorMessage(FaultReport(motor=2, faults=4, warnings=1), HOST)
    manual = CODEC.decode(frame_of("1500FD02#0400000001000000"))  # host in bits 15 to 8, motor in 7 to 0
    libraries = CODEC.decode(frame_of("150002FD#0400000001000000"))
    assert manual == expected
    assert libraries == expected


@pytest.mark.parametrize("host", [0, 5, 127, 0x80, 0xFD])
def test_the_manuals_ids_of_hosts_work_like_those_of_libraries(host):
    codec = Codec(host=host)
    for message in (
        HostMessage(Kind.ENABLE, 3, host=host),
        HostMessage(Kind.READ, 3, host=host, index=MECH_POS),
        MotorMessage(ParameterValue(motor=3, index=MECH_POS, value=1.5), host),
        MotorMessage(FaultReport(motor=3, faults=4), host),
    ):
        assert codec.decode(encoded(message, codec)) == message


@pytest.mark.parametrize("text", ["110102FD#1C70000000000000", "110002FD#3412000000000000"])
def test_a_parameter_that_the_motor_lacks_or_that_is_not_in_the_table_has_no_value(text):
    message = CODEC.decode(frame_of(text))
    assert (message.said.motor, message.said.value, message.host) == (2, None, HOST)


@pytest.mark.parametrize(("text", "kind"), [("1100FD02#3412", Kind.READ), ("1200FD02#3412", Kind.WRITE)])
def test_a_host_that_uses_a_parameter_that_is_not_in_the_table_is_no_error(text, kind):
    assert CODEC.decode(frame_of(text + "000001000000")) == HostMessage(kind, 2, index=0x1234)

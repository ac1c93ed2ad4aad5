"""Codec of the CyberGear protocol: messages to frames and back, pure. What motors say has the types of mimic's motor
interface, `mimic.hardware.motors.interface`.

A frame has an identifier of 29 bits: communication type (5), data area (16), destination (8). Motors have ids of 7
bits. Hosts may have those of the manual, 0 to 127, or from 0x80 on, as most libraries have it (0xFD). The type shows
the direction of a frame; of type 17, which is both asked and answered, the destination does.

A quantity of an operation command or a feedback is an unsigned word w that spans its range evenly. Encoding saturates
to the range and truncates, as the maker's code does; decoding gives low + w (high - low) / 65535.

Sources: CyberGear manual, sections 3.3 and 4.1, English translation in belovictor/cybergear-docs, commit 22c05e2;
libraries that were read beside it are named where they disagree.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Literal

from mimic.errors import ConfigError, FrameError, UnknownFrame
from mimic.frozen import frozen
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.motors.interface import FaultReport, Feedback, Identity, MotorCommand, MotorMode


class Kind(IntEnum):
    """Communication types, bits 28 to 24 of the identifier; manual 4.1."""

    DEVICE_ID = 0
    OPERATION = 1
    FEEDBACK = 2
    ENABLE = 3
    STOP = 4
    SET_ZERO = 6
    SET_ID = 7
    READ = 17
    WRITE = 18
    FAULT = 21
    BAUD_RATE = 22


class Fault(IntFlag):
    """Faults in a feedback, bits 21 to 16 of its identifier; manual 4.1.3."""

    UNDER_VOLTAGE = 1
    OVER_CURRENT = 2
    OVER_TEMPERATURE = 4
    MAGNETIC_ENCODER = 8
    HALL_ENCODER = 16
    NOT_CALIBRATED = 32


OPERATION_MODE = 0
"""RUN_MODE of a motor that follows operation commands; it must not change while the motor runs."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number in the motor that is read or written by its index."""

    name: str
    kind: Literal["u8", "u32", "f32"] = "f32"
    low: float = -math.inf
    high: float = math.inf
    default: float = 0.0


RUN_MODE = 0x7005
LIMIT_TORQUE = 0x700B
LIMIT_SPD = 0x7017
MECH_POS = 0x7019
IQF = 0x701A
VBUS = 0x701C
CAN_TIMEOUT = 0x200C

PARAMETERS = {
    RUN_MODE: Parameter("run_mode", "u8", 0, 3),
    LIMIT_TORQUE: Parameter("limit_torque", low=0, high=12, default=12),
    LIMIT_SPD: Parameter("limit_spd", low=0, high=30),
    MECH_POS: Parameter("mechPos"),
    IQF: Parameter("iqf"),
    VBUS: Parameter("VBUS"),
    CAN_TIMEOUT: Parameter("CAN_TIMEOUT", "u32", 0, 100000),
}
"""Those of the runtime table that mimic uses, manual 4.1.12, and CAN_TIMEOUT of the stored one, manual 3.3.3. The
default 0 of limit_spd, at which the position mode does not move, is what grrodre/cybergear found. It is not proven that
public firmware supports CAN_TIMEOUT."""


def parameter(index: int) -> Parameter:
    """Return the parameter of an index.

    Raises:
        FrameError: If the table has none.
    """
    if index not in PARAMETERS:
        known = ", ".join(f"0x{i:04X}" for i in PARAMETERS)
        raise FrameError(f"there is no parameter 0x{index:04X}; known are {known}")
    return PARAMETERS[index]


BROADCAST = 0xFE
"""Destination of a device-id answer; manual 4.1.1."""

MOTOR_IDS = 0x80
"""Motors have ids below this."""

DEFAULT_HOST = 0xFD
"""Id of a host in most libraries."""

VELOCITY = (-30.0, 30.0)
"""Range of velocities [rad/s]; manual 4.1.2 and 4.1.3."""
TORQUE = (-12.0, 12.0)
"""Range of torques [N m]."""
KP = (0.0, 500.0)
"""Range of position gains [N m/rad]."""
KD = (0.0, 5.0)
"""Range of velocity gains [N m s/rad]."""

TEMPERATURE = (0.0, 6553.5)
"""Range in degC, tenths; manual 4.1.3."""

POSITION_RANGES = (4 * math.pi, 12.5)
"""The two ends of the position range that are in circulation [rad]: the manual's tables and ten libraries split between
them. The scale differs by 0.53 %; pre-flight finds which one a motor uses."""

WORDS = 65535
"""Steps in the range of a quantity."""
_ROUNDING = 1e-6
"""Added before truncating [words], so that a decoded quantity encodes to the word it came from."""
FAULT_ORDER: Literal["little"] = "little"
"""Byte order of fault reports. Libraries disagree, and the manual does not say; parameters are little-endian."""
_PACK = {"u8": "<B3x", "u32": "<I", "f32": "<f"}


Range = tuple[float, float]
"""Ends of what a word can hold."""


def to_word(value: float, low: float, high: float) -> int:
    """Return the word of a quantity, saturated and truncated.

    Raises:
        FrameError: If it is not finite.
    """
    if not math.isfinite(value):
        raise FrameError(f"{value} cannot be sent; expected a finite number")
    return int((min(max(value, low), high) - low) * WORDS / (high - low) + _ROUNDING)


def _quantities(words: tuple[int, ...], ranges: tuple[Range, ...]) -> list[float]:
    """Return the quantities of words, each in its range."""
    return [low + word * (high - low) / WORDS for word, (low, high) in zip(words, ranges, strict=True)]


@dataclass(frozen=True, slots=True)
class HostMessage:
    """What a host says to a motor. Every kind but DEVICE_ID and READ is answered by a feedback."""

    kind: Kind
    motor: int
    host: int = DEFAULT_HOST
    """Id of the host; OPERATION does not carry it."""
    command: MotorCommand | None = None
    """Of OPERATION."""
    index: int = 0
    """Of the parameter of READ and WRITE."""
    value: float = 0.0
    """Number to WRITE; 1 where a STOP clears faults."""


@frozen
class ParameterValue:
    """Answers READ.

    A motor that lacks a parameter echoes the question with bits 23 to 16 set. Source: manual of the successor family,
    RobStride, type 17.
    """

    motor: int
    index: int
    value: float | None
    """None for a parameter that the motor lacks, or that is not in the table."""


@dataclass(frozen=True, slots=True)
class MotorMessage:
    """What a motor says; an Identity is for everybody."""

    said: Feedback | ParameterValue | Identity | FaultReport
    host: int = DEFAULT_HOST


@frozen
class Codec:
    """Messages to frames and back."""

    position_range: float = POSITION_RANGES[0]
    """Positions reach from minus this to plus this [rad]."""
    host: int = DEFAULT_HOST
    """Id of this computer; shows which frames of type 17 are answers."""

    def __post_init__(self) -> None:
        if not 1.0 < self.position_range < 100.0:
            raise ConfigError(f"position_range is {self.position_range:g} rad; expected 4 pi = 12.566 or 12.5")

    @property
    def position(self) -> Range:
        """Range of positions [rad]."""
        return -self.position_range, self.position_range

    @property
    def _command(self) -> tuple[Range, ...]:
        return self.position, VELOCITY, KP, KD, TORQUE

    def encode(self, m: HostMessage) -> CanFrame:
        """Return the frame of a message.

        Raises:
            FrameError: If a number is not finite, or an id or index does not exist.
        """
        check_ids(m.motor, m.host)
        area = m.host
        data = bytes(8)
        match m.kind:
            case Kind.OPERATION:
                assert m.command is not None
                *words, area = (to_word(number, *ends) for number, ends in zip(m.command, self._command, strict=True))
                data = struct.pack(">4H", *words)
            case Kind.STOP:
                data = bytes([m.value == 1]) + bytes(7)
            case Kind.SET_ZERO:
                data = b"\x01" + bytes(7)
            case Kind.READ:
                parameter(m.index)
                data = struct.pack("<H6x", m.index)
            case Kind.WRITE:
                data = parameter_bytes(m.index, m.value)
        return frame_of(m.kind, area, m.motor, data)

    def decode(self, frame: CanFrame) -> HostMessage | MotorMessage:
        """Return the message of a frame, of either direction.

        Raises:
            UnknownFrame: If the frame is not of this protocol: an identifier of 11 bits, not eight bytes, an unknown
                type, ids that cannot be, bits set that must be zero.
            FrameError: If it is, but with a mode, a code or a value that cannot be.
        """
        if not frame.extended:
            raise UnknownFrame(f"{frame} has an identifier of 11 bits; CyberGear's have 29")
        if len(frame.data) != 8:
            raise UnknownFrame(f"{frame} has {len(frame.data)} bytes; CyberGear's frames have 8")
        number = frame.id >> 24
        area = frame.id >> 8 & 0xFFFF
        destination = frame.id & 0xFF
        try:
            kind = Kind(number)
        except ValueError:
            raise UnknownFrame(f"{frame} has the communication type {number}, which is not public") from None
        if kind is Kind.FAULT and (area == self.host or (destination < MOTOR_IDS <= area <= 0xFF)):
            # The manual has the host in bits 15 to 8 and the motor in 7 to 0; libraries have it the other way.
            return self._of_motor(frame, kind, destination, area)
        if kind in (Kind.FEEDBACK, Kind.FAULT) or destination >= MOTOR_IDS or destination == self.host:
            return self._of_motor(frame, kind, area, destination)
        return self._of_host(frame, kind, area, destination)

    def _of_motor(self, frame: CanFrame, kind: Kind, area: int, host: int) -> MotorMessage:
        motor = area & 0xFF
        data = frame.data
        if motor >= MOTOR_IDS:
            raise UnknownFrame(f"{frame} comes from the id {motor}; motors have ids below {MOTOR_IDS}")
        said: Feedback | ParameterValue | Identity | FaultReport
        if kind is Kind.FEEDBACK:
            ranges = (self.position, VELOCITY, TORQUE, TEMPERATURE)
            q, dq, tau, temperature = _quantities(struct.unpack(">4H", data), ranges)
            if area >> 14 == 3:
                raise FrameError(f"{frame} has mode 3; a motor has modes 0 to 2")
            mode = MotorMode(area >> 14)
            faults = area >> 8 & 0x3F
            said = Feedback(motor=motor, q=q, dq=dq, tau=tau, temperature=temperature, mode=mode, faults=faults)
        elif kind is Kind.READ:
            index = _index_of(frame)
            lacks = area >> 8 or index not in PARAMETERS
            said = ParameterValue(motor=motor, index=index, value=None if lacks else _value_of(frame))
        elif area >> 8:
            raise UnknownFrame(f"{frame} has bits set where a motor leaves zeros")
        elif kind is Kind.DEVICE_ID and host == BROADCAST:
            said = Identity(motor=motor, uid=int.from_bytes(data, "little"))
        elif kind is Kind.FAULT:
            faults, warnings = (int.from_bytes(part, FAULT_ORDER) for part in (data[:4], data[4:]))
            said = FaultReport(motor=motor, faults=faults, warnings=warnings)
        else:
            raise UnknownFrame(
                f"{frame} has the communication type {kind.value} ({kind.name}), which no motor sends to a host"
            )
        return MotorMessage(said, host)

    def _of_host(self, frame: CanFrame, kind: Kind, area: int, motor: int) -> HostMessage:
        if kind is Kind.OPERATION:
            words = (*struct.unpack(">4H", frame.data), area)
            return HostMessage(kind, motor, command=MotorCommand(*_quantities(words, self._command)))
        if kind is Kind.SET_ID and area >> 8 >= MOTOR_IDS:
            raise UnknownFrame(f"{frame} sets the id {area >> 8}; motors have ids below {MOTOR_IDS}")
        index = _index_of(frame) if kind in (Kind.READ, Kind.WRITE) else 0
        strange = kind in (Kind.READ, Kind.WRITE) and index not in PARAMETERS
        if area >> 8 and kind is not Kind.SET_ID and not strange:
            raise UnknownFrame(f"{frame} has bits set where a host leaves zeros")
        value = float(kind is Kind.STOP and frame.data[0] == 1)
        if kind is Kind.WRITE and not strange:
            value = _value_of(frame)
        return HostMessage(kind, motor, area & 0xFF, index=index, value=value)


def check_ids(motor: int, host: int) -> None:
    """Refuse ids that cannot be.

    Raises:
        FrameError: With the one.
    """
    for name, value, high in (("motor", motor, MOTOR_IDS), ("host", host, 256)):
        if not 0 <= value < high:
            raise FrameError(f"the id of the {name} is {value}; expected from 0 to {high - 1}")


def frame_of(kind: Kind, area: int, destination: int, data: bytes) -> CanFrame:
    """Return a frame of its communication type, data area, destination and bytes."""
    return CanFrame(kind << 24 | area << 8 | destination, data)


def parameter_bytes(index: int, value: float) -> bytes:
    """Return the bytes of a parameter's index and value."""
    p = parameter(index)
    if not math.isfinite(value):
        raise FrameError(f"parameter {p.name} cannot be {value}; expected a finite number")
    number = min(max(value, p.low), p.high)
    return struct.pack("<H2x", index) + struct.pack(_PACK[p.kind], number if p.kind == "f32" else int(number))


def _index_of(frame: CanFrame) -> int:
    index, zero = struct.unpack("<HH", frame.data[:4])
    if zero:
        raise UnknownFrame(f"{frame} has bits set beside the parameter's index")
    return index


def _value_of(frame: CanFrame) -> float:
    p = parameter(_index_of(frame))
    value = struct.unpack(_PACK[p.kind], frame.data[4:])[0]
    if not math.isfinite(value):
        raise FrameError(f"{frame} gives parameter {p.name} a value that is not finite")
    return value

"""Codec of the CyberGear protocol: messages to frames and back, pure.

A frame has an identifier of 29 bits: communication type (5), data area (16), destination (8). Motors have ids of 7
bits. Hosts may have those of the manual, 0 to 127, or from 0x80 on, as most libraries have it (0xFD). The type shows
the direction of a frame; of type 17, which is both asked and answered, the destination does.

A quantity of an operation command or a feedback is an unsigned word w that spans its range evenly. Encoding saturates
to the range and truncates, as the maker's code does; decoding gives low + w (high - low) / 65535.

Sources: CyberGear manual 4.1; libraries that were read beside it are named where they disagree.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any, Literal

from mimic.errors import ConfigError, FrameError, UnknownFrame
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.motors.cybergear.messages import (
    PARAMETERS,
    DetailedFault,
    DeviceId,
    Enable,
    Fault,
    FaultReport,
    Feedback,
    GetDeviceId,
    HostMessage,
    Kind,
    Message,
    Mode,
    MotorMessage,
    Operation,
    OtherParameter,
    ParameterValue,
    ReadParameter,
    SetBaudRate,
    SetId,
    SetZero,
    Stop,
    WriteParameter,
    parameter,
)

BROADCAST = 0xFE
"""Destination of a device-id answer; manual 4.1.1."""

MOTOR_IDS = 0x80
"""Motors have ids below this."""

DEFAULT_HOST = 0xFD
"""Id of a host in most libraries."""

VELOCITY, TORQUE, KP, KD = (-30.0, 30.0), (-12.0, 12.0), (0.0, 500.0), (0.0, 5.0)
"""Ranges in rad/s, N m, N m/rad and N m s/rad; manual 4.1.2 and 4.1.3."""

TEMPERATURE = (0.0, 6553.5)
"""Range in degC, tenths; manual 4.1.3."""

POSITION_RANGES = (4 * math.pi, 12.5)
"""The two ends of the position range that are in circulation [rad]: the manual's tables and ten libraries split between
them. The scale differs by 0.53 %; ``Codec.check_range`` finds which one a motor uses."""

BAUD_RATES = {1: 1_000_000, 2: 500_000, 3: 250_000, 4: 125_000}
"""Code -> [bit/s]; manual 4.1.15."""

WORDS = 65535
"""Steps in the range of a quantity."""
_ROUNDING = 1e-6
"""Added before truncating [words], so that a decoded quantity encodes to the word it came from."""
_PACK = {"u8": "<B3x", "i16": "<h2x", "u32": "<I", "f32": "<f"}


def half_a_word(most: float) -> float:
    """Return half a step of a quantity from -most to most: what truncating takes off on average."""
    return most / WORDS


def to_word(value: float, low: float, high: float) -> int:
    """Return the word of a quantity, saturated and truncated.

    Raises:
        FrameError: If it is not finite.
    """
    if not math.isfinite(value):
        raise FrameError(f"{value} cannot be sent; expected a finite number")
    return int((min(max(value, low), high) - low) * WORDS / (high - low) + _ROUNDING)


def from_word(word: int, low: float, high: float) -> float:
    """Return the quantity of a word."""
    return low + word * (high - low) / WORDS


@dataclass(frozen=True, kw_only=True, slots=True)
class Codec:
    """Messages to frames and back."""

    position_range: float = POSITION_RANGES[0]
    """Positions reach from minus this to plus this [rad]."""
    host: int = DEFAULT_HOST
    """Id of this computer; shows which frames of type 17 are answers."""
    fault_order: Literal["little", "big"] = "little"
    """Byte order of fault reports. Libraries disagree, and the manual does not say; parameters are little-endian."""

    def __post_init__(self) -> None:
        if not 1.0 < self.position_range < 100.0:
            raise ConfigError(f"position_range is {self.position_range:g} rad; expected 4 pi = 12.566 or 12.5")

    def encode(self, message: Message) -> CanFrame:
        """Return the frame of a message.

        Raises:
            FrameError: If a number is not finite, or an id or index does not exist.
        """
        m = message
        ids = [("motor", m.motor, 0, MOTOR_IDS)]
        if not isinstance(m, (Operation, DeviceId)):
            ids.append(("host", m.host, 0, 256))
        for name, value, low, high in ids:
            if not low <= value < high:
                raise FrameError(f"the id of the {name} is {value}; expected from {low} to {high - 1}")
        match m:
            case Operation():
                position = (-self.position_range, self.position_range)
                words = (to_word(m.q, *position), to_word(m.dq, *VELOCITY), to_word(m.kp, *KP), to_word(m.kd, *KD))
                return _frame(Kind.OPERATION, to_word(m.tau, *TORQUE), m.motor, struct.pack(">4H", *words))
            case Feedback():
                position = (-self.position_range, self.position_range)
                words = (to_word(m.q, *position), to_word(m.dq, *VELOCITY), to_word(m.tau, *TORQUE))
                heat = to_word(m.temperature, *TEMPERATURE)
                area = m.mode << 14 | m.faults << 8 | m.motor
                return _frame(Kind.FEEDBACK, area, m.host, struct.pack(">4H", *words, heat))
            case GetDeviceId():
                return _frame(Kind.DEVICE_ID, m.host, m.motor, bytes(8))
            case DeviceId():
                return _frame(Kind.DEVICE_ID, m.motor, BROADCAST, m.uid.to_bytes(8, "little"))
            case Enable():
                return _frame(Kind.ENABLE, m.host, m.motor, bytes(8))
            case Stop():
                return _frame(Kind.STOP, m.host, m.motor, bytes([m.clear_faults]) + bytes(7))
            case SetZero():
                return _frame(Kind.SET_ZERO, m.host, m.motor, b"\x01" + bytes(7))
            case SetId():
                if not 0 <= m.new < MOTOR_IDS:
                    raise FrameError(f"the new id is {m.new}; expected from 0 to {MOTOR_IDS - 1}")
                return _frame(Kind.SET_ID, m.new << 8 | m.host, m.motor, b"\x01" + bytes(7))
            case ReadParameter():
                parameter(m.index)
                return _frame(Kind.READ, m.host, m.motor, struct.pack("<H6x", m.index))
            case ParameterValue():
                return _frame(Kind.READ, m.motor, m.host, _parameter_bytes(m.index, m.value))
            case WriteParameter():
                return _frame(Kind.WRITE, m.host, m.motor, _parameter_bytes(m.index, m.value))
            case FaultReport():
                data = int(m.faults).to_bytes(4, self.fault_order) + m.warnings.to_bytes(4, self.fault_order)
                return _frame(Kind.FAULT, m.motor, m.host, data)
            case SetBaudRate():
                codes = {rate: code for code, rate in BAUD_RATES.items()}
                if m.rate not in codes:
                    raise FrameError(f"the bit rate is {m.rate}; a motor knows {', '.join(map(str, codes))}")
                return _frame(Kind.BAUD_RATE, m.host, m.motor, bytes([codes[m.rate]]) + bytes(7))

    def decode(self, frame: CanFrame) -> Message | OtherParameter:
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
        number, area, destination, data = frame.id >> 24, frame.id >> 8 & 0xFFFF, frame.id & 0xFF, frame.data
        try:
            kind = Kind(number)
        except ValueError:
            raise UnknownFrame(f"{frame} has the communication type {number}, which is not public") from None
        if kind is Kind.FAULT and (area == self.host or (destination < MOTOR_IDS <= area <= 0xFF)):
            # The manual has the host in bits 15 to 8 and the motor in 7 to 0; libraries have it the other way.
            return self._from_motor(frame, kind, destination, area, data)
        if kind in (Kind.FEEDBACK, Kind.FAULT) or destination >= MOTOR_IDS or destination == self.host:
            return self._from_motor(frame, kind, area, destination, data)
        return self._from_host(frame, kind, area, destination, data)

    def _from_motor(
        self, frame: CanFrame, kind: Kind, area: int, host: int, data: bytes
    ) -> MotorMessage | OtherParameter:
        motor = area & 0xFF
        if motor >= MOTOR_IDS:
            raise UnknownFrame(f"{frame} comes from the id {motor}; motors have ids below {MOTOR_IDS}")
        if kind is Kind.FEEDBACK:
            q, dq, tau, heat = struct.unpack(">4H", data)
            mode = area >> 14
            if mode == 3:
                raise FrameError(f"{frame} has mode 3; a motor has modes 0 to 2")
            return Feedback(
                motor=motor,
                host=host,
                q=from_word(q, -self.position_range, self.position_range),
                dq=from_word(dq, *VELOCITY),
                tau=from_word(tau, *TORQUE),
                temperature=from_word(heat, *TEMPERATURE),
                mode=Mode(mode),
                faults=Fault(area >> 8 & 0x3F),
            )
        if kind is Kind.READ and (area >> 8 or _index_of(frame) not in PARAMETERS):
            return OtherParameter(motor=motor, host=host, index=_index_of(frame))
        if area >> 8:
            raise UnknownFrame(f"{frame} has bits set where a motor leaves zeros")
        if kind is Kind.DEVICE_ID and host == BROADCAST:
            return DeviceId(motor=motor, uid=int.from_bytes(data, "little"))
        if kind is Kind.READ:
            index, value = _parameter_of(frame)
            return ParameterValue(motor=motor, host=host, index=index, value=value)
        if kind is Kind.FAULT:
            faults, warnings = (int.from_bytes(part, self.fault_order) for part in (data[:4], data[4:]))
            return FaultReport(motor=motor, host=host, faults=DetailedFault(faults), warnings=warnings)
        raise UnknownFrame(
            f"{frame} has the communication type {kind.value} ({kind.name}), which no motor sends to a host"
        )

    def _from_host(
        self, frame: CanFrame, kind: Kind, area: int, motor: int, data: bytes
    ) -> HostMessage | OtherParameter:
        if kind is Kind.OPERATION:
            q, dq, kp, kd = struct.unpack(">4H", data)
            return Operation(
                motor=motor,
                q=from_word(q, -self.position_range, self.position_range),
                dq=from_word(dq, *VELOCITY),
                kp=from_word(kp, *KP),
                kd=from_word(kd, *KD),
                tau=from_word(area, *TORQUE),
            )
        host = area & 0xFF
        if kind is Kind.SET_ID:
            if area >> 8 >= MOTOR_IDS:
                raise UnknownFrame(f"{frame} sets the id {area >> 8}; motors have ids below {MOTOR_IDS}")
            return SetId(motor=motor, host=host, new=area >> 8)
        if kind in (Kind.READ, Kind.WRITE) and _index_of(frame) not in PARAMETERS:
            return OtherParameter(motor=motor, host=host, index=_index_of(frame), write=kind is Kind.WRITE)
        if area >> 8:
            raise UnknownFrame(f"{frame} has bits set where a host leaves zeros")
        match kind:
            case Kind.DEVICE_ID:
                return GetDeviceId(motor=motor, host=host)
            case Kind.ENABLE:
                return Enable(motor=motor, host=host)
            case Kind.STOP:
                return Stop(motor=motor, host=host, clear_faults=data[0] == 1)
            case Kind.SET_ZERO:
                return SetZero(motor=motor, host=host)
            case Kind.READ:
                return ReadParameter(motor=motor, host=host, index=_index_of(frame))
            case Kind.WRITE:
                index, value = _parameter_of(frame)
                return WriteParameter(motor=motor, host=host, index=index, value=value)
            case Kind.BAUD_RATE:
                if data[0] not in BAUD_RATES:
                    raise FrameError(
                        f"{frame} has the bit-rate code {data[0]}; expected {', '.join(map(str, BAUD_RATES))}"
                    )
                return SetBaudRate(motor=motor, host=host, rate=BAUD_RATES[data[0]])
            case _:
                raise UnknownFrame(
                    f"{frame} has the communication type {kind.value} ({kind.name}), which no host sends"
                )

    def check_range(self, q: float, mech_pos: float) -> float | None:
        """Return the end of the position range that a motor uses [rad], or None if two readings cannot decide it.

        Args:
            q: Position of a feedback as this codec decoded it [rad].
            mech_pos: Parameter MECH_POS read at the same place, a float in radians whatever the range [rad].

        Raises:
            FrameError: If neither range explains both readings.
        """
        share = q / self.position_range
        wrong = {end: abs(share * end - mech_pos) for end in POSITION_RANGES}
        tolerance = 0.02  # [rad] two words and what a held joint moves between the two readings
        best, other = sorted(POSITION_RANGES, key=wrong.__getitem__)
        if wrong[best] > tolerance:
            raise FrameError(
                f"the position is {q:.3f} rad in the feedback and {mech_pos:.3f} rad in parameter 0x7019; no known "
                "position range explains that. Was the joint moving, or the position beyond the range?"
            )
        return best if wrong[other] > 2 * tolerance else None


def _frame(kind: Kind, area: int, destination: int, data: bytes) -> CanFrame:
    return CanFrame(kind << 24 | area << 8 | destination, data)


def _parameter_bytes(index: int, value: float) -> bytes:
    p = parameter(index)
    if not math.isfinite(value):
        raise FrameError(f"parameter {p.name} cannot be {value}; expected a finite number")
    number: Any = min(max(value, p.low), p.high)
    if p.kind != "f32":
        low, high = {"u8": (0, 0xFF), "i16": (-0x8000, 0x7FFF), "u32": (0, 0xFFFFFFFF)}[p.kind]
        number = min(max(int(number), low), high)
    try:
        return struct.pack("<H2x", index) + struct.pack(_PACK[p.kind], number)
    except OverflowError:
        raise FrameError(f"parameter {p.name} cannot be {value:g}; expected a number of single precision") from None


def _index_of(frame: CanFrame) -> int:
    index, zero = struct.unpack("<HH", frame.data[:4])
    if zero:
        raise UnknownFrame(f"{frame} has bits set beside the parameter's index")
    return index


def _parameter_of(frame: CanFrame) -> tuple[int, float]:
    index = _index_of(frame)
    value = struct.unpack(_PACK[parameter(index).kind], frame.data[4:])[0]
    if not math.isfinite(value):
        raise FrameError(f"{frame} gives parameter {parameter(index).name} a value that is not finite")
    return index, value

"""Messages of a Go2's low-level interface and of its services: bytes to fields and back, pure.

Two layouts carry the same fields. On the wire each number is aligned to its size (CDR, after four bytes that say so);
in the robot's own memory so is each struct, and the checksum is taken over that one. They differ in the first bytes
only, up to the first motor.

Source: unitreerobotics/unitree_sdk2_python (BSD-3): idl/unitree_go and unitree_api, utils/crc.py, rpc/client_base.py,
go2/sport/sport_api.py and comm/motion_switcher; OMG, Common Data Representation. Not confirmed on a robot.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mimic.config.text_file import from_json
from mimic.errors import FrameError
from mimic.frozen import frozen

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""Begin of a message in CDR."""

_TYPES = {"uint8": "u1", "int8": "i1", "uint16": "<u2", "int16": "<i2", "uint32": "<u4", "int32": "<i4"}
_TYPES |= {"float32": "<f4", "int64": "<i8", "bool": "?", "string": "<u8"}
_SEQUENCE = np.dtype([("most", "<u4"), ("length", "<u4"), ("bytes", "<u8"), ("owned", "?")], align=True)

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


@dataclass(frozen=True, eq=False)
class Struct:
    """One type of message, or a part of one."""

    name: str
    """As its maker's IDL has it, modules included."""
    fields: Sequence[tuple[str, Struct | str, int]]
    """Name, type and length of each; length 0 is a single one."""

    @property
    def layout(self) -> np.dtype[Any]:
        """Of the memory, as C has it: strings and sequences are pointers there."""
        kinds: list[Any] = []
        for name, kind, size in self.fields:
            one = kind.layout if isinstance(kind, Struct) else _SEQUENCE if kind == "octets" else _TYPES[kind]
            kinds.append((name, one, (size,)) if size else (name, one))
        return np.dtype(kinds, align=True)


def define(name: str, text: str, *parts: Struct) -> Struct:
    """Return a type from its fields as an .idl file writes them; `parts` are structs that it holds."""
    known = {part.name.rpartition(".")[2]: part for part in parts}
    fields = []
    for line in text.split(";"):
        kind, field = line.split()
        field, _, length = field.removesuffix("]").partition("[")
        fields.append((field, known.get(kind, kind), int(length or 0)))
    return Struct(name, fields)


_GO = "unitree_go.msg.dds_."
_API = "unitree_api.msg.dds_."
_HEAD = (
    "uint8 head[2]; uint8 level_flag; uint8 frame_reserve; uint32 sn[2]; uint32 version[2]; uint16 bandwidth; "
    # the same in both messages
)

LOW_CMD = define(
    f"{_GO}LowCmd_",
    f"{_HEAD}MotorCmd_ motor_cmd[20]; BmsCmd_ bms_cmd; uint8 wireless_remote[40]; uint8 led[12]; uint8 fan[2]; "
    "uint8 gpio; uint32 reserve; uint32 crc",
    define(
        f"{_GO}MotorCmd_",
        "uint8 mode; float32 q; float32 dq; float32 tau; float32 kp; float32 kd; uint32 reserve[3]",
    ),
    define(f"{_GO}BmsCmd_", "uint8 off; uint8 reserve[3]"),
)
"""Command of all motors: torque = tau + kp (q - its angle) + kd (dq - its velocity)."""

LOW_STATE = define(
    f"{_GO}LowState_",
    f"{_HEAD}IMUState_ imu_state; MotorState_ motor_state[20]; BmsState_ bms_state; int16 foot_force[4]; "
    "int16 foot_force_est[4]; uint32 tick; uint8 wireless_remote[40]; uint8 bit_flag; float32 adc_reel; "
    "uint8 temperature_ntc1; uint8 temperature_ntc2; float32 power_v; float32 power_a; uint16 fan_frequency[4]; "
    "uint32 reserve; uint32 crc",
    define(
        f"{_GO}IMUState_",
        "float32 quaternion[4]; float32 gyroscope[3]; float32 accelerometer[3]; float32 rpy[3]; uint8 temperature",
    ),
    define(
        f"{_GO}MotorState_",
        "uint8 mode; float32 q; float32 dq; float32 ddq; float32 tau_est; float32 q_raw; float32 dq_raw; "
        "float32 ddq_raw; uint8 temperature; uint32 lost; uint32 reserve[2]",
    ),
    define(
        f"{_GO}BmsState_",
        "uint8 version_high; uint8 version_low; uint8 status; uint8 soc; int32 current; uint16 cycle; "
        "uint8 bq_ntc[2]; uint8 mcu_ntc[2]; uint16 cell_vol[15]",
    ),
)
"""What motors, IMU and battery say."""

_IDENTITY = define(f"{_API}RequestIdentity_", "int64 id; int64 api_id")

REQUEST = define(
    f"{_API}Request_",
    "RequestHeader_ header; string parameter; octets binary",
    define(
        f"{_API}RequestHeader_",
        "RequestIdentity_ identity; RequestLease_ lease; RequestPolicy_ policy",
        _IDENTITY,
        define(f"{_API}RequestLease_", "int64 id"),
        define(f"{_API}RequestPolicy_", "int32 priority; bool noreply"),
    ),
)
"""A question to a service."""

RESPONSE = define(
    f"{_API}Response_",
    "ResponseHeader_ header; string data; octets binary",
    define(
        f"{_API}ResponseHeader_",
        "RequestIdentity_ identity; ResponseStatus_ status",
        _IDENTITY,
        define(f"{_API}ResponseStatus_", "int32 code"),
    ),
)
"""Its answer."""

LOWCMD = "rt/lowcmd"
LOWSTATE = "rt/lowstate"
SWITCHER = "rt/api/motion_switcher/"
SPORT = "rt/api/sport/"
TOPICS: Mapping[str, Struct] = {
    LOWCMD: LOW_CMD,
    LOWSTATE: LOW_STATE,
    **{f"{service}request": REQUEST for service in (SWITCHER, SPORT)},
    **{f"{service}response": RESPONSE for service in (SWITCHER, SPORT)},
}
"""Topic -> type of its messages."""

CHECK_MODE = 1001
"""Question to the motion switcher: which service controls the robot."""
RELEASE_MODE = 1003
"""Order to the motion switcher: release it."""
STAND_DOWN = 1005
"""Order to the sport service: lie down."""

_LAYOUTS = {LOWCMD: LOW_CMD.layout, LOWSTATE: LOW_STATE.layout}
_SPANS = {
    LOWCMD: ((0, 22, 4), (24, 25, 26), (28, 812, 28)),
    LOWSTATE: ((0, 22, 4), (24, 77, 28), (80, 81, 81), (84, 1180, 84)),
}
"""Begin and end in memory, and begin on the wire, of the bytes between gaps."""


def crc32(memory: bytes) -> int:
    """Return the checksum of a message in memory, whose last word is the place of the checksum.

    CRC-32 with the polynomial 0x04C11DB7 over 32-bit words, the most significant bit first, without a final inversion:
    zlib's with the bits of each byte and of the result reversed.
    """
    words = np.frombuffer(memory, "<u4", len(memory) // 4 - 1).byteswap().tobytes()
    value = zlib.crc32(words.translate(_REVERSED)) ^ 0xFFFFFFFF
    return int.from_bytes(value.to_bytes(4, "little").translate(_REVERSED), "big")


def blank(topic: str) -> Any:
    """Return a message of rt/lowcmd or rt/lowstate with its header and else zeros, to be filled in."""
    message: Any = np.zeros((), _LAYOUTS[topic])
    message["head"] = (0xFE, 0xEF)
    message["level_flag"] = 0xFF
    return message


def encode(topic: str, message: Any) -> bytes:
    """Return a message of rt/lowcmd or rt/lowstate as it goes over the wire; sets its checksum."""
    message["crc"] = crc32(message.tobytes())
    memory = message.tobytes()
    wire = bytearray(message.nbytes)
    wire[:4] = LITTLE_ENDIAN
    for begin, end, place in _SPANS[topic]:
        wire[place : place + end - begin] = memory[begin:end]
    return bytes(wire)


def decode(topic: str, wire: bytes) -> Any:
    """Return a message of rt/lowcmd or rt/lowstate.

    Raises:
        FrameError: If it has another size or a wrong checksum; a checksum of 0 is one that was not set.
    """
    layout = _LAYOUTS[topic]
    if len(wire) != layout.itemsize or wire[:2] not in (b"\x00\x01", b"\x00\x07"):
        raise FrameError(f"{topic} has {len(wire)} bytes that begin {wire[:2].hex()}; expected {layout.itemsize}, 0001")
    places = bytearray(layout.itemsize)
    for begin, end, place in _SPANS[topic]:
        places[begin:end] = wire[place : place + end - begin]
    memory = bytes(places)
    message = np.frombuffer(memory, layout)[0]
    if int(message["crc"]) not in (0, crc32(memory)):
        raise FrameError(f"{topic} has a wrong checksum")
    return message


@frozen
class Call:
    """A question to a service, or its answer."""

    id: int
    """Chosen by who asks; the answer has the same."""
    api: int
    """What is asked."""
    text: str = "{}"
    """Parameters or result, as JSON."""
    code: int | None = None
    """0 for a good answer; None for a question."""

    def to_bytes(self) -> bytes:
        """Return it as it goes over the wire."""
        more = struct.pack("<qi?3x", 0, 0, False) if self.code is None else struct.pack("<i", self.code)
        text = self.text.encode() + b"\0"
        body = struct.pack("<qq", self.id, self.api) + more + struct.pack("<I", len(text)) + text
        return LITTLE_ENDIAN + body + bytes(-len(body) % 4) + bytes(4)

    @staticmethod
    def from_bytes(wire: bytes, *, answer: bool) -> Call:
        """Return the question or answer in some bytes.

        Raises:
            FrameError: If they hold none.
        """
        begin = 24 if answer else 36
        try:
            number, api = struct.unpack_from("<qq", wire, 4)
            code = struct.unpack_from("<i", wire, 20)[0] if answer else None
            (length,) = struct.unpack_from("<I", wire, begin)
            text = wire[begin + 4 : begin + 4 + length].rstrip(b"\0").decode()
        except (struct.error, UnicodeDecodeError):
            raise FrameError(f"an answer of a service with {len(wire)} bytes makes no sense") from None
        return Call(id=number, api=api, text=text, code=code)

    def name(self) -> str | None:
        """Return the name of the active mode in an answer to CHECK_MODE, empty for none; None if it has no name."""
        try:
            name = from_json(self.text)["name"]
        except (ValueError, KeyError, TypeError):
            return None
        return name if isinstance(name, str) else None

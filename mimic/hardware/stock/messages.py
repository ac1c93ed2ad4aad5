"""LCM messages of the CyberDog 2's motor interface: bytes to fields and back, pure.

An LCM message is a fingerprint of its type and then its fields, everything big-endian.

Source: MiRoboticsLab/cyberdog_locomotion, commit ad79bfd, common/lcm_type/lcm; LCM's documentation of its type system
(`Type hashes <https://lcm-proj.github.io/lcm/content/lcm-type-ref.html>`_).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mimic.errors import FrameError

_WIRE = {"float": ">f4", "double": ">f8", "int8_t": ">i1", "int16_t": ">i2", "int32_t": ">i4", "int64_t": ">i8"}

_MASK = (1 << 64) - 1


def fingerprint(fields: Sequence[tuple[str, str, int]]) -> int:
    """Return the fingerprint of a type without nested types, from (type, name, length) of each field; length 0: scalar.

    Source: LCM, lcmgen.c, ``lcm_struct_hash``; the last rotation is that of the encoders.
    """
    value = 0x12345678
    for kind, name, length in fields:
        dimensions = [(0, str(length))] if length else []
        parts: list[int] = [*_text(name), *_text(kind), len(dimensions)]
        for mode, size in dimensions:
            parts += [mode, *_text(size)]
        for part in parts:
            signed = value - (1 << 64) if value >> 63 else value
            value = (((value << 8) & _MASK) ^ ((signed >> 55) & _MASK)) + part & _MASK
    return ((value << 1) + (value >> 63)) & _MASK


def _text(text: str) -> list[int]:
    return [len(text), *text.encode("ascii")]


@dataclass(frozen=True, eq=False)
class MessageType:
    """One type of message: its channel, and its layout on the wire."""

    channel: str
    layout: np.dtype[Any]
    """Of the whole message, the fingerprint first."""
    fingerprint: int

    def encode(self, **values: Any) -> bytes:
        """Return the bytes of a message; fields that are not given are zero."""
        message = np.zeros((), self.layout)
        message["fingerprint"] = self.fingerprint
        for name, value in values.items():
            message[name] = value
        return message.tobytes()

    def decode(self, data: bytes) -> Any:
        """Return the fields of a message, by name, as NumPy scalars and arrays.

        Raises:
            FrameError: If the bytes are not of this type.
        """
        if len(data) != self.layout.itemsize:
            raise FrameError(f"{self.channel} has {len(data)} bytes; expected {self.layout.itemsize}")
        message = np.frombuffer(data, self.layout)[0]
        if int(message["fingerprint"]) != self.fingerprint:
            raise FrameError(
                f"{self.channel} has the fingerprint {int(message['fingerprint']):#018x}; "
                f"expected {self.fingerprint:#018x}: the robot's firmware defines this message differently"
            )
        return message


def define(channel: str, text: str) -> MessageType:
    """Return a type from its fields as an .lcm file writes them."""
    fields: list[tuple[str, str, int]] = []
    for line in text.split(";"):
        if not line.strip():
            continue
        kind, name = line.split()
        name, _, length = name.removesuffix("]").partition("[")
        fields.append((kind, name, int(length or 0)))
    layout = [("fingerprint", ">u8")] + [(n, _WIRE[k], (size,)) if size else (n, _WIRE[k]) for k, n, size in fields]
    return MessageType(channel, np.dtype(layout), fingerprint(fields))  # type: ignore[arg-type]


MOTOR_CTRL = define(
    "motor_ctrl", "float q_des[12]; float qd_des[12]; float kp_des[12]; float kd_des[12]; float tau_des[12]"
)
"""Command of all motors: torque = tau_des + kp_des (q_des - q) + kd_des (qd_des - qd)."""

MOTOR_CTRL_STATE = define("motor_ctrl_state", "int16_t err_flag; float ctrl_topic_interval")
"""What the firmware thinks of the commands; ctrl_topic_interval in ms."""

SPI_DATA = define(
    "spi_data",
    "float q_abad[4]; float q_hip[4]; float q_knee[4]; float qd_abad[4]; float qd_hip[4]; float qd_knee[4];"
    "int32_t flags[12]; int32_t spi_driver_status; float tau_abad[4]; float tau_hip[4]; float tau_knee[4];"
    "int16_t tmp_abad[4]; int16_t tmp_hip[4]; int16_t tmp_knee[4]; int8_t reserve[40]",
)
"""Readings of the motors; temperatures in 0.1 degC."""

LEG_CONTROL_DATA = define(
    "leg_control_data",
    "float q[12]; float qd[12]; float p[12]; float v[12]; float tau_est[12]; float force_est[12];"
    "float force_desired[12]; int32_t q_abad_limit[4]; int32_t q_hip_limit[4]; int32_t q_knee_limit[4]",
)
"""Joints as the firmware's leg controller has them; sent also before the first command."""

STATE_ESTIMATOR = define(
    "state_estimator",
    "float p[3]; float vWorld[3]; float vBody[3]; float p_abs[3]; float vWorld_abs[3]; float vBody_abs[3];"
    "float vRemoter[3]; float rpy[3]; float omegaBody[3]; float omegaWorld[3]; float quat[4]; float aBody[3];"
    "float aWorld[3]; float contactEstimate[4]; int64_t timestamp",
)
"""Orientation and rates of the base; timestamp in ns of the robot's clock."""

TYPES: Mapping[str, MessageType] = {
    kind.channel: kind for kind in (MOTOR_CTRL, MOTOR_CTRL_STATE, SPI_DATA, LEG_CONTROL_DATA, STATE_ESTIMATOR)
}
"""Channel -> its type."""

LOST = 0x01
"""Bit of err_flag: a command came later than 10 ms."""
TIMED_OUT = 0x02
"""Bit of err_flag: none came for 500 ms, so that commands are ignored until it is cleared."""
CUT = 0x1C
"""Bits of err_flag: desired positions were cut (of the last leg only)."""

MOTOR_ERRORS = 0x3FFFFFFF
"""Bits of a motor's flags that mean an error. Source: MiRoboticsLab/cyberdog_motor_sdk, its own loop."""

MOTOR_RUNNING = 2
"""Bits 31 and 30 of a motor's flags while it follows commands. Source: cyberdog_controller.cpp."""

"""Numbers of a CyberGear motor: kinds of frames, faults, run modes, and its table of parameters.

Source: CyberGear manual, sections 3.3 and 4.1; English translation in belovictor/cybergear-docs, commit 22c05e2.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Literal

from mimic.errors import FrameError


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


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """A number in the motor that is read or written by its index."""

    name: str
    kind: Literal["u8", "i16", "u32", "f32"]
    unit: str = ""
    low: float = float("-inf")
    high: float = float("inf")
    default: float = 0.0
    writable: bool = True


RUN_MODE = 0x7005
LIMIT_TORQUE = 0x700B
LIMIT_SPD = 0x7017
MECH_POS = 0x7019
IQF = 0x701A
VBUS = 0x701C
CAN_TIMEOUT = 0x200C

PARAMETERS: dict[int, Parameter] = {
    RUN_MODE: Parameter(name="run_mode", kind="u8", low=0, high=3),
    0x7006: Parameter(name="iq_ref", kind="f32", unit="A", low=-23, high=23),
    0x700A: Parameter(name="spd_ref", kind="f32", unit="rad/s", low=-30, high=30),
    LIMIT_TORQUE: Parameter(name="limit_torque", kind="f32", unit="N m", low=0, high=12, default=12),
    0x7010: Parameter(name="cur_kp", kind="f32", default=0.125),
    0x7011: Parameter(name="cur_ki", kind="f32", default=0.0158),
    0x7014: Parameter(name="cur_filt_gain", kind="f32", low=0, high=1, default=0.1),
    0x7016: Parameter(name="loc_ref", kind="f32", unit="rad"),
    LIMIT_SPD: Parameter(name="limit_spd", kind="f32", unit="rad/s", low=0, high=30),
    0x7018: Parameter(name="limit_cur", kind="f32", unit="A", low=0, high=23, default=23),
    MECH_POS: Parameter(name="mechPos", kind="f32", unit="rad", writable=False),
    IQF: Parameter(name="iqf", kind="f32", unit="A", writable=False),
    0x701B: Parameter(name="mechVel", kind="f32", unit="rad/s", writable=False),
    VBUS: Parameter(name="VBUS", kind="f32", unit="V", default=24, writable=False),
    0x701D: Parameter(name="rotation", kind="i16"),
    0x701E: Parameter(name="loc_kp", kind="f32", default=30),
    0x701F: Parameter(name="spd_kp", kind="f32", default=1),
    0x7020: Parameter(name="spd_ki", kind="f32", default=0.002),
    CAN_TIMEOUT: Parameter(name="CAN_TIMEOUT", kind="u32", low=0, high=100000),
}
"""Runtime table, manual 4.1.12, and CAN_TIMEOUT of the stored one, manual 3.3.3. The default 0 of
limit_spd, at which the position mode does not move, is what grrodre/cybergear found. It is not proven that public
firmware supports CAN_TIMEOUT."""


def parameter(index: int) -> Parameter:
    """Return the parameter of an index.

    Raises:
        FrameError: If the table has none.
    """
    if index not in PARAMETERS:
        known = ", ".join(f"0x{i:04X}" for i in PARAMETERS)
        raise FrameError(f"there is no parameter 0x{index:04X}; known are {known}")
    return PARAMETERS[index]

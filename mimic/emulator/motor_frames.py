"""What a CyberGear says, as frames: the other direction of `mimic.hardware.motors.cybergear.codec`."""

from __future__ import annotations

import struct

from mimic.hardware.can.frame import CanFrame
from mimic.hardware.motors.cybergear.codec import (
    BROADCAST,
    FAULT_ORDER,
    TEMPERATURE,
    TORQUE,
    VELOCITY,
    Codec,
    Kind,
    MotorMessage,
    ParameterValue,
    check_ids,
    frame_of,
    parameter_bytes,
    to_word,
)
from mimic.hardware.motors.interface import FaultReport, Feedback, Identity


def encode_answer(codec: Codec, message: MotorMessage) -> CanFrame:
    """Return the frame of what a motor says.

    Raises:
        FrameError: If a number is not finite, or an id or index does not exist.
    """
    said = message.said
    host = message.host
    check_ids(said.motor, host)
    match said:
        case Feedback():
            words = (to_word(said.q, *codec.position), to_word(said.dq, *VELOCITY), to_word(said.tau, *TORQUE))
            data = struct.pack(">4H", *words, to_word(said.temperature, *TEMPERATURE))
            return frame_of(Kind.FEEDBACK, said.mode << 14 | said.faults << 8 | said.motor, host, data)
        case Identity():
            return frame_of(Kind.DEVICE_ID, said.motor, BROADCAST, said.uid.to_bytes(8, "little"))
        case ParameterValue():
            assert said.value is not None
            return frame_of(Kind.READ, said.motor, host, parameter_bytes(said.index, said.value))
        case FaultReport():
            words = (said.faults, said.warnings)
            return frame_of(Kind.FAULT, said.motor, host, b"".join(w.to_bytes(4, FAULT_ORDER) for w in words))

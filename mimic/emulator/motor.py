"""An emulated CyberGear motor as seen on the bus: modes, parameters, faults, and a zero that is lost with the power.

It turns commands into a `Drive`; the physics is in `mimic.emulator.body`.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import NamedTuple

from mimic.errors import FrameError
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.motors.cybergear.codec import (
    BROADCAST,
    CAN_TIMEOUT,
    FAULT_ORDER,
    IQF,
    LIMIT_TORQUE,
    MECH_POS,
    OPERATION_MODE,
    PARAMETERS,
    RUN_MODE,
    TEMPERATURE,
    TORQUE,
    VBUS,
    VELOCITY,
    Codec,
    Fault,
    HostMessage,
    Kind,
    MotorMessage,
    ParameterValue,
    check_ids,
    frame_of,
    parameter_bytes,
    to_word,
)
from mimic.hardware.motors.interface import FaultReport, Feedback, Identity, MotorMode

LEAST_TORQUE = 0.1
"""A motor that is told less than this and has no stiffness is not driven [N m]; zero on the wire is not quite zero."""

ROTOR_TURN = 2 * math.pi / 7.75
"""The encoder is on the rotor: at power-up the angle is known only within this [rad]. Gear ratio: manual, 7.75."""

TORQUE_PER_AMPERE = 0.87 / math.sqrt(2)
"""[N m/A], of the amplitude of a phase current. Source: manual, 0.87 N m/Arms; 4 N m then take the rated 6.5 A."""

HOT = 80.0
"""Over-temperature fault [degC]; manual, default."""
WARM = 75.0
"""Over-temperature warning [degC]; manual, default."""

LOW_VOLTAGE = 16.0
"""Least operating voltage [V]; manual."""

TIMEOUT_TICK = 50e-6
"""Unit of CAN_TIMEOUT in firmware that supports it [s]: that of the successor family (20000 = 1 s)."""


DETAIL = {
    Fault.UNDER_VOLTAGE: 1 << 2,
    Fault.OVER_CURRENT: 1 << 16,  # of phase A
    Fault.OVER_TEMPERATURE: 1 << 0,
    Fault.NOT_CALIBRATED: 1 << 7,
}
"""Bits of a fault report; manual 4.1.14. It has none of an encoder, whose faults only the feedback reports."""


class Drive(NamedTuple):
    """What a motor does until the next command, in its own sign and from where its encoder was mounted:
    torque = tau + kp (q - position) + kd (dq - velocity)."""

    kp: float = 0.0
    kd: float = 0.0
    q: float = 0.0
    dq: float = 0.0
    tau: float = 0.0
    limit: float = TORQUE[1]
    """Greatest torque [N m]."""

    @property
    def drives(self) -> bool:
        """Whether it has stiffness or a torque."""
        return self.kp > 0.0 or abs(self.tau) > LEAST_TORQUE


class Measured(NamedTuple):
    """What the sensors of a motor say, in its own sign, counted from where its encoder was mounted."""

    q: float
    dq: float
    tau: float
    temperature: float
    voltage: float


FREE = Drive()
"""A motor that is off turns freely."""


@dataclass
class EmulatedMotor:
    """One motor from power-up on."""

    id: int
    uid: int
    codec: Codec
    encoder: float
    """Angle of the encoder where the motor's own angle is zero; never changes [rad]."""
    timeout_honoured: bool = False
    """Whether this firmware stops the motor after CAN_TIMEOUT; otherwise writing it has no effect."""
    mode: MotorMode = MotorMode.OFF
    drive: Drive = FREE
    faults: Fault = Fault(0)
    zero: float = 0.0
    """Own angle at which it reads zero [rad]."""
    heard_at: float = -math.inf
    """Time of the last frame [s]."""
    host: int = 0xFD
    """Id of the host that gets fault reports."""
    values: dict[int, float] = field(default_factory=dict)
    _reported: tuple[Fault, bool] = (Fault(0), False)

    def power_up(self, q: float) -> MotorMessage:
        """Forget everything but the id, and return the announcement of the id.

        Args:
            q: Own angle [rad].
        """
        self.mode = MotorMode.OFF
        self.drive = FREE
        self.faults = Fault(0)
        self._reported = (Fault(0), False)
        self.values = {index: p.default for index, p in PARAMETERS.items()}
        self.zero = q - ((q + self.encoder + ROTOR_TURN / 2) % ROTOR_TURN - ROTOR_TURN / 2)
        return self._identity()

    # ------------------------------------------------------------------ commands

    def hear(self, frame: CanFrame, t: float, measured: Measured) -> MotorMessage | None:
        """Take a frame from the bus and return the answer; frames for others and malformed ones have none.

        Args:
            frame: From the bus.
            t: When its last bit was [s].
            measured: What the sensors read then.
        """
        if not frame.extended or frame.id & 0xFF != self.id:
            return None
        try:
            message = self.codec.decode(frame)
        except FrameError:
            return None
        if isinstance(message, MotorMessage) or (
            message.kind in (Kind.READ, Kind.WRITE) and message.index not in PARAMETERS
        ):
            return None
        self.heard_at = t
        return self._execute(message, measured)

    def _identity(self) -> MotorMessage:
        return MotorMessage(Identity(motor=self.id, uid=self.uid))

    def _execute(self, message: HostMessage, measured: Measured) -> MotorMessage | None:
        if message.kind is not Kind.OPERATION:
            self.host = message.host
        match message.kind:
            case Kind.OPERATION:
                if self.mode is MotorMode.RUNNING and self.values[RUN_MODE] == OPERATION_MODE:
                    assert message.command is not None
                    q, dq, kp, kd, tau = message.command
                    self.drive = Drive(kp, kd, q + self.zero, dq, tau, self.values[LIMIT_TORQUE])
            case Kind.DEVICE_ID:
                return self._identity()
            case Kind.ENABLE:
                if not self.faults:
                    self.mode = MotorMode.RUNNING
                    self.drive = self._limited()
            case Kind.STOP:
                self.stop()
                if message.value:
                    self.faults = Fault(0)
            case Kind.SET_ZERO:
                self.zero = measured.q
            case Kind.READ:
                value = self._read(message.index, measured)
                return MotorMessage(
                    said=ParameterValue(motor=self.id, index=message.index, value=value), host=self.host
                )
            case Kind.WRITE:
                self._write(message.index, message.value)
            case _:
                return None  # another id, or a bit rate: this emulation keeps those of its bus
        return self.feedback(measured)

    def stop(self) -> None:
        """Switch off."""
        self.mode = MotorMode.OFF
        self.drive = FREE

    def feedback(self, measured: Measured) -> MotorMessage:
        """Return the feedback of these measurements."""
        said = Feedback(
            motor=self.id,
            q=measured.q - self.zero,
            dq=measured.dq,
            tau=measured.tau,
            temperature=measured.temperature,
            mode=self.mode,
            faults=int(self.faults),
        )
        return MotorMessage(said, self.host)

    def _read(self, index: int, measured: Measured) -> float:
        own = {
            MECH_POS: measured.q - self.zero,
            VBUS: measured.voltage,
            IQF: measured.tau / TORQUE_PER_AMPERE,
        }
        return own.get(index, self.values[index])

    def _write(self, index: int, value: float) -> None:
        running = self.mode is MotorMode.RUNNING
        if (index == RUN_MODE and running) or (index == CAN_TIMEOUT and not self.timeout_honoured):
            return
        self.values[index] = value
        if running and index == LIMIT_TORQUE:
            self.drive = self._limited()

    def _limited(self) -> Drive:
        """Return the drive within the limit of torque; in run modes of its own this motor stands idle."""
        return self.drive._replace(limit=self.values[LIMIT_TORQUE])

    # ------------------------------------------------------------------ faults

    def check_faults(self, t: float, temperature: float, voltage: float, more: Fault) -> MotorMessage | None:
        """Check for faults and for a silent host; return the fault report that is due, or None.

        Args:
            t: Now [s].
            temperature: Of the motor [degC].
            voltage: Of the supply [V].
            more: Faults besides those of temperature and voltage.
        """
        if temperature >= HOT:
            more |= Fault.OVER_TEMPERATURE
        if voltage < LOW_VOLTAGE:
            more |= Fault.UNDER_VOLTAGE
        if more:
            self.faults |= more
        if self.faults:
            self.stop()
        silence = self.values[CAN_TIMEOUT] * TIMEOUT_TICK
        if self.mode is MotorMode.RUNNING and 0 < silence < t - self.heard_at:
            self.stop()
        now = (self.faults, temperature >= WARM)
        if now == self._reported:
            return None
        self._reported = now
        detail = sum(bit for fault, bit in DETAIL.items() if fault in self.faults)
        if self.faults and not detail:
            return None
        said = FaultReport(motor=self.id, faults=detail, warnings=int(now[1]))
        return MotorMessage(said, self.host)


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

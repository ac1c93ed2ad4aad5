"""What mimic needs from the motors of one maker: frames out, answers in, and what the motors can do.

A maker is a folder beside this file with a class that satisfies `MotorProtocol`, and a row in
`mimic.hardware.motors.makers`. The motor bus, the plant, pre-flight, scan, zeroing and shutdown know nothing else about
motors.

All quantities are the motor's own: its sign, its zero, SI units. Signs and offsets of the joints are in the wiring.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, StrEnum
from typing import NamedTuple, Protocol

from mimic.frozen import frozen
from mimic.hardware.can.frame import CanFrame


class MotorMode(IntEnum):
    """What a motor is doing."""

    OFF = 0
    """It turns freely."""
    CALIBRATING = 1
    RUNNING = 2
    """It follows commands."""


class Register(StrEnum):
    """Numbers inside a motor that mimic reads or writes, where the motor has them."""

    CONTROL_MODE = "control mode"
    """Selects impedance control; may be refused while the motor runs."""
    TORQUE_LIMIT = "torque limit"
    """Largest torque that the motor gives [N m]."""
    HOST_TIMEOUT = "host timeout"
    """Time without a frame after which the motor switches itself off, in the maker's unit."""
    SUPPLY_VOLTAGE = "supply voltage"
    """[V]"""
    POSITION = "position"
    """The position of the feedback, but as a plain number with the maker's finest resolution [rad]."""
    POWER_UP_MARK = "power-up mark"
    """A number from 1 to 20 that impedance control ignores. What was written must be lost at every power-up, so that
    it shows that the power, and with it the zero, was not lost."""
    CURRENT = "current"
    """Current that makes torque [A]; 0 in a motor that is off."""


class MotorCommand(NamedTuple):
    """Torque = tau + kp (q - position) + kd (dq - velocity), until the next command."""

    q: float
    """[rad]"""
    dq: float
    """[rad/s]"""
    kp: float
    """[N m/rad]"""
    kd: float
    """[N m s/rad]"""
    tau: float
    """[N m]"""


@frozen
class Feedback:
    """What a motor measures."""

    motor: int
    """Id on its bus."""
    q: float
    """[rad]"""
    dq: float
    """[rad/s]"""
    tau: float
    """[N m]"""
    temperature: float
    """[degC]; NaN where the motor does not measure it."""
    mode: MotorMode
    faults: int
    """Fault bits as the maker defines them, below bit 6; 0 without a fault."""


@frozen
class RegisterValue:
    """Answers a question for a register."""

    motor: int
    register: Register
    value: float


@frozen
class Identity:
    """Answers the question who has an id."""

    motor: int
    uid: int
    """Unique number of the motor."""


@frozen
class FaultReport:
    """Sent unasked when faults change."""

    motor: int
    faults: int
    """0 when none is left."""
    warnings: int = 0
    """Warning bits as the maker defines them."""


@frozen
class OtherHost:
    """A frame between a motor and another computer."""

    motor: int
    commands: bool
    """Whether it shows that the other computer drives the motor: a command, or the feedback to one. A question and
    its answer do not."""
    text: str
    """What it is, such as "a stop for motor 3 by host 0xFD"."""
    feedback: Feedback | None = None
    """What the motor measured, where it says that."""


Answer = Feedback | RegisterValue | Identity | FaultReport | OtherHost


@frozen
class MotorFacts:
    """What the motors of one maker can do. Each number needs a source where it is set."""

    name: str
    """Maker and series, for messages."""
    motor_ids: range
    """Ids that a motor may have."""
    host_ids: range
    """Ids that this computer may have."""
    factory_id: int | None
    """Id of a new motor; None if there is no common one."""
    velocity: float
    """Largest velocity of a command and of a feedback [rad/s]."""
    torque: float
    """Largest torque of a command and of a feedback [N m]."""
    kp: float
    """Largest stiffness of a command [N m/rad]."""
    kd: float
    """Largest damping of a command [N m s/rad]."""
    voltage: tuple[float, float]
    """Least and greatest supply that a motor works with [V]."""
    low_voltage: float
    """Supply that pre-flight mentions [V]."""
    position_step: float
    """Resolution of a position in a feedback [rad]."""
    position_bias: float
    """What to add to a position of a feedback to get its mean [rad]: half a step if the motor rounds down, else 0."""
    position_ranges: tuple[float, ...] = ()
    """Ends of the position range that are in circulation [rad], where it is not known which one a motor uses."""
    registers: Mapping[Register, str]
    """Registers that the motor has, with the maker's name of each."""
    impedance_mode: float = 0.0
    """Value of CONTROL_MODE that selects impedance control."""
    host_timeout: float = 0.0
    """Value of HOST_TIMEOUT that mimic writes."""
    voltage_since: str = ""
    """Oldest firmware that reports the supply voltage; empty where all of them do."""
    command_bits: float
    """Mean length of a command on the bus, stuffed bits and the pause after it included [bit]."""
    feedback_bits: float
    """Mean length of a feedback [bit]."""


class MotorProtocol(Protocol):
    """The language of one maker's motors. Pure: no bus, no clock, no state.

    Every frame that a host sends, except to read a register or to ask for an id, is answered by a `Feedback`.
    """

    @property
    def facts(self) -> MotorFacts:
        """What these motors can do."""
        ...

    def command(self, motor: int, command: MotorCommand) -> tuple[CanFrame, MotorCommand]:
        """Return the frame of a command, and the command as the motor reads it: limited to the ranges and rounded.

        Raises:
            FrameError: If a number is not finite, or there is no such id.
        """
        ...

    def enable(self, motor: int) -> CanFrame:
        """Return the frame that switches a motor on."""
        ...

    def stop(self, motor: int) -> CanFrame:
        """Return the frame that switches a motor off."""
        ...

    def ask_identity(self, motor: int) -> CanFrame:
        """Return the frame that asks who has an id; answered by `Identity`."""
        ...

    def set_zero(self, motor: int) -> CanFrame:
        """Return the frame that makes the present position zero."""
        ...

    def read(self, motor: int, register: Register) -> CanFrame:
        """Return the frame that asks for a register; answered by `RegisterValue`.

        Raises:
            FrameError: If these motors do not have it.
        """
        ...

    def write(self, motor: int, register: Register, value: float) -> CanFrame:
        """Return the frame that sets a register until the power goes.

        Raises:
            FrameError: If these motors do not have it, or the value is not finite.
        """
        ...

    def decode(self, frame: CanFrame) -> Answer | None:
        """Return the answer in a frame, or None for an answer that mimic does not use.

        A frame of another computer, or to it, is an `OtherHost`. (Frames that this computer sends do not come back.)

        Raises:
            UnknownFrame: If the frame is not of this protocol.
            FrameError: If it is malformed.
        """
        ...

    def fault_names(self, faults: int) -> str:
        """Return the names of fault bits, for messages."""
        ...

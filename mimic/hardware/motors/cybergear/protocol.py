"""CyberGear motors behind mimic's motor interface, `mimic.hardware.motors.interface.MotorProtocol`."""

from __future__ import annotations

from mimic.hardware.can.frame import CanFrame
from mimic.hardware.motors.cybergear import codec as gear
from mimic.hardware.motors.cybergear.codec import Codec, HostMessage, Kind, ParameterValue
from mimic.hardware.motors.interface import (
    Answer,
    Feedback,
    MotorCommand,
    MotorFacts,
    OtherHost,
    Register,
    RegisterValue,
)

INDICES = {
    Register.CONTROL_MODE: gear.RUN_MODE,
    Register.TORQUE_LIMIT: gear.LIMIT_TORQUE,
    Register.HOST_TIMEOUT: gear.CAN_TIMEOUT,
    Register.SUPPLY_VOLTAGE: gear.VBUS,
    Register.POSITION: gear.MECH_POS,
    Register.POWER_UP_MARK: gear.LIMIT_SPD,
    Register.CURRENT: gear.IQF,
}
"""Parameter of each register. LIMIT_SPD limits the position mode only; at power-up it is 0, or 2 by the manual's
stored table."""

_REGISTERS = {index: register for register, index in INDICES.items()}

NAMES = {register: f"{gear.PARAMETERS[index].name} (0x{index:04X})" for register, index in INDICES.items()}

TIMEOUT = 4000
"""What CAN_TIMEOUT is set to: 0.2 s if it counts 50 us as in the successor's firmware, 4 s if it counts milliseconds.
Nobody has published which, nor that a public frame can set it."""

COMMAND_BITS = 141.9
"""Mean length of a command with its 29-bit identifier and 8 bytes [bit], over 20 000 frames with the payloads of a
moving robot, with exact stuffing and check sums."""
FEEDBACK_BITS = 137.5
"""The same for feedback [bit]."""

VOLTAGE = (16.0, 28.0)
"""Supply that a motor works with [V]; manual."""

LOW_VOLTAGE = 22.0
"""Supply that pre-flight mentions [V]: the manual rates the motor at 24 V."""


class CyberGear:
    """Xiaomi CyberGear. See `mimic.hardware.motors.interface.MotorProtocol`."""

    def __init__(self, *, host: int, position_range: float = gear.POSITION_RANGES[0]) -> None:
        """Take what is set up in the motors.

        Args:
            host: Id of this computer.
            position_range: Positions on the bus reach from minus this to plus this [rad].

        Raises:
            ConfigError: If the position range is none.
        """
        self._codec = Codec(position_range=position_range, host=host)
        self.facts = MotorFacts(
            name="CyberGear",
            motor_ids=range(gear.MOTOR_IDS),
            host_ids=range(0xFE),
            factory_id=127,
            velocity=gear.VELOCITY[1],
            torque=gear.TORQUE[1],
            kp=gear.KP[1],
            kd=gear.KD[1],
            voltage=VOLTAGE,
            low_voltage=LOW_VOLTAGE,
            position_step=2.0 * position_range / gear.WORDS,
            position_bias=position_range / gear.WORDS,
            position_ranges=gear.POSITION_RANGES,
            registers=NAMES,
            impedance_mode=float(gear.OPERATION_MODE),
            host_timeout=float(TIMEOUT),
            voltage_since="1.2.1.5",
            command_bits=COMMAND_BITS,
            feedback_bits=FEEDBACK_BITS,
        )
        """What these motors can do."""

    def command(self, motor: int, command: MotorCommand) -> tuple[CanFrame, MotorCommand]:
        """Return the frame of a command, and the command as the motor reads it."""
        frame = self._say(Kind.OPERATION, motor, command=command)
        sent = self._codec.decode(frame)
        assert isinstance(sent, HostMessage)
        assert sent.command is not None
        return frame, sent.command

    def _say(
        self, kind: Kind, motor: int, *, command: MotorCommand | None = None, index: int = 0, value: float = 0.0
    ) -> CanFrame:
        return self._codec.encode(HostMessage(kind, motor, self._codec.host, command, index, value))

    def enable(self, motor: int) -> CanFrame:
        """Return the frame that switches a motor on."""
        return self._say(Kind.ENABLE, motor)

    def stop(self, motor: int) -> CanFrame:
        """Return the frame that switches a motor off."""
        return self._say(Kind.STOP, motor)

    def ask_identity(self, motor: int) -> CanFrame:
        """Return the frame that asks who has an id."""
        return self._say(Kind.DEVICE_ID, motor)

    def set_zero(self, motor: int) -> CanFrame:
        """Return the frame that makes the present position zero."""
        return self._say(Kind.SET_ZERO, motor)

    def read(self, motor: int, register: Register) -> CanFrame:
        """Return the frame that asks for a register."""
        return self._say(Kind.READ, motor, index=INDICES[register])

    def write(self, motor: int, register: Register, value: float) -> CanFrame:
        """Return the frame that sets a register until the power goes."""
        return self._say(Kind.WRITE, motor, index=INDICES[register], value=value)

    def decode(self, frame: CanFrame) -> Answer | None:
        """Return the answer in a frame, or None for a parameter that mimic does not use."""
        message = self._codec.decode(frame)
        if isinstance(message, HostMessage):
            host = "another computer" if message.kind is Kind.OPERATION else f"host 0x{message.host:02X}"
            text = f"{_WORDS[message.kind]} for motor {message.motor} by {host}"
            commands = message.kind not in (Kind.DEVICE_ID, Kind.READ)
            return OtherHost(motor=message.motor, commands=commands, text=text)
        said = message.said
        ours = message.host == self._codec.host
        if isinstance(said, ParameterValue):
            register = _REGISTERS.get(said.index)
            if said.value is None:
                return None
            if not ours:
                text = f"motor {said.motor} tells host 0x{message.host:02X} a parameter"
                return OtherHost(motor=said.motor, commands=False, text=text)
            return None if register is None else RegisterValue(motor=said.motor, register=register, value=said.value)
        if isinstance(said, Feedback) and not ours:
            text = f"motor {said.motor} answers host 0x{message.host:02X}"
            return OtherHost(motor=said.motor, commands=True, text=text, feedback=said)
        return said

    def fault_names(self, faults: int) -> str:
        """Return the names of fault bits; manual 4.1.3."""
        known = gear.Fault(faults)
        return known.name or str(faults)


_WORDS = {
    Kind.DEVICE_ID: "a question",
    Kind.READ: "a question",
    Kind.OPERATION: "a command",
    Kind.ENABLE: "an order to switch on",
    Kind.STOP: "an order to stop",
    Kind.SET_ZERO: "a new zero",
    Kind.SET_ID: "a new id",
    Kind.WRITE: "a new parameter",
    Kind.BAUD_RATE: "a new bit rate",
}

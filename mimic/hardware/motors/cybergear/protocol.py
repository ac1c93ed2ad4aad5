"""CyberGear motors behind mimic's motor interface, `mimic.hardware.motors.interface.MotorProtocol`."""

from __future__ import annotations

from mimic.hardware.can.frame import CanFrame
from mimic.hardware.motors.cybergear import messages as gear
from mimic.hardware.motors.cybergear.codec import KD, KP, MOTOR_IDS, POSITION_RANGES, TORQUE, VELOCITY, WORDS, Codec
from mimic.hardware.motors.interface import (
    Answer,
    FaultReport,
    Feedback,
    Identity,
    MotorCommand,
    MotorFacts,
    MotorMode,
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

COMMAND_BITS, FEEDBACK_BITS = 141.9, 137.5
"""29-bit identifier, 8 bytes [bit]: means of 20 000 frames of each kind with the payloads of a moving robot, with
exact stuffing and check sums."""

VOLTAGE = (16.0, 28.0)
"""Supply that a motor works with [V]; manual."""

LOW_VOLTAGE = 22.0
"""Supply that pre-flight mentions [V]: the manual rates the motor at 24 V."""


class CyberGear:
    """Xiaomi CyberGear. See `mimic.hardware.motors.interface.MotorProtocol`."""

    def __init__(self, *, host: int, position_range: float = POSITION_RANGES[0]) -> None:
        """Take what is set up in the motors.

        Args:
            host: Id of this computer.
            position_range: Positions on the bus reach from minus this to plus this [rad].

        Raises:
            ConfigError: If the position range is none.
        """
        self._host = host
        self._codec = Codec(position_range=position_range, host=host)
        self._facts = MotorFacts(
            name="CyberGear",
            motor_ids=range(MOTOR_IDS),
            host_ids=range(0xFE),
            factory_id=127,
            velocity=VELOCITY[1],
            torque=TORQUE[1],
            kp=KP[1],
            kd=KD[1],
            voltage=VOLTAGE,
            low_voltage=LOW_VOLTAGE,
            position_step=2.0 * position_range / WORDS,
            position_bias=position_range / WORDS,
            registers=NAMES,
            impedance_mode=float(gear.RunMode.OPERATION),
            host_timeout=float(TIMEOUT),
            voltage_since="1.2.1.5",
            command_bits=COMMAND_BITS,
            feedback_bits=FEEDBACK_BITS,
        )

    @property
    def facts(self) -> MotorFacts:
        """What these motors can do."""
        return self._facts

    def command(self, motor: int, command: MotorCommand) -> tuple[CanFrame, MotorCommand]:
        """Return the frame of a command, and the command as the motor reads it."""
        q, dq, kp, kd, tau = command
        frame = self._codec.encode(gear.Operation(motor=motor, q=q, dq=dq, kp=kp, kd=kd, tau=tau))
        sent = self._codec.decode(frame)
        assert isinstance(sent, gear.Operation)
        return frame, MotorCommand(sent.q, sent.dq, sent.kp, sent.kd, sent.tau)

    def enable(self, motor: int) -> CanFrame:
        """Return the frame that switches a motor on."""
        return self._codec.encode(gear.Enable(motor=motor, host=self._host))

    def stop(self, motor: int) -> CanFrame:
        """Return the frame that switches a motor off."""
        return self._codec.encode(gear.Stop(motor=motor, host=self._host))

    def ask_identity(self, motor: int) -> CanFrame:
        """Return the frame that asks who has an id."""
        return self._codec.encode(gear.GetDeviceId(motor=motor, host=self._host))

    def set_zero(self, motor: int) -> CanFrame:
        """Return the frame that makes the present position zero."""
        return self._codec.encode(gear.SetZero(motor=motor, host=self._host))

    def read(self, motor: int, register: Register) -> CanFrame:
        """Return the frame that asks for a register."""
        return self._codec.encode(gear.ReadParameter(motor=motor, host=self._host, index=INDICES[register]))

    def write(self, motor: int, register: Register, value: float) -> CanFrame:
        """Return the frame that sets a register until the power goes."""
        return self._codec.encode(
            gear.WriteParameter(motor=motor, host=self._host, index=INDICES[register], value=value)
        )

    def decode(self, frame: CanFrame) -> Answer | None:
        """Return the answer in a frame, or None for a parameter that mimic does not use."""
        message = self._codec.decode(frame)
        match message:
            case gear.Feedback():
                feedback = Feedback(
                    motor=message.motor,
                    q=message.q,
                    dq=message.dq,
                    tau=message.tau,
                    temperature=message.temperature,
                    mode=MotorMode(message.mode),
                    faults=int(message.faults),
                )
                if message.host == self._host:
                    return feedback
                text = f"motor {message.motor} answers host 0x{message.host:02X}"
                return OtherHost(motor=message.motor, commands=True, text=text, feedback=feedback)
            case gear.ParameterValue() if message.host != self._host:
                text = f"motor {message.motor} tells host 0x{message.host:02X} a parameter"
                return OtherHost(motor=message.motor, commands=False, text=text)
            case gear.ParameterValue():
                register = _REGISTERS.get(message.index)
                if register is None:
                    return None
                return RegisterValue(motor=message.motor, register=register, value=message.value)
            case gear.DeviceId():
                return Identity(motor=message.motor, uid=message.uid)
            case gear.FaultReport():
                return FaultReport(motor=message.motor, faults=int(message.faults))
            case gear.OtherParameter(write=False):
                return None
            case _:
                return _other(message)

    def check_range(self, q: float, exact: float) -> float | None:
        """Return the end of the position range that a motor uses [rad], or None where two readings cannot show it.

        Raises:
            FrameError: If neither known range explains both readings.
        """
        return self._codec.check_range(q, exact)

    def fault_names(self, faults: int) -> str:
        """Return the names of fault bits; manual 4.1.3."""
        known = gear.Fault(faults)
        return known.name or str(faults)


def _other(message: gear.HostMessage | gear.OtherParameter) -> OtherHost:
    """Return what another computer sent."""
    host = "another computer" if isinstance(message, gear.Operation) else f"host 0x{message.host:02X}"
    text = f"{_WORDS[type(message)]} for motor {message.motor} by {host}"
    commands = not isinstance(message, gear.GetDeviceId | gear.ReadParameter)
    return OtherHost(motor=message.motor, commands=commands, text=text)


_WORDS: dict[type, str] = {
    gear.GetDeviceId: "a question",
    gear.ReadParameter: "a question",
    gear.Operation: "a command",
    gear.Enable: "an order to switch on",
    gear.Stop: "an order to stop",
    gear.SetZero: "a new zero",
    gear.SetId: "a new id",
    gear.WriteParameter: "a new parameter",
    gear.OtherParameter: "a new parameter",
    gear.SetBaudRate: "a new bit rate",
}

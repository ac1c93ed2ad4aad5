"""The pre-flight of motors on CAN: buses, motors, zeros, pose and IMU, before anything moves."""

from __future__ import annotations

import numpy as np

from mimic.errors import FrameError
from mimic.hardware.can.load import MAX_LOAD, expected_load
from mimic.hardware.can.other_programs import holding, others
from mimic.hardware.can.step_budget import SPARE, step_budget
from mimic.hardware.can.switch_on import set_host_timeout
from mimic.hardware.can.zeros import Homing, uneven, zero_problems
from mimic.hardware.motors import registers
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.interface import MotorMode, Register
from mimic.hardware.robot.checks import HOT, LYING_TOLERANCE, Check, imu_checks, pose_check
from mimic.hardware.robot.driver import CheckOptions
from mimic.records import DOUBLED, JOINTS, FloatArray
from mimic.robot.description import RobotDescription

WARM = 45.0
"""Pre-flight mentions a motor this warm [degC]."""

VOLTAGE_SPREAD = 1.5
"""Difference of supply voltage between motors that suggests a bad wire [V]."""

IMU_LISTEN = 0.5
"""How long to listen to the IMU [s]."""

IMU_TRIES = 3
"""How often to listen to it."""

MAX_MOVED = 0.02
"""Largest motion of a joint of a robot at rest, over half a second [rad]."""

IMU_RATE_TOLERANCE = 0.2
"""Share by which an IMU's rate may differ from the wiring's."""


UNKNOWN_SHOWN = 6
"""Identifiers of unknown senders that are named."""


def preflight(
    motor_bus: MotorBus,
    description: RobotDescription,
    options: CheckOptions,
    *,
    homing: Homing | None = None,
    trust_zeros: bool = False,
) -> list[Check]:
    """Check a robot whose motors are off; nothing moves.

    Args:
        motor_bus: Its motors and IMU.
        description: The robot.
        options: Of the run.
        homing: What is known about its zeros.
        trust_zeros: Use the zeros as the wiring has them.
    """
    suspended = options.suspended
    motor_bus.drain()  # what came while a person was asked
    found = [_load(motor_bus, options.rate_hz)]
    if options.inference is not None:
        found.append(_step(motor_bus, description.dt, options.rate_hz, options.inference))
    driven = others(motor_bus) or holding(motor_bus)
    if driven:
        return [*found, Check(name="other programs", verdict="stop", text=driven)]
    silent = registers.stop(motor_bus)
    if silent:
        names = ", ".join(JOINTS[j] for j in silent)
        return [*found, Check(name="motors", verdict="stop", text=f"no answer from {names}; run: mimic robot scan")]
    found += [_motors(motor_bus), _temperature(motor_bus), _voltage(motor_bus), _range(motor_bus)]
    zeros = _zeros(motor_bus, homing, trust_zeros)
    q, _, _ = motor_bus.readings(-np.inf)
    known = zeros.verdict != "stop"
    if not known:
        q = np.full_like(q, np.nan)
    differences = uneven(q) if known else []
    pose = pose_check(
        q,
        description,
        LYING_TOLERANCE,
        suspended=suspended,
        advice="lay it on its folded legs",
        note="" if suspended or not differences else differences[0],
    )
    found += [zeros, pose]
    found += _imu(motor_bus, q, description, suspended or not known)
    return [*found, _timeout(motor_bus), _others(motor_bus)]


def _load(motor_bus: MotorBus, rate_hz: float) -> Check:
    load = expected_load(motor_bus.wiring, rate_hz)
    shares = ", ".join(f"{share:.0%}" for share in load)
    if load.max() > MAX_LOAD:
        text = (
            f"{rate_hz:g} Hz would take {shares} of the bus; at most {MAX_LOAD:.0%} fit. Use more buses or a lower rate"
        )
        return Check(name="bus load", verdict="stop", text=text)
    return Check(name="bus load", verdict="ok", text=f"{shares} at {rate_hz:g} Hz (estimated)")


def _step(motor_bus: MotorBus, dt: float, rate_hz: float, inference: float) -> Check:
    budget = step_budget(motor_bus.wiring, dt, round(rate_hz * dt), inference)
    if budget.fits:
        return Check(name="control step", verdict="ok", text=str(budget))
    text = f"{budget}, at least {1e3 * SPARE:g} ms are needed. Use more buses or a faster computer"
    return Check(name="control step", verdict="stop", text=text)


def _others(motor_bus: MotorBus) -> Check:
    """Return what was heard of others during all checks."""
    name = "other programs"
    if motor_bus.foreign:
        text = f"another program commands the motors (the last frame was {motor_bus.foreign_text}); end it first"
        return Check(name=name, verdict="stop", text=text)
    if motor_bus.echoes:
        text = f"the adapter echoes what this computer sends ({motor_bus.echoes} frames so far); they are left out"
        return Check(name=name, verdict="note", text=text)
    if motor_bus.unknown:
        most = [
            f"{key[1]} on {motor_bus.link.names[key[0]]}" for key, _ in motor_bus.unknown.most_common(UNKNOWN_SHOWN)
        ]
        more = len(motor_bus.unknown) - len(most)
        text = f"{motor_bus.unknown.total()} frames of unknown senders: {', '.join(most)}"
        return Check(name=name, verdict="note", text=f"{text} and {more} more identifiers" if more else text)
    return Check(name=name, verdict="ok", text="nobody else speaks on the buses")


def _motors(motor_bus: MotorBus) -> Check:
    names = motor_bus.motors.fault_names
    faults = [f"{JOINTS[j]}: {names(f.faults)}" for j, f in enumerate(motor_bus.feedback) if f is not None and f.faults]
    faults += [
        f"{JOINTS[j]}: {'two motors have its id' if motor_bus.faults[j] & DOUBLED else 'fault report'}"
        for j in np.flatnonzero(motor_bus.faults)
    ]
    if faults:
        text = f"faults: {', '.join(faults)}; fix the cause, then switch the power off and on"
        return Check(name="motors", verdict="stop", text=text)
    on = [JOINTS[j] for j, f in enumerate(motor_bus.feedback) if f is not None and f.mode != MotorMode.OFF]
    if on:
        return Check(name="motors", verdict="stop", text=f"{', '.join(on)} did not switch off")
    return Check(name="motors", verdict="ok", text="all twelve answer, are off and have no fault")


def _temperature(motor_bus: MotorBus) -> Check:
    temperature = motor_bus.temperature()
    if np.isnan(temperature).all():
        return Check(name="temperature", verdict="note", text="these motors do not report it")
    hottest = int(np.nanargmax(temperature))
    text = f"{np.nanmin(temperature):.0f} to {temperature[hottest]:.0f} degC, {JOINTS[hottest]} the warmest"
    if temperature[hottest] >= HOT:
        return Check(name="temperature", verdict="stop", text=f"{text}; let it cool below {HOT:g} degC")
    return Check(name="temperature", verdict="note" if temperature[hottest] >= WARM else "ok", text=text)


def _voltage(motor_bus: MotorBus) -> Check:
    facts = motor_bus.motors.facts
    volts = registers.read(motor_bus, Register.SUPPLY_VOLTAGE)
    if np.isnan(volts).any():
        names = ", ".join(JOINTS[j] for j in np.flatnonzero(np.isnan(volts)))
        since = f"; their firmware is older than {facts.voltage_since}" if facts.voltage_since else ""
        return Check(name="voltage", verdict="note", text=f"{names} do not report it{since}")
    low = float(volts.min())
    high = float(volts.max())
    text = f"{low:.1f} to {high:.1f} V"
    if facts.voltage_since:
        text += f"; the firmware is {facts.voltage_since} or newer, as it reports this"
    least, most = facts.voltage
    if low < least or high > most:
        return Check(name="voltage", verdict="stop", text=f"{text}; motors need {least:g} to {most:g} V")
    if low < facts.low_voltage or high - low > VOLTAGE_SPREAD:
        return Check(name="voltage", verdict="note", text=f"{text}; charge the battery, or check the wires")
    return Check(name="voltage", verdict="ok", text=text)


def _range(motor_bus: MotorBus) -> Check:
    name = "position range"
    motors = motor_bus.motors
    used = motor_bus.wiring.position_range
    exact = registers.read(motor_bus, Register.POSITION)
    register = motors.facts.registers.get(Register.POSITION, "no register")
    confirmed = 0
    wrong = []
    for joint, feedback in enumerate(motor_bus.feedback):
        if feedback is None or np.isnan(exact[joint]):
            continue
        try:
            end = motors.check_range(feedback.q, float(exact[joint]))
        except FrameError as reason:
            return Check(name=name, verdict="stop", text=f"{JOINTS[joint]}: {reason}")
        confirmed += end is not None
        if end is not None and abs(end - used) > 1e-3:
            wrong.append(f"{JOINTS[joint]} {end:.3f}")
    if wrong:
        text = f"the wiring says {used:.3f} rad, but {register} says {', '.join(wrong)}; correct position_range there"
        return Check(name=name, verdict="stop", text=text)
    if confirmed:
        return Check(name=name, verdict="ok", text=f"{used:.3f} rad, confirmed by {register} of {confirmed} motors")
    text = f"{used:.3f} rad as the wiring says; so close to zero the motors' two readings cannot confirm it"
    return Check(name=name, verdict="note", text=text)


def _zeros(motor_bus: MotorBus, homing: Homing | None, trust: bool) -> Check:
    if trust:
        return Check(name="zeros", verdict="note", text="used as the wiring has them (--zeroed)")
    problems = zero_problems(motor_bus, homing)
    if problems:
        more = f" and {len(problems) - 2} more" if len(problems) > 2 else ""
        text = f"{'; '.join(problems[:2])}{more}. Lay it down and run: mimic robot zero"
        return Check(name="zeros", verdict="stop", text=text)
    return Check(name="zeros", verdict="ok", text="set since the power was switched on; the same motors")


def _imu(motor_bus: MotorBus, q: FloatArray, description: RobotDescription, suspended: bool) -> list[Check]:
    imu = motor_bus.imu
    link = motor_bus.link
    rate = 0.0
    reading = imu.reading(link.now())
    wanted = motor_bus.wiring.imu.rate["quaternion"]
    for _ in range(IMU_TRIES):  # a busy computer may itself lose messages
        begin = reading.count
        motor_bus.listen(link.now() + IMU_LISTEN)
        reading = imu.reading(link.now())
        rate = (reading.count - begin) / IMU_LISTEN
        if reading.problem is None and abs(rate - wanted) <= IMU_RATE_TOLERANCE * wanted:
            break
    if reading.problem is not None:
        return [Check(name="IMU", verdict="stop", text=reading.problem)]
    text = f"{rate:.0f} orientations a second"
    if abs(rate - wanted) > IMU_RATE_TOLERANCE * wanted:
        text += f", where the wiring says {wanted:g}"
        return [Check(name="IMU", verdict="stop", text=f"{text}; set the IMU or the wiring")]
    text += ", valid" if reading.valid else "; it sends no status word"
    return imu_checks(reading.quat_WB, reading.omega_B, q, description, suspended=suspended, text=text)


def _timeout(motor_bus: MotorBus) -> Check:
    register = motor_bus.motors.facts.registers.get(Register.HOST_TIMEOUT, "a host timeout")
    if set_host_timeout(motor_bus):
        text = f"the motors accepted {register}: they stop by themselves if both processes of mimic end"
        return Check(name="own timeout", verdict="ok", text=text)
    text = f"the motors do not accept {register}: if both processes of mimic end, they continue with their last command"
    return Check(name="own timeout", verdict="note", text=text)


def at_rest(motor_bus: MotorBus, description: RobotDescription) -> list[Check]:
    """Check that a robot whose zeros are to be set rests and is level.

    Its motors are switched off by that, as every frame that asks for a position does something.
    """
    silent = registers.stop(motor_bus)
    if silent:
        names = ", ".join(JOINTS[j] for j in silent)
        return [Check(name="motors", verdict="stop", text=f"no answer from {names}; run: mimic robot scan")]
    q, _, _ = motor_bus.readings(-np.inf)
    found = _imu(motor_bus, np.full(len(JOINTS), np.nan), description, False)
    registers.stop(motor_bus)
    moved = np.abs(motor_bus.readings(-np.inf)[0] - q)
    worst = int(np.argmax(moved))
    if not moved[worst] <= MAX_MOVED:
        text = f"{JOINTS[worst]} moved by {np.rad2deg(moved[worst]):.1f} deg meanwhile; keep the robot still"
        found.append(Check(name="rest", verdict="stop", text=text))
    return found

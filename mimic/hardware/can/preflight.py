"""The pre-flight of motors on CAN: buses, motors, zeros, pose and IMU, before anything moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from mimic.errors import FrameError, PlantError
from mimic.hardware.can.load import MAX_LOAD, expected_load
from mimic.hardware.can.other_programs import holding, others
from mimic.hardware.can.step_budget import SPARE, step_budget
from mimic.hardware.can.zeros import Homing, uneven, zero_problems
from mimic.hardware.motors import registers
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.interface import MotorFacts, MotorMode, Register
from mimic.hardware.robot.checks import HOT, LYING_TOLERANCE, Check, CheckOptions, Verdict, imu_checks, pose_check
from mimic.records import DOUBLED, JOINTS, FloatArray, joint_names
from mimic.robot.description import RobotDescription

RANGE_TOLERANCE = 0.02
"""Two words of a position, and what a held joint moves between two readings [rad]."""

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

Found = tuple[Verdict, str]
"""What a look finds: its verdict and its text."""


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
    found = [Check("bus load", *_load(motor_bus, options.rate_hz))]
    if options.inference is not None:
        found.append(Check("control step", *_step(motor_bus, description.dt, options.rate_hz, options.inference)))
    driven = others(motor_bus) or holding(motor_bus)
    if driven:
        return [*found, Check("other programs", "stop", driven)]
    try:
        registers.need_all_off(motor_bus)
    except PlantError as silent:
        return [*found, Check("motors", "stop", str(silent))]
    found += [Check(name, *look(motor_bus)) for name, look in LOOKS.items()]
    zeros = Check("zeros", *_zeros(motor_bus, homing, trust_zeros))
    q, _, _ = motor_bus.readings(-np.inf)
    known = zeros.verdict != "stop"
    if not known:
        q = np.full_like(q, np.nan)
    differences = uneven(q) if known and not suspended else []
    pose = pose_check(
        q,
        description,
        LYING_TOLERANCE,
        suspended=suspended,
        advice="lay it on its folded legs",
        note="".join(differences[:1]),
    )
    found += [zeros, pose, *_imu(motor_bus, q, description, suspended or not known)]
    return [*found, Check("own timeout", *_timeout(motor_bus)), Check("other programs", *_others(motor_bus))]


def _load(motor_bus: MotorBus, rate_hz: float) -> Found:
    load = expected_load(motor_bus.wiring, rate_hz)
    shares = ", ".join(f"{share:.0%}" for share in load)
    if load.max() > MAX_LOAD:
        text = f"{rate_hz:g} Hz would take {shares} of the bus; at most {MAX_LOAD:.0%} fit"
        return "stop", f"{text}. Use more buses or a lower rate"
    return "ok", f"{shares} at {rate_hz:g} Hz (estimated)"


def _step(motor_bus: MotorBus, dt: float, rate_hz: float, inference: float) -> Found:
    budget = step_budget(motor_bus.wiring, dt, round(rate_hz * dt), inference)
    if budget.fits:
        return "ok", str(budget)
    return "stop", f"{budget}, at least {1e3 * SPARE:g} ms are needed. Use more buses or a faster computer"


def _others(motor_bus: MotorBus) -> Found:
    """Return what was heard of others during all checks."""
    if motor_bus.foreign:
        return (
            "stop",
            f"another program commands the motors (the last frame was {motor_bus.foreign_text}); end it first",
        )
    if motor_bus.echoes:
        text = f"the adapter echoes what this computer sends ({motor_bus.echoes} frames so far); they are left out"
        return "note", text
    if not motor_bus.unknown:
        return "ok", "nobody else speaks on the buses"
    most = [f"{name} on {motor_bus.link.names[bus]}" for (bus, name), _ in motor_bus.unknown.most_common(UNKNOWN_SHOWN)]
    more = len(motor_bus.unknown) - len(most)
    text = f"{motor_bus.unknown.total()} frames of unknown senders: {', '.join(most)}"
    return "note", f"{text} and {more} more identifiers" if more else text


def _motors(motor_bus: MotorBus) -> Found:
    names = motor_bus.motors.fault_names
    faults = [f"{JOINTS[j]}: {names(f.faults)}" for j, f in enumerate(motor_bus.feedback) if f is not None and f.faults]
    faults += [
        f"{JOINTS[j]}: {'two motors have its id' if motor_bus.faults[j] & DOUBLED else 'fault report'}"
        for j in np.flatnonzero(motor_bus.faults)
    ]
    if faults:
        return "stop", f"faults: {', '.join(faults)}; fix the cause, then switch the power off and on"
    on = motor_bus.in_other_mode(MotorMode.OFF)
    return ("stop", f"{on} did not switch off") if on else ("ok", "all twelve answer, are off and have no fault")


def _temperature(motor_bus: MotorBus) -> Found:
    temperature = motor_bus.temperature()
    if np.isnan(temperature).all():
        return "note", "these motors do not report it"
    hottest = int(np.nanargmax(temperature))
    text = f"{np.nanmin(temperature):.0f} to {temperature[hottest]:.0f} degC, {JOINTS[hottest]} the warmest"
    if temperature[hottest] >= HOT:
        return "stop", f"{text}; let it cool below {HOT:g} degC"
    return ("note" if temperature[hottest] >= WARM else "ok"), text


def _voltage(motor_bus: MotorBus) -> Found:
    facts = motor_bus.motors.facts
    volts = registers.read(motor_bus, Register.SUPPLY_VOLTAGE)
    if np.isnan(volts).any():
        since = f"; their firmware is older than {facts.voltage_since}" if facts.voltage_since else ""
        return "note", f"{joint_names(np.flatnonzero(np.isnan(volts)))} do not report it{since}"
    low = float(volts.min())
    high = float(volts.max())
    text = f"{low:.1f} to {high:.1f} V"
    if facts.voltage_since:
        text += f"; the firmware is {facts.voltage_since} or newer, as it reports this"
    least, most = facts.voltage
    if low < least or high > most:
        return "stop", f"{text}; motors need {least:g} to {most:g} V"
    if low < facts.low_voltage or high - low > VOLTAGE_SPREAD:
        return "note", f"{text}; charge the battery, or check the wires"
    return "ok", text


def position_range(facts: MotorFacts, used: float, q: float, exact: float) -> float | None:
    """Return the end of the position range that a motor uses [rad], or None where two readings cannot show it.

    Args:
        facts: Of the motor.
        used: End of the range with which q was decoded [rad].
        q: Position of a feedback [rad].
        exact: Register POSITION, read at the same place [rad].

    Raises:
        FrameError: If no known range explains both readings.
    """
    wrong = {end: abs(q / used * end - exact) for end in facts.position_ranges}
    if not wrong:
        return None
    best, *others = sorted(wrong, key=wrong.__getitem__)
    if wrong[best] > RANGE_TOLERANCE:
        register = facts.registers[Register.POSITION]
        raise FrameError(
            f"the position is {q:.3f} rad in the feedback and {exact:.3f} rad in {register}; no known "
            "position range explains that. Was the joint moving, or the position beyond the range?"
        )
    return best if all(wrong[other] > 2 * RANGE_TOLERANCE for other in others) else None


def _range(motor_bus: MotorBus) -> Found:
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
            end = position_range(motors.facts, used, feedback.q, float(exact[joint]))
        except FrameError as reason:
            return "stop", f"{JOINTS[joint]}: {reason}"
        confirmed += end is not None
        if end is not None and abs(end - used) > 1e-3:
            wrong.append(f"{JOINTS[joint]} {end:.3f}")
    if wrong:
        text = f"the wiring says {used:.3f} rad, but {register} says {', '.join(wrong)}; correct position_range there"
        return "stop", text
    if confirmed:
        return "ok", f"{used:.3f} rad, confirmed by {register} of {confirmed} motors"
    return "note", f"{used:.3f} rad as the wiring says; so close to zero the motors' two readings cannot confirm it"


LOOKS: Mapping[str, Callable[[MotorBus], Found]] = {
    "motors": _motors,
    "temperature": _temperature,
    "voltage": _voltage,
    "position range": _range,
}
"""What is looked at of motors that answer, in this order."""


def _zeros(motor_bus: MotorBus, homing: Homing | None, trust: bool) -> Found:
    if trust:
        return "note", "used as the wiring has them (--zeroed)"
    problems = zero_problems(motor_bus, homing)
    if not problems:
        return "ok", "set since the power was switched on; the same motors"
    more = f" and {len(problems) - 2} more" if len(problems) > 2 else ""
    return "stop", f"{'; '.join(problems[:2])}{more}. Lay it down and run: mimic robot zero"


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
    text = f"{rate:.0f} orientations a second"
    if reading.problem is None and abs(rate - wanted) <= IMU_RATE_TOLERANCE * wanted:
        text += ", valid" if reading.valid else "; it sends no status word"
        return imu_checks(reading.quat_WB, reading.omega_B, q, description, suspended=suspended, text=text)
    wrong = f"{text}, where the wiring says {wanted:g}; set the IMU or the wiring"
    return [Check("IMU", "stop", reading.problem or wrong)]


def _timeout(motor_bus: MotorBus) -> Found:
    register = motor_bus.motors.facts.registers.get(Register.HOST_TIMEOUT, "a host timeout")
    if registers.set_host_timeout(motor_bus):
        return "ok", f"the motors accepted {register}: they stop by themselves if both processes of mimic end"
    text = f"the motors do not accept {register}: if both processes of mimic end, they continue with their last command"
    return "note", text


def at_rest(motor_bus: MotorBus, description: RobotDescription) -> list[Check]:
    """Check that a robot whose zeros are to be set rests and is level.

    Its motors are switched off by that, as every frame that asks for a position does something.
    """
    try:
        registers.need_all_off(motor_bus)
    except PlantError as silent:
        return [Check("motors", "stop", str(silent))]
    q, _, _ = motor_bus.readings(-np.inf)
    found = _imu(motor_bus, np.full(len(JOINTS), np.nan), description, False)
    registers.stop(motor_bus)
    moved = np.abs(motor_bus.readings(-np.inf)[0] - q)
    worst = int(np.argmax(moved))
    if not moved[worst] <= MAX_MOVED:
        text = f"{JOINTS[worst]} moved by {np.rad2deg(moved[worst]):.1f} deg meanwhile; keep the robot still"
        found.append(Check("rest", "stop", text))
    return found

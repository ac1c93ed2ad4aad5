"""What is looked at before anything moves: buses, motors, zeros, pose, IMU, and who damps the robot if all else fails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mimic.errors import FrameError
from mimic.frames import rotation_from_quat
from mimic.robot.description import RobotDescription
from mimic.robot.leg import all_toes
from mimic.run.bus_load import MOST, expected_load
from mimic.run.can_robot import set_timeout
from mimic.run.exchange import Exchange
from mimic.run.homing import NEAR, Homing, beyond_limits, homed, uneven
from mimic.run.motor_messages import MECH_POS, VBUS, Mode, Stop
from mimic.types import JOINTS, FloatArray

WARM, HOT = 45.0, 60.0
"""A motor this warm is mentioned; this warm it does not start: it sits down at 72 [degC]."""

LOW, LEAST, MOST_VOLTS, SPREAD = 22.0, 16.0, 28.0, 1.5
"""Supply that is mentioned; that motors work from and up to; difference between motors that a bad wire makes [V]. Manual."""

LISTEN = 0.5
"""How long the IMU is listened to [s]."""

IMU_TRIES = 3
"""How often."""

LEVEL = 0.26
"""Tilt of a lying robot, at most [rad]: 15 deg."""

LEGS_TILT = 0.2
"""Angle between up by the IMU and by the four feet, at most [rad]; a joint that is 0.1 rad off tilts the feet by 0.06."""

RESTS = 0.1
"""Rate of turn of a robot that nobody moves, at most [rad/s]."""

RATE_OFF = 0.2
"""Share by which an IMU's rate may differ from the wiring's."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that was looked at."""

    name: str
    verdict: Literal["ok", "note", "stop"]
    text: str


def preflight(
    exchange: Exchange,
    description: RobotDescription,
    *,
    rate_hz: float | FloatArray,
    homing: Homing | None,
    trust_zeros: bool,
    hung: bool = False,
) -> list[Finding]:
    """Look at a robot whose motors are off, and return what was found; nothing moves.

    Args:
        exchange: With its motors and IMU.
        description: The robot.
        rate_hz: Commands a second to each motor, or to these motors in each part of a motion (parts, 12).
        homing: What is known of its zeros.
        trust_zeros: Take the zeros as they are.
        hung: It hangs instead of lying.
    """
    found = [_load(exchange, rate_hz)]
    host = exchange.wiring.host
    silent = exchange.ask_feedback(lambda motor: Stop(motor=motor, host=host))
    if silent:
        names = ", ".join(JOINTS[j] for j in silent)
        return [*found, Finding(name="motors", verdict="stop", text=f"no answer from {names}; see: mimic robot scan")]
    found += [_motors(exchange), _temperature(exchange), _voltage(exchange), _range(exchange)]
    zeros = _zeros(exchange, homing, trust_zeros)
    q, _, _ = exchange.readings(-np.inf)
    known = zeros.verdict != "stop"
    if not known:
        q = np.full_like(q, np.nan)
    found += [zeros, _limits(q, description) if hung or not known else _pose(q, description)]
    found += _imu(exchange, q, description, hung or not known)
    return [*found, _timeout(exchange)]


def _load(exchange: Exchange, rate_hz: float | FloatArray) -> Finding:
    parts = np.atleast_2d(np.broadcast_to(rate_hz, (*np.shape(rate_hz)[:-1], len(JOINTS))))
    load = np.max([expected_load(exchange.wiring, rates) for rates in parts], axis=0)
    told = ", ".join(f"{share:.0%}" for share in load)
    rates = f"{parts.max():g} Hz"
    if parts.min() < parts.max():
        rates = f"{rates} for legs that move and {parts.min():.3g} Hz for the others"
    if load.max() > MOST:
        text = f"{rates} would take {told} of the bus; at most {MOST:.0%} fit. Use more buses or a lower rate"
        return Finding(name="bus load", verdict="stop", text=text)
    return Finding(name="bus load", verdict="ok", text=f"{told} at {rates}, by the arithmetic")


def _motors(exchange: Exchange) -> Finding:
    faults = [
        f"{JOINTS[j]}: {f.faults.name or f.faults}"
        for j, f in enumerate(exchange.feedback)
        if f is not None and f.faults
    ]
    faults += [f"{JOINTS[j]}: fault report" for j in np.flatnonzero(exchange.faults)]
    if faults:
        return Finding(
            name="motors", verdict="stop", text=f"faults: {', '.join(faults)}; mend the cause, then power off"
        )
    on = [JOINTS[j] for j, f in enumerate(exchange.feedback) if f is not None and f.mode != Mode.RESET]
    if on:
        return Finding(name="motors", verdict="stop", text=f"{', '.join(on)} would not switch off")
    return Finding(name="motors", verdict="ok", text="all twelve answer, off, without faults")


def _temperature(exchange: Exchange) -> Finding:
    temperature = exchange.temperature()
    hottest = int(np.argmax(temperature))
    text = f"{temperature.min():.0f} to {temperature[hottest]:.0f} degC, {JOINTS[hottest]} the warmest"
    if temperature[hottest] >= HOT:
        return Finding(name="temperature", verdict="stop", text=f"{text}; let it cool below {HOT:g} degC")
    return Finding(name="temperature", verdict="note" if temperature[hottest] >= WARM else "ok", text=text)


def _voltage(exchange: Exchange) -> Finding:
    volts = exchange.read(VBUS)
    if np.isnan(volts).any():
        names = ", ".join(JOINTS[j] for j in np.flatnonzero(np.isnan(volts)))
        text = f"{names} do not tell it; their firmware is older than 1.2.1.5"
        return Finding(name="voltage", verdict="note", text=text)
    low, high = float(volts.min()), float(volts.max())
    text = f"{low:.1f} to {high:.1f} V; firmware is 1.2.1.5 or newer, as it tells this"
    if low < LEAST or high > MOST_VOLTS:
        return Finding(name="voltage", verdict="stop", text=f"{text}; motors need {LEAST:g} to {MOST_VOLTS:g} V")
    if low < LOW or high - low > SPREAD:
        return Finding(name="voltage", verdict="note", text=f"{text}; charge the battery, or look at the wires")
    return Finding(name="voltage", verdict="ok", text=text)


def _range(exchange: Exchange) -> Finding:
    name, mech = "position range", exchange.read(MECH_POS)
    used = exchange.codec.position_range
    told, wrong = 0, []
    for joint, feedback in enumerate(exchange.feedback):
        if feedback is None or np.isnan(mech[joint]):
            continue
        try:
            end = exchange.codec.check_range(feedback.q, float(mech[joint]))
        except FrameError as reason:
            return Finding(name=name, verdict="stop", text=f"{JOINTS[joint]}: {reason}")
        told += end is not None
        if end is not None and abs(end - used) > 1e-3:
            wrong.append(f"{JOINTS[joint]} {end:.3f}")
    if wrong:
        text = f"the wiring says {used:.3f} rad, but parameter 0x7019 says {', '.join(wrong)}; set position_range there"
        return Finding(name=name, verdict="stop", text=text)
    if told:
        return Finding(name=name, verdict="ok", text=f"{used:.3f} rad, by parameter 0x7019 of {told} motors")
    text = (
        f"{used:.3f} rad as the wiring says; so near to zero the motors' two readings cannot tell it from the other one"
    )
    return Finding(name=name, verdict="note", text=text)


def _zeros(exchange: Exchange, homing: Homing | None, trust: bool) -> Finding:
    if trust:
        return Finding(name="zeros", verdict="note", text="taken as the wiring has them, as asked for")
    problems = homed(exchange, homing)
    if problems:
        more = f" and {len(problems) - 2} more" if len(problems) > 2 else ""
        text = f"{'; '.join(problems[:2])}{more}. Lay it on its folded legs and run: mimic robot zero"
        return Finding(name="zeros", verdict="stop", text=text)
    return Finding(name="zeros", verdict="ok", text="set since the power came, the same motors")


def _limits(q: FloatArray, description: RobotDescription) -> Finding:
    if np.isnan(q).all():
        return Finding(name="pose", verdict="note", text="cannot be known without the zeros")
    beyond = beyond_limits(q, description)
    if len(beyond):
        told = ", ".join(f"{JOINTS[j]} at {q[j]:.2f} rad" for j in beyond)
        return Finding(name="pose", verdict="stop", text=f"beyond the joint limits: {told}")
    return Finding(name="pose", verdict="ok", text="all joints inside their limits")


def _pose(q: FloatArray, description: RobotDescription) -> Finding:
    inside = _limits(q, description)
    if inside.verdict == "stop":
        return inside
    off = q - description.poses["lie"]
    worst = int(np.argmax(np.abs(off)))
    text = f"{JOINTS[worst]} is {np.rad2deg(off[worst]):+.0f} deg from the lying pose, the others less"
    if abs(off[worst]) > NEAR:
        return Finding(name="pose", verdict="stop", text=f"{text}; lay it on its folded legs")
    odd = uneven(q)
    if odd:
        return Finding(name="pose", verdict="note", text=f"{text}; {odd[0]}")
    return Finding(name="pose", verdict="ok", text=text)


def _imu(exchange: Exchange, q: FloatArray, description: RobotDescription, hung: bool) -> list[Finding]:
    imu, link = exchange.imu, exchange.link
    rate, reading, wanted = 0.0, imu.reading(link.now()), exchange.wiring.imu.rate["quaternion"]
    for _ in range(IMU_TRIES):  # a busy computer may be late itself
        begin = reading.count
        exchange.listen(link.now() + LISTEN)
        reading = imu.reading(link.now())
        rate = (reading.count - begin) / LISTEN
        if reading.problem is None and abs(rate - wanted) <= RATE_OFF * wanted:
            break
    if reading.problem is not None:
        return [Finding(name="IMU", verdict="stop", text=reading.problem)]
    text = f"{rate:.0f} orientations a second"
    if abs(rate - wanted) > RATE_OFF * wanted:
        text += f", where the wiring says {wanted:g}"
        return [Finding(name="IMU", verdict="stop", text=f"{text}; set the IMU or the wiring")]
    turning = float(np.linalg.norm(reading.omega_B))
    if turning > RESTS and not hung:
        return [Finding(name="IMU", verdict="stop", text=f"{text}; it turns with {turning:.2f} rad/s; hold still")]
    found = [Finding(name="IMU", verdict="ok", text=f"{text}, valid" if reading.valid else f"{text}; no status word")]
    if hung:
        return found
    up = rotation_from_quat(reading.quat_WB)[2]
    tilt = float(np.arccos(np.clip(up[2], -1.0, 1.0)))
    if tilt > LEVEL:
        text = f"tilted by {np.rad2deg(tilt):.0f} deg; a lying robot is level within {np.rad2deg(LEVEL):.0f} deg"
        return [*found, Finding(name="IMU and legs", verdict="stop", text=text)]
    apart = float(np.arccos(np.clip(up @ feet_normal(q, description), -1.0, 1.0)))
    text = f"up by IMU and by the four feet differ by {np.rad2deg(apart):.0f} deg"
    verdict = "stop" if apart > LEGS_TILT else "ok"
    more = "; is the IMU mounted as the wiring says, and does every foot touch the ground?" if verdict == "stop" else ""
    return [*found, Finding(name="IMU and legs", verdict=verdict, text=text + more)]


def feet_normal(q: FloatArray, description: RobotDescription) -> FloatArray:
    """Return the unit vector that the four feet stand perpendicular to, upward in base axes (3,)."""
    toes = all_toes(q, description)
    _, _, axes = np.linalg.svd(toes - toes.mean(axis=0))
    normal = axes[-1]
    return normal if normal[2] > 0 else -normal


def _timeout(exchange: Exchange) -> Finding:
    if set_timeout(exchange):
        return Finding(name="own timeout", verdict="ok", text="the motors took CAN_TIMEOUT and stop by themselves")
    text = "the motors do not take CAN_TIMEOUT: without a host they go on with their last command"
    return Finding(name="own timeout", verdict="note", text=text)

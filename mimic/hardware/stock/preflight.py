"""Pre-flight of a stock robot: everything that can be checked by listening. Nothing is sent."""

from __future__ import annotations

from typing import Any

import numpy as np

from mimic.geometry import rotation_from_quat
from mimic.hardware.homing import beyond_limits
from mimic.hardware.preflight import MAX_LEGS_TILT, MAX_TILT, MAX_TURN_RATE, Check, feet_normal
from mimic.hardware.stock.messages import TIMED_OUT
from mimic.hardware.stock.plant import LYING_TOLERANCE, BoardLink
from mimic.hardware.stock.readings import NEVER, NO_ERR_FLAG
from mimic.hardware.stock.sender import Order, State
from mimic.records import JOINTS, FloatArray
from mimic.robot.description import RobotDescription

LISTEN = 1.5
"""How long to listen [s]: three times as long as the firmware waits for another command."""

LOWEST_RATE = 30.0
"""Orientations a second that a robot sends at least [Hz]: 50 before the first command, 500 afterwards."""


def board_preflight(
    link: BoardLink, description: RobotDescription, network: str, *, suspended: bool = False
) -> list[Check]:
    """Check a stock robot by listening to it.

    Args:
        link: Process at the board.
        description: The robot.
        network: How messages leave this computer, in words.
        suspended: The robot hangs in the air instead of lying on the floor.
    """
    link.order(Order(state=State.LISTEN))
    link.wait(link.now() + 0.02)
    begin = link.now()
    reports = link.wait(begin + LISTEN)
    found = [Check(name="network", verdict="ok", text=network)]
    if not reports or reports[-1]["heard"] < begin:
        text = (
            "no message came from the robot; is it switched on and awake, the cable in, this computer at the wiring's "
            "address, and developer access granted?"
        )
        return [*found, Check(name="messages", verdict="stop", text=text)]
    first, last = reports[0], reports[-1]
    seconds = max(float(last["t"] - first["t"]), 1e-3)
    found += [_messages(first, last, seconds), _commands(last)]
    joints = last["joints_came"] >= begin
    q = np.array(last["q"]) if joints else np.full(len(JOINTS), np.nan)
    found.append(_pose(q, description, suspended))
    found += _imu(last, q, description, suspended)
    text = "motor temperatures and errors are known once the first command was sent, and checked then"
    found.append(Check(name="motors", verdict="note", text=text))
    text = (
        "a second process sends, and damps the robot if this one ends; without both the firmware damps it after 0.5 s"
    )
    return [*found, Check(name="watchdog", verdict="ok", text=text)]


def _messages(first: Any, last: Any, seconds: float) -> Check:
    rates = {
        "leg_control_data": float(last["joints_count"] - first["joints_count"]) / seconds,
        "state_estimator": float(last["imu_count"] - first["imu_count"]) / seconds,
    }
    text = ", ".join(f"{name} {rate:.0f} Hz" for name, rate in rates.items())
    if last["malformed"]:
        text += f"; {int(last['malformed'])} could not be read: the firmware may define its messages differently"
        return Check(name="messages", verdict="stop", text=text)
    if min(rates.values()) < LOWEST_RATE:
        return Check(name="messages", verdict="stop", text=f"{text}; expected at least {LOWEST_RATE:g} Hz of each")
    return Check(name="messages", verdict="ok", text=text)


def _commands(last: Any) -> Check:
    if last["foreign"]:
        text = f"another program commands this robot ({int(last['foreign'])} messages in {LISTEN:g} s); end it first"
        return Check(name="other programs", verdict="stop", text=text)
    if last["err_flag"] == NO_ERR_FLAG:
        text = "none commands this robot; its firmware is not in motor mode yet"
        return Check(name="other programs", verdict="ok", text=text)
    if not int(last["err_flag"]) & TIMED_OUT:
        text = "a program commanded this robot within the last half second; wait, and try again"
        return Check(name="other programs", verdict="stop", text=text)
    return Check(name="other programs", verdict="ok", text="none commands this robot; it is in motor mode from before")


def _pose(q: FloatArray, description: RobotDescription, suspended: bool) -> Check:
    if np.isnan(q).any():
        return Check(name="pose", verdict="stop", text="the robot sends no joint angles")
    outside = beyond_limits(q, description)
    if len(outside):
        angles = ", ".join(f"{JOINTS[j]} at {q[j]:.2f} rad" for j in outside)
        return Check(name="pose", verdict="stop", text=f"beyond the joint limits: {angles}")
    if suspended:
        return Check(name="pose", verdict="ok", text="all joints inside their limits")
    away = q - description.poses["lie"]
    worst = int(np.argmax(np.abs(away)))
    text = f"{JOINTS[worst]} is {np.rad2deg(away[worst]):+.0f} deg from the lying pose, the others less"
    if abs(away[worst]) > LYING_TOLERANCE:
        text += (
            "; if the robot stands by its own order, let it lie down, switch it off, and start it again lying: motor "
            "mode is entered from there only"
        )
        return Check(name="pose", verdict="stop", text=text)
    return Check(name="pose", verdict="ok", text=text)


def _imu(last: Any, q: FloatArray, description: RobotDescription, suspended: bool) -> list[Check]:
    if last["imu_came"] == NEVER:
        return [Check(name="IMU", verdict="stop", text="the robot sends no orientation")]
    turning = float(np.linalg.norm(last["omega_B"]))
    if turning > MAX_TURN_RATE and not suspended:
        return [Check(name="IMU", verdict="stop", text=f"it turns at {turning:.2f} rad/s; keep the robot still")]
    found = [Check(name="IMU", verdict="ok", text=f"turns at {turning:.3f} rad/s")]
    if suspended or np.isnan(q).any():
        return found
    up = rotation_from_quat(np.array(last["quat_WB"]))[2]
    tilt = float(np.arccos(np.clip(up[2], -1.0, 1.0)))
    if tilt > MAX_TILT:
        text = f"tilted by {np.rad2deg(tilt):.0f} deg; a lying robot is level within {np.rad2deg(MAX_TILT):.0f} deg"
        return [*found, Check(name="IMU and legs", verdict="stop", text=text)]
    apart = float(np.arccos(np.clip(up @ feet_normal(q, description), -1.0, 1.0)))
    text = f"up by IMU and by the four feet differ by {np.rad2deg(apart):.0f} deg"
    if apart > MAX_LEGS_TILT:
        return [*found, Check(name="IMU and legs", verdict="stop", text=f"{text}; does every foot touch the ground?")]
    return [*found, Check(name="IMU and legs", verdict="ok", text=text)]

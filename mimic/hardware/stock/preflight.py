"""Pre-flight of a stock robot: everything that can be checked by listening. Nothing is sent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mimic.hardware.robot.checks import Check, imu_checks, pose_check
from mimic.hardware.robot.driver import NEVER
from mimic.hardware.stock.messages import TIMED_OUT
from mimic.hardware.stock.readings import NO_ERR_FLAG
from mimic.robot.description import RobotDescription

if TYPE_CHECKING:
    from mimic.hardware.stock.driver import StockDriver

LYING_TOLERANCE = 0.6
"""Largest distance of a joint from the lying pose at the start [rad].

A limp robot rests on its trunk, its legs splayed: 0.37 rad from the lying pose, in the maker's firmware on the bench as
in the emulation. One that stands is 1.1 rad from it.
"""

LISTEN = 1.5
"""How long to listen [s]: three times as long as the firmware waits for another command."""

LOWEST_RATE = 30.0
"""Orientations a second that a robot sends at least [Hz]: 50 before the first command, 500 afterwards."""


def board_preflight(
    driver: StockDriver, description: RobotDescription, network: str, *, suspended: bool = False
) -> list[Check]:
    """Check a stock robot by listening to it.

    Args:
        driver: Of the board.
        description: The robot.
        network: How messages leave this computer, in words.
        suspended: The robot hangs in the air instead of lying on the floor.
    """
    driver.listen(driver.now() + 0.02)
    begin, joints, imu = driver.now(), driver.readings.joints, int(driver.report["imu_count"])
    driver.listen(begin + LISTEN)
    last, seconds = driver.report, driver.now() - begin
    found = [Check(name="network", verdict="ok", text=network)]
    if last["heard"] < begin:
        text = (
            "no message came from the robot; is it switched on and awake, the cable in, this computer at the wiring's "
            "address, and developer access granted?"
        )
        return [*found, Check(name="messages", verdict="stop", text=text)]
    rates = {
        "leg_control_data": (driver.readings.joints - joints) / seconds,
        "state_estimator": (int(last["imu_count"]) - imu) / seconds,
    }
    found += [_messages(rates, int(last["errors"])), _commands(last)]
    q = np.array(last["q"])
    if np.isnan(q).any():
        return [*found, Check(name="pose", verdict="stop", text="the robot sends no joint angles")]
    advice = (
        "if the robot stands by its own order, let it lie down, switch it off, and start it again lying: motor mode is "
        "entered from there only"
    )
    found.append(pose_check(q, description, LYING_TOLERANCE, suspended=suspended, advice=advice))
    if last["imu_came"] == NEVER:
        found.append(Check(name="IMU", verdict="stop", text="the robot sends no orientation"))
    else:
        quat, omega = np.array(last["quat_WB"]), np.array(last["omega_B"])
        text = f"turns at {np.linalg.norm(omega):.3f} rad/s"
        found += imu_checks(quat, omega, q, description, suspended=suspended, text=text)
    text = "motor temperatures and errors are known once the first command was sent, and checked then"
    found.append(Check(name="motors", verdict="note", text=text))
    text = "its firmware damps it by itself 0.5 s after the last message"
    return [*found, Check(name="own timeout", verdict="ok", text=text)]


def _messages(rates: dict[str, float], errors: int) -> Check:
    text = ", ".join(f"{name} {rate:.0f} Hz" for name, rate in rates.items())
    if errors:
        text += f"; {errors} could not be read: the firmware may define its messages differently"
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

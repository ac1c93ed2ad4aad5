"""The emulated board's motor mode against the maker's firmware, cycle by cycle, on the same commands and readings.

The firmware runs on the bench. What it reads (spi_data), the age of its command (motor_ctrl_state), and what it then
tells the motors (leg_control_command) are recorded, and the emulated rules get the same. So neither physics nor
of the computer is in the comparison. Cycles next to a change of the command are left out: which of the two the firmware
had cannot be told. At a soft joint limit the torque is compared with that of the bench's next reading.
"""

from __future__ import annotations

import bisect
import time
from pathlib import Path
from typing import Any

import numpy as np

from lab.stock_firmware.firmware import Bench
from mimic.emulator.motor_mode import MotorModeRules
from mimic.hardware.stock.messages import MOTOR_CTRL, MOTOR_CTRL_STATE, SPI_DATA, TIMED_OUT, define
from mimic.hardware.stock.wiring import load_board
from mimic.io.assets import shipped
from mimic.robot.description import load_description

LEG_CONTROL_COMMAND = define(
    "leg_control_command",
    "float tau_ff[12]; float f_ff[12]; float q_des[12]; float qd_des[12]; float p_des[12]; float v_des[12];"
    "float kp_cartesian[12]; float kd_cartesian[12]; float kp_joint[12]; float kd_joint[12]",
)

PERIOD = 0.002


ZERO = MOTOR_CTRL.encode()

UNTIL_CLEAR = 20.0
"""Zero messages of a segment this long end when error 0x02 has cleared [s]: a busy computer takes longer."""


def script(rng: np.random.Generator) -> list[tuple[float, bytes | None]]:
    """Return segments of seconds and the message that is sent in them; None is silence."""
    stand = np.tile([0.0, -0.785, 1.222], 4)

    def hold(q: Any, kp: float = 20.0, kd: float = 1.0, **more: Any) -> bytes:
        return MOTOR_CTRL.encode(q_des=q, kp_des=[kp] * 12, kd_des=[kd] * 12, **more)

    parts: list[tuple[float, bytes | None]] = [(UNTIL_CLEAR, ZERO), (1.0, hold(stand))]
    for joint in range(12):  # beyond the cut, one joint at a time
        q = stand.copy()
        q[joint] += 0.6 if joint % 3 != 2 else -0.6
        parts += [(0.06, hold(q, 60.0, 2.0)), (0.3, hold(stand))]
    for joint in (0, 4, 8, 11):  # beyond the joint limits, long enough to arrive
        for far in (-4.0, 4.0):
            q = stand.copy()
            q[joint] = far
            parts += [(0.8, hold(q, 30.0, 2.0)), (0.6, hold(stand))]
    for _ in range(40):  # anything
        values = {"qd_des": rng.uniform(-12, 12, 12), "tau_des": rng.uniform(-6, 6, 12)}
        parts.append((0.05, hold(stand + rng.uniform(-0.4, 0.4, 12), rng.uniform(0, 60), rng.uniform(0, 5), **values)))
    feed = hold(stand, qd_des=[2.0] * 12, tau_des=[1.0] * 12)
    for silence in (0.015, 0.03, 0.08, 0.2, 0.45):
        parts += [(0.2, feed), (silence, None)]
    parts += [(0.3, feed), (0.9, None), (0.6, feed), (0.2, ZERO), (2.5, feed), (UNTIL_CLEAR, ZERO), (0.3, hold(stand))]
    parts += [(3.4, None), (0.5, feed), (UNTIL_CLEAR, ZERO), (0.3, hold(stand))]
    return parts


def newest_flag(heard: list[tuple[str, float, bytes]]) -> int:
    data = next((data for channel, _, data in reversed(heard) if channel == MOTOR_CTRL_STATE.channel), None)
    return TIMED_OUT if data is None else int(MOTOR_CTRL_STATE.decode(data)["err_flag"])


def record(folder: Path, work: Path) -> tuple[list[tuple[float, bytes]], list[tuple[str, float, bytes]]]:
    """Send the script to the firmware; return what was sent and what was heard, with times."""
    import lcm

    board = load_board()
    sent: list[tuple[float, bytes]] = []
    heard: list[tuple[str, float, bytes]] = []
    with Bench(folder, work, shipped("assets", "cyberdog2", "scene.xml"), "--hang"):
        bus = lcm.LCM(f"udpm://{board.address}:{board.port}?ttl=0")
        for kind in (SPI_DATA, MOTOR_CTRL_STATE, LEG_CONTROL_COMMAND):
            take = bus.subscribe(kind.channel, lambda channel, data: heard.append((channel, time.monotonic(), data)))
            take.set_queue_capacity(2000)
        due = time.monotonic()
        for seconds, message in script(np.random.default_rng(5)):
            for step in range(round(seconds / PERIOD)):
                if seconds == UNTIL_CLEAR and step > 50 and not newest_flag(heard) & TIMED_OUT:
                    break
                if message is not None:
                    sent.append((time.monotonic(), message))
                    bus.publish(MOTOR_CTRL.channel, message)
                due += PERIOD
                while (left := due - time.monotonic()) > 0.0:
                    bus.handle_timeout(max(int(1e3 * left), 0))
                while bus.handle_timeout(0):
                    pass
    return sent, heard


def cycles(heard: list[tuple[str, float, bytes]]) -> list[tuple[float, Any, Any, Any]]:
    """Return time, readings, state and motor commands of each cycle of which all three were heard in order."""
    found, parts = [], {}
    for channel, t, data in heard:
        if channel == SPI_DATA.channel:
            parts = {channel: SPI_DATA.decode(data)}
        elif channel == MOTOR_CTRL_STATE.channel:
            parts[channel], parts["t"] = MOTOR_CTRL_STATE.decode(data), t
        else:
            parts[channel] = LEG_CONTROL_COMMAND.decode(data)
        if len(parts) == 4 and SPI_DATA.channel in parts:
            found.append(
                (parts["t"], *(parts[kind.channel] for kind in (SPI_DATA, MOTOR_CTRL_STATE, LEG_CONTROL_COMMAND)))
            )
            parts = {}
    return found


def compare(folder: Path, work: Path) -> dict[str, Any]:
    """Return how far the emulated rules are from the firmware, over all cycles of the script."""
    description = load_description("cyberdog2")
    order = load_board().index
    sign = np.tile([1.0, -1.0, -1.0], 4)
    low, high = np.empty(12), np.empty(12)
    low[order], high[order] = description.q_min, description.q_max
    low, high = np.minimum(sign * low, sign * high), np.maximum(sign * low, sign * high)
    sent, heard = record(folder, work)
    times = [t for t, _ in sent]
    rules = MotorModeRules(low, high)
    errors: dict[str, list[float]] = {name: [] for name in ("q_des", "qd_des", "kp", "kd", "torque", "soft torque")}
    flags: dict[str, int] = {}
    wrong: dict[str, int] = {}
    ambiguous = 0
    cleared: list[int] = []
    before: tuple[Any, Any] | None = None  # which joints were at a soft limit in the last cycle, and their torques

    def by_joint(message: Any, name: str) -> Any:
        parts = [message[f"{name}_{part}"] for part in ("abad", "hip", "knee")]
        return np.stack(parts, axis=1).reshape(12).astype(float)

    for t, spi, state, told in cycles(heard):
        age = 1e-3 * float(state["ctrl_topic_interval"])
        newest = max(bisect.bisect_right(times, t - age + 3e-4) - 1, 0)
        q, dq, tau = (by_joint(spi, name) for name in ("q", "qd", "tau"))
        flag = int(state["err_flag"])
        if rules.err_flag & TIMED_OUT and not flag & TIMED_OUT:  # cycles that were not heard are missing in the count
            cleared.append(rules.clear())
        mine = rules.cycle(MOTOR_CTRL.decode(sent[newest][1]), age, q, dq)
        if before is not None and before[0].any():
            errors["soft torque"].append(float(np.max(np.abs(tau - before[1])[before[0]])))
        before = None
        flags[f"{flag:#04x}"] = flags.get(f"{flag:#04x}", 0) + 1
        if len({data for _, data in sent[max(newest - 2, 0) : newest + 3]}) > 1:
            ambiguous += 1
            continue
        if flag != rules.err_flag:
            bits = f"{flag ^ rules.err_flag:#04x}"
            wrong[bits] = wrong.get(bits, 0) + 1
        soft = (rules.limits != 0) & (mine.kp == 0.0) & (mine.tau != told["tau_ff"])
        before = soft, np.clip(mine.tau, -12.0, 12.0)
        for name, theirs, own in (
            ("q_des", told["q_des"], mine.q_des),
            ("qd_des", told["qd_des"], mine.dq_des),
            ("kp", told["kp_joint"], mine.kp),
            ("kd", told["kd_joint"], mine.kd),
        ):
            errors[name].append(float(np.max(np.abs(theirs - own))))
        firmware = told["kp_joint"] * (told["q_des"] - q) + told["kd_joint"] * (told["qd_des"] - dq) + told["tau_ff"]
        own = mine.kp * (mine.q_des - q) + mine.kd * (mine.dq_des - dq) + mine.tau
        errors["torque"].append(float(np.max(np.abs(np.where(soft, 0.0, firmware - own)))))
    return {
        "cycles compared": len(errors["torque"]),
        "of these with a soft limit": len(errors["soft torque"]),
        "cycles left out": ambiguous,
        "cycles heard until error 0x02 cleared": cleared,
        "cycles by error flag": flags,
        "error flags that differ (bits: cycles)": wrong,
        "largest difference": {name: round(max(values), 6) for name, values in errors.items()},
        "cycles that differ by more than 0.001": {
            name: int(np.count_nonzero(np.array(values) > 1e-3)) for name, values in errors.items()
        },
    }

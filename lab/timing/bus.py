"""Load of the emulated bus against arithmetic, and how long twelve commands take to their twelve answers.

    python -m lab.timing.bus                # both: in the emulation's own time, then across processes for 20 s each

Arithmetic: mean bits of a command, an answer, an orientation and a rate of turn with realistic payloads, stuffing and
check sum included (141.9, 137.5, 114.8, 102.1), times how often each is sent.
"""

from __future__ import annotations

import argparse
import dataclasses
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

from lab.in_process.can_link import EmulatedLink
from mimic.config.emulator import EmulateSettings
from mimic.emulator.robot import EmulatedRobot
from mimic.hardware.can.frame import CanFrame, Link
from mimic.hardware.can.opening import open_link
from mimic.hardware.can.wiring import Wiring, load_wiring
from mimic.hardware.motors.cybergear.codec import Codec, HostMessage, Kind, MotorMessage
from mimic.hardware.motors.interface import Feedback, MotorCommand
from mimic.robot.description import load_description

COMMAND, ANSWER, ORIENTATION, TURN = 141.9, 137.5, 114.8, 102.1
"""Mean bits on the bus."""

CODEC = Codec()


def _is_feedback(frame: CanFrame) -> bool:
    message = CODEC.decode(frame) if frame.extended else None
    return isinstance(message, MotorMessage) and isinstance(message.said, Feedback)


def with_imu(wiring: Wiring, rate: float) -> Wiring:
    return dataclasses.replace(
        wiring, imu=dataclasses.replace(wiring.imu, rate={"quaternion": rate, "rate_of_turn": rate})
    )


def cycles(
    link: Link, wiring: Wiring, rate: float, seconds: float, mark: Callable[[], None] = lambda: None
) -> tuple[np.ndarray, int]:
    """Move all joints at a rate; return the time from the first command to the last answer of each period, and misses.

    ``mark`` is called before the first period and after the last.
    """
    middle = load_description("cyberdog2").poses["four"]
    for bus, motor in zip(wiring.bus, wiring.motor, strict=True):
        link.send(int(bus), CODEC.encode(HostMessage(Kind.ENABLE, int(motor), host=wiring.host)))
    link.sleep(0.1)
    while link.receive(0.0) is not None:
        pass
    begin, took, missed, total = link.now(), [], 0, 0
    mark()
    for tick in range(round(seconds * rate)):
        target = wiring.p_of(middle + 0.3 * np.sin(6.0 * tick / rate + np.arange(12)))
        started = link.now()
        for i in range(12):
            said = HostMessage(
                Kind.OPERATION,
                int(wiring.motor[i]),
                command=MotorCommand(q=float(target[i]), dq=0.0, kp=30.0, kd=3.0, tau=0.0),
            )
            link.send(int(wiring.bus[i]), CODEC.encode(said))
        answers, last = 0, started
        while (heard := link.receive(begin + (tick + 1) / rate - link.now())) is not None:
            if _is_feedback(heard.frame):
                answers, last = answers + 1, heard.t
        missed += answers < 12
        total += answers
        took.append(last - started)
    mark()
    end = link.now() + 5.0
    while total < 12 * round(seconds * rate) and (heard := link.receive(end - link.now())) is not None:
        total += _is_feedback(heard.frame)
    assert total >= 12 * round(seconds * rate), f"only {total} answers came in all"
    return np.array(took), missed


def loads() -> None:
    print(
        "| buses | commands and IMU at | estimated | emulated | answers that missed their period |\n"
        "|---|---|---|---|---|"
    )
    for buses, rate in ((1, 50.0), (1, 100.0), (1, 200.0), (2, 200.0), (4, 200.0)):
        wiring = with_imu(load_wiring(buses=buses), rate)
        robot = EmulatedRobot(load_description("cyberdog2"), wiring, EmulateSettings(zeroed=True, suspended=True))
        link = EmulatedLink(robot)
        link.sleep(0.1)
        marks: list[tuple[float, list[int]]] = []

        def mark(robot: EmulatedRobot = robot, marks: list[tuple[float, list[int]]] = marks) -> None:
            marks.append((robot.now, [bus.bits for bus in robot.buses]))

        _, missed = cycles(link, wiring, rate, 5.0, mark)
        (start, before), (end, after) = marks
        found = [(b - a) / wiring.bitrate / (end - start) for a, b in zip(before, after, strict=True)]
        motors = [int(np.sum(wiring.bus == bus)) for bus in range(buses)]
        imu = [(ORIENTATION + TURN) * (bus == wiring.imu.bus) for bus in range(buses)]
        wanted = [rate * (m * (COMMAND + ANSWER) + i) / wiring.bitrate for m, i in zip(motors, imu, strict=True)]
        row = (", ".join(f"{share:.1%}" for share in shares) for shares in (wanted, found))
        print(f"| {buses} | {rate:.0f} Hz | {' | '.join(row)} | {missed} of {round(5 * rate)} periods |")


def transports(seconds: float) -> None:
    print(
        "\n| transport | rate | first command to last answer p50 / p99 / max | periods with a miss | opened in |\n"
        "|---|---|---|---|---|"
    )
    for kind in ("socketcand", "slcan"):
        for rate in (50.0, 200.0):
            command = [
                sys.executable,
                "-m",
                "mimic",
                "emulate",
                "--listen",
                "127.0.0.1:0",
                "--slcan",
                "--zeroed",
                "--suspended",
            ]
            with subprocess.Popen([*command, "--every", "0"], stdout=subprocess.PIPE, text=True) as process:
                assert process.stdout is not None
                try:
                    address = next(line.split()[-1] for line in process.stdout if kind in line)
                    begin = time.monotonic()
                    link = open_link(address)
                    opened = time.monotonic() - begin
                    took, missed = cycles(link, load_wiring(), rate, seconds)
                    link.close()
                finally:
                    process.terminate()
            p50, p99, most = 1e3 * np.quantile(took, [0.5, 0.99, 1.0])
            print(
                f"| {kind} | {rate:.0f} Hz | {p50:.1f} / {p99:.1f} / {most:.1f} ms "
                f"| {missed} of {len(took)} | {1e3 * opened:.0f} ms |"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    loads()
    transports(options.seconds)


if __name__ == "__main__":
    main()

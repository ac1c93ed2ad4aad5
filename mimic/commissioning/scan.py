"""Finds motors and IMU: asks every id on every bus, and listens for other senders."""

from __future__ import annotations

from mimic.errors import FrameError
from mimic.frozen import frozen
from mimic.hardware.can.frame import Link
from mimic.hardware.can.wiring import Wiring
from mimic.hardware.motors.imu import make_imu
from mimic.hardware.motors.interface import Identity
from mimic.records import JOINTS

SPACING = 0.001
"""Time between two questions [s]: a question and its answer take 0.3 ms."""

PASSES = 2
"""How often every id is asked; an adapter that was just opened may lose the first frames."""

TAIL = 0.3
"""How long to listen after the last question [s]."""


@frozen
class BusScan:
    """What answered on one bus."""

    name: str
    motors: dict[int, int]
    """Id -> unique number."""
    imu: float
    """Orientations a second; 0 if no IMU was heard [Hz]."""
    others: tuple[int, ...]
    """Identifiers of frames from unknown senders."""


def scan(link: Link, wiring: Wiring) -> list[BusScan]:
    """Ask every id on every bus, and return what answered on each.

    Raises:
        BusError: If a bus fails.
    """
    protocol = wiring.motors()
    motors: list[dict[int, int]] = [{} for _ in link.names]
    others: list[set[int]] = [set() for _ in link.names]
    imus = [make_imu(wiring.imu) for _ in link.names]
    while link.receive(0.0) is not None:
        pass  # frames that arrived since the buses were opened
    begin = link.now()

    def listen(until: float) -> None:
        while (left := until - link.now()) > 0:
            received = link.receive(left)
            if received is None:
                continue
            bus, frame, t = received
            try:
                if imus[bus].feed(frame, t):
                    continue
                message = protocol.decode(frame)
            except FrameError:
                others[bus].add(frame.id)
                continue
            if isinstance(message, Identity):
                motors[bus][message.motor] = message.uid

    for motor in PASSES * tuple(protocol.facts.motor_ids):
        for bus in range(len(link.names)):
            link.send(bus, protocol.ask_identity(motor))
        listen(link.now() + SPACING)
    listen(link.now() + TAIL)
    seconds = link.now() - begin
    return [
        BusScan(
            name=name,
            motors=dict(sorted(motors[bus].items())),
            imu=imus[bus].reading(link.now()).count / seconds,
            others=tuple(sorted(others[bus])),
        )
        for bus, name in enumerate(link.names)
    ]


def wiring_problems(found: list[BusScan], wiring: Wiring) -> list[str]:
    """Return the differences between a scan and the wiring, as sentences."""
    problems = []
    factory_id = wiring.motors().facts.factory_id
    for joint, name in enumerate(JOINTS):
        bus = int(wiring.bus[joint])
        motor = int(wiring.motor[joint])
        if motor not in found[bus].motors:
            problems.append(f"{name} should be motor {motor} on {found[bus].name}, which does not answer")
    for bus, one in enumerate(found):
        for motor in one.motors:
            if wiring.joint_of(bus, motor) is None:
                new = f"; new motors have {motor}" if motor == factory_id else ""
                problems.append(f"motor {motor} on {one.name} is not in the wiring{new}")
    if not found[wiring.imu.bus].imu:
        problems.append(f"no IMU answers on {found[wiring.imu.bus].name}")
    return problems

"""Who is on the buses: every id is asked, and what else speaks is listened to."""

from __future__ import annotations

from dataclasses import dataclass

from mimic.errors import FrameError
from mimic.robot.wiring import Wiring
from mimic.run.cybergear import FIRST_HOST, Codec
from mimic.run.imu import make_imu
from mimic.run.link import Link
from mimic.run.motor_messages import DeviceId, GetDeviceId
from mimic.types import JOINTS

SPACING = 0.001
"""Between two questions [s]: a question and its answer take 0.3 ms."""

PASSES = 2
"""How often every id is asked; an adapter that was just opened may lose the first frames."""

AFTER = 0.3
"""How long is listened after the last question [s]."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What answered on one bus."""

    name: str
    motors: dict[int, int]
    """Id -> unique id."""
    imu: float
    """Orientations a second; 0 where no IMU spoke."""
    others: tuple[int, ...]
    """Identifiers of frames that nobody here knows."""


def scan(link: Link, wiring: Wiring) -> list[Seen]:
    """Ask every id on every bus, and return what answered on each.

    Raises:
        BusError: If a bus fails.
    """
    codec = Codec(position_range=wiring.position_range)
    motors: list[dict[int, int]] = [{} for _ in link.names]
    others: list[set[int]] = [set() for _ in link.names]
    imus = [make_imu(wiring.imu) for _ in link.names]
    while link.receive(0.0) is not None:
        pass  # what waited since the buses were opened
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
                message = codec.decode(frame)
            except FrameError:
                others[bus].add(frame.id)
                continue
            if isinstance(message, DeviceId):
                motors[bus][message.motor] = message.uid

    for motor in PASSES * tuple(range(FIRST_HOST)):
        for bus in range(len(link.names)):
            link.send(bus, codec.encode(GetDeviceId(motor=motor, host=wiring.host)))
        listen(link.now() + SPACING)
    listen(link.now() + AFTER)
    seconds = link.now() - begin
    return [
        Seen(
            name=name,
            motors=dict(sorted(motors[bus].items())),
            imu=imus[bus].reading(link.now()).count / seconds,
            others=tuple(sorted(others[bus])),
        )
        for bus, name in enumerate(link.names)
    ]


def lacking(seen: list[Seen], wiring: Wiring) -> list[str]:
    """Return what the wiring has and the buses do not, and the other way round, as sentences."""
    told = []
    for joint, name in enumerate(JOINTS):
        bus, motor = int(wiring.bus[joint]), int(wiring.motor[joint])
        if motor not in seen[bus].motors:
            told.append(f"{name} should be motor {motor} on {seen[bus].name}, which does not answer")
    for bus, one in enumerate(seen):
        for motor in one.motors:
            if wiring.joint_of(bus, motor) is None:
                new = "; new motors have 127" if motor == 127 else ""
                told.append(f"motor {motor} on {one.name} is not in the wiring{new}")
    if not seen[wiring.imu.bus].imu:
        told.append(f"no IMU speaks on {seen[wiring.imu.bus].name}")
    return told

"""A host on the emulated robot's buses in the same process; waiting advances the robot's time."""

from __future__ import annotations

from mimic.emulator.robot import EmulatedRobot
from mimic.errors import BusError
from mimic.hardware.can.frame import CanFrame, Received


class EmulatedLink:
    """A link (`mimic.hardware.can.frame.Link`) without a wire. Several links to one robot are several hosts."""

    wake: int | None = None
    woken = False

    def __init__(self, robot: EmulatedRobot) -> None:
        self._robot = robot
        self._host = robot.connect()

    @property
    def names(self) -> tuple[str, ...]:
        """The buses."""
        return tuple(f"emulated bus {i}" for i in range(len(self._robot.buses)))

    def now(self) -> float:
        """Return the robot's time [s]."""
        return self._robot.now

    def sleep(self, seconds: float) -> None:
        """Advance the robot's time."""
        self._robot.advance(self._robot.now + max(seconds, 0.0))

    def send(self, bus: int, frame: CanFrame) -> None:
        """Hand a frame to a bus.

        Raises:
            BusError: If it is unplugged.
        """
        self._robot.send(self._host, bus, frame)

    def receive(self, timeout: float) -> Received | None:
        """Return the next frame of any bus, or None when there is none for ``timeout`` seconds of the robot's time.

        Raises:
            BusError: If a bus is unplugged.
        """
        if not self._host.heard:
            self._robot.advance(self._robot.now + max(timeout, 0.0), waiting=self._host)
        if self._host.heard:
            return self._host.heard.popleft()
        for bus in range(len(self._robot.buses)):
            if self._robot.unplugged(bus):
                raise BusError(f"bus {bus} is unplugged")
        return None

    def reopen(self, bus: int) -> None:
        """Do nothing: a bus that was unplugged works again as soon as it is plugged in."""

    def close(self) -> None:
        """Leave the buses; the robot continues with its last commands."""
        self._robot.disconnect(self._host)

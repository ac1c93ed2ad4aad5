"""A host on the emulated robot's buses in the same process; waiting lets the robot's time go on."""

from __future__ import annotations

from mimic.errors import BusError
from mimic.run.can_frame import CanFrame
from mimic.run.emulator import EmulatedRobot
from mimic.run.link import Received


class EmulatedLink:
    """A link (:class:`mimic.run.link.Link`) without a wire. Several links to one robot are several hosts."""

    def __init__(self, robot: EmulatedRobot) -> None:
        self._robot, self._host = robot, robot.connect()

    @property
    def names(self) -> tuple[str, ...]:
        """The buses."""
        return tuple(f"emulated bus {i}" for i in range(len(self._robot.buses)))

    def now(self) -> float:
        """Return the robot's time [s]."""
        return self._robot.now

    def sleep(self, seconds: float) -> None:
        """Let the robot's time go on."""
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
        for bus in range(len(self._robot.buses)):
            if self._robot.unplugged(bus):
                raise BusError(f"bus {bus} is unplugged")
        return self._host.heard.popleft() if self._host.heard else None

    def close(self) -> None:
        """Leave the buses; the robot goes on with its last commands when time goes on."""
        self._robot.disconnect(self._host)

"""LCM on the network of a stock robot, and whether that network is set up for it."""

from __future__ import annotations

import errno
import ipaddress
import socket
import time
from collections.abc import Callable
from typing import Any

from mimic.errors import BusError, MissingExtra
from mimic.hardware.robot.board import Bus, address_of
from mimic.hardware.stock.messages import STATE_ESTIMATOR, TYPES
from mimic.hardware.stock.wiring import BoardWiring

QUEUE = 500
"""Messages of a channel that wait to be read; those after them are dropped."""


def check_network(wiring: BoardWiring, interface: str | None) -> tuple[str, int]:
    """Check that multicast leaves on the robot's network; return how it leaves, in words, and the ttl to use.

    Args:
        wiring: Of the board.
        interface: Network interface; ``lo`` keeps every message on this computer; None takes the one that has the
            multicast route, if it is on the robot's network or the loopback.

    Raises:
        ConfigError: If there is no such interface.
        BusError: With the commands that set the network up.
    """
    name = interface or "eth0"
    route = f"sudo ip route add 224.0.0.0/4 dev {name}"
    own = None if interface is None else address_of(interface)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.connect((wiring.address, wiring.port))
            source = str(sock.getsockname()[0])
        except OSError as reason:
            if reason.errno not in (errno.ENETUNREACH, errno.ENODEV, errno.EADDRNOTAVAIL):
                raise BusError(f"multicast to {wiring.address}: {reason.strerror}") from None
            raise BusError(f"there is no route for multicast to {wiring.address}; to set it: {route}") from None
    if interface == "lo" or source.startswith("127."):
        return "messages stay on this computer", 0
    if interface is not None:
        if own is None:
            raise BusError(f"{interface} has no address; to set it: sudo ip addr add {wiring.host} dev {interface}")
        if own != source:
            raise BusError(f"multicast leaves from {source}, not through {interface} ({own}); to change that: {route}")
    elif ipaddress.ip_address(source) not in ipaddress.ip_interface(wiring.host).network:
        raise BusError(
            f"multicast leaves from {source}, which is not on the robot's network; set the address of the interface "
            f"to the robot with: sudo ip addr add {wiring.host} dev {name}; then: {route}; or name the interface with "
            "--interface (lo for an emulated robot)"
        )
    return f"messages leave from {source}", wiring.ttl


class LcmBus(Bus):
    """The two LCM ports of a board."""

    def __init__(
        self, wiring: BoardWiring, ttl: int, heard: Callable[[str, bytes, float], None] = lambda *_: None
    ) -> None:
        """Open both ports.

        Args:
            wiring: Group and ports.
            ttl: 0 keeps messages on this computer.
            heard: Called with channel, bytes and time on the monotonic clock [s].

        Raises:
            MissingExtra: If the package lcm is not installed.
            BusError: If LCM cannot be opened.
        """
        try:
            import lcm
        except ImportError:
            raise MissingExtra("lcm", "stock") from None

        self.heard = heard

        def take(channel: str, data: bytes) -> None:
            self.heard(channel, data, time.monotonic())

        self._ports: dict[int, Any] = {}
        for port in (wiring.port, wiring.state_port):
            try:
                bus = self._ports[port] = lcm.LCM(f"udpm://{wiring.address}:{port}?ttl={ttl}")
                for channel in TYPES:
                    if (channel == STATE_ESTIMATOR.channel) == (port == wiring.state_port):
                        bus.subscribe(channel, take).set_queue_capacity(QUEUE)
            except (RuntimeError, OSError) as reason:
                raise BusError(f"LCM cannot be opened at {wiring.address}:{port}: {reason}") from None
        self._port = wiring.port
        self._state_port = wiring.state_port
        self._sources = {bus.fileno(): bus.handle for bus in self._ports.values()}

    def publish(self, channel: str, data: bytes) -> None:
        """Send a message on the port of its channel.

        Raises:
            OSError: If the network does not take it.
        """
        port = self._state_port if channel == STATE_ESTIMATOR.channel else self._port
        self._ports[port].publish(channel, data)

    def close(self) -> None:
        """Leave the network."""
        self._sources = {}
        self._ports.clear()

"""DDS on the network of a Go2, and who else is on it.

Messages stay the bytes they are on the wire: Cyclone DDS gets the types only to announce them, as its own conversion of
an rt/lowstate takes 0.7 ms, a third of a cycle.
"""

from __future__ import annotations

import ipaddress
import os
import select
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any

from mimic.errors import BusError, MissingExtra
from mimic.hardware.go2.messages import LOWCMD, LOWSTATE, SPORT, SWITCHER, TOPICS, Struct
from mimic.hardware.go2.wiring import Go2Wiring
from mimic.hardware.stock.lcm_bus import FLOOD, address_of

FROM_ROBOT = (LOWSTATE, f"{SWITCHER}response", f"{SPORT}response")
"""What a robot sends."""

TO_ROBOT = (LOWCMD, f"{SWITCHER}request", f"{SPORT}request")
"""What a robot hears."""

BLOCKS = 1
"""A message that a slow reader holds up is given up after this [ms]."""

_CONFIG = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="{}" priority="default" '
    'multicast="default"/></Interfaces></General><Compatibility><IgnoreTypeInformation>1.16</IgnoreTypeInformation>'
    "</Compatibility></Domain></CycloneDDS>"
)


def check_network(wiring: Go2Wiring, interface: str | None) -> str:
    """Return the network interface to the robot.

    Args:
        wiring: Of the robot.
        interface: Network interface; ``lo`` keeps every message on this computer; None takes the one whose address is
            on the robot's network.

    Raises:
        ConfigError: If there is no such interface.
        BusError: If none is on the robot's network, with the command that sets one up.
    """
    network = ipaddress.ip_interface(wiring.host).network
    setup = f"sudo ip addr add {wiring.host} dev {interface or 'eth0'}"
    if interface is not None:
        if address_of(interface) is None:
            raise BusError(f"{interface} has no address; to set it: {setup}")
        return interface
    for _, name in socket.if_nameindex():
        address = address_of(name)
        if address is not None and ipaddress.ip_address(address) in network:
            return name
    raise BusError(
        f"no interface of this computer is on the robot's network {network}; to set one up: {setup}; or name the "
        "interface with --interface (lo for an emulated robot)"
    )


def idl_type(struct: Struct) -> Any:
    """Return a type as Cyclone DDS knows it."""
    from cyclonedds import idl
    from cyclonedds.idl import annotations, types

    def kind(one: Struct | str, length: int) -> Any:
        single = (
            idl_type(one)
            if isinstance(one, Struct)
            else {"string": str, "bool": bool, "octets": types.sequence[types.uint8]}.get(one)
            or getattr(types, str(one))
        )
        return types.array[single, length] if length else single

    fields = {name: kind(one, length) for name, one, length in struct.fields}
    made = idl.make_idl_struct(struct.name.rpartition(".")[2], struct.name, fields, dataclassify=False)
    return dataclass(annotations.final(annotations.autoid("sequential")(made)))


@cache
def _raw(struct: Struct) -> Any:
    """Return a type whose messages are the bytes they are on the wire."""
    made = idl_type(struct)

    def init(self: Any, data: bytes) -> None:
        self.data = data

    def deserialize(data: bytes, **_: Any) -> Any:
        return made(data)

    made.__init__, made.serialize, made.deserialize = init, lambda self, **_: self.data, staticmethod(deserialize)
    made.deserialize_key = staticmethod(lambda data, **_: None)
    return made


@cache
def _domain(domain: int, interface: str) -> Any:
    """Return a domain of this process, which lives as long as it."""
    from cyclonedds.domain import Domain

    return Domain(domain, _CONFIG.format(interface))


class DdsBus:
    """The topics of a Go2: publishes, and hands every message on with the time at which it was read."""

    echoes = False
    """Whether own messages come back."""

    def __init__(
        self,
        wiring: Go2Wiring,
        interface: str,
        heard: Callable[[str, bytes, float], None] = lambda *_: None,
        *,
        robot: bool = False,
    ) -> None:
        """Listen; nothing is sent, and nobody sees a writer yet.

        Args:
            wiring: Domain.
            interface: Network interface.
            heard: Called with topic, bytes and time on the monotonic clock [s].
            robot: Take the robot's place: hear what is sent to it.

        Raises:
            MissingExtra: If the package cyclonedds is not installed.
            BusError: If DDS cannot be opened.
        """
        try:
            from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsParticipant, BuiltinTopicDcpsPublication
            from cyclonedds.core import DDSException, Listener
            from cyclonedds.domain import DomainParticipant
            from cyclonedds.qos import Policy, Qos
            from cyclonedds.sub import DataReader
            from cyclonedds.topic import Topic
        except ImportError:
            raise MissingExtra("cyclonedds", "go2") from None

        self.heard, self._failure = heard, DDSException
        self._wakes, woken = os.pipe()
        os.set_blocking(self._wakes, False)
        os.set_blocking(woken, False)
        self._woken = woken

        def wake(_: Any) -> None:
            with suppress(OSError):  # full: it is awake; or closed
                os.write(woken, b".")

        try:
            _domain(wiring.domain, interface)
            self._participant: Any = DomainParticipant(wiring.domain)
            self._topics = {name: Topic(self._participant, name, _raw(kind)) for name, kind in TOPICS.items()}
            foreign = Qos(Policy.IgnoreLocal.Participant)
            self._readers = {
                name: DataReader(self._participant, self._topics[name], foreign, Listener(on_data_available=wake))
                for name in (TO_ROBOT if robot else (*FROM_ROBOT, LOWCMD))
            }
            self._who: Any = BuiltinDataReader(self._participant, BuiltinTopicDcpsParticipant)
            self._what: Any = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        except DDSException as reason:
            os.close(self._wakes)
            os.close(woken)
            raise BusError(f"DDS cannot be opened on {interface}: {reason.msg}") from None
        self._writers: dict[str, Any] = {}

    def ready(self, topic: str) -> bool:
        """Return whether somebody hears what is published on a topic; announces it the first time."""
        return bool(self._writer(topic).get_matched_subscriptions())

    def _writer(self, topic: str) -> Any:
        from cyclonedds.pub import DataWriter
        from cyclonedds.qos import Policy, Qos
        from cyclonedds.util import duration

        if topic not in self._writers:
            reliable = Qos(Policy.Reliability.Reliable(max_blocking_time=duration(milliseconds=BLOCKS)))
            self._writers[topic] = DataWriter(self._participant, self._topics[topic], reliable)
        return self._writers[topic]

    def publish(self, channel: str, data: bytes) -> None:
        """Send a message.

        Raises:
            OSError: If the network does not take it.
        """
        try:
            writer = self._writer(channel)
            writer.write(writer.data_type(data))
        except self._failure as reason:
            raise OSError(reason.msg) from None

    def others(self) -> list[str]:
        """Return who else may write commands, by computer and program as far as known."""
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState

        alive = SampleState.Any | ViewState.Any | InstanceState.Alive
        own = self._participant.guid
        found = {
            endpoint.participant_key
            for endpoint in self._what.read(1000, condition=ReadCondition(self._what, alive))
            if endpoint.topic_name == LOWCMD and endpoint.participant_key != own
        }
        names = {
            one.key: {p.key: p.value for p in one.qos if hasattr(p, "key") and hasattr(p, "value")}
            for one in self._who.read(1000, condition=ReadCondition(self._who, alive))
        }
        return sorted(
            f"{known.get('__ProcessName', 'a program')} (pid {known.get('__Pid', '?')}) on "
            f"{known.get('__Hostname', 'an unknown computer')}"
            for known in (names.get(key, {}) for key in found)
        )

    def now(self) -> float:
        """Return the monotonic clock [s]."""
        return time.monotonic()

    def listen(self, until: float, wake: int | None = None) -> None:
        """Hand on messages until a time [s]; return early where something is to be read from a descriptor."""
        files = [self._wakes, *([] if wake is None else [wake])]
        while True:
            left = until - time.monotonic()
            ready, _, _ = select.select(files, [], [], max(left, 0.0))
            if self._wakes in ready:
                os.read(self._wakes, 4096)
                self._take()
            if wake in ready or (left <= 0.0 and not ready) or left < -FLOOD:
                return

    def _take(self) -> None:
        now = time.monotonic()
        for topic, reader in self._readers.items():
            for sample in reader.take(100):
                data = getattr(sample, "data", None)  # none where a writer only left
                if data is not None:
                    self.heard(topic, data, now)

    def close(self) -> None:
        """Leave the network. Safe to call twice."""
        if self._participant is None:
            return
        self._readers.clear()
        self._writers.clear()
        self._topics.clear()
        self._who = self._what = self._participant = None
        os.close(self._woken)
        os.close(self._wakes)

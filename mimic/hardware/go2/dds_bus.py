"""DDS on the network of a Go2, and who else is on it.

Cyclone DDS is used through its C functions: messages stay the bytes they are on the wire (its Python conversion of an
rt/lowstate takes 0.7 ms, a third of a cycle), and types are announced by name alone (see `_descriptor`).
"""

from __future__ import annotations

import ctypes
import ipaddress
import os
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any

from mimic.errors import BusError, MissingExtra
from mimic.hardware.go2.messages import LOWCMD, LOWSTATE, SPORT, SWITCHER, TOPICS, Struct
from mimic.hardware.go2.wiring import Go2Wiring
from mimic.hardware.robot.board import Bus, address_of

FROM_ROBOT = (LOWSTATE, f"{SWITCHER}response", f"{SPORT}response")
"""What a robot sends."""

FROM_OTHERS = (*FROM_ROBOT, LOWCMD)
"""What a host hears: other programs, too."""

TO_ROBOT = (LOWCMD, f"{SWITCHER}request", f"{SPORT}request")
"""What a robot hears."""

KEPT = 32
"""Messages of a topic that wait to be read: two robots may speak at once."""

BLOCKS = 1_000_000
"""A message that a slow reader holds up is given up after this [ns]."""

_RELIABLE = 1
"""Kind of reliability: messages are repeated until they arrive."""
_OWN = 1
"""Kind of messages that are left out: those of the same participant."""
_LAST = 0
"""Kind of messages that are kept: the last ones."""

_CONFIG = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="{}" priority="default" '
    'multicast="default"/></Interfaces></General></Domain></CycloneDDS>'
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
        try:
            address = address_of(name)
        except BusError:  # it is down
            continue
        if address is not None and ipaddress.ip_address(address) in network:
            return name
    raise BusError(
        f"no interface of this computer is on the robot's network {network}; to set one up: {setup}; or name the "
        "interface with --interface (lo for an emulated robot)"
    )


class _Descriptor(ctypes.Structure):
    """Of a type, as dds_create_topic takes it. Source: Cyclone DDS 11, ddsc/dds_public_impl.h."""

    _fields_ = (
        *((name, ctypes.c_uint32) for name in ("size", "align", "flagset", "nkeys")),
        ("typename", ctypes.c_char_p),
        ("keys", ctypes.c_void_p),
        ("nops", ctypes.c_uint32),
        ("ops", ctypes.POINTER(ctypes.c_uint32)),
        ("meta", ctypes.c_char_p),
        *((name, ctypes.c_uint64 * 2) for name in ("type_information", "type_mapping")),
        ("restrict_data_representation", ctypes.c_uint32),
    )


class _Piece(ctypes.Structure):
    """Bytes of a message."""

    _fields_ = (("bytes", ctypes.c_char_p), ("size", ctypes.c_size_t))


_ADDRESS = 1 << 24
_ARRAY = 8 << 16
_SEQUENCE = 7 << 16
_CODES = {"uint8": 1, "int8": 1, "uint16": 2, "int16": 2, "uint32": 3, "int32": 3, "float32": 3, "int64": 4}
_CODES |= {"string": 5, "bool": 14}
"""Instructions of Cyclone DDS's serializer, and its types. Source: ddsc/dds_opcodes.h."""

_DATA = 2
"""A message that is no mere key."""


def _instructions(struct: Struct, begin: int = 0) -> list[int]:
    """Return how the serializer goes through a struct at an offset, field by field."""
    words = []
    layout = struct.layout
    for name, kind, length in struct.fields:
        place = begin + layout.fields[name][1]  # type: ignore[index]
        if isinstance(kind, Struct):
            for number in range(length or 1):
                words += _instructions(kind, place + number * kind.layout.itemsize)
        elif kind == "octets":
            words += [_ADDRESS | _SEQUENCE | _CODES["uint8"] << 8, place]
        elif length:
            words += [_ADDRESS | _ARRAY | _CODES[kind] << 8, place, length]
        else:
            words += [_ADDRESS | _CODES[kind] << 16, place]
    return words


@cache
def _descriptor(struct: Struct) -> _Descriptor:
    """Return the description of a type by its name alone, without the information from which others check it.

    With that information, DDS 0.10.2 of Unitree's SDK ends in a segmentation fault as soon as it sees this computer.
    """
    words = [*_instructions(struct), 0]
    return _Descriptor(
        size=struct.layout.itemsize,
        align=struct.layout.alignment,
        typename=struct.name.replace(".", "::").encode(),
        nops=len(words),
        ops=(ctypes.c_uint32 * len(words))(*words),
        meta=b"",
    )


@cache
def _domain(domain: int, interface: str) -> Any:
    """Return a domain of this process, which lives as long as it."""
    from cyclonedds.domain import Domain

    return Domain(domain, _CONFIG.format(interface))


class DdsBus(Bus):
    """The topics of a Go2."""

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
            from cyclonedds.core import DDSException
            from cyclonedds.domain import DomainParticipant
            from cyclonedds.internal import dds_c_t, load_cyclonedds
        except ImportError:
            raise MissingExtra("cyclonedds", "go2") from None

        self.heard = heard
        self._dds = load_cyclonedds()
        self._wakes, self._woken = os.pipe()
        os.set_blocking(self._wakes, False)
        os.set_blocking(self._woken, False)
        self._sources = {self._wakes: self._take}
        woken = self._woken

        def wake(*_: Any) -> None:
            with suppress(OSError):  # full: it is awake; or closed
                os.write(woken, b".")

        self._wake = ctypes.CFUNCTYPE(None, ctypes.c_int32, ctypes.c_void_p)(wake)
        self._info = dds_c_t.sample_info()
        self._message = ctypes.c_void_p()
        self._writers: dict[str, tuple[int, ctypes.c_void_p]] = {}
        for name in ("dds_create_qos", "dds_create_listener", "ddsi_serdata_from_ser_iov"):
            getattr(self._dds, name).restype = ctypes.c_void_p
        self._dds.ddsi_serdata_size.restype = ctypes.c_uint32
        try:
            _domain(wiring.domain, interface)
            self._participant: Any = DomainParticipant(wiring.domain)
            self._topics = {name: self._made("topic", name) for name in TOPICS}
            self._readers = {name: self._made("reader", name) for name in (TO_ROBOT if robot else FROM_OTHERS)}
            self._who: Any = BuiltinDataReader(self._participant, BuiltinTopicDcpsParticipant)
            self._what: Any = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        except (DDSException, OSError) as reason:
            os.close(self._wakes)
            os.close(woken)
            raise BusError(f"DDS cannot be opened on {interface}: {getattr(reason, 'msg', reason)}") from None

    def _made(self, kind: str, name: str) -> int:
        """Return a new topic, or a reader or writer of one.

        Raises:
            OSError: If there is none.
        """
        dds = self._dds
        participant = self._participant._ref
        qos = ctypes.c_void_p(dds.dds_create_qos())
        if kind == "topic":
            made = dds.dds_create_topic(participant, ctypes.byref(_descriptor(TOPICS[name])), name.encode(), None, None)
        elif kind == "reader":
            dds.dds_qset_ignorelocal(qos, _OWN)
            dds.dds_qset_history(qos, _LAST, KEPT)
            listener = ctypes.c_void_p(dds.dds_create_listener(None))
            dds.dds_lset_data_available(listener, self._wake)
            made = dds.dds_create_reader(participant, self._topics[name], qos, listener)
            dds.dds_delete_listener(listener)
        else:
            dds.dds_qset_reliability(qos, _RELIABLE, ctypes.c_int64(BLOCKS))
            made = dds.dds_create_writer(participant, self._topics[name], qos, None)
        dds.dds_delete_qos(qos)
        if made < 0:
            raise OSError(f"no {kind} for {name} (DDS error {made})")
        return int(made)

    def _writer(self, topic: str) -> tuple[int, ctypes.c_void_p]:
        """Return a writer and the type of its messages; others see it from then on."""
        if topic not in self._writers:
            made = self._made("writer", topic)
            kind = ctypes.c_void_p()
            self._dds.dds_get_entity_sertype(made, ctypes.byref(kind))
            self._writers[topic] = made, kind
        return self._writers[topic]

    def ready(self, topic: str) -> bool:
        """Return whether somebody hears what is published on a topic; announces it the first time."""
        return self._dds.dds_get_matched_subscriptions(self._writer(topic)[0], None, ctypes.c_size_t(0)) > 0

    def publish(self, channel: str, data: bytes) -> None:
        """Send a message.

        Raises:
            OSError: If the network does not take it.
        """
        dds = self._dds
        (writer, kind) = self._writer(channel)
        piece = _Piece(data, len(data))
        made = dds.ddsi_serdata_from_ser_iov(kind, _DATA, ctypes.c_size_t(1), ctypes.byref(piece), piece.size)
        if not made:
            raise OSError(f"{channel}: no message of {len(data)} bytes can be made")
        failed = dds.dds_writecdr(writer, ctypes.c_void_p(made))
        if failed < 0:
            raise OSError(f"{channel}: DDS error {failed}")

    def others(self, topic: str = LOWCMD) -> list[str]:
        """Return who else may write a topic, by computer and program as far as known, and by its number (GUID)."""
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState

        alive = SampleState.Any | ViewState.Any | InstanceState.Alive
        own = self._participant.guid
        found = {
            endpoint.participant_key
            for endpoint in self._what.read(1000, condition=ReadCondition(self._what, alive))
            if endpoint.topic_name == topic and endpoint.participant_key != own
        }
        qos = {one.key: one.qos for one in self._who.read(1000, condition=ReadCondition(self._who, alive))}
        return sorted(_program(key, qos.get(key, ())) for key in found)

    def _take(self) -> None:
        os.read(self._wakes, 4096)
        now = time.monotonic()
        dds = self._dds
        message = ctypes.byref(self._message)
        info = ctypes.byref(self._info)
        for topic, reader in self._readers.items():
            while dds.dds_takecdr(reader, message, 1, info, 0) > 0:
                self.source = int(self._info.publication_handle)
                if self._info.valid_data:  # not where a writer only left
                    data = ctypes.create_string_buffer(dds.ddsi_serdata_size(self._message))
                    size = ctypes.c_size_t(len(data))
                    dds.ddsi_serdata_to_ser(self._message, ctypes.c_size_t(0), size, data)
                    self.heard(topic, data.raw, now)
                dds.ddsi_serdata_unref(self._message)

    def close(self) -> None:
        """Leave the network. Safe to call twice."""
        if self._participant is None:
            return
        for entity in (
            *self._readers.values(),
            *(writer for writer, _ in self._writers.values()),
            *self._topics.values(),
        ):
            self._dds.dds_delete(entity)
        self._readers.clear()
        self._writers.clear()
        self._topics.clear()
        self._sources = {}
        self._who = None
        self._what = None
        self._participant = None
        os.close(self._woken)
        os.close(self._wakes)


def _program(key: Any, qos: Any) -> str:
    """Return what a participant says about its computer and program, and its number (GUID)."""
    said = {entry.key: entry.value for entry in qos if hasattr(entry, "key") and hasattr(entry, "value")}
    return (
        f"{said.get('__ProcessName', 'a program')} (pid {said.get('__Pid', '?')}) on "
        f"{said.get('__Hostname', 'an unknown computer')}, GUID {str(key)[:8]}"
    )

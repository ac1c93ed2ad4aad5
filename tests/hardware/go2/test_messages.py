"""The messages of a Go2: layout, checksum and calls, held against Unitree's own SDK and Cyclone DDS's serializer."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from mimic.errors import FrameError
from mimic.hardware.go2.messages import LOWCMD, LOWSTATE, TOPICS, Call, blank, decode, encode


def idl_type(struct):
    """Return a type as Cyclone DDS's own serializer takes it."""
    from cyclonedds import idl
    from cyclonedds.idl import types

    def kind(one, length):
        known = {"string": str, "bool": bool, "octets": types.sequence[types.uint8]}
        single = (known.get(one) or getattr(types, one)) if isinstance(one, str) else idl_type(one)
        return types.array[single, length] if length else single

    fields = {name: kind(one, length) for name, one, length in struct.fields}
    return idl.make_idl_struct(struct.name.rpartition(".")[2], struct.name, fields)


def command():
    """Return a command with numbers in every field of twelve motors."""
    message, motors = blank(LOWCMD), np.arange(12)
    first = message["motor_cmd"][:12]
    first["mode"], first["q"], first["dq"], first["tau"] = 1, 0.1 * motors, -0.5, 0.25 * motors
    first["kp"], first["kd"] = 40.0, 1.0
    return message


def test_a_command_has_the_bytes_and_the_checksum_of_unitrees_sdk():
    wire = encode(LOWCMD, command())
    # the same numbers through LowCmd_.serialize and CRC().Crc of unitree-sdk2py-dimos 1.0.3 (unitree_sdk2_python)
    assert int.from_bytes(wire[-4:], "little") == 0xFFA8C2FE
    assert hashlib.sha256(wire).hexdigest() == "04831d09ca8e97ba508493af1ffc500d2c3c5e0e3f932d5a056ebe6d7b4b270c"
    assert (len(wire), len(encode(LOWSTATE, blank(LOWSTATE)))) == (812, 1180)


@pytest.mark.parametrize("topic", [LOWCMD, LOWSTATE])
def test_random_messages_have_the_bytes_of_cyclone_dds(topic):
    pytest.importorskip("cyclonedds")
    rng = np.random.default_rng(0)

    def fill(struct, place):
        """Fill a struct in memory with numbers; return the same as Cyclone's type."""
        made = {}
        for name, kind, length in struct.fields:
            if not isinstance(kind, str):
                parts = [fill(kind, place[name][i]) for i in range(length)] if length else fill(kind, place[name])
                made[name] = parts
            else:
                place[name] = rng.integers(1, 100, length or None)
                made[name] = place[name].tolist()
        return idl_type(struct)(**made)

    memory = blank(topic)
    theirs = fill(TOPICS[topic], memory)
    ours = encode(topic, memory)
    theirs.crc = int(memory["crc"])
    assert ours == theirs.serialize()
    assert decode(topic, ours).tobytes() == memory.tobytes()


def test_calls_have_the_bytes_of_cyclone_dds():
    pytest.importorskip("cyclonedds")
    topic = "rt/api/motion_switcher/response"
    header, (_, part, _), (_, status, _) = TOPICS[topic].fields[0][1], *TOPICS[topic].fields[0][1].fields
    head = idl_type(header)(identity=idl_type(part)(id=7, api_id=1001), status=idl_type(status)(code=5))
    theirs = idl_type(TOPICS[topic])(header=head, data='{"name":"ai"}', binary=[])
    call = Call(id=7, api=1001, text='{"name":"ai"}', code=5)
    assert call.to_bytes() == theirs.serialize()
    assert Call.from_bytes(call.to_bytes(), answer=True) == call
    assert call.name() == "ai"


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"name": 3}', "nonsense"])
def test_an_answer_without_a_name_names_no_mode(text):
    assert Call(id=1, api=1001, text=text, code=0).name() is None


@pytest.mark.parametrize("wire", [b"", bytes(811), bytes(812), b"\x00\x00" + bytes(810)])
def test_bytes_that_are_no_message_are_refused(wire):
    with pytest.raises(FrameError, match="rt/lowcmd"):
        decode(LOWCMD, wire)
    with pytest.raises(FrameError, match="makes no sense"):
        Call.from_bytes(wire[:20], answer=True)


def test_one_wrong_bit_anywhere_is_found():
    wire = encode(LOWCMD, command())
    for place in (26, 40, 700, 811):
        damaged = bytearray(wire)
        damaged[place] ^= 0x10
        with pytest.raises(FrameError, match="wrong checksum"):
            decode(LOWCMD, bytes(damaged))

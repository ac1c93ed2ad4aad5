"""Messages of the stock robot, against what the maker's types give when lcm-gen 1.5 compiles them."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from mimic.errors import FrameError
from mimic.hardware.stock.messages import (
    LEG_CONTROL_DATA,
    MOTOR_CTRL,
    MOTOR_CTRL_STATE,
    SPI_DATA,
    STATE_ESTIMATOR,
    TYPES,
)

FROM_LCM_GEN = {
    "motor_ctrl": 0x7BB7CC457845ACAC,
    "motor_ctrl_state": 0x55FBEF7BEC06B5D4,
    "spi_data": 0x9B4A1512C17CE8C6,
    "leg_control_data": 0x4D630488C94854D7,
    "state_estimator": 0x18D2C31121532F5E,
}
"""Packed fingerprints of the classes that lcm-gen makes of the maker's .lcm files."""


def test_fingerprints_are_those_of_lcm_gen():
    assert {name: kind.fingerprint for name, kind in TYPES.items()} == FROM_LCM_GEN


def test_a_message_has_the_bytes_of_lcm_gen():
    assert MOTOR_CTRL_STATE.encode(err_flag=0x1E, ctrl_topic_interval=2.5).hex() == "55fbef7bec06b5d4001e40200000"


def test_a_message_of_all_kinds_of_fields_has_the_bytes_of_lcm_gen():
    data = SPI_DATA.encode(q_abad=[1, 2, 3, 4], flags=[-(2**31)] + [0] * 11, tmp_knee=[350, 351, 352, 353])
    assert (len(data), hashlib.sha256(data).hexdigest()) == (
        268,
        "0ae747395ceec0e286bfec975546ca075f4ed893acc872ff19654d90655957be",
    )


@pytest.mark.parametrize("kind", TYPES.values(), ids=TYPES)
def test_fields_survive_the_wire(kind):
    rng = np.random.default_rng(3)
    values = {}
    for name in kind.layout.names[1:]:
        layout = kind.layout.fields[name][0]
        values[name] = rng.integers(-100, 100, layout.shape).astype(layout.base.newbyteorder("="))
    message = kind.decode(kind.encode(**values))
    for name, value in values.items():
        np.testing.assert_array_equal(message[name], value)


@pytest.mark.parametrize("kind", TYPES.values(), ids=TYPES)
def test_another_length_is_refused(kind):
    with pytest.raises(FrameError, match=f"{kind.channel} has .* bytes; expected"):
        kind.decode(kind.encode()[:-1])


def test_another_type_of_the_same_length_is_refused():
    data = bytearray(STATE_ESTIMATOR.encode())
    data[:8] = LEG_CONTROL_DATA.encode()[:8]
    with pytest.raises(FrameError, match="defines this message differently"):
        STATE_ESTIMATOR.decode(bytes(data))


def test_a_command_has_the_length_of_sixty_floats_and_a_fingerprint():
    assert len(MOTOR_CTRL.encode()) == 8 + 4 * 60

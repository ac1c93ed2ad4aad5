"""Bus load: the share of a bus's time that a robot takes, estimated before anything is sent.

The bits of commands and feedback are facts of the motors' maker.
"""

from __future__ import annotations

import numpy as np

from mimic.hardware.can.wiring import Wiring
from mimic.records import FloatArray

IMU_MESSAGE = {
    "quaternion": 114.8,
    "rate_of_turn": 102.1,
    "group_counter": 66.0,
    "status_word": 83.0,
    "sample_time": 86.0,
}
"""Length of each message, with stuffed bits and the pause after it [bit]: orientation and rate of turn are means of
20 000 frames of a moving robot; for counter, status and time one bit in twenty is assumed to be stuffed."""

MAX_LOAD = 0.9
"""Share of a bus above which frames pile up when they have more stuffed bits than on average."""


def expected_load(wiring: Wiring, rate_hz: float | FloatArray) -> FloatArray:
    """Return the expected share of each bus's time (buses,).

    Args:
        wiring: Which motor is on which bus.
        rate_hz: Commands a second to each motor, or to each of them (12,) [Hz].
    """
    rates = np.broadcast_to(rate_hz, wiring.bus.shape)
    motors = wiring.motors().facts
    bits = np.bincount(wiring.bus, weights=rates, minlength=wiring.buses) * (motors.command_bits + motors.feedback_bits)
    bits[wiring.imu.bus] += sum(IMU_MESSAGE[name] * rate for name, rate in wiring.imu.rate.items())
    return bits / wiring.bitrate

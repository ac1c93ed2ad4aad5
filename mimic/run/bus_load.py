"""How much of a bus's time a robot takes, worked out before anything is sent.

Bits of a frame with the payloads of a moving robot, stuffed bits and the pause after it included: means of 20 000 frames of
each kind, with exact stuffing and check sums.
"""

from __future__ import annotations

import numpy as np

from mimic.robot.wiring import Wiring
from mimic.types import FloatArray

COMMAND, FEEDBACK = 141.9, 137.5
"""29-bit identifier, 8 bytes [bit]."""

IMU_MESSAGE = {
    "quaternion": 114.8,
    "rate_of_turn": 102.1,
    "group_counter": 66.0,
    "status_word": 83.0,
    "sample_time": 86.0,
}
"""11-bit identifier [bit]. Of counter, status and time, which were not simulated, one bit in twenty is taken as stuffed."""

MOST = 0.9
"""Share of a bus above which its frames pile up when they are stuffed more than on average."""


def expected_load(wiring: Wiring, rate_hz: float | FloatArray) -> FloatArray:
    """Return the share of each bus's time (buses,) at this many commands a second to each motor, or to these motors (12,)."""
    rates = np.broadcast_to(rate_hz, wiring.bus.shape)
    bits = np.bincount(wiring.bus, weights=rates, minlength=wiring.buses) * (COMMAND + FEEDBACK)
    bits[wiring.imu.bus] += sum(IMU_MESSAGE[name] * rate for name, rate in wiring.imu.rate.items())
    return bits / wiring.bitrate

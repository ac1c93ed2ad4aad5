"""What speaks to a robot's motors: the same for twelve motors on CAN and for a maker's motion board.

A driver lives in the process that sends (`mimic.hardware.robot.process`). It has no process, no orders and no rules of
its own: `mimic.hardware.robot.sender` says when to send what.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from mimic.frozen import frozen
from mimic.hardware.robot.checks import Check, CheckOptions
from mimic.records import JOINTS, JointCommand

ALL = tuple(range(len(JOINTS)))

NEVER = -np.inf
"""When something came that never did."""

BUSES = 12
"""Most buses of a robot."""

_UNKNOWN = {"q": 12, "dq": 12, "tau": 12, "temperature": 12, "q_sent": 12, "kp_sent": 12, "kd_sent": 12, "quat_WB": 4}
_UNKNOWN |= {"omega_B": 3, "voltage": (), "round_trip": (), "busy": BUSES}
"""Numbers that are NaN until somebody says them, and their shapes."""

_TIMES = {"heard": (), "came": 12, "imu_came": (), "imu_changed": ()}

_COUNTS = {"state": (), "sent": (), "faults": 12, "running": 12, "imu_count": (), "imu_valid": (), "readings": ()}
_COUNTS |= {"errors": (), "foreign": (), "err_flag": ()}

REPORT = np.dtype(
    [(name, "f8", shape) for name, shape in {"t": (), "gap": (), **_UNKNOWN, **_TIMES}.items()]
    + [(name, "i8", shape) for name, shape in _COUNTS.items()]
)
"""The newest readings of a robot, in joint order and sign, and when each came on the monotonic clock [s].

``sent`` counts messages, ``heard`` is when anything came, ``imu_valid`` is -1 where the IMU does not say, ``readings``
counts full sets of readings where each is worth a sample, ``errors`` counts what made no sense, ``foreign`` commands of
other programs, ``err_flag`` and ``gap`` [s] are a motion board's, ``busy`` is for how long each bus was busy so far
[s] (NaN where there is no bus)."""


def no_report() -> Any:
    """Return a report without any reading: a scalar of REPORT."""
    report: Any = np.zeros((), REPORT)
    for name in _TIMES:
        report[name] = NEVER
    for name in _UNKNOWN:
        report[name] = np.nan
    report["imu_valid"] = -1
    return report


SILENT = 0.5
"""Who has said nothing for this long is shown as silent [s]."""


class Driver(Protocol):
    """Sends to a robot and keeps what it says."""

    period: float
    """Time from one message to the next [s]."""
    repeats: bool
    """Whether the robot must hear the newest command again and again."""
    problem: str
    """What is wrong with the way to the robot, as a sentence without its full stop; empty where nothing is."""

    @property
    def report(self) -> Any:
        """Newest readings; a scalar of REPORT whose time and state the sender fills in."""
        ...

    def now(self) -> float:
        """Return the driver's time: the monotonic clock [s], or that of an emulated robot."""
        ...

    def checks(self, options: CheckOptions) -> list[Check]:
        """Check a robot that nobody drives; nothing moves."""
        ...

    def start(self, *, suspended: bool) -> None:
        """Switch the motors on without gains.

        Raises:
            PlantError: If something stands against it.
            BusError: If a bus fails.
        """
        ...

    def drive(self, command: JointCommand) -> None:
        """Send a command; where the way to the robot fails, ``problem`` says so.

        Raises:
            FrameError: If it is not finite, or the robot does not take its gains.
        """
        ...

    def damp(self) -> None:
        """Send a command that only damps, over whatever still works; open again what does not."""
        ...

    def speed(self) -> float:
        """Return how fast the fastest joint moves [rad/s]; infinite where no joint says."""
        ...

    @property
    def lost(self) -> bool:
        """Whether nothing at all reaches the robot."""
        ...

    def end(self, *, since: float, rested: bool) -> str | None:
        """Switch the motors off a little more; return how the robot was left once that is done.

        Args:
            since: When ending began [s].
            rested: Whether the robot has come to rest.
        """
        ...

    def abandon(self) -> str:
        """Return how a robot is left whose start failed before its motors were on; empty where they must be damped."""
        ...

    def listen(self, until: float, wake: int | None = None) -> bool:
        """Take readings until a time [s]; return early, with True, once a full set of them is there.

        Args:
            until: On the driver's clock.
            wake: Descriptor; also return when something is to be read from it.
        """
        ...

    def close(self) -> None:
        """Let go of the robot. Safe to call twice."""
        ...


@frozen
class DriverSettings:
    """What it takes to open the driver of a robot, in any process."""

    bus_url: str
    """Buses, or the name of a motion board."""
    robot: str
    """Name of the robot's description."""
    wiring: str | None = None
    """Path of a wiring file."""
    interface: str | None = None
    """Network interface to a motion board."""
    zeroed: bool = False
    torque_limit: float | None = None
    """[N m]"""
    dry_run: bool = False

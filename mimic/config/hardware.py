"""Settings of the robot on its buses."""

from __future__ import annotations

from typing import Literal

from mimic.config.play import RAMP
from mimic.config.ranges import Limited, within
from mimic.frozen import frozen

TETHER_TORQUE = 9.0
"""Largest torque of each motor on a rope [N m]."""
TETHER_RAMP = 6.0
"""Time of the start on a rope [s]."""


@frozen
class WiringSettings(Limited):
    """What any command needs to know of a robot."""

    wiring: str | None = None
    """Your copy of bus.toml (CAN) or board.toml (stock robot); default: the shipped one."""


@frozen
class LookSettings(WiringSettings):
    """How a robot is looked at."""

    interface: str | None = None
    """Network interface to a stock robot, such as eth0, or lo for an emulated one; default: by multicast route, or for
    a Go2 by address."""
    zeroed: bool = False
    """CAN: use the zeros of the wiring file, without checking that mimic set them since power-up."""


@frozen
class DriveSettings(LookSettings):
    """How the motors of a robot are driven."""

    yes: bool = False
    """Start without waiting for Enter; for rehearsals."""
    torque_limit: float | None = None
    """CAN: largest torque of each motor [N m]; written to the motors and read back. Default: their peak torque."""

    @property
    def torque(self) -> float | None:
        """Largest torque of each motor [N m]; None for their peak torque."""
        return self.torque_limit


@frozen
class BusSettings(DriveSettings):
    """How a robot is driven by a policy."""

    ramp: float = within(RAMP, 0.5, 30.0, "s")
    """Time to raise the gains and move into the crouch [s]; a test of each joint follows."""
    dry_run: bool = False
    """CAN: run pre-flight, policy, timing and log, with the motors off."""
    tether: bool = False
    """First runs on a rope: at most 9 N m, a start of 6 s, and warnings sit the robot down. Standing up still takes
    0.4 s."""
    hold: str | None = None
    """Run only while this is held: key (any key in this terminal), or a gamepad such as /dev/input/js0."""

    @property
    def start_ramp(self) -> float:
        """Time of the start [s], longer on a rope."""
        return max(self.ramp, TETHER_RAMP) if self.tether else self.ramp

    @property
    def torque(self) -> float | None:
        """Largest torque of each motor [N m]; None for their peak torque."""
        return TETHER_TORQUE if self.tether and self.torque_limit is None else self.torque_limit


@frozen
class ProbeSettings(Limited):
    """How a suspended robot is moved to measure its drives."""

    seconds: float = within(120.0, 12.0, 3600.0, "s")
    """Length of the motion [s]."""
    rate_hz: float = within(200.0, 50.0, 250.0, "Hz")
    """Readings per second [Hz]; at 200 Hz twelve motors use 70 % of one bus."""
    amplitude: float = within(0.5, 0.05, 1.0)
    """Share of the joint ranges to use."""
    kind: Literal["probe", "random"] = "probe"
    """probe excites every effect; random is for a second log."""
    kp: float = within(30.0, 1.0, 100.0, "N m/rad")
    """Position gain [N m/rad]."""
    kd: float = within(1.0, 0.1, 5.0, "N m s/rad")
    """Velocity gain [N m s/rad]."""
    approach: float = within(3.0, 0.2, 60.0, "s")
    """Time to raise the gains, and again to move to the start of the motion [s]."""
    seed: int = within(0, 0, 2**63)
    """Seed of the motion."""

"""The makers of motors that mimic knows, by the name that a wiring file gives. One row each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from mimic.errors import ConfigError
from mimic.hardware.motors.cybergear.protocol import CyberGear
from mimic.hardware.motors.interface import MotorProtocol


class MotorMaker(Protocol):
    """Makes the protocol of a maker's motors; the class itself does."""

    def __call__(self, *, host: int, position_range: float) -> MotorProtocol:
        """Return the protocol.

        Args:
            host: Id of this computer.
            position_range: Positions on the bus reach from minus this to plus this [rad].

        Raises:
            ConfigError: If these motors cannot have such a range.
        """
        ...


MAKERS: Mapping[str, MotorMaker] = {"cybergear": CyberGear}


def make_motors(maker: str, *, host: int, position_range: float) -> MotorProtocol:
    """Return the protocol of a maker's motors.

    Args:
        maker: Name in MAKERS.
        host: Id of this computer.
        position_range: Positions on the bus reach from minus this to plus this [rad].

    Raises:
        ConfigError: If mimic does not know the maker.
    """
    if maker not in MAKERS:
        raise ConfigError(f"the motors are {maker!r}; mimic knows {', '.join(MAKERS)}")
    return MAKERS[maker](host=host, position_range=position_range)

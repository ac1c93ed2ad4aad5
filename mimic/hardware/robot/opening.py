"""Opens the driver of a robot: on CAN, or of a maker's motion board."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from mimic.hardware.robot.board_wiring import BOARDS
from mimic.hardware.robot.driver import Driver, DriverSettings


def load_driver(settings: DriverSettings) -> Callable[..., Driver]:
    """Import what opens the driver of a robot, and return it: opening is quick then."""
    if settings.bus_url == "go2":
        from mimic.hardware.go2.driver import open_go2_driver

        with suppress(ImportError):
            import cyclonedds.domain  # noqa: F401
        return open_go2_driver
    if settings.bus_url in BOARDS:
        from mimic.hardware.stock.driver import open_stock_driver

        with suppress(ImportError):
            import lcm  # noqa: F401
        return open_stock_driver
    import mimic.hardware.can.opening  # noqa: F401
    from mimic.hardware.can.open_driver import open_can_driver

    return open_can_driver


def open_driver(settings: DriverSettings, *, quick: bool = False) -> Driver:
    """Open the driver of a robot; nothing is sent.

    Args:
        settings: Which robot.
        quick: Do not wait for an adapter that starts up: it was in use a moment ago.

    Raises:
        ConfigError, AssetError, BusError, MissingExtra: If that is not possible.
    """
    return load_driver(settings)(settings, quick=quick)

"""Exception classes, sorted by what the caller can do about them."""

from __future__ import annotations

import re
from pathlib import Path


class MimicError(Exception):
    """Base of every error that mimic raises on purpose; its message says what to do next."""


class ConfigError(MimicError, ValueError):
    """A setting has a value that cannot be used."""


class AssetError(MimicError):
    """A shipped or user-given file (robot, policy, record) is missing or does not fit."""


class MissingExtra(MimicError, ImportError):
    """A library of an optional extra is not installed."""

    def __init__(self, library: str, extra: str) -> None:
        self.library = library
        self.extra = extra
        super().__init__(f"this needs {library}, which is not installed: {install_line(extra)}")

    def __reduce__(self) -> tuple[type[MissingExtra], tuple[str, str]]:
        return type(self), (self.library, self.extra)


def install_line(extra: str) -> str:
    """Return the command that installs the packages of an optional extra, also outside a checkout of mimic."""
    from importlib.metadata import PackageNotFoundError, requires

    try:
        marked = [line.partition(";") for line in requires("mimic-retarget") or ()]
    except PackageNotFoundError:  # run from a checkout that was not installed
        return f"pip install '{Path(__file__).parents[1]}[{extra}]'"
    wanted = [name.strip() for name, _, marker in marked if re.search(rf"extra == .{extra}\b", marker)]
    return " ".join(["pip install", *(f"'{name}'" for name in wanted)])


class SourceError(MimicError):
    """The input (video, track) cannot give a human motion."""


class ContractError(MimicError):
    """Two parts that must agree (policy and robot, record and reader) do not."""


class PlantError(MimicError):
    """The robot or the simulation failed while running."""


class SenderError(PlantError):
    """The process that sends to a robot has ended, hangs, or has damped the robot."""


class BusError(PlantError):
    """A bus cannot be opened, or has failed."""


class FrameError(PlantError):
    """A frame on a bus does not follow its protocol."""


class UnknownFrame(FrameError):
    """A frame on a bus is of another protocol, so that its sender is not known."""


class CalibrationError(MimicError):
    """A log cannot be calibrated from."""

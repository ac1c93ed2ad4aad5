"""Exception classes, sorted by what the caller can do about them."""


class MimicError(Exception):
    """Base of every error that mimic raises on purpose; its message says what to do next."""


class ConfigError(MimicError, ValueError):
    """A setting has a value that cannot be used."""


class AssetError(MimicError):
    """A shipped or user-given file (robot, policy, record) is missing or does not fit."""


class MissingExtra(MimicError, ImportError):
    """A library of an optional extra is not installed."""

    def __init__(self, library: str, extra: str) -> None:
        self.library, self.extra = library, extra
        super().__init__(
            f"this needs {library}, which is not installed; in a checkout of mimic: pip install '.[{extra}]'"
        )


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

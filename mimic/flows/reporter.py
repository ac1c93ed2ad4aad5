"""Where a flow sends its notes, warnings and progress."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

from mimic.errors import ConfigError

Progress = Callable[[int, int | None], None]
"""Takes the steps done, and their total where it is known."""

Activity = Callable[[str, int], None]
"""Takes what is being done, and a count."""


class Reporter(Protocol):
    """Receives what a flow has to say while it works."""

    def note(self, text: str) -> None:
        """Take a line that the user should read."""
        ...

    def warn(self, text: str) -> None:
        """Take a warning."""
        ...

    def progress(self, what: str) -> AbstractContextManager[Progress]:
        """Return a context that gives a function of the steps done and their total."""
        ...

    def activity(self, unit: str) -> AbstractContextManager[Activity]:
        """Return a context for work of unknown length; its function takes what is being done and a count of units."""
        ...


class SilentReporter:
    """Shows nothing and keeps the warnings."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def note(self, text: str) -> None:
        """Drop it."""

    def warn(self, text: str) -> None:
        """Keep it."""
        self.warnings.append(text)

    def progress(self, what: str) -> AbstractContextManager[Progress]:
        """Return a context whose function does nothing."""
        return nullcontext(lambda done, total=None: None)

    def activity(self, unit: str) -> AbstractContextManager[Activity]:
        """Return a context whose function does nothing."""
        return nullcontext(lambda text, count: None)


def reporting(reporter: Reporter | None) -> Reporter:
    """Return the reporter, a silent one for None.

    Raises:
        ConfigError: If it is no reporter.
    """
    if reporter is not None and not hasattr(reporter, "progress"):
        raise ConfigError(f"reporter is {reporter!r}; expected an object with note, warn, progress and activity")
    return reporter or SilentReporter()

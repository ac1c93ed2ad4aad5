"""Which command made a file: stored with everything that a flow writes."""

from __future__ import annotations

from collections.abc import Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mimic.records import Provenance

COMMAND: ContextVar[str] = ContextVar("command", default="python")
"""The command line that runs; "python" where mimic is used as a library."""


def provenance(settings: Any = None, inputs: Mapping[str, Path] | None = None) -> Provenance:
    """Return the provenance of what the running command writes.

    Args:
        settings: Settings used, as dataclasses or plain data.
        inputs: Name of each input file -> its path; its SHA-256 is stored.
    """
    from mimic.io import store

    return store.provenance(command=COMMAND.get(), settings=settings, inputs=inputs)

"""The command line: parse, load, call one flow, save, exit status. Heavy libraries load inside the commands.

Exit status: 0 done, 1 a bug (with its traceback), 2 something for the user to mend, 3 stopped for safety.
"""

from __future__ import annotations

import shlex
import sys
from contextvars import ContextVar

COMMAND: ContextVar[str] = ContextVar("command", default="mimic")
"""The command line that runs, for the provenance of what it writes."""


def main(arguments: list[str] | None = None) -> int:
    """Run the ``mimic`` command and return its exit status."""
    from mimic.cli.app import run

    words = sys.argv[1:] if arguments is None else arguments
    COMMAND.set(shlex.join(["mimic", *words]))
    return run(words)

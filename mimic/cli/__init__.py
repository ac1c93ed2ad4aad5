"""The command line: each command parses its options, calls one flow, prints, and returns an exit status."""

from __future__ import annotations

import shlex
import sys

from mimic.cli.exit_status import STOPPED


def main(arguments: list[str] | None = None) -> int:
    """Run the ``mimic`` command and return its exit status (see mimic.cli.exit_status)."""
    try:
        from mimic.cli.app import run
        from mimic.flows.provenance import COMMAND
    except KeyboardInterrupt:  # Ctrl-C in the first second
        print("mimic: interrupted", file=sys.stderr)
        return STOPPED
    words = sys.argv[1:] if arguments is None else arguments
    COMMAND.set(shlex.join(["mimic", *words]))
    return run(words)

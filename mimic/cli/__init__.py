"""The command line: each command parses its options, calls one flow, prints, and returns an exit status."""

from __future__ import annotations

import shlex
import sys


def main(arguments: list[str] | None = None) -> int:
    """Run the ``mimic`` command and return its exit status (see mimic.cli.exit_status)."""
    from mimic.cli.app import run
    from mimic.flows.provenance import COMMAND

    words = sys.argv[1:] if arguments is None else arguments
    COMMAND.set(shlex.join(["mimic", *words]))
    return run(words)

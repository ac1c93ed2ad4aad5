"""The command line: each command parses its options, calls one flow, prints, and returns an exit status."""

from __future__ import annotations

import io
import sys
from pathlib import Path

from mimic.cli.terminal.exit_status import DONE, STOPPED

HELP = Path(__file__).with_name("help.txt")
"""The help of the bare command, drawn before: the parser takes half a second to draw it. Written by
``python tests/golden/test_golden.py help``."""


def main(arguments: list[str] | None = None) -> int:
    """Run the ``mimic`` command and return its exit status (see mimic.cli.terminal.exit_status)."""
    try:
        for stream in (sys.stdout, sys.stderr):  # what a terminal cannot show becomes a question mark
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")
        words = sys.argv[1:] if arguments is None else arguments
        if words in ([], ["--help"], ["-h"]):
            print(HELP.read_text(encoding="utf-8"), end="")
            return DONE
        import shlex

        from mimic.cli.app import run
        from mimic.flows.provenance import COMMAND
    except KeyboardInterrupt:  # Ctrl-C in the first second
        print("mimic: interrupted", file=sys.stderr)
        return STOPPED
    COMMAND.set(shlex.join(["mimic", *words]))
    return run(words)

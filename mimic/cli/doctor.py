"""``mimic doctor``: what this computer has, and the line that fixes what is missing."""

from __future__ import annotations

from mimic.cli.terminal.console import table
from mimic.cli.terminal.exit_status import DONE, USER_ERROR
from mimic.flows.doctor import examine


def doctor() -> int:
    """Say what is installed and connected, and how to fix what is missing; nothing moves."""
    findings = list(examine())
    rows = {f.name: ("ok  " if f.ok else "–   ") + f.text + (f"\n    → {f.fix}" if f.fix else "") for f in findings}
    table("This computer", rows)
    return USER_ERROR if any(f.needed and not f.ok for f in findings) else DONE

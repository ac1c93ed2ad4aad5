"""Finds the files that ship with mimic, and the folder of the user in which it keeps files of its own."""

from __future__ import annotations

import os
from pathlib import Path

from mimic.errors import AssetError

_PACKAGE = Path(__file__).resolve().parents[1]

DEMO_CLIP = ("examples", "videos", "waving.mp4")
"""The example clip that also ships in the wheel; ``shipped(*DEMO_CLIP)`` finds it."""


def user_cache(name: str) -> Path:
    """Return the folder of a name in the user's cache, such as ``~/.cache/mimic/pose``; it may not exist yet."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "mimic" / name


def manual(page: str) -> str:
    """Return the path of a page of the manual, such as ``manual("log-format.md")``; for messages."""
    return str(shipped("docs", "manual", page))


def shipped(*parts: str) -> Path:
    """Return the path of a shipped file or folder, such as ``shipped("assets", "cyberdog2")``.

    Raises:
        AssetError: If it is in neither place.
    """
    for root in (_PACKAGE, _PACKAGE.parent):
        path = root.joinpath(*parts)
        if path.exists():
            return path
    raise AssetError(f"{'/'.join(parts)} is missing from this installation of mimic; install it again")

"""Finds the files that ship with mimic: inside the installed package, or beside it in a checkout."""

from __future__ import annotations

from pathlib import Path

from mimic.errors import AssetError

_PACKAGE = Path(__file__).resolve().parents[1]

DEMO_CLIP = ("examples", "videos", "waving.mp4")
"""The example clip that also ships in the wheel; ``shipped(*DEMO_CLIP)`` finds it."""


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

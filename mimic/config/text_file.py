"""Text files of any encoding, and the one reader of JSON and TOML."""

from __future__ import annotations

import codecs
import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


DEEPEST = 40
"""Levels of tables and lists in a file; mimic's own have six."""


def from_json(text: str | bytes) -> Any:
    """Return what a text in JSON holds.

    Raises:
        ValueError: If it is none, or is nested too deeply.
    """
    return _read(json.loads, text)


def from_toml(text: str) -> dict[str, Any]:
    """Return what a text in TOML holds.

    Raises:
        ValueError: If it is none, or is nested too deeply.
    """
    return _read(tomllib.loads, text)


def _read(loads: Callable[[Any], Any], text: str | bytes) -> Any:
    try:
        whole = loads(text)
    except RecursionError:
        whole = None
    else:
        if _shallow(whole):
            return whole
    raise ValueError(f"it is nested too deeply; expected at most {DEEPEST} levels")


def _shallow(whole: Any) -> bool:
    level: list[Any] = [whole]
    for _ in range(DEEPEST):
        parts: list[Any] = []
        for table in level:
            if isinstance(table, dict | list):  # pyrefly: ignore[implicit-any-type-argument]
                parts += table.values() if isinstance(table, dict) else table
        level = parts
    return not level


def read_text(path: Path) -> str:
    """Return the text of a file: UTF-8 or UTF-16, with or without a byte order mark; what is neither becomes U+FFFD."""
    data = path.read_bytes()
    marked = next((name for mark, name in _MARKS.items() if data.startswith(mark)), None)
    zeros = [data[start:2000:2].count(0) for start in (0, 1)]  # of Latin text in UTF-16 each other byte is zero
    plain = "utf-8" if max(zeros) <= len(data[:2000]) // 4 else "utf-16-be" if zeros[0] > zeros[1] else "utf-16-le"
    return data.decode(marked or plain, errors="replace")

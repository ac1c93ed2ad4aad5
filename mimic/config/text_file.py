"""Text files of any encoding."""

from __future__ import annotations

import codecs
from pathlib import Path

_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def read_text(path: Path) -> str:
    """Return the text of a file: UTF-8 or UTF-16, with or without a byte order mark; what is neither becomes U+FFFD."""
    data = path.read_bytes()
    marked = next((name for mark, name in _MARKS.items() if data.startswith(mark)), None)
    zeros = [data[start:2000:2].count(0) for start in (0, 1)]  # of Latin text in UTF-16 each other byte is zero
    plain = "utf-8" if max(zeros) <= len(data[:2000]) // 4 else "utf-16-be" if zeros[0] > zeros[1] else "utf-16-le"
    return data.decode(marked or plain, errors="replace")

"""Faults of the environment as one line each: what was given, what is wrong, and what to do."""

from __future__ import annotations

import errno

_OPENING = {
    errno.EACCES: "no permission; add your user to the group that owns it (often dialout) and log in again",
    errno.EPERM: "no permission; add your user to the group that owns it (often dialout) and log in again",
    errno.EBUSY: "another program uses it; close that program",
    errno.ENOENT: "there is no such device; plug the adapter in and check its name",
    errno.ENETDOWN: "the interface is down; bring it up, such as with: ip link set can0 up type can bitrate 1000000",
}


def first_line(reason: BaseException) -> str:
    """Return the first line of an exception's text, or its class name if it has no text."""
    text = str(reason).strip()
    return text.splitlines()[0] if text else type(reason).__name__


def error_number(reason: BaseException | None) -> int | None:
    """Return the operating system's error number behind an exception, or None; drivers wrap it in their own classes."""
    for _ in range(5):
        if reason is None:
            return None
        for name in ("errno", "error_code"):
            number = getattr(reason, name, None)
            if isinstance(number, int):
                return number
        reason = reason.__cause__ or reason.__context__
    return None


def explain(reason: BaseException) -> str:
    """Return what is wrong and what to do, in one line."""
    return _OPENING.get(error_number(reason) or 0, first_line(reason))

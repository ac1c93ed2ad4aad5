"""A wiring file and its fields, read and checked."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from mimic.config.text_file import from_toml, read_text
from mimic.errors import AssetError, ConfigError

T = TypeVar("T")


def read_file(path: Path, understand: Callable[[Mapping[str, Any]], T]) -> T:
    """Return what a function makes of a TOML file.

    Raises:
        AssetError: If there is no such file.
        ConfigError: If it is not TOML, or the function raises it; the message names the file.
    """
    try:
        raw = from_toml(read_text(path))
    except OSError as reason:
        raise AssetError(f"{path} cannot be read: {reason.strerror}") from None
    except ValueError as reason:
        raise ConfigError(f"{path} is not TOML: {reason}") from None
    try:
        return understand(raw)
    except ConfigError as reason:
        raise ConfigError(f"{path}: {reason}") from None


def table(raw: Mapping[str, Any], name: str, where: str) -> Mapping[str, Any]:
    """Return a table.

    Raises:
        ConfigError: If it is missing.
    """
    value = raw.get(name)
    if not isinstance(value, Mapping):
        raise ConfigError(f"{where} lacks the table {name}")
    return value


def number(raw: Mapping[str, Any], name: str, where: str) -> float:
    """Return a finite number.

    Raises:
        ConfigError: If it is missing or something else.
    """
    value = raw.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f"{name} of {where} is {value!r}; expected a number")
    return float(value)


def whole(raw: Mapping[str, Any], name: str, where: str, low: int, high: int) -> int:
    """Return a whole number from ``low`` to ``high``.

    Raises:
        ConfigError: If it is missing, something else, or outside.
    """
    value = raw.get(name)
    if type(value) is not int or not low <= value <= high:
        raise ConfigError(f"{name} of {where} is {value!r}; expected a whole number from {low} to {high}")
    return value

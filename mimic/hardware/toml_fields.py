"""Fields of a wiring file, read and checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from mimic.errors import ConfigError


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

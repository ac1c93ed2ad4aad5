"""Limits of settings."""

from __future__ import annotations

from dataclasses import field, fields
from numbers import Integral, Real
from typing import Any

from mimic.errors import ConfigError


def within(default: float | str | None, low: float, high: float, unit: str = "") -> Any:
    """Return a field of `Limited` settings, whose numbers lie between limits, ends included."""
    return field(default=default, metadata={"limits": (low, high, unit)})


def required(low: float, high: float, unit: str = "") -> Any:
    """Return a field as `within` does, without a default."""
    return field(metadata={"limits": (low, high, unit)})


KINDS = {
    "int": (Integral, "a whole number"),
    "float": (Real, "a number"),
    "str": (str, "text"),
    "str | None": (str | None, "text"),
    "bool": (bool, "True or False"),
}
"""What settings may be, by their annotation."""


class Limited:
    """Settings whose kind is checked, and of which those that are `within` limits lie between them."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            name = f.name.replace("_", "-")
            kind, said = KINDS.get(str(f.type), (object, ""))
            if not isinstance(value, kind):
                raise ConfigError(f"{name} is {value!r}; expected {said}")
            if "limits" in f.metadata and isinstance(value, Real):
                check_range(name, float(value), *f.metadata["limits"])


def check_range(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Raise a ConfigError unless a setting lies between its limits, ends included."""
    if not low <= value <= high:
        suffix = f" {unit}" if unit else ""
        raise ConfigError(f"{name} is {value:g}{suffix}; it must be from {low:g} to {high:g}{suffix}")

"""Checks that settings share."""

from __future__ import annotations

from mimic.errors import ConfigError


def check_range(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Raise a ConfigError unless a setting lies between its limits, ends included."""
    if not low <= value <= high:
        suffix = f" {unit}" if unit else ""
        raise ConfigError(f"{name} is {value:g}{suffix}; it must be from {low:g} to {high:g}{suffix}")

"""Settings from TOML: values with the type of their field."""

from __future__ import annotations

from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from mimic.config.text_file import from_toml, read_text
from mimic.errors import ConfigError


def read_toml(path: Path) -> dict[str, Any]:
    """Return what a TOML file holds.

    Raises:
        ConfigError: If it cannot be read, or is none.
    """
    try:
        return from_toml(read_text(path))
    except OSError as reason:
        raise ConfigError(f"{path} cannot be read ({reason.strerror})") from None
    except ValueError as reason:
        raise ConfigError(f"{path} is not a TOML file: {reason}") from None


def fitted(value: Any, hint: Any) -> Any:
    """Return a value of TOML as its field has it.

    Raises:
        TypeError: If it does not fit.
    """
    kind = get_origin(hint)
    parts = get_args(hint)
    if kind in (Union, UnionType):
        for part in parts:
            try:
                return fitted(value, part)
            except TypeError:
                pass
    elif kind is Literal:
        if value in parts and isinstance(value, str):
            return value
    elif kind is tuple and isinstance(value, list):
        parts = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        if len(parts) == len(value):
            return tuple(fitted(one, part) for one, part in zip(value, parts, strict=True))
    elif hint is float and type(value) is int:
        return float(value)
    elif hint is Path and isinstance(value, str):
        return Path(value)
    elif type(value) is hint:
        return value
    raise TypeError


def expected(hint: Any) -> str:
    """Return what a value must be, in words."""
    kind = get_origin(hint)
    parts = get_args(hint)
    if kind in (Union, UnionType):
        return " or ".join(expected(part) for part in parts if part is not NoneType)
    if kind is Literal:
        return " or ".join(f'"{one}"' for one in parts)
    if kind is tuple:
        many = "several" if parts[-1] is Ellipsis else str(len(parts))
        return f"a list of {many}, each {expected(parts[0])}"
    return {bool: "true or false", int: "a whole number", float: "a number", str: "text in quotes"}.get(
        hint, "a file name in quotes"
    )

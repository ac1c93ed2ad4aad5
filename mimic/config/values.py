"""Settings from TOML: values with the type of their field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from mimic.config.text_file import from_toml, read_text
from mimic.errors import ConfigError

S = TypeVar("S")

_hints = cache(get_type_hints)


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


def read_made(kind: type[S], file: Path, **more: Any) -> S:
    """Return a dataclass from a TOML file, and from what else is given.

    Raises:
        ConfigError: If the file cannot be read or does not fit; the message names it.
    """
    table = read_toml(file)
    try:
        return made(kind, {**table, **more})
    except ConfigError as reason:
        raise ConfigError(f"{file}: {reason}") from None


def made(kind: type[S], table: Any, above: str = "", base: S | None = None) -> S:
    """Return a dataclass from a table of TOML; what the table lacks is as in another one, or has its default.

    Args:
        kind: Of settings; a field may itself be a dataclass, or a mapping of names to something.
        table: Name -> value.
        above: Where the table is, with what separates it from its names.
        base: Of the same kind.

    Raises:
        ConfigError: If there is no such field, one is missing, or a value does not fit.
    """
    hints = _hints(kind)
    if not isinstance(table, Mapping):
        names = ", ".join(above + name for name in hints)
        raise ConfigError(f"{above.strip(' .')} is {table!r}; set one of its fields: {names}")
    unknown = [name for name in table if name not in hints]
    if unknown:
        raise ConfigError(f"there is no setting {above + unknown[0]!r}; there are {', '.join(hints)}")
    values = {name: _one(hints[name], value, above + name, getattr(base, name, None)) for name, value in table.items()}
    try:
        if base is not None:
            return replace(base, **values)  # type: ignore[type-var]
        for f in fields(kind):  # type: ignore[arg-type]
            if f.name not in values and f.default is MISSING and f.default_factory is MISSING:
                raise ConfigError(f"{f.name} is missing")
        return kind(**values)
    except ConfigError as reason:
        raise ConfigError(f"{above}{reason}") from None


def _one(hint: Any, value: Any, name: str, base: Any) -> Any:
    """Return a value of TOML as its field has it."""
    if is_dataclass(hint):
        return made(hint, value, f"{name}.", base)  # type: ignore[arg-type]
    if get_origin(hint) is Mapping and isinstance(value, Mapping):
        return {key: _one(get_args(hint)[1], one, f"{name}.{key}", None) for key, one in value.items()}
    try:
        return fitted(value, hint)
    except TypeError:
        raise ConfigError(f"{name} is {value!r}; expected {expected(hint)}") from None


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
    elif hint is Path and isinstance(value, str | Path):
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
    if kind is Mapping:
        return "a table"
    if kind is tuple:
        many = "several" if parts[-1] is Ellipsis else str(len(parts))
        return f"a list of {many}, each {expected(parts[0])}"
    return {bool: "true or false", int: "a whole number", float: "a number", str: "text in quotes"}.get(
        hint, "a file name in quotes"
    )

"""Settings from ``name=value`` words, and from recipes."""

from __future__ import annotations

import ast
import dataclasses
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from mimic.config.training import LearnSettings, MdpSettings
from mimic.errors import ConfigError
from mimic.io.assets import shipped

S = TypeVar("S")

RECIPES = ("stand_track",)
"""Shipped policies whose training can be repeated by name."""


def changed(settings: S, path: str, value: Any, whole: str = "") -> S:
    """Return the settings with the field at ``path`` (dots go down) replaced; lists become tuples.

    Args:
        settings: A settings dataclass.
        path: Name of a field, or ``field.field``.
        value: Its new value, of the kind of the old one.
        whole: The path as the user wrote it, for messages.

    Raises:
        ConfigError: If there is no such field, or the value is of another kind.
    """
    whole = whole or path
    name, _, rest = path.partition(".")
    if not dataclasses.is_dataclass(settings) or name not in {f.name for f in dataclasses.fields(settings)}:
        raise ConfigError(f"there is no setting {whole!r}")
    before = getattr(settings, name)
    if rest:
        value = changed(before, rest, value, whole)
    elif dataclasses.is_dataclass(before):
        fields = ", ".join(f"{whole}.{f.name}" for f in dataclasses.fields(before))
        raise ConfigError(f"{whole} is {value!r}; set one of its fields: {fields}")
    else:
        value = tuple(value) if isinstance(value, list) else value
        if not _fits(value, before):
            kinds = {bool: "True or False", int: "a whole number", float: "a number"}
            kind = (kinds | {tuple: "a list of numbers", str: "a word"})[type(before)]
            raise ConfigError(f"{whole} is {_shown(value)}; expected {kind} such as {_shown(before)}")
    return dataclasses.replace(settings, **{name: value})  # type: ignore[type-var]


def _fits(value: Any, before: Any) -> bool:
    if isinstance(before, tuple):
        return isinstance(value, tuple) and all(isinstance(v, int | float) for v in value)
    if isinstance(before, bool) or isinstance(value, bool):
        return isinstance(value, bool) and isinstance(before, bool)
    return isinstance(value, int | float if isinstance(before, float) else type(before))


def _shown(value: Any) -> str:
    return repr(list(value) if isinstance(value, tuple) else value)


def with_overrides(mdp: MdpSettings, learn: LearnSettings, words: list[str]) -> tuple[MdpSettings, LearnSettings]:
    """Return the settings with ``name=value`` words applied, such as ``rewards.slip=-0.4``.

    Raises:
        ConfigError: If a word has no such form, names no setting, or its value does not fit.
    """
    for word in words:
        name, equals, text = word.partition("=")
        if not equals:
            raise ConfigError(f"{word!r} is not a setting; expected name=value")
        try:
            value = ast.literal_eval(text)
        except (ValueError, SyntaxError):
            value = text
        first = name.split(".")[0]
        if first in {f.name for f in dataclasses.fields(mdp)}:
            mdp = changed(mdp, name, value)
        elif first in {f.name for f in dataclasses.fields(learn)}:
            learn = changed(learn, name, value)
        else:
            names = [f.name for s in (mdp, learn) for f in dataclasses.fields(s)]
            raise ConfigError(f"there is no setting {name!r}; there are {', '.join(names)}")
    return mdp, learn


def recipe(name: str) -> list[str]:
    """Return the words of a recipe: a TOML file of settings, or the name of a policy that ships with its recipe.

    Raises:
        ConfigError: If there is no such recipe, or it is no TOML.
        AssetError: If the shipped one is missing.
    """
    path = Path(name)
    if path.suffix != ".toml":
        if name not in RECIPES:
            raise ConfigError(f"there is no recipe {name!r}; give a .toml file or one of {', '.join(RECIPES)}")
        path = shipped("policies", f"{name}.toml")
    try:
        return _words(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as reason:
        raise ConfigError(f"the recipe {path} cannot be read ({reason})") from None


def _words(table: dict[str, Any], before: str = "") -> list[str]:
    found: list[str] = []
    for name, value in table.items():
        if isinstance(value, dict):
            found += _words(value, f"{before}{name}.")  # pyright: ignore[reportUnknownArgumentType]
        else:
            found.append(f"{before}{name}={value!r}")
    return found

"""Settings from ``name=value`` words."""

from __future__ import annotations

import ast
import dataclasses
from typing import Any, TypeVar

from mimic.errors import ConfigError
from mimic.settings import LearnSettings, MdpSettings

S = TypeVar("S")


def changed(settings: S, path: str, value: Any) -> S:
    """Return the settings with the field at ``path`` (dots go down) replaced; lists become tuples."""
    name, _, rest = path.partition(".")
    inner = changed(getattr(settings, name), rest, value) if rest else value
    return dataclasses.replace(settings, **{name: inner})  # type: ignore[type-var]


def with_overrides(mdp: MdpSettings, learn: LearnSettings, words: list[str]) -> tuple[MdpSettings, LearnSettings]:
    """Return the settings with ``name=value`` words applied, such as ``rewards.slip=-0.4``.

    Raises:
        ConfigError: If a word has no such form or names no setting.
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

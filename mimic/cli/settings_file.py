"""``--config FILE``: settings from a TOML file, a section for each group; ``mimic config`` prints all."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from textwrap import wrap
from typing import Any, get_args, get_type_hints

from cyclopts import App, Parameter, Token
from cyclopts.argument import Argument, ArgumentCollection
from cyclopts.exceptions import UnknownOptionError

from mimic.cli.options import SECTIONS
from mimic.config.values import expected, made, read_toml
from mimic.errors import ConfigError

Given = Mapping[str, Mapping[str, Any]]
"""Section -> setting -> value."""


def read_settings(path: Path) -> Given:
    """Return the settings that a file gives, each with the type and range of its field.

    Raises:
        ConfigError: If a section or key is unknown, or a value has a wrong type or is out of range.
    """
    if not path.is_file():
        raise ConfigError(f"there is no file {path}; --config expects a TOML file with settings (see: mimic config)")
    sections = read_toml(path)
    given: dict[str, dict[str, Any]] = {}
    for section, values in sections.items():
        if section not in SECTIONS:
            what = f"section [{section}]" if isinstance(values, dict) else f"key {section} outside a section"
            raise ConfigError(f"{path}: unknown {what}; sections are {', '.join(SECTIONS)}")
        if not isinstance(values, dict):
            raise ConfigError(f"{path}: {section} is {values!r}; expected a section [{section}]")
        settings = made(SECTIONS[section], values, f"{path}: [{section}] ")
        given[section] = {key: getattr(settings, key) for key in values}
    return given


def apply_settings(given: Given, app: App, commands: tuple[str, ...], arguments: ArgumentCollection) -> None:
    """Fill what the command line leaves open; sections that the command does not use are left alone."""
    typed = {name for argument in arguments if argument.has_tokens for name in argument.names}
    other_robot = "robot" if "--sim" in typed else "effects" if "--robot" in typed else ""
    for section, argument in _groups(arguments):
        values = {} if section == other_robot else given.get(section, {})
        for child in argument.children:
            if child.keys[-1] in values and not child.has_tokens:
                child.parameter = Parameter.combine(child.parameter, Parameter(parse=True))
                child.append(Token(implicit_value=values[child.keys[-1]], source="--config"))


def _groups(arguments: ArgumentCollection) -> list[tuple[str, Argument]]:
    """Return each group of settings among the arguments of a command, with its section."""
    found = []
    for argument in arguments:
        kinds: list[type] = [kind for kind in get_args(argument.hint) if isinstance(kind, type) and is_dataclass(kind)]
        section = next((s for s, kind in SECTIONS.items() if kinds and issubclass(kind, kinds[0])), None)
        if section is not None:
            found.append((section, argument))
    return found


def where_to_set(error: UnknownOptionError) -> str | None:
    """Return how to give an option that is a setting of a file only; None if there is no such setting."""
    option = error.token.keyword or error.token.value
    name = re.sub("^--(no-)?", "", option.partition("=")[0]).replace("-", "_")
    for section, argument in _groups(error.argument_collection):
        if any(child.keys[-1] == name for child in argument.children):
            return (
                f"{option} is a setting, not an option: put [{section}] and below it {name} = ... into a file, and add "
                "--config FILE (mimic config prints all settings)"
            )
    return None


def config() -> int:
    """Print all settings with their defaults as a TOML file, to be edited and given to --config."""
    print("\n".join(_template()))
    return 0


def _template() -> list[str]:
    """Return the lines of a file with every setting at its default; those without a default are commented out."""
    from docstring_parser import parse_from_object

    lines = ["# Settings of mimic, all at their defaults: keep what you change and give the file to --config."]
    for section, kind in SECTIONS.items():
        helps = {}
        for one in reversed(kind.__mro__[:-1]):
            parsed = parse_from_object(one)
            helps |= {parameter.arg_name: parameter.description or "" for parameter in parsed.params}
        lines += ["", *(f"# {line}" for line in wrap(kind.__doc__ or "", 100)), f"[{section}]"]
        hints = get_type_hints(kind)
        defaults = kind()
        for f in fields(kind):
            lines += [f"# {line}" for line in wrap(" ".join(helps.get(f.name, "").split()), 100)]
            value = getattr(defaults, f.name)
            unset = f"# {f.name} = ...  # {expected(hints[f.name])}"
            lines.append(unset if value is None else f"{f.name} = {json.dumps(value, default=str, ensure_ascii=False)}")
    return lines

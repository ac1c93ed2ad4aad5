"""Which effects a machine has, with numbers: the file that calibration writes and every other flow reads.

[[effect]]
name = "stribeck"
role = "fixed"                 # off, fixed or fitted; all but off are applied
joints = ["FL_knee", "FR_knee"]
level = [0.21, 0.19]           # one number for each joint, or one for all
speed = 0.1
source = "calibration of probe.parquet"
[effect.interval]              # optional, 95 %
level = [[0.19, 0.23], [0.17, 0.21]]
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mimic.config.values import expected, fitted, read_toml
from mimic.dynamics.catalogue import effect as find_effect
from mimic.errors import ConfigError
from mimic.io.store import written_whole
from mimic.records import FloatArray

Role = Literal["off", "fixed", "fitted"]


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectValues:
    """One effect with its numbers."""

    name: str
    """Name in the catalogue."""
    joints: tuple[str, ...] = ()
    """Joints that have it; empty for an effect of the whole machine."""
    values: Mapping[str, FloatArray]
    """Value of each parameter, one for each joint (J,), or (1,) for the whole machine; units of the catalogue."""
    intervals: Mapping[str, FloatArray] = field(default_factory=dict)
    """95 % interval of each parameter (J, 2), where known."""
    role: Role = "fixed"
    """Off, fixed or fitted; fixed and fitted effects are applied."""
    source: str = ""
    """Where the numbers come from."""

    def __post_init__(self) -> None:
        spec = find_effect(self.name)
        if spec.scope == "machine" and self.joints:
            raise ConfigError(f"effect {self.name!r} belongs to the whole machine; leave out its joints")
        if spec.scope == "joint" and not self.joints:
            raise ConfigError(f'effect {self.name!r} belongs to joints; name them, such as joints = ["FL_knee"]')
        if len(set(self.joints)) < len(self.joints):
            raise ConfigError(f"effect {self.name!r} has a joint twice: {', '.join(self.joints)}")
        count = max(1, len(self.joints))
        values = {name: _row(self.name, name, value, count) for name, value in self.values.items()}
        for name, row in values.items():
            parameter = spec.parameter(name)
            for value in row:
                if not np.isfinite(value) or not parameter.low <= value <= parameter.high:
                    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
                    raise ConfigError(
                        f"{self.name}.{name} is {value:g}{unit}; "
                        f"it must be from {parameter.low:g} to {parameter.high:g}{unit}"
                    )
        for name, rows in self.intervals.items():
            spec.parameter(name)
            if np.asarray(rows).shape != (count, 2):
                raise ConfigError(
                    f"the interval of {self.name}.{name} has shape {np.shape(rows)}, expected {(count, 2)}"
                )
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "intervals", {k: np.asarray(v, dtype=np.float64) for k, v in self.intervals.items()})


def _row(effect: str, name: str, value: Any, count: int) -> FloatArray:
    row = np.atleast_1d(np.asarray(value, dtype=np.float64))
    if row.shape == (1,):
        row = np.repeat(row, count)
    if row.shape != (count,):
        raise ConfigError(f"{effect}.{name} has {row.size} values for {count} joints; give one, or one for each")
    row.setflags(write=False)
    return row


@dataclass(frozen=True, eq=False)
class EffectSet:
    """Ordered effects of one machine; replaced, never edited."""

    effects: tuple[EffectValues, ...] = ()

    def __post_init__(self) -> None:
        names = [e.name for e in self.effects]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ConfigError(f"effect {twice[0]!r} is given twice; put its joints into one entry")

    @property
    def applied(self) -> tuple[EffectValues, ...]:
        """Those that act: all but the ones with role off."""
        return tuple(e for e in self.effects if e.role != "off")

    def __iter__(self) -> Any:
        return iter(self.effects)

    def __len__(self) -> int:
        return len(self.effects)


def read_effects(path: str | Path) -> EffectSet:
    """Read an effects.toml.

    Raises:
        ConfigError: If it is no such file, or a value does not fit the catalogue.
    """
    file = Path(path)
    raw = read_toml(file)
    rows = raw.get("effect")
    if not isinstance(rows, list) or set(raw) != {"effect"}:
        raise ConfigError(f"{path} is not an effects file; it holds [[effect]] tables, each with a name")
    return EffectSet(tuple(_effect(file, row) for row in rows))


FIELDS = {"joints": tuple[str, ...], "role": Role, "source": str}
"""What an effect of a file has besides its name, numbers and intervals."""

NUMBERS = float | tuple[float, ...]


def _fitted(name: str, value: Any, hint: Any) -> Any:
    try:
        return fitted(value, hint)
    except TypeError:
        raise ConfigError(f"{name} is {value!r}; expected {expected(hint)}") from None


def _effect(path: Path, row: Any) -> EffectValues:
    if not isinstance(row, dict) or "name" not in row:
        raise ConfigError(f"{path}: an [[effect]] has no name")
    known = {"name", "interval", *FIELDS}
    try:
        given = {key: _fitted(key, row[key], hint) for key, hint in FIELDS.items() if key in row}
        values = {key: _fitted(key, value, NUMBERS) for key, value in row.items() if key not in known}
        return EffectValues(name=row["name"], values=values, intervals=dict(row.get("interval", {})), **given)
    except (ConfigError, TypeError, ValueError, OverflowError) as reason:
        raise ConfigError(f"{path}: effect {row['name']!r}: {reason}") from None


def write_effects(effects: EffectSet, path: Path, comment: Iterable[str] = ()) -> Path:
    """Write an effects.toml whole or not at all; ``comment`` lines go on top."""
    lines = [f"# {line}" for line in comment]
    for e in effects:
        lines += ["", "[[effect]]", f"name = {_text(e.name)}", f"role = {_text(e.role)}"]
        if e.joints:
            lines.append(f"joints = [{', '.join(_text(j) for j in e.joints)}]")
        lines += [f"{name} = {_numbers(row)}" for name, row in e.values.items()]
        if e.source:
            lines.append(f"source = {_text(e.source)}")
        if e.intervals:
            lines.append("[effect.interval]")
            for name, rows in e.intervals.items():
                lines.append(f"{name} = [{', '.join(_numbers(row, True) for row in rows)}]")
    with written_whole(path) as part:
        part.write_text("\n".join(lines).strip() + "\n", encoding="utf-8")
    return path


def _text(value: str) -> str:
    return json.dumps(value)  # a JSON string is a TOML basic string


def _numbers(row: Sequence[float] | FloatArray, always: bool = False) -> str:
    values = [repr(float(v)) for v in row]
    return values[0] if len(values) == 1 and not always else f"[{', '.join(values)}]"

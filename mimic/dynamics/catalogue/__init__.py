"""The catalogue of physical effects: equations, parameters, units, bounds and signatures, in effects.toml.

One catalogue for simulation, training, calibration and the emulator. `mimic.dynamics.law` turns the parameters
into what the physics is given at every step; this package only says what exists. A parameter at its neutral value has
no effect at all. Signs and letters: tau torque at the joint, q and v its position and velocity, e the target less the
measured position, residual = measured - predicted.

Joints may slide instead of turn: read N for N m, m for rad.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mimic.config.text_file import from_toml, read_text
from mimic.dynamics.catalogue.kinds import MODEL, Effect, Parameter
from mimic.errors import ConfigError

__all__ = ["CATALOGUE", "MODEL", "Effect", "Parameter", "UnknownEffect", "effect", "scale_of", "unit_of"]


class UnknownEffect(ConfigError):
    """An effect that the catalogue does not have."""

    def __init__(self, name: str) -> None:
        self.name = name
        super().__init__(f"effect {name!r} is not in the catalogue; it has {', '.join(CATALOGUE)}")


def _starts(given: Any) -> tuple[float, ...]:
    """Return where a fit begins: a list, or ``count`` numbers from ``first`` on, each ``factor`` times the last."""
    if isinstance(given, dict):
        return tuple(given["first"] * given["factor"] ** k for k in range(given["count"]))
    return tuple(given)


def _effect(row: dict[str, Any]) -> Effect:
    """Return the effect of a table of effects.toml."""
    parameters = (Parameter(**one | {"starts": _starts(one.get("starts", ()))}) for one in row["parameters"])
    return Effect(**row | {"parameters": tuple(parameters)})


_ROWS = from_toml(read_text(Path(__file__).with_name("effects.toml")))["effect"]

CATALOGUE: Mapping[str, Effect] = {row["name"]: _effect(row) for row in _ROWS}
"""Every effect by name."""


_LINEAR = {
    "N m": "N",
    "N m/rad": "N/m",
    "N m/(rad s)": "N/(m s)",
    "N m/rad^2": "N/m^2",
    "N m s/rad": "N s/m",
    "N m s^2/rad^2": "N s^2/m^2",
    "rad/(N m)": "m/N",
    "1/(N m)^2": "1/N^2",
    "kg m^2": "kg",
    "rad": "m",
    "rad/s": "m/s",
    "1/rad": "1/m",
}


def unit_of(name: str, parameter: str, positions: str = "rad") -> str:
    """Return the unit of a parameter, nothing where it has none, for joints that turn (rad) or slide (m)."""
    spec = effect(name)
    unit = spec.parameter(parameter).unit
    if positions == "m" and spec.scope == "joint":
        unit = _LINEAR.get(unit, unit)
    return "" if unit == "1" else unit


def scale_of(unit: str, position: float, speed: float, acceleration: float, torque: float) -> float:
    """Return the typical size of a parameter of this unit, from RMS motion and torque; 1 for units without a scale."""
    return {
        "N m": torque,
        "N m s/rad": torque / speed,
        "N m s^2/rad^2": torque / speed**2,
        "N m/rad": torque / position,
        "N m/(rad s)": torque / position,
        "N m/rad^2": torque / position**2,
        "kg m^2": torque / acceleration,
        "1/(N m)^2": 1.0 / torque**2,
        "rad/(N m)": position / torque,
        "rad": position,
        "rad/s": speed,
    }.get(unit, 1.0)


def effect(name: str) -> Effect:
    """Return an effect by name.

    Raises:
        UnknownEffect: If the catalogue does not have it.
    """
    if name not in CATALOGUE:
        raise UnknownEffect(name)
    return CATALOGUE[name]

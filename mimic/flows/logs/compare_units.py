"""Which effect differs between two units of one machine: the same effects fitted to a log of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mimic.config.sysid import CalibrateSettings
from mimic.errors import CalibrationError
from mimic.flows.logs.calibrate import calibrate
from mimic.flows.reporter import Reporter
from mimic.frozen import frozen

if TYPE_CHECKING:
    from mimic.dynamics.machine import MachineModel
    from mimic.io.joint_log import JointLog
    from mimic.sysid.result import Calibration

WIDTH = 2 * 1.96
"""Width of a 95 % interval, in standard errors."""

SURE = 3.0
"""Standard errors from which on a difference counts, as a calibration asks of an effect."""


@frozen
class Difference:
    """A number of an effect in both units."""

    effect: str
    """Name in the catalogue."""
    parameter: str
    unit: str
    joint: str
    """Empty for the whole machine."""
    first: float
    """Value in the first unit."""
    second: float
    """… and in the second."""
    z: float
    """Their difference in its standard errors; 0 where an interval is not known."""

    @property
    def sure(self) -> bool:
        """Whether noise does not explain it."""
        return abs(self.z) >= SURE


def compare(
    first: str | Path | JointLog,
    second: str | Path | JointLog,
    model: str | Path | MachineModel | None = None,
    settings: CalibrateSettings | None = None,
    *,
    notes: Sequence[str] = (),
    reporter: Reporter | None = None,
) -> list[Difference]:
    """Return how two units of one machine differ, the surest difference first.

    Effects are looked for in each log; all that were found in either are then fitted to both.

    Args:
        first: Log of one unit.
        second: Log of the other; the same motion shows most.
        model: As of `mimic.flows.logs.calibrate.calibrate`, and so are all others.

    Raises:
        CalibrationError: If a log cannot be used, or is of another machine.
    """
    settings = settings or CalibrateSettings()
    logs = (first, second)
    found: list[str] = []
    for log in logs:
        result = calibrate(log, model, settings, notes=notes, reporter=reporter)
        if not result.log_matches_model:
            raise CalibrationError(f"{log if isinstance(log, (str, Path)) else 'a log'}: {result.sentence}")
        found += [one.name for one in result.found if one.name not in found]
    both = replace(settings, baseline=(*settings.baseline, *found), most_effects=0)
    fits = [calibrate(log, model, both, notes=notes, reporter=reporter) for log in logs]
    differences = _differences(fits[0], fits[1])
    return sorted(differences, key=lambda one: -abs(one.z))


def _differences(first: Calibration, second: Calibration) -> list[Difference]:
    from mimic.dynamics.catalogue import unit_of

    others = _values(second)
    differences = []
    for key, (value, variance) in _values(first).items():
        if key not in others:
            continue
        effect, parameter, joint = key
        theirs, other_variance = others[key]
        error = (variance + other_variance) ** 0.5
        differences.append(
            Difference(
                effect=effect,
                parameter=parameter,
                unit=unit_of(effect, parameter, first.unit),
                joint=joint,
                first=value,
                second=theirs,
                z=(theirs - value) / error if error > 0.0 else 0.0,
            )
        )
    return differences


def _values(result: Calibration) -> dict[tuple[str, str, str], tuple[float, float]]:
    """Return value and squared standard error, 0 where that is not known, by effect, parameter and joint."""
    found = {}
    for effect in result.effects:
        for name, values in effect.values.items():
            for j, joint in enumerate(effect.joints or ("",)):
                low, high = effect.intervals[name][j] if name in effect.intervals else (0.0, 0.0)
                found[effect.name, name, joint] = (float(values[j]), float((high - low) / WIDTH) ** 2)
    return found

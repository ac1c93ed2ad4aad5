"""The plain sentences that a calibration ends with."""

from __future__ import annotations

import numpy as np

from mimic.calibrate.fit import Fit, weak_directions
from mimic.calibrate.point import Knob
from mimic.calibrate.problem import Problem
from mimic.calibrate.state import Search
from mimic.calibration import Errors, Remainder, Stage
from mimic.robot.effect_set import EffectSet
from mimic.robot.effects import CATALOGUE
from mimic.robot.machine import MachineModel
from mimic.types import FloatArray


def experiments(stages: list[Stage]) -> tuple[str, ...]:
    """Return what would tell names apart that this log does not tell apart."""
    lines = []
    for stage in stages:
        for name in (stage.added, *stage.rivals) if stage.rivals else ():
            lines.append(f"{CATALOGUE[name].title}: {CATALOGUE[name].experiment}")
    return tuple(dict.fromkeys(lines))


def of_base(state: Search, noise: FloatArray, unit: str) -> tuple[str, ...]:
    """Return what a motion of the base would leave, where that explains the rest, from the noise floors (J,)."""
    if (base := state.base) is None:
        return ()
    at = " and ".join(f"{f:.2f}" for f in base.frequencies)
    squares = state.problem.mean_squares(base.residual, True)[: len(noise)]
    left = _number(Errors.total(np.sqrt(squares) * noise), unit)
    return (f"a base that moves at {at} Hz would leave {left}: hold it more stiffly, and log an IMU on it",)


def _where(joints: tuple[str, ...], machine: MachineModel) -> str:
    if not joints or len(machine.joints) == 1:
        return ""
    if len(joints) == len(machine.joints):
        return " in all joints"
    return f" in {', '.join(joints)}"


def _number(value: float, unit: str) -> str:
    return f"{1000 * value:.2f} mrad" if unit == "rad" else f"{1e6 * value:.3g} µm"


def not_together(why: str) -> str:
    """Return that log and model do not belong together."""
    return f"Log and model do not belong together: {why or 'what was asked does not explain what was measured'}."


def of_declared(stages: list[Stage], rest: tuple[Remainder, ...], noise: FloatArray, unit: str) -> str:
    """Return what a fit of the declared numbers alone came to."""
    unexplained = _left(rest)
    more = f" Unexplained: {unexplained}." if unexplained else ""
    errors = _fall(stages, noise, unit)
    return f"The declared numbers were fitted ({errors}). Effects that it may lack were not looked for.{more}"


def sentence(
    stages: list[Stage],
    rest: tuple[Remainder, ...],
    noise: FloatArray,
    machine: MachineModel,
    effects: EffectSet,
) -> str:
    """Return what the model lacked.

    Args:
        stages: What was added, with the errors after each.
        rest: What is left of each joint.
        noise: Noise floors (J,) [rad or m].
        machine: The model.
        effects: What was found.
    """
    errors, unexplained = _fall(stages, noise, machine.unit), _left(rest)
    added = [s for s in stages if s.added not in ("", "declared")]
    if not added and not unexplained:
        return f"The model lacks nothing that this log shows ({errors})."
    if not added:
        return f"Nothing in the catalogue explains what is left ({errors}). Unexplained: {unexplained}."
    joints = {e.name: e.joints for e in effects}
    named = " and ".join(f"{CATALOGUE[s.added].title}{_where(joints.get(s.added, ()), machine)}" for s in added)
    rivals = sorted({CATALOGUE[r].title for s in added for r in s.rivals})
    return (
        f"The model lacked {named} ({errors}); not told apart from: {', '.join(rivals) or 'none'}; "
        f"still unexplained: {unexplained or 'none'}."
    )


def _fall(stages: list[Stage], noise: FloatArray, unit: str) -> str:
    first, last, floor = (Errors.total(e) for e in (stages[0].errors.held_out, stages[-1].errors.held_out, noise))
    return f"held-out error {_number(first, unit)} → {_number(last, unit)}, noise floor {_number(floor, unit)}"


def _left(rest: tuple[Remainder, ...]) -> str:
    groups: dict[str, list[str]] = {}
    for r in rest:
        if r.verdict == "explained":
            continue
        what = {
            "state-dependent": f"depends on {' and '.join(r.depends_on) or 'the state'}",
            "periodic": f"periodic near {r.peak_hz:.1f} Hz, whatever the robot does",
            "moving base": f"shaken near {r.peak_hz:.1f} Hz in the pattern of a base that moves",
            "events": "single events, nothing in between",
            "broadband": "broadband, depends on nothing logged",
        }[r.verdict]
        groups.setdefault(what, []).append(r.joint)
    return "; ".join(f"{', '.join(names)} ({what})" for what, names in groups.items())


def stopped_at(knob: Knob, bound: float, machine: MachineModel) -> str:
    """Return that a number stopped at its bound, and where."""
    where = "" if knob.joint < 0 else f" of {machine.joints[knob.joint]}"
    return (
        f"{knob.key[0]}.{knob.key[1]}{where} stopped at its bound {bound:g}: something else is wrong in the model there"
    )


def weak(final: Fit, problem: Problem) -> tuple[str, ...]:
    """Return the numbers that the log determines only together."""
    lines = []
    for direction in weak_directions(final, problem):
        parts = []
        for (name, parameter), joints in direction.items():
            where = "" if joints == [-1] else " of " + ", ".join(problem.machine.joints[j] for j in joints)
            parts.append(f"{name}.{parameter}{where}")
        if parts:
            lines.append(" with ".join(parts))
    return tuple(dict.fromkeys(lines))

"""Sentences that summarise a calibration."""

from __future__ import annotations

import itertools

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.machine import MachineModel
from mimic.records import FloatArray
from mimic.sysid.least_squares import Fit, weak_directions
from mimic.sysid.residuals import FreeParameter, Problem
from mimic.sysid.result import Errors, Stage, UnexplainedResidual
from mimic.sysid.torque_regression import BaseMotion


def experiments(stages: list[Stage]) -> tuple[str, ...]:
    """Return the motions that would rule out the alternatives."""
    lines = []
    for stage in stages:
        for name in (stage.added, *stage.alternatives) if stage.alternatives else ():
            lines.append(f"{CATALOGUE[name].title}: {CATALOGUE[name].experiment}")
    return tuple(dict.fromkeys(lines))


_NEXT = {
    "position": "move {joint} slowly over its whole range, in both directions",
    "velocity": "move {joint} at five constant speeds from 0.05 rad/s to its fastest, in both directions",
    "torque": "repeat the motion of {joint} with another payload, and log the measured torque",
    "another joint": "move {joint} while its neighbours hold still, then its neighbours alone",
    "time": "hold {joint} still for 20 s with the drive on, then off; log an IMU on the base",
}
"""What tells more about a residual that depends on this."""

_NEXT_BY_VERDICT = {
    "periodic": _NEXT["time"],
    "events": "log when each target was sent (t_send), and film {joint} to see whether something touches or catches",
    "broadband": "log {joint} at a higher rate, and 10 s of it at rest with the drive off, for the encoder's noise",
    "state-dependent": "move {joint} alone: slowly over its range, then fast, each twice",
}


def next_logs(rest: tuple[UnexplainedResidual, ...]) -> tuple[str, ...]:
    """Return what to log to explain what stays unexplained: a line for each kind of motion, with its joints."""
    wanted: dict[str, list[str]] = {}
    for r in rest:
        if r.verdict in ("explained", "moving base"):  # the latter is said by `of_base`
            continue
        for what in [_NEXT[d] for d in r.depends_on if d in _NEXT] or [_NEXT_BY_VERDICT[r.verdict]]:
            wanted.setdefault(what, []).append(r.joint)
    return tuple(what.format(joint=", ".join(joints)) for what, joints in wanted.items())


def of_base(base: BaseMotion | None) -> tuple[str, ...]:
    """Return what a motion of the base would explain, if one is what is left."""
    if base is None:
        return ()
    at = " and ".join(f"{f:.2f}" for f in base.frequencies)
    most = 100 * float(base.share.max())
    return (
        f"a base motion at {at} Hz would explain up to {most:.0f} % of a joint's unexplained torque: hold the base more"
        " stiffly and log an IMU on it",
    )


def _where(joints: tuple[str, ...], machine: MachineModel) -> str:
    if not joints or len(machine.joints) == 1:
        return ""
    if len(joints) == len(machine.joints):
        return " in all joints"
    return f" in {', '.join(joints)}"


def _number(value: float, unit: str) -> str:
    return f"{1000 * value:.2f} mrad" if unit == "rad" else f"{1e6 * value:.3g} µm"


def no_match(why: str) -> str:
    """Return that the log does not match the model."""
    return f"The log does not match the model: {why or 'the targets do not explain the measured positions'}."


def of_baseline(stages: list[Stage], rest: tuple[UnexplainedResidual, ...], noise: FloatArray, unit: str) -> str:
    """Return the result of a fit of the baseline parameters alone."""
    unexplained = _left(rest)
    more = f" Unexplained: {unexplained}." if unexplained else ""
    errors = _fall(stages, noise, unit)
    return f"The baseline parameters were fitted ({errors}). No missing effects were searched for.{more}"


def sentence(
    stages: list[Stage],
    rest: tuple[UnexplainedResidual, ...],
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
    added = [s for s in stages if s.added not in ("", "baseline")]
    if not added and not unexplained:
        return f"The model lacks nothing that this log shows ({errors})."
    if not added:
        return f"No effect of the catalogue explains the remaining error ({errors}). Unexplained: {unexplained}."
    joints = {e.name: e.joints for e in effects}
    shares = [
        f" ({100 * share:.0f} % of the unexplained error)" if unexplained else "" for share in shares_of(stages, noise)
    ]
    named = " and ".join(
        f"{CATALOGUE[s.added].title}{_where(joints.get(s.added, ()), machine)}{share}"
        for s, share in zip(added, shares, strict=True)
    )
    alternatives = sorted({CATALOGUE[r].title for s in added for r in s.alternatives})
    return (
        f"The model lacked {named} ({errors}). "
        f"Alternatives this log cannot rule out: {', '.join(alternatives) or 'none'}. "
        f"Unexplained: {unexplained or 'none'}."
    )


def shares_of(stages: list[Stage], noise: FloatArray) -> list[float]:
    """Return the share of each added effect in what the baseline model leaves beyond the noise of held-out blocks."""
    squares = [Errors.total(s.errors.held_out) ** 2 for s in stages]
    whole = max(squares[0] - Errors.total(noise) ** 2, 1e-300)
    fell = [(before - after) / whole for before, after in itertools.pairwise(squares)]
    return [min(max(f, 0.0), 1.0) for f, s in zip(fell, stages[1:], strict=True) if s.added]


def _fall(stages: list[Stage], noise: FloatArray, unit: str) -> str:
    first, last, floor = (Errors.total(e) for e in (stages[0].errors.held_out, stages[-1].errors.held_out, noise))
    return f"held-out error {_number(first, unit)} → {_number(last, unit)}, noise floor {_number(floor, unit)}"


def _left(rest: tuple[UnexplainedResidual, ...]) -> str:
    groups: dict[str, list[str]] = {}
    for r in rest:
        if r.verdict == "explained":
            continue
        what = {
            "state-dependent": f"depends on {' and '.join(r.depends_on) or 'the state'}",
            "periodic": f"periodic near {r.peak_hz:.1f} Hz, independent of the motion",
            "moving base": f"moving base, near {r.peak_hz:.1f} Hz",
            "events": "isolated events",
            "broadband": "broadband, independent of all logged signals",
        }[r.verdict]
        groups.setdefault(what, []).append(r.joint)
    return "; ".join(f"{', '.join(names)} ({what})" for what, names in groups.items())


def stopped_at(free: FreeParameter, bound: float, machine: MachineModel) -> str:
    """Return that a parameter stopped at its bound, and where."""
    return f"{free.called(machine.joints)} stopped at its bound {bound:g}: the model is wrong there in another way"


def weak(final: Fit, problem: Problem) -> tuple[str, ...]:
    """Return the parameters that the log determines only in combination."""
    lines = []
    for direction in weak_directions(final, problem):
        parts = []
        for (name, parameter), joints in direction.items():
            where = "" if joints == [-1] else " of " + ", ".join(problem.machine.joints[j] for j in joints)
            parts.append(f"{name}.{parameter}{where}")
        if parts:
            lines.append(" with ".join(parts))
    return tuple(dict.fromkeys(lines))

"""A calibration in words: what the model lacked, what stays unexplained, and what to log next."""

from __future__ import annotations

from collections.abc import Sequence

from mimic.dynamics.catalogue import CATALOGUE
from mimic.records import FloatArray
from mimic.sysid.next_motion import NextMotion
from mimic.sysid.result import Alternative, Errors, Found, UnexplainedResidual

NEXT = {
    "position": "move {joint} slowly over its whole range, in both directions",
    "speed": "move {joint} at five constant speeds from 0.05 rad/s to its fastest, in both directions",
    "torque": "repeat the motion of {joint} with another payload, and log the measured torque",
    "position of": "move {joint} while its neighbours hold still, then its neighbours alone",
    "time": "hold {joint} still for 20 s with the drive on, then off, and the base more stiffly; log an IMU on it",
    "": "log {joint} at a higher rate with the time at which each target was sent (t_send), and film it",
}
"""What tells more about a torque that depends on this; on nothing last."""


def no_match(why: str) -> str:
    """Return that the log does not match the model."""
    return f"The log does not match the model: {why or 'the targets do not explain the measured positions'}."


def sentence(
    found: Sequence[Found],
    alternatives: Sequence[Alternative],
    rest: Sequence[UnexplainedResidual],
    errors: str,
    joints: Sequence[str],
    searched: bool,
    explained: bool,
) -> str:
    """Return what the model lacked.

    Args:
        found: Effects.
        alternatives: What the logs do not tell from them.
        rest: What is left of each joint.
        errors: Errors before and after, in words.
        joints: All joints.
        searched: Whether effects were looked for.
        explained: Whether those found explain the machine.
    """
    unexplained = left(rest)
    if not searched:
        more = f" Unexplained: {unexplained}." if unexplained else ""
        return f"The baseline parameters were fitted ({errors}). No missing effects were searched for.{more}"
    if not found and not unexplained:
        return f"The model lacks nothing that this log shows ({errors})."
    if not found:
        return f"No effect of the catalogue explains the remaining error ({errors}). Unexplained: {unexplained}."
    named = " and ".join(f"{called([(one.name, one.joints)], joints)}{_share(one, unexplained)}" for one in found)
    others = "; or ".join(dict.fromkeys(called(one.effects, joints) for one in alternatives))
    lacked = f"The model lacked {named} ({errors})."
    if not explained:
        lacked = f"No effect of the catalogue explains the remaining error ({errors}). What helps: {named}."
    return f"{lacked} Alternatives this log cannot rule out: {others or 'none'}. Unexplained: {unexplained or 'none'}."


def called(effects: Sequence[tuple[str, tuple[str, ...]]], joints: Sequence[str]) -> str:
    """Return effects with their joints in words."""
    said = []
    for name, own in effects:
        where = f" in {', '.join(own)}" if own and len(joints) > 1 else ""
        said.append(CATALOGUE[name].title + (" in all joints" if where and len(own) == len(joints) else where))
    return " and ".join(said) or "nothing"


def _share(one: Found, unexplained: str) -> str:
    return f" ({100 * one.share:.0f} % of the unexplained error)" if unexplained and one.evidence else ""


def fall(before: FloatArray, after: FloatArray, noise: FloatArray, unit: str) -> str:
    """Return held-out errors before and after, and the noise floor (J,), in words."""
    shown = [Errors.total(e) for e in (before, after, noise)]
    first, last, floor = (f"{1e3 * v:.2f} mrad" if unit == "rad" else f"{1e6 * v:.3g} µm" for v in shown)
    return f"held-out error {first} → {last}, noise floor {floor}"


def left(rest: Sequence[UnexplainedResidual]) -> str:
    """Return the joints that are not explained, with what their unknown torque depends on; empty where all are."""
    groups: dict[str, list[str]] = {}
    for one in rest:
        if not one.explained:
            on = " and ".join(name for name, _ in one.depends_on[:2])
            what = f"unknown torque, depends on {on}" if on else "unknown torque, depends on no logged signal"
            groups.setdefault(what, []).append(one.joint)
    return "; ".join(f"{', '.join(names)} ({what})" for what, names in groups.items())


def next_logs(
    found: Sequence[Found],
    alternatives: Sequence[Alternative],
    rest: Sequence[UnexplainedResidual],
    motion: NextMotion | None,
) -> tuple[str, ...]:
    """Return what to log to tell alternatives apart, with the motion that does it, and to explain what is left."""
    lines = []
    if motion is not None:
        where = f"{motion.apart:.1f} noise floors apart, in {motion.joint}"
        if motion.tells:
            lines.append(
                f"next_motion.parquet ({motion.kind}, {motion.size:.0%} of the ranges): under it what was found and "
                f"the nearest alternative are {where}"
            )
        else:
            lines.append(f"no motion in these ranges tells what was found from the nearest alternative: {where}")
    names = {one.name for one in found} if alternatives else set()
    for one in alternatives:
        names |= {name for name, _ in one.effects}
    for name in sorted(names):
        lines.append(f"{CATALOGUE[name].title}: {CATALOGUE[name].experiment}")
    wanted: dict[str, list[str]] = {}
    for one in rest:
        if not one.explained:
            on = one.depends_on[0][0] if one.depends_on else ""
            kind = "position of" if on.startswith("position of") else on
            wanted.setdefault(NEXT[kind], []).append(one.joint)
    return (*lines, *(what.format(joint=", ".join(joints)) for what, joints in wanted.items()))

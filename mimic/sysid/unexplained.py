"""The residual that no effect explains: does it depend on the state, on time alone, or on nothing? And the sentences
that summarise a calibration.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy import signal

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.machine import MachineModel
from mimic.records import FloatArray, IntArray
from mimic.sysid.fit.least_squares import SMALLEST
from mimic.sysid.fit.problem import FreeParameter
from mimic.sysid.log.noise import LOW, MEMORY, smooth
from mimic.sysid.result import RULES, Errors, Stage, UnexplainedResidual
from mimic.sysid.select.starts import PredictedMotion

FEATURES = 160
"""Random Fourier features of the regression on the state."""

FOLDS = 5
"""Shares of the blocks that are left out, one after another."""


def unexplained_residuals(
    joints: Sequence[str],
    residual: FloatArray,
    motion: PredictedMotion,
    target: FloatArray,
    blocks: IntArray,
    neighbour: IntArray,
) -> tuple[UnexplainedResidual, ...]:
    """Classify the residual of each joint.

    Args:
        joints: Names.
        residual: In noise floors (T, J); NaN where a reading does not count.
        motion: What the model does.
        target: Targets (T, J).
        blocks: Block of each reading, -1 where it does not count (T,).
        neighbour: Index of the joint next to each (J,).
    """
    states = [_state(j, motion, target, int(n)) for j, n in enumerate(neighbour)]
    return tuple(_remainder(name, residual[:, j], states[j], blocks, motion.t) for j, name in enumerate(joints))


def _state(j: int, motion: PredictedMotion, target: FloatArray, n: int) -> dict[str, FloatArray]:
    error = target[:, j] - motion.q[:, j]
    late = np.concatenate([error[:10], error[:-10]])
    v = motion.dq[:, j]
    return {
        "position": motion.q[:, [j]],
        "velocity": np.stack([v, np.tanh(v / 0.05)], -1),
        "torque": np.stack([motion.tau[:, j], error, late], -1),
    } | ({} if n == j else {"another joint": np.stack([motion.q[:, n], motion.dq[:, n]], -1)})


def _remainder(
    name: str, residual: FloatArray, state: dict[str, FloatArray], blocks: IntArray, t: FloatArray
) -> UnexplainedResidual:
    rows = (blocks >= 0) & np.isfinite(residual)
    r = residual[rows].astype(np.float64)
    ratio = float(np.sqrt(np.mean(r**2)))
    dt = float(np.median(np.diff(t)))
    peak_hz, peak_ratio = _peak(r, dt)
    slow = smooth(t, r)
    inputs = {k: v[rows] for k, v in state.items()}
    r2 = predicted(slow, inputs, blocks[rows])
    depends: tuple[str, ...] = ()
    if ratio >= RULES.explained and r2 > RULES.predictable:
        alone = {k: predicted(slow, {k: v}, blocks[rows]) for k, v in inputs.items()}
        lost = {k: r2 - predicted(slow, {n: v for n, v in inputs.items() if n != k}, blocks[rows]) for k in inputs}
        score = {k: max(alone[k], 0.0) + max(lost[k], 0.0) for k in inputs}
        top = max(score.values())
        depends = tuple(sorted((k for k in score if score[k] > RULES.most * top), key=lambda k: -score[k]))
    if ratio < RULES.explained:
        verdict = "explained"
    elif r2 > RULES.predictable:
        verdict = "state-dependent"
    elif _steady(slow, t[rows], blocks[rows], peak_hz) > RULES.predictable:
        verdict = "periodic"
        depends = ("time",)
    else:
        verdict = "events" if _bursts(r, dt) else "broadband"
    return UnexplainedResidual(
        joint=name,
        ratio=ratio,
        state_r2=r2,
        depends_on=depends,
        peak_hz=peak_hz,
        peak_ratio=peak_ratio,
        verdict=verdict,
    )


def _peak(r: FloatArray, dt: float) -> tuple[float, float]:
    """Return the frequency [Hz] at which a residual (T,) is largest, and its power there over the usual one.

    A wave longer than the folds says nothing: what is left out lies between what is not.
    """
    frequency, power = signal.welch(r - r.mean(), 1 / dt, nperseg=len(r) // FOLDS)
    inside = frequency > 1 / FOLDS
    at = int(np.argmax(power[inside]))
    return float(frequency[inside][at]), float(power[inside][at] / max(np.median(power[inside]), SMALLEST))


def _steady(r: FloatArray, t: FloatArray, blocks: IntArray, near_hz: float) -> float:
    """Return the share of the variance of r (T,) that a sine wave near a frequency predicts on blocks left out.

    Something external keeps its phase; what the robot's own motion makes comes and goes with it.
    """
    best, wave = -1.0, np.zeros((len(r), 2))
    for frequency in near_hz + np.linspace(-FOLDS, FOLDS, 8 * FOLDS + 1) / (t[-1] - t[0]):
        angle = 2 * np.pi * frequency * t
        a = np.stack([np.cos(angle), np.sin(angle)], -1)
        fitted = a @ np.linalg.lstsq(a, r, rcond=None)[0]
        if (found := float(fitted @ r)) > best:
            best, wave = found, a
    return _share(wave, r, blocks, 0.0)


def _bursts(r: FloatArray, dt: float) -> bool:
    """Return whether most of what noise does not explain of r (T,), in noise floors, is in a few fifths of a second."""
    rows = max(int(2 * MEMORY / dt), 1)
    squares = (r[: len(r) // rows * rows] ** 2).reshape(-1, rows).mean(1) - 1.0
    top = np.sort(squares)[::-1][: max(int(LOW * len(squares)), 1)]
    return bool(top.sum() > RULES.most * np.maximum(squares, 0.0).sum() and squares.sum() > 0)


def predicted(r: FloatArray, inputs: dict[str, FloatArray], blocks: IntArray) -> float:
    """Return the share of the variance of r (T,) that inputs predict on blocks left out; negative where they mislead.

    Ridge regression on random Fourier features of the scaled inputs; whole blocks are left out, because neighbouring
    readings are alike.
    """
    x = np.concatenate(list(inputs.values()), -1)
    x = (x - x.mean(0)) / (x.std(0) + 1e-9)
    rng = np.random.default_rng(0)
    weights = rng.standard_normal((x.shape[1], FEATURES)) / np.sqrt(x.shape[1]) * rng.choice([0.5, 1.5, 4.0], FEATURES)
    a = np.concatenate([x, np.cos(x @ weights + rng.uniform(0, 2 * np.pi, FEATURES)), np.ones((len(x), 1))], -1)
    return _share(a, r - r.mean(), blocks, 1e-3)


def _share(a: FloatArray, r: FloatArray, blocks: IntArray, ridge: float) -> float:
    """Return the share of the squares of r (T,) that columns a (T, N) predict on blocks left out."""
    parts = [(a[rows], r[rows]) for rows in (blocks % FOLDS == k for k in range(FOLDS))]
    outer, along = [x.T @ x for x, _ in parts], [x.T @ y for x, y in parts]
    error = 0.0
    for k, (x, y) in enumerate(parts):
        rest = sum(outer) - outer[k] + ridge * (len(r) - len(y)) * np.eye(a.shape[1])
        error += float(np.sum((y - x @ np.linalg.lstsq(rest, sum(along) - along[k], rcond=None)[0]) ** 2))
    return 1.0 - error / max(float(r @ r), SMALLEST)


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
    "time": "hold {joint} still for 20 s with the drive on, then off, and the base more stiffly; log an IMU on it",
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
        if r.verdict == "explained":
            continue
        for what in [_NEXT[d] for d in r.depends_on if d in _NEXT] or [_NEXT_BY_VERDICT[r.verdict]]:
            wanted.setdefault(what, []).append(r.joint)
    return tuple(what.format(joint=", ".join(joints)) for what, joints in wanted.items())


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
    whole = max(squares[0] - Errors.total(noise) ** 2, SMALLEST)
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
            "events": "isolated events",
            "broadband": "broadband, independent of all logged signals",
        }[r.verdict]
        groups.setdefault(what, []).append(r.joint)
    return "; ".join(f"{', '.join(names)} ({what})" for what, names in groups.items())


def stopped_at(free: FreeParameter, bound: float, machine: MachineModel) -> str:
    """Return that a parameter is at a bound of its validity, and where."""
    end = "largest" if bound == free.parameter.high else "smallest"
    return f"{free.called(machine.joints)} is at its {end}, {bound:g}: the log does not say more of it"

"""Methods that fit a model to logs. Each returns what it found as effects, so that one replay judges all of them.

``mujoco.sysid`` needs ``pip install mujoco[sysid]`` and CMA-ES ``pip install cma``; both are no part of mimic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lab.rivals.cases import Case, switched_on
from lab.rivals.torque import Motion, motions_of
from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, as_logged
from mimic.dynamics.servo import neutral
from mimic.errors import MimicError
from mimic.io.joint_log import JointLog
from mimic.records import FloatArray
from mimic.sysid.calibrate import calibrate
from mimic.sysid.engine.data import data_of
from mimic.sysid.engine.laws import ROW
from mimic.sysid.engine.likelihood import FOLLOWING
from mimic.sysid.engine.model import Setting, setting_of

SETTINGS = CalibrateSettings(threads=1)

Point = dict[tuple[str, str], FloatArray]
"""Values of parameters, of each joint or of the machine."""

PACE = ("coulomb", "viscous", "armature", "encoder_offset", "delay")
"""What PACE fits: friction, damping, rotor inertia and offset of each joint, and one delay. Source: Bjelonic 2025."""


EXACT = {"x_scale": "jac", "gtol": 1e-12}
"""Settings of mujoco.sysid: with those that it comes with, a fit in newtons and metres ends after one step."""

BATCH = 64
"""Samples judged together."""

UNSTABLE = 1e3
"""Log of the sum of squares of a replay that diverges."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """What a method says of a machine."""

    effects: EffectSet
    names: tuple[str, ...] | None
    """Effects beside the baseline that it reports; None where it fits a given list and reports none."""
    replays: int
    """Of all logs, 0 where it replays nothing."""


def as_given(case: Case) -> Found:
    """The model as it is."""
    return Found(effects=EffectSet(), names=None, replays=0)


def of_mimic(case: Case) -> Found:
    """``mimic calibrate``."""
    made = calibrate(case.fitted, case.machine, SETTINGS)
    return Found(effects=made.effects, names=made.names, replays=made.passes)


def of_baseline(case: Case) -> Found:
    """Its first stage: the baseline parameters by least squares."""
    made = calibrate(case.fitted, case.machine, CalibrateSettings(threads=1, most_effects=0))
    return Found(effects=made.effects, names=None, replays=made.passes)


def of_random(case: Case, samples: int = 8192) -> Found:
    """The paper's search: the best of so many random samples of the baseline parameters."""
    problem = setting_of(data_of(case.fitted, case.machine))
    keys = _keys(CalibrateSettings().baseline)
    rng = np.random.default_rng(0)
    best, winner = np.inf, np.zeros(0)
    size = sum(problem_rows(case, keys).values())
    for _ in range(0, samples, BATCH):
        x = rng.random((BATCH, size))
        squares = np.nan_to_num(_squares(problem, [_point(case, keys, row) for row in x]), nan=np.inf)
        if squares.min() < best:
            best, winner = float(squares.min()), x[int(squares.argmin())]
    return Found(effects=_effects(case, _point(case, keys, winner)), names=None, replays=problem.passes.count)


def of_cma(case: Case, replays: int = 4096, population: int = 64) -> Found:
    """CMA-ES over the parameters of PACE, until it converges or has made so many replays."""
    try:
        import cma
    except ModuleNotFoundError:
        raise MimicError("cma is not installed; install it with: pip install cma") from None
    problem = setting_of(data_of(case.fitted, case.machine))
    keys = _keys(PACE)
    size = sum(problem_rows(case, keys).values())
    search = cma.CMAEvolutionStrategy(
        np.full(size, 0.4),
        0.25,
        {"bounds": [0.0, 1.0], "popsize": population, "maxfevals": replays, "seed": 1, "verbose": -9, "tolfun": 1e-6},
    )
    while not search.stop():
        x = search.ask()
        squares = _squares(problem, [_point(case, keys, np.asarray(row)) for row in x])
        search.tell(x, np.nan_to_num(np.log(squares), nan=UNSTABLE, posinf=UNSTABLE).tolist())
    found = _point(case, keys, np.asarray(search.result.xbest))
    return Found(effects=_effects(case, found), names=None, replays=problem.passes.count)


def _keys(names: Sequence[str]) -> list[tuple[str, str]]:
    return [(n, p.name) for n in names for p in CATALOGUE[n].parameters]


def _squares(problem: Setting, points: Sequence[Point]) -> FloatArray:
    """Return the sum of squares to the end of blocks (N,), beside which nothing is fitted."""
    tables = []
    for point in points:
        tables.append(problem.blank.copy())
        for key, row in point.items():
            tables[-1][ROW[key]] = row
    errors = problem.passes.run(tables, problem.gains.of(FOLLOWING * problem.gains.torque, problem.data))
    counts = problem.data.counts
    return np.array([np.square(e[counts]).sum() for e in errors])


def problem_rows(case: Case, keys: Sequence[tuple[str, str]]) -> dict[tuple[str, str], int]:
    """Return how many numbers each parameter has."""
    return {k: 1 if CATALOGUE[k[0]].scope == "machine" else len(case.machine.joints) for k in keys}


def _point(case: Case, keys: Sequence[tuple[str, str]], x: FloatArray) -> Point:
    """Return the parameters at a place in the unit cube."""
    values: Point = {}
    at = 0
    for key, rows in problem_rows(case, keys).items():
        low, high = case.ranges[key]
        values[key] = low + (high - low) * np.clip(x[at : at + rows], 0.0, 1.0)
        at += rows
    return values


def _effects(case: Case, point: Point) -> EffectSet:
    named: dict[str, dict[str, FloatArray]] = {}
    for (name, parameter), row in point.items():
        named.setdefault(name, {})[parameter] = row
    return EffectSet(
        tuple(
            EffectValues(name=n, joints=() if CATALOGUE[n].scope == "machine" else case.machine.joints, values=v)
            for n, v in named.items()
        )
    )


# ---------------------------------------------------------------------- mujoco.sysid


def of_mujoco(case: Case) -> Found:
    """``mujoco.sysid``: friction, damping, rotor inertia and mass of each joint and one delay, by least squares.

    It replays whole logs, from the first reading. Logs in which drives are switched off are left out: its controls
    have no such thing.
    """
    try:
        from mujoco import sysid

        transform = sysid.SignalTransform()
    except (ImportError, AttributeError):
        raise MimicError("its extra is not installed; install it with: pip install 'mujoco[sysid]'") from None
    params, keys = sysid.ParameterDict(), {}
    spec = _spec_for_mujoco(case, case.fitted[0])
    for j, joint in enumerate(case.machine.joints):
        body = spec.joint(joint).parent
        mass, inertia = float(body.mass), np.array(body.inertia)
        wholes = {
            ("coulomb", "level"): lambda s, p, n=joint: setattr(s.joint(n), "frictionloss", p.value[0]),
            ("viscous", "coefficient"): lambda s, p, n=joint: _set_damping(s.joint(n), p.value[0]),
            ("armature", "inertia"): lambda s, p, n=joint: setattr(s.joint(n), "armature", p.value[0]),
            ("link_mass", "factor"): lambda s, p, n=body.name, own=(mass, inertia): _scale(s.body(n), p.value[0], *own),
        }
        for key, modifier in wholes.items():
            low, high = case.ranges[key]
            middle = low + 0.4 * (high - low)  # off the bounds, where it would stall
            name = f"{key[0]}_{j}"
            params.add(sysid.Parameter(name, middle, low, high, modifier=modifier))
            keys[key, j] = name
    early, late = case.ranges["delay", "time"]
    params.add(sysid.Parameter("delay", early + 0.4 * (late - early), early, late))
    for joint in case.machine.joints:
        transform.delay(f"{joint}_read", params["delay"])
    sequences = []
    for i, log in enumerate(log for log in case.fitted if switched_on(log)):
        one = _spec_for_mujoco(case, log)
        model = one.compile()
        t = np.arange(0.0, log.t[-1] - log.t[0], model.opt.timestep)
        newest = np.clip(np.searchsorted(log.t - log.t[0], t + 1e-9, side="right") - 1, 0, None)
        begin = sysid.create_initial_state(model, log.q[0], np.zeros(model.nv))
        control = sysid.TimeSeries.from_control_names(t, log.q_des[newest], model)
        readings = sysid.TimeSeries.from_names(log.t - log.t[0], log.q, model)
        sequences.append(sysid.ModelSequences(f"log{i}", one, f"log{i}", begin, control, readings))
    calls = [0]
    residual = sysid.build_residual_fn(models_sequences=sequences, modify_residual=transform.apply, n_threads=1)

    def counted(x: FloatArray, p: object, **more: object) -> object:
        calls[0] += 1 if np.ndim(x) == 1 else np.shape(x)[1]
        return residual(x, p, **more)

    fitted, _ = sysid.optimize(params, counted, optimizer="mujoco", verbose=False, max_iters=30, **EXACT)
    values: dict[tuple[str, str], FloatArray] = {}
    for (key, _), name in keys.items():
        values[key] = np.append(values.get(key, np.zeros(0)), fitted[name].value[0])
    values["delay", "time"] = np.array(fitted["delay"].value)
    return Found(effects=_effects(case, _best_delay(case, values)), names=None, replays=calls[0] * len(sequences))


def _best_delay(case: Case, values: Mapping[tuple[str, str], FloatArray]) -> Point:
    """Return the parameters with the delay that suits the fitted logs best in the replay that judges.

    The toolbox counts a delay from other moments of a step; only this number is set anew.
    """
    problem = setting_of(data_of(case.fitted, case.machine))
    low, high = case.ranges["delay", "time"]
    points = [{**values, ("delay", "time"): np.array([d])} for d in np.linspace(low, high, 121)]
    return points[int(np.argmin(np.nan_to_num(_squares(problem, points), nan=np.inf)))]


def _set_damping(joint: object, value: float) -> None:
    joint.damping = [value, 0.0, 0.0]  # type: ignore[attr-defined]


def _scale(body: object, factor: float, mass: float, inertia: FloatArray) -> None:
    body.mass, body.inertia = factor * mass, factor * inertia  # type: ignore[attr-defined]


def _spec_for_mujoco(case: Case, log: JointLog) -> object:
    """Return the model with the drives of a log as position servos, an encoder each, and dry friction that holds."""
    import mujoco

    machine = as_logged(case.machine, log.metadata)
    spec = mujoco.MjSpec.from_string(case.mjcf)
    for group in (spec.actuators, spec.sensors, spec.keys):
        for item in list(group):
            spec.delete(item)
    spec.option.timestep = min(0.0025, 1.0 / log.rate)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = np.array(machine.model.opt.gravity)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for j, name in enumerate(machine.joints):
        spec.joint(name).solref_friction = [2 * spec.option.timestep, 1.0]
        spec.joint(name).solimp_friction = [0.99, 0.999, 0.001, 0.5, 2.0]
        servo = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
        servo.set_to_position(kp=float(machine.drives.kp[j]), kv=float(machine.drives.kd[j]))
        most = float(machine.drives.torque[j])
        servo.forcelimited, servo.forcerange = True, [-most, most]
        spec.add_sensor(name=f"{name}_read", type=mujoco.mjtSensor.mjSENS_JOINTPOS, objtype=mujoco.mjtObj.mjOBJ_JOINT,
                        objname=name)  # fmt: skip
    return spec


# ---------------------------------------------------------------------- sparse regression

Library = Mapping[tuple[str, str], Callable[[Motion, FloatArray], FloatArray]]

SLOW = 0.1
"""Speed of Stribeck friction over the greatest speed of the joint: a library has no such unknown."""

LIBRARY: Library = {
    ("coulomb", "level"): lambda m, s: s,
    ("viscous", "coefficient"): lambda m, s: m.dq,
    ("armature", "inertia"): lambda m, s: m.ddq,
    ("spring", "stiffness"): lambda m, s: m.q,
    ("spring", "moment"): lambda m, s: -np.ones_like(m.q),
    ("stribeck", "level"): lambda m, s: np.exp(-((m.dq / (SLOW * np.abs(m.dq).max(0))) ** 2)) * s,
    ("load_friction", "ratio"): lambda m, s: np.abs(m.tau) * s,
    ("asymmetric_friction", "coefficient"): lambda m, s: np.abs(m.dq),
    ("quadratic_drag", "coefficient"): lambda m, s: m.dq * np.abs(m.dq),
}
"""Terms of the torque of one joint; s is the sign of its velocity."""

ALWAYS = {("coulomb", "level"), ("viscous", "coefficient")}
"""Terms that are kept."""

THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Least share of the torque of friction that a term must have; the one with the least left-out error is taken."""


def of_sindy(case: Case) -> Found:
    """Sparse regression of the torque that the links do not need (SINDy's algorithm), term by term of a library.

    Sequentially thresholded least squares, the threshold by leaving out blocks of 1.5 s. Source: Brunton, Proctor, Kutz
    2016.
    """
    delay, motions = motions_of([(log, case.machine) for log in case.fitted])
    joints = len(case.machine.joints)
    values = {key: np.zeros(joints) for key in LIBRARY}
    for j in range(joints):
        x, y, block = _regression(motions, j)
        errors = [_left_out(x, y, block, t) for t in THRESHOLDS]
        found = _thresholded(x, y, THRESHOLDS[int(np.argmin(errors))])
        for key, value in zip(LIBRARY, found, strict=True):
            values[key][j] = value
    names = tuple(dict.fromkeys(k[0] for k, v in values.items() if k not in ALWAYS and np.any(v != 0.0)))
    own = np.asarray(motions[0].machine.drives.armature)
    values["armature", "inertia"] = np.maximum(own + values["armature", "inertia"], 1e-4)
    fast = np.max([np.abs(m.dq).max(0) for m in motions], axis=0)
    values["stribeck", "speed"] = SLOW * fast
    for key in (*ALWAYS, ("stribeck", "level"), ("load_friction", "ratio")):
        values[key] = np.maximum(values[key], 0.0)
    kept = {key: row for key, row in values.items() if key in ALWAYS or key[0] in names}
    kept |= _neutral_rest(kept, case.machine)
    kept["delay", "time"] = np.array([delay])
    return Found(effects=_effects(case, kept), names=names, replays=0)


def _neutral_rest(kept: Point, machine: MachineModel) -> Point:
    names = {name for name, _ in kept}
    return {key: neutral(*key, machine) for key in _keys(sorted(names)) if key not in kept}


def _regression(motions: Sequence[Motion], j: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    x, y, block = [], [], []
    for n, m in enumerate(motions):
        sign = np.tanh(m.dq / m.slow)
        terms = np.stack([m.filtered(f(m, sign))[:, j] for f in LIBRARY.values()], -1)
        use = m.moving[:: m.every, j]
        x.append(terms[use])
        y.append(m.filtered(m.tau - m.need)[use, j])
        block.append(1000 * n + np.floor(m.t[:: m.every][use] / 1.5))
    return np.concatenate(x), np.concatenate(y), np.concatenate(block)


def _thresholded(x: FloatArray, y: FloatArray, threshold: float) -> FloatArray:
    """Return coefficients of the terms whose contribution is more than a share of the torque; zeros elsewhere."""
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-12
    keep = np.ones(x.shape[1], dtype=bool)
    always = np.array([k in ALWAYS for k in LIBRARY])
    found = np.zeros(x.shape[1])
    for _ in range(10):
        found = np.zeros(x.shape[1])
        found[keep] = np.linalg.lstsq(x[:, keep] / size[keep], y, rcond=1e-6)[0] / size[keep]
        small = (np.abs(found) * size < threshold * np.sqrt(np.mean(y**2))) & ~always
        if not np.any(small & keep):
            break
        keep &= ~small
    return found


def _left_out(x: FloatArray, y: FloatArray, block: FloatArray, threshold: float) -> float:
    total = 0.0
    for fold in range(5):
        out = block % 5 == fold
        if out.any() and (~out).sum() > x.shape[1]:
            total += float(np.sum((y[out] - x[out] @ _thresholded(x[~out], y[~out], threshold)) ** 2))
    return math.sqrt(total / len(y))


METHODS: Mapping[str, Callable[[Case], Found]] = {
    "model as given": as_given,
    "mujoco.sysid": of_mujoco,
    "CMA-ES, PACE's parameters": of_cma,
    "8192 random samples": of_random,
    "sparse regression of torque": of_sindy,
    "mimic, baseline only": of_baseline,
    "**mimic calibrate**": of_mimic,
}

"""How often the torque screen ranks and claims what is hidden, on machines that share no code with mimic's replay.

    python -m lab.hidden_effects.torque_screen --seeds 2
    python -m lab.hidden_effects.torque_screen --real ../shared/data/logs

A planar arm of two links in closed form (Spong, Hutchinson, Vidyasagar 2006, section 7.4), stepped at 20 us by the
semi-implicit Euler rule, logged at 200 Hz by a clock of its own 3 ms beside the targets. A quarter of the laws differ
from the catalogue's on purpose: "other" below says how. With ``--real`` the measured logs instead.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import stats

from lab.real_logs.logs import EMPS_MJCF, SERVO_MJCF, emps_log, go2_log, identify, read_emps, servo_logs
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.io.joint_log import JointLog
from mimic.records import FloatArray
from mimic.sysid.torque.columns import Column
from mimic.sysid.torque.regression import Score, Torques, evidence

try:
    from numba import njit
except ImportError:  # slower, same numbers

    def njit(*args, **options):
        return args[0] if args and callable(args[0]) else lambda f: f


KP, KD, DELAY, STEP, ROTOR = 28.0, 1.0, 0.007, 2e-5, 0.003
MASS, LENGTH, CENTRE, INERTIA = (0.7, 0.4), 0.16, (0.08, 0.07), (1.5e-3, 9e-4)
DRY, VISCOUS = (0.08, 0.05), (0.04, 0.03)

MJCF = f"""<mujoco><worldbody><body pos="0 0 1"><joint name="a" axis="0 1 0" armature="{ROTOR}"/>
<inertial pos="0 0 -{CENTRE[0]}" mass="{MASS[0] * 1.04}" diaginertia="{INERTIA[0]} {INERTIA[0]} 1e-4"/>
<body pos="0 0 -{LENGTH}"><joint name="b" axis="0 1 0" armature="{ROTOR}"/>
<inertial pos="0 0 -{CENTRE[1]}" mass="{MASS[1] * 0.95}" diaginertia="{INERTIA[1]} {INERTIA[1]} 1e-4"/>
<site pos="0 0 -{LENGTH}"/></body></body></worldbody></mujoco>"""

LAWS = ("load", "load_power", "stribeck", "width", "exponent", "drag", "drag_power", "lopsided", "spring", "cubic")
LAWS += ("soft", "gap", "lag", "limit", "integral", "dead", "where", "tilt", "beat", "slip")

SINGLES: dict[str, tuple[str, dict[str, float]]] = {
    "load friction": ("load_friction", {"load": 0.12}),
    "load friction, other: |tau|^0.8": ("load_friction", {"load": 0.12, "load_power": 0.8}),
    "Stribeck": ("stribeck", {"stribeck": 0.12, "width": 0.12}),
    "Stribeck, other: exponent 1": ("stribeck", {"stribeck": 0.14, "width": 0.1, "exponent": 1.0}),
    "quadratic drag": ("quadratic_drag", {"drag": 0.02}),
    "drag, other: |v|^1.6": ("quadratic_drag", {"drag": 0.02, "drag_power": 0.6}),
    "asymmetric friction": ("asymmetric_friction", {"lopsided": 0.04}),
    "spring": ("spring", {"spring": 0.6}),
    "compliance": ("compliance", {"soft": 1 / 60}),
    "backlash": ("backlash", {"gap": 0.015, "soft": 1 / 2500}),
    "torque lag": ("torque_lag", {"lag": 0.006}),
    "torque limit": ("torque_speed", {"limit": 2.0}),
    "tilt": ("base_tilt", {"tilt": 0.06}),
}
PAIRS = (
    ("load friction", "spring"),
    ("Stribeck", "backlash"),
    ("quadratic drag", "torque limit"),
    ("load friction", "asymmetric friction"),
    ("compliance", "spring"),
)
ALIENS = {
    "integral": {"integral": 20.0},
    "deadband": {"dead": 0.006},
    "friction over position": {"where": 0.05},
    "cubic spring": {"cubic": 1.5},
    "beating force": {"beat": 0.1},
    "slip of the encoder": {"slip": 0.05},
}


@njit(cache=True)
def _run(steps, target, p, out):
    """Step from rest; out (steps // 50, 2) gets what the encoders, on the motors, read each millisecond."""
    (load, load_power, level, width, exponent, drag, drag_power, lopsided, spring, cubic) = p[:10]
    (soft, gap, lag, limit, integral, dead, where, tilt, beat, slip) = p[10:]
    q, v, theta, omega = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    torque, total, drive = np.zeros(2), np.zeros(2), np.zeros(2)
    lost = 0.0
    for k in range(steps):
        t = k * STEP
        goal = target[min(max(int((t - DELAY) / 0.02), 0), len(target) - 1)]
        for j in range(2):
            x, w = (theta[j], omega[j]) if soft > 0.0 else (q[j], v[j])
            e = goal[j] - x
            total[j] += STEP * e
            e = e - min(max(e, -dead), dead)
            asked = KP * e - KD * w + integral * total[j]
            if limit > 0.0:
                asked = min(max(asked, -limit), limit)
            torque[j] = asked if lag <= 0.0 else torque[j] + (asked - torque[j]) * STEP / lag
            through = torque[j]
            if soft > 0.0:
                twist = theta[j] - q[j]
                beyond = twist - min(max(twist, -gap / 2), gap / 2)
                through = beyond / soft + (0.05 * (omega[j] - v[j]) if beyond != 0.0 else 0.0)
                omega[j] += STEP * (torque[j] - through) / ROTOR
                theta[j] += STEP * omega[j]
            drive[j] = through - spring * q[j] - cubic * q[j] ** 3 - VISCOUS[j] * v[j]
            drive[j] -= drag * abs(v[j]) ** drag_power * v[j]
        drive[1] += beat * math.sin(7.0 * t) * math.sin(0.31 * t)
        c2, s2 = math.cos(q[1]), math.sin(q[1])
        h = MASS[1] * LENGTH * CENTRE[1]
        m22 = INERTIA[1] + MASS[1] * CENTRE[1] ** 2
        m12 = m22 + h * c2
        m11 = INERTIA[0] + MASS[0] * CENTRE[0] ** 2 + MASS[1] * LENGTH**2 + m22 + 2.0 * h * c2
        g2 = 9.81 * MASS[1] * CENTRE[1] * math.sin(q[0] + q[1] + tilt)
        g1 = 9.81 * (MASS[0] * CENTRE[0] + MASS[1] * LENGTH) * math.sin(q[0] + tilt) + g2
        r0 = drive[0] + h * s2 * (2.0 * v[0] * v[1] + v[1] ** 2) - g1
        r1 = drive[1] - h * s2 * v[0] ** 2 - g2
        if soft <= 0.0:
            m11, m22 = m11 + ROTOR, m22 + ROTOR
        d = m11 * m22 - m12 * m12
        a, b, c = m22 / d, -m12 / d, m11 / d
        v0, v1 = v[0] + STEP * (a * r0 + b * r1), v[1] + STEP * (b * r0 + c * r1)
        push0, push1 = 0.0, 0.0
        for _ in range(30):  # friction that holds, or opposes the motion at the end of the step
            for j in range(2):
                most = DRY[j] + load * abs(torque[j]) ** load_power + where * math.cos(2.0 * q[j])
                if level > 0.0:
                    most += level * math.exp(-(abs(v[j] / width) ** exponent))
                most *= STEP
                if j == 0:
                    free, own = v0 + a * push0 + b * push1, a
                    push0 = min(max(push0 - free / own, -most - STEP * lopsided), most - STEP * lopsided)
                else:
                    free, own = v1 + b * push0 + c * push1, c
                    push1 = min(max(push1 - free / own, -most - STEP * lopsided), most - STEP * lopsided)
        v[0], v[1] = v0 + a * push0 + b * push1, v1 + b * push0 + c * push1
        q += STEP * v
        if slip > 0.0 and k % 250000 == 249999:
            lost += slip
        if k % 50 == 49:
            for j in range(2):
                out[k // 50, j] = (theta[j] if soft > 0.0 else q[j]) + lost


def arm_log(hidden: Mapping[str, float], *, seconds: float = 36.0, seed: int = 0) -> JointLog:
    """Return the log of an arm with these laws."""
    rng = np.random.default_rng((seed, 11))
    t = np.arange(0.0, seconds, 0.02)
    phase = rng.uniform(0, 2 * np.pi, (5, 2))
    sines = sum(
        0.4 / (1 + 0.7 * k) * np.sin(2 * np.pi * f * t[:, None] + phase[k])
        for k, f in enumerate((0.23, 0.6, 1.3, 2.2, 3.7))
    )
    slow = 0.7 * np.abs((t[:, None] * np.array([0.27, 0.21]) + phase[0] / 6) % 2.0 - 1.0) - 0.35
    steps = np.repeat(rng.uniform(-0.5, 0.5, (len(t) // 40 + 1, 2)), 40, axis=0)[: len(t)]
    part = (t % 10.0)[:, None]
    target = np.where(part < 5.0, sines, np.where(part < 8.0, slow, steps))
    defaults = {"load_power": 1.0, "width": 1.0, "exponent": 2.0, "drag_power": 1.0}
    p = np.array([float({**defaults, **hidden}.get(name, 0.0)) for name in LAWS])
    out = np.zeros((round(seconds / STEP) // 50, 2))
    _run(round(seconds / STEP), target, p, out)
    rows = np.arange(0.003, seconds - 0.02, 0.005) + 2e-4 * rng.standard_normal(round((seconds - 0.023) / 0.005 + 0.5))
    q = np.stack([np.interp(rows, (np.arange(len(out)) + 1) * 1e-3, c) for c in out.T], -1)
    newest = np.clip((rows / 0.02 + 1e-9).astype(int), 0, len(target) - 1)
    q = q + 3e-4 * rng.standard_normal(q.shape)
    return JointLog(joints=("a", "b"), t=rows, q=q, q_des=target[newest], metadata={"kp": KP, "kd": KD})


CHANCE, LEAST_GAIN = 0.05, 0.02
"""Of claiming anything of a log that has nothing, over all columns together (Holm 1979), and the share of the error
that an effect must take.
"""

WIDTH, MOST = 4, 4
"""Sets that are kept of each size, and the largest set."""

Grown = tuple[Score, tuple[Column, ...]]
"""A set of effects: how it does, and its columns."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Screen:
    """What the torques of some logs say."""

    singles: tuple[Score, ...]
    """Best first, each with its best thresholds."""
    claimed: tuple[str, ...]
    """Names of the best set that pays for all of its effects."""
    relative: FloatArray
    """RMS of the torque that the baseline leaves, over that of the torque (J,)."""


class Sets:
    """A beam search over sets of effects."""

    def __init__(self, torques: Torques) -> None:
        self.search, self.candidates = torques.regression, torques.candidates
        self._blocks = len(self.search.score(()).blocks)
        self.tried = len({c.name for c in self.candidates}) * (1 + (len(self.search.spread) > 1))

    def best(self) -> Score | None:
        """Return the best set of which each effect pays; None if nothing is claimed."""
        base = self.search.score(())
        found: dict[str, Grown] = {}
        for c in self.candidates:
            s = self.search.score((c,), base.blocks)
            if c.name not in found or s.gain > found[c.name][0].gain:
                found[c.name] = (s, (c,))
        beam: list[Grown] = [(base, ())]
        best: list[Grown] = []
        for size in range(MOST):
            grown: dict[tuple[str, ...], Grown] = {}
            for before, columns in beam:
                for _, (c,) in found.values():
                    if c.name in {x.name for x in columns}:
                        continue
                    s = self.search.score((*columns, c), before.blocks)
                    if self._pays(s.gain, s.z):
                        key = tuple(sorted(s.names))
                        if key not in grown or s.total < grown[key][0].total:
                            grown[key] = (s, (*columns, c))
            beam = sorted(grown.values(), key=lambda r: r[0].total)[:WIDTH]
            if size:
                beam = [row for row in (self._sharper(*row) for row in beam) if self._all_pay(*row)]
            if not beam:
                break
            best = beam + best
        return min((s for s, _ in best), key=lambda s: s.total, default=None)

    def _pays(self, gain: float, z: float) -> bool:
        chance = self.tried * float(stats.t.sf(z, self._blocks - 1))
        return gain >= LEAST_GAIN and min(1.0, chance) <= CHANCE

    def _sharper(self, score: Score, columns: tuple[Column, ...]) -> Grown:
        """Return a set with the thresholds of its last effect that suit it best beside the others."""
        best = (score, columns)
        for c in self.candidates:
            if c.name == columns[-1].name and c is not columns[-1]:
                s = self.search.score((*columns[:-1], c))
                if s.total < best[0].total:
                    own = replace(score, at=s.at, coefficients=s.coefficients, blocks=s.blocks)
                    best = (own, (*columns[:-1], c))
        return best

    def _all_pay(self, score: Score, columns: tuple[Column, ...]) -> bool:
        """Return whether each effect of a set is missed without it."""
        rests = (self.search.score((*columns[:i], *columns[i + 1 :])) for i in range(len(columns)))
        return all(self._pays(*evidence(rest.blocks - score.blocks)) for rest in rests)


def screen(logs: Sequence[tuple[JointLog, MachineModel]]) -> Screen:
    """Return single effects of some logs of one machine, and the set that is claimed."""
    torques = Torques(logs)
    claimed = Sets(torques).best()
    return Screen(
        singles=tuple(torques.singles()),
        claimed=claimed.names if claimed else (),
        relative=torques.regression.spread / np.maximum(torques.regression.torque, 1e-12),
    )


def _line(title: str, made: Screen, seconds: float, names: tuple[str, ...] = ()) -> str:
    top = ", ".join(f"{s.names[0]} {s.gain:.2f} (z {s.z:.1f})" for s in made.singles[:4])
    rank = [next((i + 1 for i, s in enumerate(made.singles) if s.names[0] == n), 0) for n in names]
    error = 100 * float(np.sqrt(np.mean(made.relative**2)))
    return f"{title:40} rank {rank} claimed {', '.join(made.claimed) or '-'} | {top} | {error:.1f} %, {seconds:.1f} s"


def _real(folder: Path) -> None:
    with tempfile.TemporaryDirectory() as out:
        (Path(out) / "servo.xml").write_text(SERVO_MJCF, encoding="utf-8")
        pendulum = read_machine(Path(out) / "servo.xml")
    for kp in (12.0, 17.6, 25.0, 40.0, 67.3):
        began = time.monotonic()
        made = screen([(log, pendulum) for log in servo_logs(folder / "sts3250", kp).values()])
        print(_line(f"STS3250 pooled, kp {kp:g}", made, time.monotonic() - began, ("load_friction",)), flush=True)
    columns = read_emps(folder / "emps" / "DATA_EMPS.parquet")
    with tempfile.TemporaryDirectory() as out:
        (Path(out) / "emps.xml").write_text(EMPS_MJCF, encoding="utf-8")
        began = time.monotonic()
        made = screen([(emps_log(columns, identify(columns)), read_machine(Path(out) / "emps.xml"))])
    print(_line("EMPS", made, time.monotonic() - began, ("asymmetric_friction",)))
    level, viscous = made.singles[0].coefficients[0]
    print(f"    {made.singles[0].names[0]}: level {level:.2f} N, coefficient {viscous:.2f} N s/m")
    began = time.monotonic()
    path = folder / "go2_air_chirp"
    made = screen([(go2_log(path / "log.parquet"), read_machine(path / "go2_hung.xml"))])
    print(_line("Go2", made, time.monotonic() - began))


def main() -> None:
    """Print one line for each log, and how often what was hidden is first, among the first three, and claimed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=36.0)
    parser.add_argument("--real", type=Path, default=None)
    a = parser.parse_args()
    if a.real is not None:
        return _real(a.real)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "arm.xml").write_text(MJCF, encoding="utf-8")
        model = read_machine(Path(folder) / "arm.xml", {"kp": KP, "kd": KD})
    cases: list[tuple[str, str, tuple[str, ...], Mapping[str, float]]] = [("clean", "clean", (), {})]
    cases += [("single", title, (name,), laws) for title, (name, laws) in SINGLES.items()]
    for one, two in PAIRS:
        names, laws = (SINGLES[one][0], SINGLES[two][0]), {**SINGLES[two][1], **SINGLES[one][1]}
        laws["soft"] = max(SINGLES[one][1].get("soft", 0.0), SINGLES[two][1].get("soft", 0.0))
        cases.append(("pair", f"{one} + {two}", names, laws))
    cases += [("alien", title, (), laws) for title, laws in ALIENS.items()]
    rows: dict[str, list[FloatArray]] = {}
    for kind, title, names, laws in cases:
        for seed in range(a.seeds):
            log = arm_log(laws, seconds=a.seconds, seed=seed)
            began = time.monotonic()
            made = screen([(log, model)])
            print(_line(f"{title} [{seed}]", made, time.monotonic() - began, names), flush=True)
            first = [s.names[0] for s in made.singles]
            top, near = set(names) <= set(first[: len(names)]), set(names) <= set(first[: len(names) + 3])
            claim = set(names) <= set(made.claimed) if names else not made.claimed
            rows.setdefault(kind, []).append(np.array([top, near, claim, set(made.claimed) == set(names)], dtype=float))
    for kind, found in rows.items():
        first, near, claim, exact = np.sum(found, axis=0).astype(int)
        print(
            f"{kind}: of {len(found)}, first {first}, within three more {near}, claimed {claim}, nothing else {exact}"
        )


if __name__ == "__main__":
    main()

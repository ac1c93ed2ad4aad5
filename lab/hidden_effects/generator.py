"""Logs of a hung CyberDog 2 with effects whose numbers are known: the truth that a calibration has to find.

Equations are those of mimic.dynamics.catalogue, written again; physics is in physics.py. Aliens are effects that the
catalogue does not have. Nothing of mimic's law, machine or replay is used here.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lab.hidden_effects import physics as ph
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.excitation import Excitation
from mimic.io.joint_log import JointLog
from mimic.records import JOINTS, LEGS, FloatArray
from mimic.robot.description import RobotDescription, load_description

GRAVITY = 9.81
NOISE = 0.35e-3
"""Gaussian, standard deviation [rad]."""
ENCODER = 8.0 * math.pi / 2**16
"""Step of the reading: 16 bits over +-4 pi; CyberGear manual, feedback frame [rad]."""
FLOOR = math.hypot(NOISE, ENCODER / math.sqrt(12.0))
"""Standard deviation of both together [rad]."""
RATE = 200.0
"""Readings per second [Hz]."""
STEP = 0.03125e-3
"""Physics step [s]."""
SETTLE = 1.0
"""Time at the first target before the log begins [s]."""

_COLUMN = {name: i for i, name in enumerate(ph.COLUMNS)}

_DIRECT: Mapping[str, Mapping[str, str]] = {
    "coulomb": {"level": "friction"},
    "viscous": {"coefficient": "damping"},
    "armature": {"inertia": "armature"},
    "torque_speed": {"torque": "torque", "speed": "speed", "flat": "flat"},
    "kt_gain": {"factor": "kt"},
    "kt_drift": {"rate": "drift"},
    "kt_heat": {"loss": "heat_loss", "time": "heat_time"},
    "torque_lag": {"time": "torque_lag"},
    "velocity_lag": {"time": "velocity_lag"},
    "stribeck": {"level": "stribeck", "speed": "stribeck_speed"},
    "load_friction": {"ratio": "load"},
    "asymmetric_friction": {"level": "asymmetric", "coefficient": "asymmetric_viscous"},
    "quadratic_drag": {"coefficient": "drag"},
    "coupling": {"coefficient": "coupling"},
    "backlash": {"gap": "gap"},
    "compliance": {"compliance": "compliance"},
    "encoder_offset": {"angle": "offset"},
    "encoder_scale": {"factor": "scale"},
    "encoder_step": {"angle": "step"},
    "cogging": {"cosine": "cog_cos", "sine": "cog_sin", "order": "cog_order"},
    "spring": {"stiffness": "stiffness", "moment": "moment"},
}
"""Parameters of the catalogue that are a column of the physics."""


@dataclass(frozen=True, kw_only=True)
class Alien:
    """An effect outside the catalogue."""

    name: str
    joints: tuple[str, ...]
    """Affected joints; all of them for what moves the base."""
    size: float
    """In the unit of ALIENS."""


ALIENS: Mapping[str, str] = {
    "cable_stop": "N m/rad beyond an angle that a third of the motion passes",
    "base_swing": "m/s^2, sideways at 0.83 Hz and forward at 0.94 Hz",
    "eccentricity": "rad, reading + c sin(q + p)",
    "wearing_in": "share by which dry friction is greater at first, gone after 15 rad of travel",
    "imbalance": "kg m^2, rotor inertia + c cos(9 q + p)",
    "cable_hysteresis": "N m, Bouc-Wen loop reached within 0.15 rad",
    "detent": "N m, magnet at one angle, 0.05 rad wide",
    "random_walk": "N m, wandering torque, forgotten after 3 s",
    "periodic_force": "N m, an outside force at 1.7 Hz",
    "integral": "N m/(rad s), integral term of the drive, which has run since before the log",
    "target_filter": "s, first-order lag of the target",
    "deadband": "rad, errors below which the drive does nothing",
    "friction_wave": "N m, dry friction + c cos(3 q), never less than none",
    "slip": "rad by which the reading jumps after 4 rad of travel, and back after 4 more",
    "zero_drift": "rad/s by which the zero of the encoder moves",
}
"""Name and size."""

DESCRIBED = {"eccentricity": "encoder_eccentricity", "target_filter": "target_filter"}
"""Aliens that the catalogue describes by now: to name them is right, too."""

OTHER_LAWS: Mapping[str, tuple[str, Mapping[str, float]]] = {
    "load_friction": ("grows with |tau|^0.8", {"load_power": 0.8}),
    "stribeck": ("exp(-|v|/speed)", {"stribeck_power": 1.0}),
    "quadratic_drag": ("|v|^1.6", {"drag_power": 0.6}),
    "spring": ("stiffens by 30 % at 1 rad", {"cubic": 0.3}),
    "cogging": ("second harmonic, a fifth of the first", {"second_cog": 0.2}),
    "compliance": ("stiffens, twice as stiff at 60 mrad", {"hardening": 0.06}),
    "backlash": ("flanks of 2500 N m/rad", {"flank": 2500.0}),
}
"""Laws that differ from the catalogue's: what in words, and columns of the physics; of cogging a share of its size."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Machine:
    """Everything true about one machine. Joint arrays are (12,)."""

    friction: FloatArray
    """[N m]"""
    damping: FloatArray
    """[N m s/rad]"""
    mass: FloatArray
    """Factor of each moved link."""
    delay: float
    """[s]"""
    hidden: EffectSet = field(default_factory=EffectSet)
    aliens: tuple[Alien, ...] = ()
    motor_side: bool = False
    """Dry and viscous friction act on the motor, not on the link."""
    other_laws: tuple[str, ...] = ()
    """Hidden effects whose law is that of OTHER_LAWS."""

    @staticmethod
    def drawn(rng: np.random.Generator, hidden: EffectSet | None = None, aliens: Sequence[Alien] = ()) -> Machine:
        """Draw the baseline values."""
        return Machine(
            friction=rng.uniform(0.03, 0.12, 12),
            damping=rng.uniform(0.02, 0.1, 12),
            mass=rng.uniform(0.9, 1.15, 12),
            delay=float(rng.uniform(0.005, 0.020)),
            hidden=hidden or EffectSet(),
            aliens=tuple(aliens),
        )


def robot_numbers(description: RobotDescription | None = None) -> dict[str, Any]:
    """Return the tables of robot.toml; the generator reads masses there by itself, independent of mimic's MJCF."""
    folder = (description or load_description("cyberdog2")).folder
    return tomllib.loads((folder / "robot.toml").read_text(encoding="utf-8"))


def links(description: RobotDescription, leg: str) -> FloatArray:
    """Return mass, centre, inertia and next joint (3, 13) of one leg; rotors belong to the link that carries them."""
    raw = robot_numbers(description)
    s, f = (1.0 if leg[1] == "L" else -1.0), (1.0 if leg[0] == "F" else -1.0)
    flip_com = {"abad": (f, s, 1.0), "hip": (1.0, s, 1.0), "knee": (1.0, 1.0, 1.0)}
    flip_products = {"abad": (s * f, f, s), "hip": (s, 1.0, s), "knee": (1.0, 1.0, 1.0)}
    rotors = {"abad": [("abad", (f, 1.0, 1.0))], "hip": [("hip", (1.0, s, 1.0)), ("knee", (1.0, s, 1.0))], "knee": []}
    ends = {
        "abad": np.array(raw["hip"]["origin"]) * (1.0, s, 1.0),
        "hip": np.array([0.0, 0.0, -raw["hip"]["length"]]),
        "knee": np.array(raw["toe"]["position"]),
    }
    rows = []
    for part in ("abad", "hip", "knee"):
        parts = [
            (
                raw[part]["mass"],
                np.array(raw[part]["com"]) * flip_com[part],
                _tensor(raw[part]["inertia"], flip_products[part]),
            )
        ]
        rotor = raw["rotor"]
        parts += [
            (rotor["mass"], np.array(rotor[name]) * flip, _tensor(rotor["inertia"], (1, 1, 1)))
            for name, flip in rotors[part]
        ]
        mass, com, tensor = _merged(parts)
        rows.append(_link_row(mass, com, tensor, ends[part]))
    return np.array(rows)


def _tensor(six: Sequence[float], flip: Sequence[float]) -> FloatArray:
    xx, yy, zz, xy, xz, yz = six
    xy, xz, yz = xy * flip[0], xz * flip[1], yz * flip[2]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _merged(parts: Sequence[tuple[float, FloatArray, FloatArray]]) -> tuple[float, FloatArray, FloatArray]:
    mass = sum(m for m, _, _ in parts)
    com = sum(m * c for m, c, _ in parts) / mass
    tensor = np.zeros((3, 3))
    for m, c, inertia in parts:
        r = c - com
        tensor += inertia + m * (r @ r * np.eye(3) - np.outer(r, r))
    return mass, com, tensor


def _link_row(mass: float, com: FloatArray, tensor: FloatArray, end: FloatArray) -> FloatArray:
    products = tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]
    return np.array([mass, *com, *products, *end])


def _with_payload(row: FloatArray, load: float) -> FloatArray:
    tensor = _tensor(row[4:10], (1, 1, 1))
    return _link_row(
        *_merged([(row[0], row[1:4], tensor), (load, row[10:13].copy(), np.zeros((3, 3)))]),
        row[10:13],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """A simulated motion before noise. (T, 12)"""

    t: FloatArray
    q: FloatArray
    """What an ideal encoder reads [rad]."""
    tau: FloatArray
    """Torque of the motors [N m]."""
    q_des: FloatArray
    """Target last sent [rad]."""


@dataclass(frozen=True, kw_only=True)
class Clock:
    """When a logger writes its rows, each with the newest target beside the reading."""

    rate_hz: float
    beside: float = 0.0
    """First row after the first target [s]."""
    jitter: float = 0.0
    """Standard deviation of the time of a row, which the row tells [s]."""


CLOCKS = {
    "grid": Clock(rate_hz=RATE),
    "beside": Clock(rate_hz=200.0, beside=0.004, jitter=0.0003),
    "187": Clock(rate_hz=187.0, beside=0.001),
    "50": Clock(rate_hz=50.0, beside=0.004),
}
"""The first is that of the targets, which come at 50 Hz."""

FINE_RATE = 1000.0
"""Rows between which other clocks read [Hz]: straight lines over 1 ms are within a hundredth of the noise."""


def simulate(machine: Machine, motion: Excitation, seed: int, step: float = STEP, rate_hz: float = RATE) -> Truth:
    """Return the motion of the machine at so many rows a second; seed draws what is random in it."""
    description = load_description("cyberdog2")
    rng = np.random.default_rng((seed, 1))
    par = np.zeros((4, 3, len(ph.COLUMNS)))

    def put(column: str, value: FloatArray | float) -> None:
        par[:, :, _COLUMN[column]] = np.broadcast_to(value, 12).reshape(4, 3)

    motor = robot_numbers(description)["motor"]
    for column, value in {
        "friction": machine.friction,
        "damping": machine.damping,
        "armature": motor["armature"],
        "kp": motor["kp"],
        "kd": motor["kd"],
        "torque": motor["torque_max"],
        "speed": motor["speed_max"],
        "flat": motor["speed_flat"],
        "kt": 1.0,
        "heat_time": 40.0,
        "stribeck_speed": 0.1,
        "scale": 1.0,
        "low": description.q_min,
        "high": description.q_max,
        "motor_side": float(machine.motor_side),
        "wear_travel": 15.0,
        "cable_k": 1.0,
        "detent_width": 1.0,
        "load_power": 1.0,
        "stribeck_power": 2.0,
        "drag_power": 1.0,
        "slip_travel": 4.0,
    }.items():
        put(column, value)
    link = np.stack([links(description, leg) for leg in LEGS])
    link[:, :, [0, 4, 5, 6, 7, 8, 9]] *= machine.mass.reshape(4, 3)[:, :, None]
    gravity, drop = np.array([0.0, 0.0, -GRAVITY]), 0.0
    late, jitter, lost = np.zeros(12), 0.0, 0.0
    for effect in machine.hidden.applied:
        index = [JOINTS.index(j) for j in effect.joints]
        values = effect.values
        if effect.name in machine.other_laws:
            for column, value in OTHER_LAWS[effect.name][1].items():
                size = np.hypot(values["cosine"], values["sine"]) if effect.name == "cogging" else 1.0
                par.reshape(12, -1)[index, _COLUMN[column]] = value * size
        if effect.name in _DIRECT:
            for parameter, row in values.items():
                par.reshape(12, -1)[index, _COLUMN[_DIRECT[effect.name][parameter]]] = row
        elif effect.name == "gains":
            for gain in ("kp", "kd"):
                par.reshape(12, -1)[index, _COLUMN[gain]] *= values.get(gain, 1.0)
        elif effect.name == "com_shift":
            for j, distance in zip(index, values["distance"], strict=True):
                row = link[j // 3, j % 3]
                row[1:4] += distance * row[10:13] / np.linalg.norm(row[10:13])
        elif effect.name == "payload":
            for j, load in zip(index, values["mass"], strict=True):
                link[j // 3, j % 3] = _with_payload(link[j // 3, j % 3], load)
        elif effect.name == "base_tilt":
            gravity = _tilted(float(values["roll"][0]), float(values["pitch"][0]))
        elif effect.name == "supply_sag":
            drop = float(values["drop"][0])
        elif effect.name == "joint_delay":
            late[index] = values["time"]
        elif effect.name == "delay_jitter":
            jitter = float(values["spread"][0])
        elif effect.name == "lost_commands":
            lost = float(values["share"][0])
        else:
            raise ValueError(f"the benchmark does not simulate {effect.name}")
    rows = round((motion.t[-1] + motion.t[1]) * rate_hz)
    swing, extra = np.zeros((2, 3)), np.zeros((0, 4, 3))
    for alien in machine.aliens:
        index = [JOINTS.index(j) for j in alien.joints]
        if alien.name == "base_swing":
            swing = np.array(
                [
                    [alien.size, 0.94, rng.uniform(0, 2 * np.pi)],
                    [alien.size, 0.83, rng.uniform(0, 2 * np.pi)],
                ]
            )
        elif alien.name == "random_walk":
            keep = np.zeros(12)
            keep[index] = alien.size
            more = _wandering(round(rows * RATE / rate_hz) + 400, rng) * keep.reshape(4, 3)
            extra = more + extra if len(extra) else more
        else:
            for j in index:
                for column, value in _alien_columns(alien, motion, j, rng).items():
                    par[j // 3, j % 3, _COLUMN[column]] = value
    arrival, target = _commands(motion, machine.delay + late, jitter, lost, rng)
    q = np.zeros((rows, 4, 3))
    tau = np.zeros((rows, 4, 3))
    ph.run(
        step, round(SETTLE / step), round(1.0 / rate_hz / step), rows, par, link, gravity, swing, drop,
        arrival.reshape(4, 3, -1), target.reshape(4, 3, -1), motion.q_des[0].reshape(4, 3), extra, 1.0 / RATE, q, tau,
    )  # fmt: skip
    t = np.arange(rows) / rate_hz
    sent = np.searchsorted(motion.t, t + 1e-9, side="right") - 1
    return Truth(t=t, q=q.reshape(rows, 12), tau=tau.reshape(rows, 12), q_des=motion.q_des[sent])


def read_by(clock: Clock, truth: Truth, motion: Excitation, seed: int) -> Truth:
    """Return what a motion is when another clock reads it; ``truth`` has many rows."""
    rng = np.random.default_rng((seed, 3))
    t = np.arange(clock.beside, truth.t[-1] - 0.01, 1.0 / clock.rate_hz)
    t = np.maximum.accumulate(np.maximum(t + clock.jitter * rng.standard_normal(len(t)), 0.0))
    q, tau = (np.stack([np.interp(t, truth.t, c) for c in x.T], -1) for x in (truth.q, truth.tau))
    return Truth(t=t, q=q, tau=tau, q_des=motion.q_des[np.searchsorted(motion.t, t + 1e-9, side="right") - 1])


def measured(truth: Truth, seed: int, noise: float = NOISE, notes: Mapping[str, object] | None = None) -> JointLog:
    """Return the log that a machine with a 16-bit encoder would write."""
    rng = np.random.default_rng((seed, 2))
    motor = robot_numbers()["motor"]
    q = np.round((truth.q + noise * rng.standard_normal(truth.q.shape)) / ENCODER) * ENCODER
    metadata = {"kp": motor["kp"], "kd": motor["kd"], "gravity": [0.0, 0.0, -GRAVITY], **(notes or {})}
    return JointLog(joints=JOINTS, t=truth.t, q=q, q_des=truth.q_des, metadata=metadata)


def _tilted(roll: float, pitch: float) -> FloatArray:
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    turn = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return turn.T @ np.array([0.0, 0.0, -GRAVITY])


def _commands(
    motion: Excitation, late: FloatArray, jitter: float, lost: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """When each target takes effect (12, K) [s], in order, and what it is; the first acts from the start."""
    sent = np.array(motion.t)
    kept = np.ones(len(sent), bool)
    if lost > 0.0:
        kept = rng.random(len(sent)) >= lost
        kept[0] = True
    sent, targets = sent[kept], motion.q_des[kept]
    if jitter > 0.0:
        sent = np.maximum.accumulate(sent + rng.uniform(0.0, jitter, len(sent)))
    arrival = sent[None] + late[:, None]
    arrival[:, 0] = -1e9
    return np.ascontiguousarray(arrival), np.ascontiguousarray(targets.T)


def _wandering(rows: int, rng: np.random.Generator) -> FloatArray:
    """Ornstein-Uhlenbeck process of unit size (rows, 4, 3), forgotten after 3 s."""
    keep = math.exp(-1.0 / RATE / 3.0)
    kicks = math.sqrt(1 - keep**2) * rng.standard_normal((rows, 12))
    x = np.empty((rows, 12))
    x[0] = rng.standard_normal(12)
    for i in range(1, rows):
        x[i] = keep * x[i - 1] + kicks[i]
    return x.reshape(rows, 4, 3)


_ONE_COLUMN = {
    "integral": "integral",
    "target_filter": "target_lag",
    "deadband": "deadband",
    "friction_wave": "friction_wave",
    "slip": "slip",
    "zero_drift": "zero_drift",
}


def _alien_columns(alien: Alien, motion: Excitation, joint: int, rng: np.random.Generator) -> dict[str, float]:
    passed = motion.q_des[:, joint]
    if alien.name == "cable_stop":
        return {"stop_k": alien.size, "stop_q": float(np.quantile(passed, 0.67))}
    if alien.name == "eccentricity":
        return {"eccentric": alien.size, "eccentric_phase": rng.uniform(0, 2 * np.pi)}
    if alien.name == "wearing_in":
        return {"wear": alien.size}
    if alien.name == "imbalance":
        return {"imbalance": alien.size, "imbalance_order": 9.0, "imbalance_phase": rng.uniform(0, 2 * np.pi)}
    if alien.name == "cable_hysteresis":
        return {"cable_torque": alien.size, "cable_k": alien.size / 0.15}
    if alien.name == "periodic_force":
        phase = rng.uniform(0, 2 * np.pi)
        return {"force_cos": alien.size * np.cos(phase), "force_sin": alien.size * np.sin(phase), "force_hz": 1.7}
    if alien.name in _ONE_COLUMN:
        return {_ONE_COLUMN[alien.name]: alien.size}
    if alien.name == "detent":
        return {
            "detent": alien.size,
            "detent_q": float(np.quantile(passed, rng.uniform(0.35, 0.65))),
            "detent_width": 0.05,
        }
    raise ValueError(f"alien {alien.name!r} does not exist; there are {', '.join(ALIENS)}")

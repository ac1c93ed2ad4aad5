"""Numbers from a log: tracking, standing, effort and heat. Each works on any log, simulated or measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from mimic.dynamics.thermal import seconds_to_limit, winding_rise
from mimic.geometry import heading_from_quat, quat_parts, upright_cosine, wrap_angle
from mimic.records import JOINTS, PHASES, FloatArray, RunLog, TargetTrack
from mimic.records.table import number
from mimic.robot.description import RobotDescription

LONGEST_LAG = 0.4
"""Of the toes [s]."""

UPRIGHT_COSINE = 0.9
"""Standing means: base x within this cosine of the wanted direction; the paper's gate."""

UPRIGHT_SHARE = 0.8
"""… and the base at least this share of its upright height high, in whole centimetres, where height is measured; the
paper's factor is 1 from here on."""

PARTS = ("sampling", "clamp", "speed_limit", "policy", "lag")
"""What lies between the motion of a person and that of the toes, in this order."""


def uprightness(quat_WB: FloatArray, description: RobotDescription) -> FloatArray:
    """Return the cosine between base x and the wanted upright direction (...,), the direction turned to the heading."""
    return upright_cosine(
        *quat_parts(quat_WB), heading=heading_from_quat(quat_WB), direction=description.upright_direction, xp=np
    )


def standing(log: RunLog, description: RobotDescription) -> np.ndarray:
    """Return for each tick whether the robot stands upright; height counts where it is measured."""
    ok = uprightness(log.quat_WB, description) > UPRIGHT_COSINE
    height = log.p_WB[:, 2]
    least = round(UPRIGHT_SHARE * description.pose_height["upright"], 2)
    return ok & (np.isnan(height) | (height > least))


def stand_up_time(log: RunLog, description: RobotDescription) -> float:
    """Return the time from when the policy begins to the first upright tick [s]; infinite if there is none."""
    stood = log.t[standing(log, description)]
    begins = log.t[log.phase != PHASES.index("lie")]
    return float(stood[0] - begins[0]) if len(stood) and len(begins) else float("inf")


def _step(log: RunLog) -> float:
    """Return the time between two ticks [s]; a log of one tick takes it from its metadata."""
    return float(np.median(np.diff(log.t))) if len(log.t) > 1 else float(log.metadata["dt"])


def toe_error(log: RunLog) -> FloatArray:
    """Return the distance between target and reached toe while tracking (ticks, 2) [m]."""
    rows = log.phase == PHASES.index("track")
    return np.linalg.norm(log.p_BE[rows] - log.p_BE_des[rows], axis=-1)


def toe_lag(log: RunLog) -> tuple[float, float]:
    """Return the delay that explains most of the toe error [s], and the mean error left with it [m].

    The targets are shifted in time by whole ticks; the shift with the least mean error wins.
    """
    rows = np.flatnonzero(log.phase == PHASES.index("track"))
    if len(rows) < 3:
        return 0.0, float("nan")
    dt = _step(log)
    reached = log.p_BE[rows]
    target = log.p_BE_des[rows]
    most = len(rows) // 2
    shifts = range(min(round(LONGEST_LAG / dt) + 1, most))

    def error(shift: int) -> float:
        apart = reached[shift:] - target[: len(target) - shift]
        return float(np.linalg.norm(apart, axis=-1).mean())

    best = min(shifts, key=error)
    return best * dt, error(best)


def wanted_to_reached(log: RunLog, targets: TargetTrack) -> dict[str, float] | None:
    """Return how far the toes were from what the person did, and what took how much of it [cm].

    The parts add up to ``apart``: what each step adds to the mean distance from the person's own motion. Only rows in
    which the hand was seen count. What the camera did not see of the motion is not in it.

    Returns:
        ``wanted`` and ``reached``: motion of the person and of the toes, rms about its mean; ``apart`` and ``p95``:
        distance between the two; then its parts. None if no row was played.
    """
    rows = np.flatnonzero(log.phase == PHASES.index("track"))[: len(targets.t)]
    n = len(rows)
    valid = targets.valid[:n]
    if not valid.any():
        return None
    person = np.where(np.isfinite(targets.person[:n]), targets.person[:n], targets.wanted[:n])
    within = np.where(np.isfinite(targets.within_reach[:n]), targets.within_reach[:n], targets.p_BE[:n])
    shift = round(toe_lag(log)[0] / _step(log))
    in_time = log.p_BE[np.clip(rows + shift, 0, len(log.t) - 1)]
    steps = (targets.wanted[:n], within, targets.p_BE[:n], in_time, log.p_BE[rows])
    apart = [100 * np.linalg.norm(step - person, axis=-1)[valid] for step in steps]
    means = [0.0, *(float(values.mean()) for values in apart)]

    def motion(toes: FloatArray) -> float:
        away = [toes[seen, side] - toes[seen, side].mean(axis=0) for side, seen in enumerate(valid.T) if seen.any()]
        return 100 * float(np.sqrt(np.mean(np.sum(np.concatenate(away) ** 2, axis=-1))))

    return {
        "wanted": motion(person),
        "reached": motion(log.p_BE[rows]),
        "apart": means[-1],
        "p95": float(np.quantile(apart[-1], 0.95)),
        **dict(zip(PARTS, np.diff(means).tolist(), strict=True)),
    }


def run_metrics(log: RunLog, description: RobotDescription) -> dict[str, Any]:
    """Return the figures of a run as plain data; lengths in cm where the name says so."""
    error = 100 * toe_error(log)
    lag, left = toe_lag(log)
    stood = standing(log, description)
    stand_up = stand_up_time(log, description)
    rows = log.aimed
    dt = _step(log)
    lasting = log.tau[rows] if rows.any() else log.tau
    rise = winding_rise(log.tau, dt, description)[-1]
    limit = seconds_to_limit(lasting, dt, description)
    hottest = int(np.argmax(np.mean(lasting**2, axis=0)))
    knees = [i for i, name in enumerate(JOINTS) if name.startswith("R") and name.endswith("knee")]
    duration = len(log.t) * dt
    heading = heading_from_quat(log.quat_WB)
    aimed = np.flatnonzero(rows)
    drift = np.linalg.norm(np.diff(log.p_WB[aimed[[0, -1]], :2], axis=0)) if len(aimed) else float("nan")
    return {
        "duration_s": duration,
        "stand_up_s": stand_up,
        "fell_at_s": log.metadata.get("fell_at"),
        "falls": 0 if log.metadata.get("fell_at") is None else 1,
        "standing_share": float(stood[rows].mean()) if rows.any() else 0.0,
        "toe_error_cm": {
            "mean": float(error.mean()) if error.size else float("nan"),
            "p95": float(np.quantile(error, 0.95)) if error.size else float("nan"),
            "max": float(error.max()) if error.size else float("nan"),
            "left": float(error[:, 0].mean()) if error.size else float("nan"),
            "right": float(error[:, 1].mean()) if error.size else float("nan"),
        },
        "lag_s": lag,
        "toe_error_without_lag_cm": 100 * left,
        "heading_error_rad": float(np.abs(wrap_angle(heading - log.heading_des))[rows].mean()) if rows.any() else None,
        "drift_m": float(drift),
        "torque_nm": {
            "rms": float(np.sqrt(np.mean(log.tau[rows] ** 2))) if rows.any() else float("nan"),
            "max": float(np.abs(log.tau).max()),
            "knee_rms": float(np.sqrt(np.mean(log.tau[rows][:, knees] ** 2))) if rows.any() else float("nan"),
        },
        "joint_speed_max_rad_s": float(np.abs(log.dq).max()),
        "winding_rise": {name: float(rise[i]) for i, name in enumerate(JOINTS)},
        "hottest_motor": JOINTS[hottest],
        "minutes_to_limit": float(limit[hottest] / 60),
    }


def _lag(m: dict[str, Any]) -> str:
    """Return how late the toes were."""
    left = number(m["toe_error_without_lag_cm"], "{:.1f} cm")
    return f"{number(1e3 * m['lag_s'], '{:.0f} ms')} (error with lag removed: {left})"


def _wanted_to_reached(m: dict[str, Any]) -> dict[str, str]:
    """Return what the person did against what the toes did, and what lies between."""
    found = m.get("wanted_to_reached_cm")
    if not found:
        return {}
    parts = ", ".join(f"{name.replace('_', ' ')} {found[name]:.1f}" for name in PARTS)
    return {
        "wanted → reached": f"{found['apart']:.1f} cm apart (95th percentile {found['p95']:.1f}): {parts}; "
        f"motion {found['wanted']:.1f} → {found['reached']:.1f} cm rms"
    }


def metric_rows(m: dict[str, Any]) -> dict[str, str]:
    """Return the figures of a run; a dash where there was nothing to measure."""
    error = m["toe_error_cm"]
    hot = m["minutes_to_limit"]
    return _wanted_to_reached(m) | {
        "stood up in": number(m["stand_up_s"], "{:.2f} s"),
        "upright": number(m["standing_share"], "{:.1%} of the time after standing up"),
        "toe error": f"{number(error['mean'], '{:.1f} cm')} mean, {number(error['p95'], '{:.1f} cm')} 95th percentile",
        "lag": _lag(m),
        "knee torque": f"{number(m['torque_nm']['knee_rms'], '{:.1f} N m')} rms; "
        f"{number(m['torque_nm']['max'], '{:.1f} N m')} peak of any joint",
        "heat": f"{m['hottest_motor']} reaches its limit after {hot:.0f} min of this"
        if hot < 1e4
        else "no motor above its continuous rating",
    }

"""Figures of a run, a row each, as the commands print them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mimic.cli.console import number
from mimic.metrics import PARTS

if TYPE_CHECKING:
    from mimic.records import TargetTrack


def target_rows(targets: TargetTrack | None) -> dict[str, str]:
    """Return what retargeting did."""
    if targets is None:
        return {}
    report: dict[str, Any] = dict(targets.report)
    if "targets" not in report:  # not made by retargeting
        return {"targets": f"{targets.t[-1]:.1f} s in all"}
    rows = {
        "targets": f"{report['targets']} at {report['rate_s']:.3g} s, {targets.t[-1]:.1f} s in all",
        "clamped": f"{report['clamped_share']:.1%}, moved {number(report['moved_mean_cm'], '{:.2f} cm')} on average, "
        f"{number(report['moved_max_cm'], '{:.1f} cm')} at most",
        "limited by speed": f"{report['limited_share']:.1%}",
    }
    if report.get("slow_down", 1.0) != 1.0:
        rows["slowed down"] = f"{report['slow_down']:.3g} times"
    pose = report.get("pose")
    if pose:
        rows |= {
            "frames with a person": f"{pose['frames_with_person']} of {pose['frames']}",
            "left/right swapped": f"{pose['frames_exchanged']} frames",
        } | ({"camera": str(pose["unseen"])} if "unseen" in pose else {})
    return rows


def _lag(m: dict[str, Any]) -> str:
    """Return how late the toes were, and what was done about it."""
    left = number(m["toe_error_without_lag_cm"], "{:.1f} cm")
    asked = f"each target asked for {1e3 * m['early_s']:.0f} ms early" if m["early_s"] else "no target asked for early"
    return f"{number(1e3 * m['lag_s'], '{:.0f} ms')}, with {asked} (error with lag removed: {left})"


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

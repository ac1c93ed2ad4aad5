"""What commands print of a run: its figures, a row each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mimic.cli.console import number, table, warn
from mimic.cli.exit_status import DONE, STOPPED
from mimic.metrics import PARTS

if TYPE_CHECKING:
    from mimic.flows.run_folder import SavedRun
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


def show_simulated(saved: SavedRun, title: str, view: bool | None, rows: dict[str, str] | None = None) -> int:
    """Print the figures of a simulated run, open its scene, and return the exit status."""
    show_figures(saved, title, rows)
    result = saved.run.result
    if result.error is not None:
        raise result.error
    if saved.run.shortfall is not None:
        warn(f"stopped: {saved.run.shortfall}")
    open_scene(saved.folder, view)
    return STOPPED if saved.run.shortfall is not None or result.interrupted else DONE


def show_figures(
    saved: SavedRun, title: str, rows: dict[str, str] | None = None, more: dict[str, str] | None = None
) -> None:
    """Print the figures of a run, with further rows before and after those of the robot."""
    motion = saved.run.motion
    figures = target_rows(None if motion is None else motion.targets) | (rows or {})
    figures |= metric_rows(dict(saved.metrics)) | (more or {}) | {"run folder": str(saved.folder)}
    table(title, figures | ({"film": str(saved.film)} if saved.film else {}))


def open_scene(folder: Path, view: bool | None) -> None:
    """Open the scene of a run folder if asked for, or by default where there is a display."""
    from mimic.flows.run_folder import SCENE
    from mimic.view.scene.viewer import display_available, open_viewer

    if view or (view is None and display_available()):
        open_viewer(folder / SCENE)

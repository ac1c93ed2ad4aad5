"""What commands print of a run: its figures, a row each."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mimic.cli.terminal.console import note, table, warn
from mimic.cli.terminal.exit_status import DONE, STOPPED
from mimic.metrics import metric_rows
from mimic.records.table import number

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


def show_simulated(saved: SavedRun, title: str, view: bool | None, rows: dict[str, str] | None = None) -> int:
    """Print the figures of a simulated run, open its scene, and return the exit status."""
    show_figures(saved, title, rows)
    result = saved.run.result
    if result.error is not None:
        raise result.error
    open_scene(saved.folder, view)
    if saved.run.shortfall is not None:
        warn(f"stopped: {saved.run.shortfall}")
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
    """Open the scene of a run folder if asked for, or by default where there is a display; say what to do next."""
    from mimic.flows.run_folder import SCENE
    from mimic.view.scene.viewer import display_available, open_viewer

    wanted = display_available() if view is None else view
    if wanted and open_viewer(folder / SCENE):
        note("next         look at the run in the Rerun window")
    else:
        note(f"next         mimic view {shlex.quote(str(folder))}")

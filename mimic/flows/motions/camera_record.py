"""What a camera saw that a robot followed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mimic.errors import SourceError
from mimic.flows.motions.motion import InputSettings, Motion
from mimic.flows.reporter import Reporter
from mimic.io import store
from mimic.records import PHASES, WRISTS, CommandTrack, FloatArray, LiveTrack, PoseTrack, Provenance, RunLog

if TYPE_CHECKING:
    from mimic.sources.video.camera import CameraFrame

LIVE = "live.parquet"
"""Its file in a run folder."""


@dataclass(slots=True)
class CameraRecord:
    """What the camera saw and how long each frame took, row by row."""

    settings: InputSettings = field(default_factory=InputSettings)
    seen: list[CameraFrame] = field(default_factory=list)
    latency: list[float] = field(default_factory=list)
    people: tuple[str, ...] = ()
    """What was last to be said of several people in view."""
    began: float = float("nan")
    """When the first command was asked for, on the clock of the rows [s]."""
    zero: float = 0.0
    """Time from the first command to the first tracked target [s]."""
    overruns: int | None = None
    """Control steps that the simulation could not finish in time; None on a robot."""
    error: Exception | None = None

    def summary(self, latest: int | None = None) -> str:
        """Return the latency as text, of all frames or of the latest."""
        rows = 1e3 * np.array(self.latency[-latest:] if latest else self.latency)
        if not len(rows):
            return "no frame yet"
        dropped = self.seen[-1].number + 1 - len(self.seen)
        return (
            f"{np.median(rows):.0f} ms p50, {np.quantile(rows, 0.95):.0f} ms p95, {rows.max():.0f} ms max; "
            f"{len(self.seen)} frames, {dropped} dropped in favour of newer ones"
        )

    def track(self) -> LiveTrack:
        """Return the rows as a record."""
        rows = self.seen
        wrists = [row.valid[WRISTS] for row in rows]
        return LiveTrack(
            t=np.array([row.t for row in rows]) - self.began,
            latency=np.array(self.latency),
            detector=np.array([row.detector_s for row in rows]),
            skipped=np.diff(np.array([row.number for row in rows], dtype=np.int64), prepend=-1) - 1,
            seen=np.array(wrists, dtype=np.bool_).reshape(-1, 2),
        )

    def pose(self) -> PoseTrack | None:
        """Return what was seen from the first tracked target on, as a track; None where nothing was."""
        from mimic.sources.video.video import doubts

        zero = self.began + self.zero
        rows = [row for row in self.seen if row.t >= zero]
        if len(rows) < 2:
            return None
        t = np.array([row.t for row in rows]) - zero
        columns: dict[str, Any] = {}
        for name in ("landmarks", "image", "score", "valid", "depth_spread", "swapped"):
            columns[name] = np.array([getattr(row, name) for row in rows])
        track = PoseTrack(t=t, size=rows[-1].size, **columns)
        return replace(track, warnings=(*self.people, *doubts(track)))

    def report(self, pose: PoseTrack, reporter: Reporter) -> None:
        """Say what a run of a video says: doubts, an arm that is not seen, where the camera is."""
        from mimic.retargeting.wrists import pose_report, wrist_track

        try:
            wrists = wrist_track(pose, self.settings.retarget)
        except SourceError as nobody:
            reporter.warn(str(nobody))
            return
        for text in wrists.warnings:
            reporter.warn(text)
        reporter.note(pose_report(pose, self.settings.retarget)["unseen"])

    def motion(self, log: RunLog) -> Motion | None:
        """Return what was asked of the robot in the tracking phase, with the person; it can be played again."""
        rows = log.phase == PHASES.index("track")
        if not rows.any():
            return None
        t = log.t[rows]
        began = np.flatnonzero(np.isfinite(log.heading_des))[0]  # nothing is asked of a robot that lies
        heading = log.heading_des[rows] - log.heading_des[began]
        robot = str(log.metadata.get("robot", ""))
        commands = CommandTrack(t=t - t[0], v=log.v_des[rows], heading=heading, p_BE=log.p_BE_des[rows], robot=robot)
        return Motion(commands=commands, pose=self.pose())

    def save(self, folder: Path, made_by: Provenance) -> dict[str, Any]:
        """Write the latency of every frame; return figures of it for metrics.json."""
        track = self.track()
        store.save(track, folder / LIVE, made_by=made_by)

        def quantiles(seconds: FloatArray) -> dict[str, float | None]:
            shares = (0.5, 0.95, 1.0) if len(seconds) else ()
            found = {f"p{round(100 * q)}": float(np.quantile(1e3 * seconds, q)) for q in shares}
            return {name: found.get(name) for name in ("p50", "p95", "p100")}

        return {
            "frames": len(track.t),
            "skipped": int(track.skipped.sum()),
            "seen_share": float(track.seen.any(axis=1).mean()) if len(track.t) else None,
            "latency_ms": quantiles(track.latency),
            "detector_ms": quantiles(track.detector),
            **({} if self.overruns is None else {"late_steps": self.overruns}),
        }

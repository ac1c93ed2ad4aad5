"""Recorded motion -> PoseTrack: named points over time, in metres and camera axes.

A reader for each format returns `Points`; all later steps are shared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from mimic.config.pose import MocapSettings, PoseSettings
from mimic.errors import ConfigError, SourceError
from mimic.io.reading import check_clock
from mimic.records import SIDES, FloatArray, PoseTrack
from mimic.sources.mocap.body import handedness, marks_said, with_steady_bones, without_first_pose, without_marks
from mimic.sources.mocap.bvh import read_bvh
from mimic.sources.mocap.c3d import read_c3d
from mimic.sources.mocap.npz import read_npz
from mimic.sources.mocap.points import UNITS, UPS, Points
from mimic.sources.mocap.skeletons import NEEDED, Columns, read_names, recognise
from mimic.sources.mocap.smpl import read_parameters
from mimic.sources.mocap.trc import read_trc
from mimic.sources.video.screening import SHORTEST
from mimic.sources.video.smoothing import smooth

READERS: Mapping[str, Callable[[Path, MocapSettings], Points]] = {
    ".bvh": read_bvh,
    ".c3d": read_c3d,
    ".npz": read_npz,
    ".pkl": read_parameters,
    ".pt": read_parameters,
    ".trc": read_trc,
}
"""Reader of each file ending."""

ARM = 0.5
"""Approximate length of an adult's arm, shoulder -> elbow -> wrist [m]; it decides the unit of a file that names none.
The motion does not depend on it, because arms are measured in their own length."""
METRIC = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Units that a file without one may have, and those that are confused where it names one [m]."""
BVH_UNITS = {**METRIC, "inches": 0.0254, "CMU's unit": 0.0254 / 0.45}
"""Those of BVH, which has no place for a unit: Biovision's own are in inches, CMU's skeletons 1/0.45 of one [m]."""
LONGEST = (0.15, 1.6)
"""An arm in the unit that a file names is not shorter and not longer [m]."""
CORRECTED = (0.25, 1.0)
"""The same where the unit follows from it [m]."""
CLEARLY = 0.75
"""Minimum component of the torso direction along an axis that is taken as up."""

_UP: dict[str, FloatArray] = dict(zip(UPS, np.concatenate([np.eye(3), -np.eye(3)]), strict=True))


def track_mocap(path: Path, mocap: MocapSettings, settings: PoseSettings) -> PoseTrack:
    """Return the person in a file with recorded motion, smoothed like a video.

    Left and right are taken from the file. There is no picture: ``image`` is NaN.

    Args:
        path: A file that ends in one of READERS.
        mocap: What the file does not say itself.
        settings: Visibility, least share of frames with a person, and cut-off, as for a video.

    Raises:
        SourceError: If the file cannot be read, names no shoulders and wrists, or shows them too seldom.
    """
    points = READERS[path.suffix.lower()](path, mocap)
    if len(points.t) < 2 or 0.0 < points.t[-1] - points.t[0] < SHORTEST:
        raise SourceError(
            f"{path.name} has {len(points.t)} rows in {np.ptp(points.t) if len(points.t) else 0:.2f} s; a motion needs "
            f"at least two and {SHORTEST:g} s"
        )
    check_clock(
        points.t, path.name, SourceError, "store times in seconds, or give the frame rate as [mocap] fps in --config"
    )
    scheme, skeletons = recognise(points.names, read_names(mocap.names))
    person, others = _person(points, skeletons, settings.person, path)
    steady = with_steady_bones(_named(without_marks(points), person))
    if np.isnan(steady.xyz).all():
        raise SourceError(f"{path.name} shows nobody: no coordinates, or marks for what was not seen; export it again")
    marks = marks_said(_named(points, person), steady)
    unit, length, doubts = _unit(steady, path)
    moving, rest = without_first_pose(steady)
    named = _present(moving)
    t = named.t
    up, notes = _up(named, mocap.up, path)
    hips = named.middle("hip")
    origin = named.of(*NEEDED[:2]).mean(axis=1) if hips is None else hips
    xyz = length * (named.xyz - origin[:, None]) @ _camera_axes(up).T
    valid = np.isfinite(xyz).all(axis=-1) & (named.score >= settings.min_visibility)
    shoulders, wrists = np.split(valid[:, [named.names.index(name) for name in NEEDED]], 2, axis=1)
    share = float((shoulders.all(axis=1) & wrists.any(axis=1)).mean())
    if share < settings.min_person_share:
        raise SourceError(
            f"{path.name} shows both shoulders and a wrist in {share:.0%} of its rows, "
            f"{settings.min_person_share:.0%} are needed; look at its gaps and visibilities, or lower [pose] "
            "min_visibility in --config"
        )
    mirrored, sides = handedness(replace(named, xyz=xyz))
    xyz = xyz * (-1.0 if mirrored else 1.0, 1.0, 1.0)
    seen = np.where(valid[..., None], xyz, np.nan)
    no_cuts = np.zeros(0, dtype=np.int64)
    smoothed = [smooth(t, column, no_cuts, settings.cutoff_hz) for column in np.moveaxis(seen, 1, 0)]
    return PoseTrack(
        t=t,
        landmarks=np.stack(smoothed, axis=1),
        image=np.full((*xyz.shape[:2], 2), np.nan),
        score=np.where(valid, named.score, 0.0),
        valid=valid,
        names=named.names,
        swapped=np.zeros(len(xyz), dtype=np.bool_),
        warnings=(
            *points.warnings,
            f"read as {scheme}, {up} up, in {unit}; correct it with [mocap] names or up in --config",
            *others,
            *marks,
            *rest,
            *doubts,
            *notes,
            *sides,
        ),
    )


def _person(
    points: Points, skeletons: list[Columns], asked: str | int | None, path: Path
) -> tuple[Columns, tuple[str, ...]]:
    """Return who is played, and a note if there are others; copies of a skeleton at the same place are no others."""
    people: list[Columns] = []
    for one in skeletons:
        if all(_apart(_named(points, one), _named(points, other)) for other in people):
            people.append(one)
    if isinstance(asked, str) and asked != "largest" and len(people) > 1:
        raise ConfigError(f"{path.name} has no picture to be {asked} in; give a number from 1 to {len(people)}")
    if isinstance(asked, int) and asked > len(people):
        raise ConfigError(f"--person {asked}: {path.name} has {len(people)}; give a number from 1 to {len(people)}")
    seen = [float(np.isfinite(_named(points, one).of(*NEEDED)).mean()) for one in people]
    chosen = asked if isinstance(asked, int) else 1 + int(np.argmax(seen))
    note = f"{len(people)} people are in the file; number {chosen} of them is played (choose with --person)"
    return people[chosen - 1], (note,) * (len(people) > 1)


def _present(named: Points) -> Points:
    """Return the rows from the first to the last in which somebody is seen, in times since the first."""
    seen = np.flatnonzero(np.isfinite(named.xyz).any(axis=(1, 2)))
    rows = slice(seen[0], seen[-1] + 1) if len(seen) else slice(None)
    return replace(named, t=named.t[rows] - named.t[rows][0], xyz=named.xyz[rows], score=named.score[rows])


def _apart(one: Points, other: Points) -> bool:
    """Return whether two skeletons have their wrists at different places."""
    arms = [who.of(*NEEDED) for who in (one, other)]
    gap = np.linalg.norm(arms[0][:, 2:] - arms[1][:, 2:], axis=-1)
    width = np.linalg.norm(arms[0][:, 0] - arms[0][:, 1], axis=-1)
    known = np.isfinite(gap)
    return not known.any() or float(np.median(gap[known])) > 0.1 * float(np.nanmedian(width))


def _named(points: Points, scheme: Columns) -> Points:
    """Return the landmarks of ours that a file has."""
    columns = [list(theirs) for theirs in scheme.values()]
    finite = np.where(np.isfinite(points.xyz), points.xyz, np.nan)
    xyz = np.stack([finite[:, own].mean(axis=1) for own in columns], axis=1)
    score = np.stack([points.score[:, own].min(axis=1) for own in columns], axis=1)
    return replace(points, names=tuple(scheme), xyz=xyz, score=score)


def _up(named: Points, asked: str, path: Path) -> tuple[str, tuple[str, ...]]:
    """Return the axis that points up, asked for or along the trunk, and what the user should know about that."""
    trunk = _trunk(named)
    if asked != "auto":
        down = trunk is not None and bool(np.dot(trunk, _UP[asked]) < 0.0)
        return asked, (f"with {asked} up the person of {path.name} is upside down most of the time",) * down
    if trunk is None:
        raise SourceError(
            f"{path.name} has neither hips nor feet, so the upward axis is unknown; give it as [mocap] up in --config"
        )
    axis = int(np.abs(trunk).argmax())
    if abs(trunk[axis]) < CLEARLY:
        raise SourceError(
            f"the torso in {path.name} points along ({', '.join(f'{v:.2f}' for v in trunk)}), along no single axis; "
            "give the upward axis as [mocap] up in --config"
        )
    return ("" if trunk[axis] > 0 else "-") + "xyz"[axis], ()


def _trunk(named: Points) -> FloatArray | None:
    """Return the direction from hips (or what else is below) to shoulders over the whole file (3,), of length one."""
    top = named.middle("shoulder")
    for part in ("hip", "knee", "ankle"):
        below = named.middle(part)
        if top is not None and below is not None and np.isfinite(top - below).all(axis=1).any():
            line = np.nanmedian(top - below, axis=0)
            return line / np.linalg.norm(line)
    return None


def _camera_axes(up: str) -> FloatArray:
    """Return the rotation (3, 3) that brings an axis to -y of the camera; which way the camera looks means nothing."""
    down = -np.array(_UP[up])
    right = np.roll(np.abs(down), 1)
    return np.stack([right, down, np.cross(right, down)])


def _unit(named: Points, path: Path) -> tuple[str, float, tuple[str, ...]]:
    """Return name and length [m] of the unit that makes the arms as long as arms are, of the file's if that one does.

    Last comes what the user should know about that.
    """
    given = named.unit
    joints = [part for part in ("shoulder", "elbow", "wrist") if f"left_{part}" in named.names]
    chains = [named.names.index(f"{side}_{part}") for side in SIDES for part in joints]
    places = named.xyz[:, chains].reshape(-1, len(SIDES), len(joints), 3)
    arms = np.linalg.norm(np.diff(places, axis=2), axis=-1).sum(axis=2)
    known = arms[np.isfinite(arms)]
    if not len(known):
        return given or "m", UNITS[given or "m"], ()
    length = float(np.quantile(known, 0.9))
    if given is not None and LONGEST[0] <= UNITS[given] * length <= LONGEST[1]:
        return given, UNITS[given], ()
    units = BVH_UNITS if path.suffix.lower() == ".bvh" else METRIC
    best = min(units, key=lambda name: abs(np.log(max(units[name] * length, 1e-12) / ARM)))
    if not CORRECTED[0] <= units[best] * length <= CORRECTED[1]:
        raise SourceError(
            f"the arms in {path.name} are {length:.3g} {given or 'units'} long; expected {CORRECTED[0]:g} to "
            f"{CORRECTED[1]:g} m, in {' or '.join(units)}: correct the unit, or the positions"
        )
    would = UNITS[given or "m"] * length
    doubts = (f"the file says {given}, but its arms would be {would:.3g} m long",) * (given is not None)
    return f"{best} by the length of the arms", units[best], doubts

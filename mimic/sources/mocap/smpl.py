"""Joint rotations of the SMPL family -> points, by forward kinematics on a generic skeleton; no body model is needed.

Read are the parameters as AMASS, SMPL, SMPL-H, SMPL-X, AIST++, GVHMR, WHAM, 4D-Humans and GEM-X (SOMA) store them. The
shape of the person (betas) is not used: retargeting measures arms in their own length.

Source: Loper et al., "SMPL: A Skinned Multi-Person Linear Model", 2015: each joint has a rotation relative to its
parent, the rest pose is a T-pose with the left arm along +x, up +y, and the face toward +z. The offsets are segment
lengths of a person of 1.70 m after Winter, "Biomechanics and Motor Control of Human Movement", 2009, figure 4.1.
SOMA's are relative to the same T-pose: NVlabs/SOMA-X, soma/geometry/rig_utils.py and tests/test_pose_inversion.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.pose import MocapSettings
from mimic.errors import SourceError
from mimic.records import FloatArray
from mimic.sources.mocap.points import Points, clock
from mimic.sources.mocap.skeletons import LAYOUTS

JOINTS = LAYOUTS["smpl24"][:22]
"""Joints that SMPL, SMPL-H and SMPL-X share, in their order."""
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
SOMA = (0, 67, 72, 1, 68, 73, 2, 69, 74, 3, 70, 75, 4, 11, 39, 6, 12, 40, 13, 41, 14, 42)
"""Where they are among the 77 joints of SOMA."""
_LEFT = {
    "left_hip": (0.09, -0.08, 0.0),
    "left_knee": (0.0, -0.42, 0.0),
    "left_ankle": (0.0, -0.42, 0.0),
    "left_foot_index": (0.0, -0.06, 0.13),
    "left_collar": (0.07, 0.10, 0.0),
    "left_shoulder": (0.12, 0.03, 0.0),
    "left_elbow": (0.30, 0.0, 0.0),
    "left_wrist": (0.25, 0.0, 0.0),
}
_OFFSETS = {
    "mid_hip": (0.0, 0.0, 0.0),
    "spine1": (0.0, 0.12, 0.0),
    "spine2": (0.0, 0.13, 0.0),
    "spine3": (0.0, 0.06, 0.0),
    "neck": (0.0, 0.20, 0.0),
    "head": (0.0, 0.10, 0.03),
    **_LEFT,
    **{name.replace("left", "right"): (-x, y, z) for name, (x, y, z) in _LEFT.items()},
}
"""From the parent to the joint in the rest pose [m]."""

ROOTS = ("global_orient", "root_orient")
BODIES = ("body_pose", "pose_body")
WHOLE = ("poses", "pose_world", "smpl_poses", "pose", "fullpose")
"""Names of the rotations of the pelvis, of the other joints, and of all of them; the first that is there counts."""
RATES = ("mocap_framerate", "mocap_frame_rate", "fps", "frame_rate", "framerate")
KEYS = (*ROOTS, *BODIES, *WHOLE, *RATES)
_JOINTS = {22: "the body", 24: "SMPL", 52: "SMPL-H", 55: "SMPL-X", 77: "SOMA"}


SKEWED = 0.02
"""A matrix whose product with its transpose is farther from the identity is no rotation; half precision gives 0.002."""


def has_rotations(arrays: Mapping[str, Any]) -> bool:
    """Return whether arrays are parameters of the SMPL family."""
    parts = _first(arrays, ROOTS) is not None and _first(arrays, BODIES) is not None
    return parts or _first(arrays, WHOLE) is not None


def points_of_rotations(arrays: Mapping[str, Any], settings: MocapSettings, path: Path) -> Points:
    """Return the joints of a generic skeleton with the rotations of a file.

    Args:
        arrays: Rotations as axis angles (T, 66), (T, 72), (T, 156), (T, 165), or in two arrays for pelvis and body;
            also as (T, N, 3), or as matrices (T, N, 3, 3). Further arrays are not used.
        settings: The frame rate, where the file has none.
        path: The file, for messages.

    Raises:
        SourceError: If an array has another shape, or no frame rate is known.
    """
    turns = _rotations(arrays, path)
    turned: list[FloatArray] = []
    xyz = np.zeros((len(turns), len(JOINTS), 3))
    for joint, parent in enumerate(PARENTS):
        if parent < 0:
            turned.append(turns[:, joint])
            continue
        xyz[:, joint] = xyz[:, parent] + turned[parent] @ np.array(_OFFSETS[JOINTS[joint]])
        turned.append(turned[parent] @ turns[:, joint])
    note = "joint rotations on a generic skeleton, without a body model"
    return Points(
        t=clock(len(xyz), arrays.get(_first(arrays, RATES) or ""), settings, path),
        xyz=xyz,
        score=np.ones(xyz.shape[:2]),
        names=JOINTS,
        unit="m",
        warnings=(note,),
    )


def _first(arrays: Mapping[str, Any], names: tuple[str, ...]) -> str | None:
    return next((name for name in names if name in arrays), None)


def _rotations(arrays: Mapping[str, Any], path: Path) -> FloatArray:
    """Return the rotations of the 22 joints relative to their parents (T, 22, 3, 3)."""
    both = [name for name in (_first(arrays, ROOTS), _first(arrays, BODIES)) if name]
    names = both if len(both) > 1 else [name for name in WHOLE if name in arrays][:1]
    parts = [_matrices(arrays[name], name, path) for name in names]
    joints = sum(part.shape[1] for part in parts)
    if joints not in _JOINTS or len({len(part) for part in parts}) > 1:
        given = " and ".join(f"'{name}' {np.shape(arrays[name])}" for name in names)
        known = ", ".join(f"{count} ({what})" for count, what in _JOINTS.items())
        raise SourceError(f"{path.name} has {given}; expected T rows of joints whose number is {known}")
    turns = np.concatenate(parts, axis=1)
    return turns[:, SOMA if joints == max(_JOINTS) else slice(len(JOINTS))]


def _matrices(given: Any, name: str, path: Path) -> FloatArray:
    """Return rotations (T, N, 3, 3) of axis angles (T, 3 N) or (T, N, 3), or of matrices (T, N, 3, 3)."""
    from scipy.spatial.transform import Rotation

    array = np.asarray(given)
    matrices = array.ndim == 4 and array.shape[2:] == (3, 3)
    vectors = (array.ndim == 2 and array.shape[1] % 3 == 0) or (array.ndim == 3 and array.shape[2] == 3)
    if array.dtype.kind not in "fiu" or not (matrices or vectors) or not array.size:
        raise SourceError(
            f"{path.name}: '{name}' has shape {array.shape}; expected axis angles (T, 3 N) or matrices (T, N, 3, 3)"
        )
    array = np.asarray(array, dtype=np.float64)
    rows = np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))
    if len(rows):
        raise SourceError(f"{path.name}: '{name}' is not a number in row {rows[0] + 1}; cut these rows")
    if matrices:
        skewed = np.abs(array @ array.swapaxes(-1, -2) - np.eye(3)).max(axis=(-1, -2)) > SKEWED
        wrong = np.flatnonzero((skewed | (np.linalg.det(array) < 0.0)).any(axis=1))
        if len(wrong):
            raise SourceError(f"{path.name}: '{name}' has matrices that are no rotations in row {wrong[0] + 1}")
        return array
    angles = np.linalg.norm(array.reshape(len(array), -1, 3), axis=-1)
    if np.median(angles, axis=0).max() > 2.0 * np.pi:
        raise SourceError(
            f"{path.name}: '{name}' turns joints by {np.abs(array).max():.4g}; expected axis angles in radians, up to "
            "3.14: multiply degrees by 0.01745"
        )
    return Rotation.from_rotvec(array.reshape(-1, 3)).as_matrix().reshape(len(array), -1, 3, 3)


# ---------------------------------------------------------------------- what programs store besides arrays


def read_parameters(path: Path, settings: MocapSettings) -> Points:
    """Return the people in a .pkl or .pt file of GVHMR, WHAM, 4D-Humans, AIST++, or of a dictionary of parameters.

    Points of one person of several have the person's name before their own. Nothing in the file is executed.

    Raises:
        SourceError: If the file cannot be read, or holds no parameters of the SMPL family.
    """
    from mimic.sources.mocap.pickles import read_pickle

    data = read_pickle(path)
    found = ((name, reader(data)) for name, reader in _PROGRAMS) if isinstance(data, dict) else ()
    program, people = next(((name, people) for name, people in found if people), ("", {}))
    if not people:
        keys = ", ".join(str(key)[:40] for key in list(data)[:8]) if isinstance(data, dict) else type(data).__name__
        raise SourceError(
            f"{path.name} holds {keys or 'nothing'}; expected what GVHMR (hmr4d_results.pt), GEM-X (hpe_results.pt), "
            "WHAM (wham_output.pkl), 4D-Humans (demo_….pkl) or AIST++ write, or a dictionary with global_orient and "
            "body_pose, or poses"
        )
    each = [points_of_rotations(arrays, settings, path) for arrays in people.values()]
    frames = [_frames(arrays, len(own.t)) for arrays, own in zip(people.values(), each, strict=True)]
    rows = np.unique(np.concatenate(frames))
    xyz = np.full((len(rows), len(each), len(JOINTS), 3), np.nan)
    for i, (own, at) in enumerate(zip(each, frames, strict=True)):
        xyz[np.searchsorted(rows, at), i] = own.xyz
    first = each[0]
    return Points(
        t=(rows - rows[0]) * float(first.t[1] if len(first.t) > 1 else 1.0),
        xyz=xyz.reshape(len(rows), -1, 3),
        score=np.ones((len(rows), len(each) * len(JOINTS))),
        names=tuple(f"{key}:{joint}" for key in people for joint in JOINTS),
        unit=first.unit,
        warnings=(f"parameters of {program}", *first.warnings),
    )


def _frames(arrays: Mapping[str, Any], count: int) -> FloatArray:
    """Return the numbers of the frames of somebody (T,), which may have gaps."""
    numbers = np.asarray(arrays.get("frames", ()), dtype=np.float64).reshape(-1)
    return numbers if len(np.unique(numbers)) == count else np.arange(count, dtype=np.float64)


_People = Mapping[Any, Mapping[str, Any]]


def _global(data: dict[Any, Any]) -> _People:
    own = next((value for key, value in data.items() if str(key).endswith("_params_global")), data)
    return {0: own} if has_rotations(own) else {}


def _wham(data: dict[Any, Any]) -> _People:
    return {
        key: {"poses": one.get("pose_world", one.get("pose")), "frames": one.get("frame_ids", ())}
        for key, one in data.items()
        if isinstance(one, dict) and "trans" in one and one.keys() & {"pose_world", "pose"}
    }


def _humans4d(data: dict[Any, Any]) -> _People:
    """Frames as PHALP stores them: for each picture the identities and, for each, matrices of pelvis and body."""
    tracks: dict[Any, list[tuple[int, dict[str, Any]]]] = {}
    for number, frame in enumerate(frame for frame in data.values() if isinstance(frame, dict)):
        ids, bodies = (frame.get(key) for key in ("tid", "smpl"))
        for who, body in zip(ids if ids is not None else (), bodies if bodies is not None else (), strict=False):
            if isinstance(body, dict) and {"global_orient", "body_pose"} <= body.keys():
                tracks.setdefault(who, []).append((number, body))
    people: dict[Any, dict[str, Any]] = {}
    for who, rows in tracks.items():
        people[who] = {"frames": [number for number, _ in rows]}
        for part in ("global_orient", "body_pose"):
            people[who][part] = np.stack([np.asarray(body[part]).reshape(-1, 3, 3) for _, body in rows])
    return people


_PROGRAMS: tuple[tuple[str, Callable[[dict[Any, Any]], _People]], ...] = (
    ("WHAM", _wham),
    ("4D-Humans", _humans4d),
    ("the SMPL family", _global),
)

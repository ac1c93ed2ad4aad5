"""A robot's folder from its MJCF: what it tells is derived, all else is the Go2's, scaled, and marked as guessed."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import brentq

from mimic.config.text_file import from_toml, read_text
from mimic.errors import AssetError, ConfigError
from mimic.frozen import frozen_arrays
from mimic.io import store
from mimic.io.assets import shipped
from mimic.records import LEGS, FloatArray, IntArray
from mimic.robot.description import FILE, RobotDescription, load_description
from mimic.robot.model import leave_out, name_shapes, read_model

_UPPER_NAMES = (LEGS, ("FL", "FR", "HL", "HR"), ("LF", "RF", "LH", "RH"))
LEG_NAMES = (*_UPPER_NAMES, *(tuple(" ".join(names).lower().split()) for names in _UPPER_NAMES))
"""What models call their legs, in the order of LEGS."""
INSIDE = 0.05
"""Distance of the poses from the joint limits [rad]."""
SAME = 1e-4
"""A site this near to the centre of a toe marks it [m]."""
DERIVED = "derived from the MJCF"
GUESSED = "GUESSED: the Go2's{}; measure it"
UNLIMITED = "GUESSED: the MJCF has no limit; measure it"
RANGES = {"abad.range": (0, 0), "hip.range_front": (0, 1), "hip.range_rear": (2, 1), "knee.range": (0, 2)}
"""Leg and joint that each range of the description is of."""
POSES = {"lie": (1.25, -2.5, 1.25, -2.5), "four": (0.8, -1.6, 0.8, -1.6), "upright": (0.9, -1.6, 1.8, -1.2)}
"""Hip and knee of the front legs, then of the hind legs [rad]; the upright hind hip is then solved for."""
SCALED = {
    "legs": ("goals.low", "goals.high", "reach.scale", "reach.forward", "safety.toes_apart", "safety.toes_apart_moving")
    + ("safety.front_above",),
    "upright": ("training.rise_to", "training.height_low", "training.height_span", "training.height_fallen")
    + ("training.early_toe_height",),
    "lying": ("training.rise_from", "training.lying_height", "start.height"),
    "torque": ("motor.kp", "motor.kd", "start.kp", "start.kd", "motor.kd_max", "motor.torque_rated"),
}
"""What grows with the length of a leg, the height upright and lying, and the torque of the motors."""
UNUSED = {
    "body": ("mass", "com", "inertia", "imu"),
    "abad": ("mass", "com", "inertia", "shoulder"),
    "hip": ("mass", "com", "inertia", "box"),
    "knee": ("mass", "com", "inertia", "mirrors", "shank"),
    "motor": ("thermal",),
    "physics": ("solref_friction", "solimp_friction"),
}
"""What describes the Go2's own MJCF, or its motors."""


@frozen_arrays
class _Legs:
    """The legs of a compiled model, by their roles."""

    joints: np.ndarray
    """Joints of LEGS: abad, hip, knee (4, 3)."""
    links: np.ndarray
    """Bodies that they move (4, 3)."""
    base: int
    names: tuple[str, ...]
    """The model's names of the legs."""


def new_robot(mjcf: Path, out: Path) -> tuple[RobotDescription, int]:
    """Write the folder of a robot, and return its description and how many of its numbers are guessed.

    Raises:
        AssetError: If the MJCF is not that of a robot with four legs of three joints, as add-a-robot.md says.
        ConfigError: If ``out`` exists.
    """
    if out.exists():
        raise ConfigError(f"{out} exists; name another folder with --out, or remove it")
    store.check_writable(out.parent)
    try:
        spec: Any = mujoco.MjSpec.from_file(str(mjcf))
        torque = _torques(spec)
        leave_out(spec, mjcf)
        name_shapes(spec)
        model = spec.compile()
    except (ValueError, OSError) as reason:
        raise AssetError(f"{mjcf} is not an MJCF that MuJoCo reads: {' '.join(str(reason).split())}") from None
    legs = _legs(model, mjcf)
    unlimited = {name for name, at in RANGES.items() if not model.jnt_limited[legs.joints[at]]}
    model.jnt_range[model.jnt_limited == 0] = -np.pi, np.pi
    if "knee.range" in unlimited:
        model.jnt_range[legs.joints[:, 2]] = -np.pi, 0.0  # it bends backward
    own = _derived(model, legs, torque, mjcf)
    text, guessed = _written(own, out.name, unlimited)
    out.mkdir()
    try:
        text_of_model = read_text(mjcf)
        if "<include" in text_of_model:  # of files that are not beside the copy
            text_of_model = spec.to_xml()
        (out / mjcf.name).write_text(text_of_model, encoding="utf-8")
        (out / FILE).write_text(text, encoding="utf-8")
        description = load_description(out)
        read_model(description)
    except BaseException:
        shutil.rmtree(out)
        raise
    return description, guessed


def _torques(spec: Any) -> dict[str, float]:
    """Return the largest torque of each joint that the MJCF limits [N m]."""
    found = {joint.name: float(joint.actfrcrange[1]) for joint in spec.joints if joint.actfrcrange[1] > 0}
    for actuator in spec.actuators:
        is_motor = actuator.biastype == mujoco.mjtBias.mjBIAS_NONE
        ranges = [actuator.forcerange[1], actuator.ctrlrange[1] * actuator.gainprm[0] if is_motor else 0.0]
        most = next((float(limit) for limit in ranges if limit > 0), 0.0) * abs(actuator.gear[0])
        if most > 0:
            found.setdefault(actuator.target, most)
    return found


def _legs(model: mujoco.MjModel, mjcf: Path) -> _Legs:
    links, joints = _chains(model, mjcf)
    base = int(model.body_parentid[links[0, 0]])
    if not base:
        raise AssetError(f"{mjcf} has its legs on the world itself; expected them on a body that is free to move")
    known = []
    for row, on in zip(links, joints, strict=True):
        known.append([model.body(b).name for b in row] + [model.joint(j).name for j in on])
    if not all(name for leg in known for name in leg):
        raise AssetError(f"{mjcf} has legs whose joints or links have no names; name them, such as FL_hip, FR_hip")
    for names in LEG_NAMES:
        patterns = [name.replace(names[0], "{leg}") for name in known[0]]
        expected = [pattern.replace("{leg}", leg) for leg in names for pattern in patterns]
        if expected == [name for leg in known for name in leg]:
            return _Legs(joints=joints, links=links, base=base, names=names)
    raise AssetError(
        f"{mjcf} calls its joints {', '.join(known[0][3:])} …; expected names that differ by FL, FR, RL, RR or "
        "such, for links, too, each leg in its place (x forward, y left)"
    )


def _chains(model: mujoco.MjModel, mjcf: Path) -> tuple[IntArray, IntArray]:
    """Return links and joints of each leg (4, 3), in the order of LEGS."""
    hinges = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
    of_body = {int(model.jnt_bodyid[j]): j for j in hinges}
    first = [body for body in of_body if int(model.body_parentid[body]) not in of_body]
    chains = []
    for start in first:
        chains.append([body for body in of_body if _ancestor(model, body, start)])
    if len(hinges) != 12 or [len(chain) for chain in chains] != [3] * 4:
        raise AssetError(f"{mjcf} has {len(hinges)} hinges in {len(chains)} chains; expected four legs of three joints")
    place = {_corner(model, chain[0]): chain for chain in chains}
    if set(place) != set(LEGS):
        raise AssetError(
            f"{mjcf} has legs at {', '.join(sorted(place))}; expected one at each corner, x forward, y left"
        )
    links = np.array([place[leg] for leg in LEGS])
    return links, np.vectorize(of_body.get)(links)


def _corner(model: mujoco.MjModel, body: int) -> str:
    """Return at which corner a leg is, by its first link: FL, FR, RL or RR."""
    x, y, _ = model.body_pos[body]
    return ("F" if x > 0 else "R") + ("L" if y > 0 else "R")


def _ancestor(model: mujoco.MjModel, body: int, wanted: int) -> bool:
    while body not in (0, wanted):
        body = int(model.body_parentid[body])
    return body == wanted


def _derived(model: mujoco.MjModel, legs: _Legs, torque: Mapping[str, float], mjcf: Path) -> dict[str, Any]:
    """Return the numbers that the model tells, by table and name."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    front = legs.links[0]
    shapes, toe = _shapes(model, legs, data, mjcf)
    limits = model.jnt_range[legs.joints]
    position = data.geom_xpos[toe] - data.xpos[front[2]]
    radius = float(model.geom_size[toe, 0])
    dof = model.jnt_dofadr[legs.joints[0]]
    own: dict[str, Any] = {
        "model.file": mjcf.name,
        "model.base": model.body(legs.base).name,
        "model.legs": legs.names,
        "model.joints": [model.joint(j).name.replace(legs.names[0], "{leg}") for j in legs.joints[0]],
        "model.links": [model.body(b).name.replace(legs.names[0], "{leg}") for b in front],
        **{f"model.shapes.{role}": names for role, names in shapes.items()},
        "body.box": 2 * _extent(model, data, legs.base, shapes["trunk"]),
        "abad.origin": data.xpos[front[0]] - data.xpos[legs.base],
        "hip.origin": [0.0, data.xpos[front[1]][1] - data.xpos[front[0]][1], 0.0],
        "hip.length": data.xpos[front[1]][2] - data.xpos[front[2]][2],
        **{name: limits[at] for name, at in RANGES.items()},
        "toe.radius": radius,
        "toe.position": [position[0], 0.0, position[2]],
    }
    away = np.linalg.norm(data.site_xpos - data.geom_xpos[toe], axis=1)
    sites = [model.site(site).name for site in np.flatnonzero(away < SAME)]
    if sites:
        own["model.toe_site"] = sites[0].replace(legs.names[0], "{leg}")
    known = [torque.get(model.joint(j).name) for j in legs.joints[0]]
    if None not in known:
        own["motor.torque_max"] = known
    for name, values in (
        ("armature", model.dof_armature),
        ("friction", model.dof_frictionloss),
        ("damping", model.dof_damping),
    ):
        if (values[dof] > 0).all():
            own[f"motor.{name}"] = values[dof]
    direction = np.array([0.2, 0.0, 1.0]) / np.hypot(0.2, 1.0)
    toes = [_toe_of(model, legs, data, leg, mjcf) for leg in range(4)]
    for pose in POSES:
        q, height = _pose(model, legs, toes, radius, pose, float(np.arcsin(direction[2])) if pose == "upright" else 0.0)
        own[f"pose.{pose}"] = {"z": height, "up": float(direction[2]) if pose == "upright" else 0.0, "q": q}
    return own


def _group(model: mujoco.MjModel, legs: _Legs, geom: int) -> tuple[int, int] | None:
    """Return the leg and the link (0 abad, 1 hip, 2 knee) that a shape moves with; None for the base."""
    body = int(model.geom_bodyid[geom])
    while body and body != legs.base:
        found = np.argwhere(legs.links == body)
        if len(found):
            return int(found[0][0]), int(found[0][1])
        body = int(model.body_parentid[body])
    return None


def _collision(model: mujoco.MjModel, legs: _Legs) -> Iterator[tuple[int, tuple[int, int] | None]]:
    for geom in range(model.ngeom):
        if (model.geom_contype[geom] or model.geom_conaffinity[geom]) and _ancestor(
            model, int(model.geom_bodyid[geom]), legs.base
        ):
            yield geom, _group(model, legs, geom)


def _toe_of(model: mujoco.MjModel, legs: _Legs, data: mujoco.MjData, leg: int, mjcf: Path) -> int:
    balls = [
        g for g, at in _collision(model, legs) if at == (leg, 2) and model.geom_type[g] == mujoco.mjtGeom.mjGEOM_SPHERE
    ]
    if not balls:
        raise AssetError(f"{mjcf} has no ball at the toe of {LEGS[leg]}; expected a sphere that collides")
    return min(balls, key=lambda geom: data.geom_xpos[geom][2])


def _shapes(model: mujoco.MjModel, legs: _Legs, data: mujoco.MjData, mjcf: Path) -> tuple[dict[str, list[str]], int]:
    """Return the collision shapes by role, those that every leg has as patterns, and the ball of the front left toe."""
    toe = _toe_of(model, legs, data, 0, mjcf)
    names = {model.geom(geom).name for geom in range(model.ngeom)}
    found: dict[str, list[str]] = {"trunk": [], "abad": [], "thigh": [], "shank": [], "toe": []}
    for geom, at in _collision(model, legs):
        if at is None:
            found["trunk"].append(model.geom(geom).name)
        elif at[0] == 0:
            role = "toe" if geom == toe else ("abad", "thigh", "shank")[at[1]]
            pattern = model.geom(geom).name.replace(legs.names[0], "{leg}")
            if all(pattern.replace("{leg}", leg) in names for leg in legs.names):
                found[role].append(pattern)
    if not found["trunk"]:
        raise AssetError(f"{mjcf} has no shape of the trunk that collides; add a box to {model.body(legs.base).name}")
    return found, toe


def _extent(model: mujoco.MjModel, data: mujoco.MjData, base: int, names: list[str]) -> FloatArray:
    """Return how far shapes reach from the base along its axes (3,) [m]."""
    most = np.zeros(3)
    for name in names:
        geom = model.geom(name).id
        turn = data.geom_xmat[geom].reshape(3, 3)
        centre = data.geom_xpos[geom] - data.xpos[base] + turn @ model.geom_aabb[geom, :3]
        most = np.maximum(most, np.abs(centre) + np.abs(turn) @ model.geom_aabb[geom, 3:])
    return most


def _pose(
    model: mujoco.MjModel, legs: _Legs, toes: list[int], radius: float, pose: str, pitch: float
) -> tuple[FloatArray, float]:
    """Return joints (12,) [rad] and height [m] of a pose.

    An upright robot's hind toes are under its centre of mass, and a thigh's length or more below its hips.
    """
    fore_hip, fore_knee, hind_hip, hind_knee = POSES[pose]
    wanted = np.array([[0.0, fore_hip, fore_knee]] * 2 + [[0.0, hind_hip, hind_knee]] * 2)
    low, high = np.moveaxis(model.jnt_range[legs.joints], -1, 0)
    data = mujoco.MjData(model)
    turn = np.array([[np.cos(pitch), 0.0, np.sin(-pitch)], [0.0, 1.0, 0.0], [np.sin(pitch), 0.0, np.cos(pitch)]])

    def placed(hip: float, knee: float) -> tuple[FloatArray, FloatArray, float]:
        """Return joints (4, 3) [rad], toes (4, 3) [m], and how far hind toes are before the centre of mass [m]."""
        wanted[2:, 1:] = hip, knee
        q = np.clip(wanted, low + INSIDE, high - INSIDE)
        data.qpos[model.jnt_qposadr[legs.joints]] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        points = (data.geom_xpos[toes] - data.xpos[legs.base]) @ turn.T
        centre = turn @ (data.subtree_com[legs.base] - data.xpos[legs.base])
        return q, points, float(points[2:, 0].mean() - centre[0])

    def standing_hips(knee: float) -> list[float]:
        """Return hind hips [rad] whose toes are under the centre of mass."""
        hips = np.linspace(low[2, 1] + INSIDE, high[2, 1] - INSIDE, 40)
        off = np.array([placed(hip, knee)[2] for hip in hips])
        turns = np.flatnonzero(np.diff(np.sign(off)))
        found: list[Any] = [brentq(lambda hip: placed(hip, knee)[2], hips[at], hips[at + 1]) for at in turns]
        return [hip for hip in found if below_the_hips(placed(hip, knee)[1])]

    def below_the_hips(points: FloatArray) -> bool:
        hips = (data.xpos[legs.links[2:, 1]] - data.xpos[legs.base]) @ turn.T
        length = np.linalg.norm(data.xpos[legs.links[2, 1]] - data.xpos[legs.links[2, 2]])
        return bool((points[2:, 2] < hips[:, 2] - length).all())

    if pose == "upright":
        knees = np.linspace(low[2, 2] + INSIDE, high[2, 2] - INSIDE, 40)
        for knee in (hind_knee, *sorted(knees, key=lambda knee: abs(knee - hind_knee))):
            standing = standing_hips(knee)
            if standing:
                hind_hip = min(standing, key=lambda hip: abs(hip - hind_hip))
                hind_knee = knee
                break
        else:
            raise AssetError(
                "the hind toes do not come under the centre of mass of the upright robot: it cannot stand so; its hind "
                f"hips turn from {low[2, 1]:.2f} to {high[2, 1]:.2f} rad and its knees from {low[2, 2]:.2f} to "
                f"{high[2, 2]:.2f} rad; if those are not its limits, mend the range of these joints in the MJCF"
            )
    q, points, _ = placed(hind_hip, hind_knee)
    return q.reshape(-1), radius - float(points[:, 2].min())


def _written(own: Mapping[str, Any], name: str, unlimited: set[str]) -> tuple[str, int]:
    """Return robot.toml, with ranges that the MJCF does not limit marked, and how many of its numbers are guessed."""
    raw: dict[str, Any] = from_toml(read_text(shipped("assets") / "go2" / FILE))
    theirs = load_description("go2")
    toe = np.array(own["toe.position"])
    torque = np.array(own.get("motor.torque_max", raw["motor"]["torque_max"]))
    scale = {
        "legs": float((own["hip.length"] + np.linalg.norm(toe)) / (theirs.leg.thigh + np.linalg.norm(theirs.leg.toe))),
        "upright": own["pose.upright"]["z"] / theirs.pose_height["upright"],
        "lying": own["pose.lie"]["z"] / theirs.pose_height["lie"],
        "torque": float(np.mean(torque / raw["motor"]["torque_max"])),
    }
    factor = {key: (kind, scale[kind]) for kind, keys in SCALED.items() for key in keys}
    raw.pop("name")
    raw.pop("head")
    raw.pop("contact")
    named = [key.split(".") for key in own if key.startswith("model.")]
    raw["model"] = {key[1]: None for key in named if len(key) == 2}
    raw["model.shapes"] = {key[2]: None for key in named if len(key) == 3}
    lines = [f"# {name}: written by mimic robot new. SI units.", f"name = {json.dumps(name)}"]
    guessed = 0
    for table, content in raw.items():
        for entries in content if isinstance(content, list) else [content]:
            lines += ["", f"[[{table}]]" if isinstance(content, list) else f"[{table}]"]
            for key, value in entries.items():
                if key in UNUSED.get(table, ()):
                    continue
                full = f"{table}.{key}"
                kind, by = factor.get(full, ("", 1.0))
                guessed += full not in own or full in unlimited
                mark = DERIVED if full in own else GUESSED.format(f", scaled with {kind}" if kind else "")
                mark = UNLIMITED if full in unlimited else mark
                known = own.get(full, value if by == 1.0 else np.multiply(value, by))
                lines.append(f"{key} = {_toml(known)}  # {mark}")
    return "\n".join(lines) + "\n", guessed


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {_toml(one)}' for key, one in value.items())} }}"
    if isinstance(value, (list, tuple, np.ndarray)):
        return f"[{', '.join(map(_toml, value))}]"
    return f"{float(value):.9g}" if isinstance(value, (float, np.floating)) else json.dumps(value)

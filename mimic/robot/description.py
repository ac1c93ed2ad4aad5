"""The robot's numbers and names, read from ``assets/<robot>/robot.toml``, where each number has its source.

No other module knows a number of one robot, or what its model calls a joint, a link or a shape. All robots have four
legs of three joints: abad turns about +x, hip and knee about +y. The legs mirror each other.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mimic.config.text_file import from_toml, read_text
from mimic.errors import AssetError, ConfigError
from mimic.io.assets import shipped
from mimic.records import JOINTS, LEGS, FloatArray
from mimic.robot.parts import (
    ROLES,
    Box,
    CommandLimits,
    Goals,
    LegGeometry,
    ModelNames,
    ProbeRanges,
    SafetyLimits,
    StartNumbers,
    ThermalNumbers,
    TrainingNumbers,
    TrunkNumbers,
    Workspace,
)

R = TypeVar("R")

FILE = "robot.toml"
"""Name of a description in a robot's folder."""

BY_JOINT = ("kp", "kd", "torque_max", "torque_rated", "speed_flat", "speed_max", "gear_ratio", "armature")
"""Numbers of ``[motor]`` that differ from joint to joint: one for all, one each for abad, hip and knee, or twelve."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotDescription:
    """What the rest of mimic needs to know about the robot. Joint arrays are (12,) in the order of JOINTS."""

    name: str
    folder: Path
    names: ModelNames
    """What the model calls joints, links and shapes."""
    leg: LegGeometry
    trunk: Box
    """Extent of the trunk."""
    head: tuple[Box, ...]
    """Extents of what else is fixed to the trunk."""
    q_min: FloatArray
    """Lower joint limits [rad]."""
    q_max: FloatArray
    """Upper joint limits [rad]."""
    kp: FloatArray
    """Position gain [N m/rad]."""
    kd: FloatArray
    """Velocity gain [N m s/rad]."""
    kp_max: float
    """Greatest position gain that a motor takes [N m/rad]."""
    kd_max: float
    """Greatest velocity gain that a motor takes [N m s/rad]; damping a robot uses it."""
    torque_max: FloatArray
    """Peak torque [N m]."""
    torque_rated: FloatArray
    """Continuous torque [N m]."""
    speed_flat: FloatArray
    """Speed up to which the full torque is there [rad/s]."""
    speed_max: FloatArray
    """Speed at which no driving torque is left [rad/s]."""
    voltage: float
    """Rated supply voltage [V]."""
    gear_ratio: FloatArray
    """Turns of the rotor for one turn of the joint."""
    armature: FloatArray
    """Inertia of the rotor, seen at the joint [kg m^2]."""
    delay: float
    """From command to effect [s]."""
    timestep: float
    """Physics step [s]."""
    decimation: int
    """Physics steps in a control step."""
    poses: Mapping[str, FloatArray]
    """Named joint poses [rad]: lie, four, upright."""
    pose_height: Mapping[str, float]
    """Base height in each pose [m]."""
    upright_direction: FloatArray
    """Unit vector that base x points along when upright, heading frame (3,)."""
    goals: Goals
    toe_radius: float
    """[m]"""
    workspace: Workspace
    commands: CommandLimits
    start: StartNumbers
    safety: SafetyLimits
    training: TrainingNumbers
    trunk_numbers: TrunkNumbers | None
    """None where nobody has found out how the robot stands by itself."""
    thermal_numbers: ThermalNumbers | None
    """None where the maker publishes none."""
    probe_ranges: ProbeRanges | None
    """None where nobody has measured them."""

    @property
    def dt(self) -> float:
        """Control step [s]."""
        return self.timestep * self.decimation

    @property
    def mjcf(self) -> Path:
        """The robot alone."""
        return self.folder / self.names.file

    @property
    def scene(self) -> Path | None:
        """The robot on a floor; None where the folder has no such file."""
        return self.folder / self.names.scene if self.names.scene else None

    @property
    def thermal(self) -> ThermalNumbers:
        """Thermal model of the motors.

        Raises:
            AssetError: If the description has none.
        """
        if self.thermal_numbers is None:
            raise AssetError(
                f"{self.folder / FILE} has no [motor.thermal]: winding temperatures of {self.name} are unknown"
            )
        return self.thermal_numbers

    @property
    def probe(self) -> ProbeRanges:
        """Where the suspended robot's joints may go.

        Raises:
            AssetError: If the description has none.
        """
        if self.probe_ranges is None:
            raise AssetError(f"{self.folder / FILE} has no [probe]: no joint ranges are known to be free of collisions")
        return self.probe_ranges


def _array(values: Any) -> FloatArray:
    return np.array(values, dtype=np.float64)


def _by_joint(value: Any) -> FloatArray:
    given = np.atleast_1d(_array(value))
    if given.shape not in ((1,), (3,), (len(JOINTS),)):
        raise ValueError(f"a number of [motor] is {value}; expected one, three (abad, hip, knee) or {len(JOINTS)}")
    return np.resize(given, len(JOINTS))


def _per_joint(table: Callable[[str], list[Any]], mirrored: Callable[[Any], Any]) -> FloatArray:
    """Return a row a joint from the rows of a left leg at each end; the abad row is mirrored on the right.

    Args:
        table: ``front`` or ``rear`` -> rows of abad, hip and knee of the left leg.
        mirrored: Row of the left abad joint -> that of the right one.
    """
    rows: list[Any] = []
    for leg in LEGS:
        abad, hip, knee = table("front" if leg.startswith("F") else "rear")
        rows += [mirrored(abad) if leg.endswith("R") else abad, hip, knee]
    return _array(rows)


def _interval_mirrored(interval: Any) -> Any:
    low, high = interval
    return [-high, -low]


def _joint_limits(raw: dict[str, Any]) -> FloatArray:
    def of_end(end: str) -> list[Any]:
        return [raw["abad"]["range"], raw["hip"][f"range_{end}"], raw["knee"]["range"]]

    return _per_joint(of_end, _interval_mirrored)


def _probe(probe: dict[str, Any]) -> ProbeRanges:
    def bounds(end: str) -> list[Any]:
        return [probe["abad"], probe[f"hip_{end}"], probe[f"knee_{end}"]]

    limits = _per_joint(bounds, _interval_mirrored)
    centre = _per_joint(lambda end: probe[f"centre_{end}"], lambda abad: -abad)
    return ProbeRanges(low=limits[:, 0], high=limits[:, 1], centre=centre)


def _record(kind: type[R], table: dict[str, Any]) -> R:
    """Return a record of a table's numbers; lists become arrays."""
    return kind(**{key: _array(value) if isinstance(value, list) else value for key, value in table.items()})


def _names(model: dict[str, Any]) -> ModelNames:
    shapes = model["shapes"]
    own: dict[str, Any] = {}
    own = {key: tuple(value) if isinstance(value, list) else value for key, value in model.items() if key != "shapes"}
    return ModelNames(**own, patterns={role: tuple(shapes.get(role, ())) for role in ROLES})


def _leg(raw: dict[str, Any], path: Path) -> LegGeometry:
    to_hip = _array(raw["hip"]["origin"])
    toe = _array(raw["toe"]["position"])
    if np.any(to_hip[[0, 2]] != 0.0) or toe[1] != 0.0:
        raise AssetError(f"{path}: [hip] origin must lie on the y axis and [toe] position in the plane y = 0")
    return LegGeometry(
        origin=_array(raw["abad"]["origin"]), offset=float(to_hip[1]), thigh=float(raw["hip"]["length"]), toe=toe
    )


def _described(raw: dict[str, Any], path: Path) -> RobotDescription:
    limits = _joint_limits(raw)
    upright = _array(raw["upright"]["direction"])
    motor, physics, goals = (raw[k] for k in ("motor", "physics", "goals"))
    poses = {pose: _array(values["q"]) for pose, values in raw["pose"].items()}
    if any(q.shape != (len(JOINTS),) for q in poses.values()):
        raise AssetError(f"{path}: a pose does not have {len(JOINTS)} joints")
    numbers: dict[str, Any] = {name: _by_joint(motor[name]) for name in BY_JOINT}
    numbers |= {name: motor[name] for name in ("kp_max", "kd_max", "voltage", "delay")}
    return RobotDescription(
        name=raw["name"],
        folder=path.parent,
        names=_names(raw["model"]),
        leg=_leg(raw, path),
        trunk=Box(centre=np.zeros(3), size=_array(raw["body"]["box"])),
        head=tuple(Box(centre=_array(h["position"]), size=_array(h["size"])) for h in raw.get("head", ())),
        q_min=limits[:, 0],
        q_max=limits[:, 1],
        **numbers,
        timestep=physics["timestep"],
        decimation=physics["decimation"],
        poses=poses,
        pose_height={pose: values["z"] for pose, values in raw["pose"].items()},
        upright_direction=upright / np.linalg.norm(upright),
        goals=Goals(**{key: _array([*map(itemgetter(key), goals)]) for key in ("share", "low", "high")}),
        toe_radius=raw["toe"]["radius"],
        workspace=_record(Workspace, raw["reach"]),
        commands=_record(CommandLimits, raw["commands"]),
        start=StartNumbers(**raw["start"]),
        safety=SafetyLimits(**raw["safety"]),
        training=TrainingNumbers(**raw["training"]),
        trunk_numbers=_record(TrunkNumbers, raw["trunk"]) if "trunk" in raw else None,
        thermal_numbers=_record(ThermalNumbers, motor["thermal"]) if "thermal" in motor else None,
        probe_ranges=_probe(raw["probe"]) if "probe" in raw else None,
    )


def load_description(robot: str | Path) -> RobotDescription:
    """Read the description of a robot; each file is read once.

    Args:
        robot: Name of a shipped robot, or path of a folder with a robot.toml, or of that file.

    Raises:
        AssetError: If there is no such robot, or its file lacks a number or cannot be read.
    """
    path = Path(robot)
    if path.name == FILE:
        return _read(path.resolve())
    if path.is_dir() or len(path.parts) > 1:
        return _read(path.resolve() / FILE)
    return _read(shipped("assets") / path / FILE)


@cache
def _read(path: Path) -> RobotDescription:
    if not path.is_file():
        raise AssetError(f"there is no {path}; name a shipped robot (cyberdog2, go2), or a folder with a {FILE}")
    try:
        return _described(from_toml(read_text(path)), path)
    except KeyError as missing:
        raise AssetError(f"{path} lacks {missing}") from None
    except (TypeError, ValueError) as reason:
        raise AssetError(f"{path} is not a robot description: {reason}") from None


@cache
def with_timestep(description: RobotDescription, timestep: float) -> RobotDescription:
    """Return the robot with another physics step [s] at the same control step, the same object each time.

    Raises:
        ConfigError: If the control step is no multiple of it.
    """
    decimation = round(description.dt / timestep)
    if not np.isclose(decimation * timestep, description.dt, rtol=1e-9):
        raise ConfigError(
            f"the timestep is {timestep:g} s; the control step of {description.dt:g} s must be a multiple"
        )
    return dataclasses.replace(description, timestep=timestep, decimation=decimation)

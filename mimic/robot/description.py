"""The robot's numbers, read from ``assets/<robot>/robot.toml``, where each has its source."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import AssetError, ConfigError
from mimic.shipped import shipped
from mimic.types import JOINTS, LEGS, FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Goals:
    """Boxes in which front-toe goals are drawn, left toe in base axes; the right toe mirrors y."""

    share: FloatArray
    """Probability of each box (B,)."""
    low: FloatArray
    """Lower corners (B, 3) [m]."""
    high: FloatArray
    """Upper corners (B, 3) [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotDescription:
    """What the rest of mimic needs to know about the robot. Joint arrays are (12,) in the order of JOINTS."""

    name: str
    folder: Path
    q_min: FloatArray
    """Lower joint limits [rad]."""
    q_max: FloatArray
    """Upper joint limits [rad]."""
    kp: float
    """Position gain [N m/rad]."""
    kd: float
    """Velocity gain [N m s/rad]."""
    torque_max: float
    """Peak torque [N m]."""
    torque_rated: float
    """Continuous torque [N m]."""
    speed_flat: float
    """Speed up to which the full torque is there [rad/s]."""
    speed_max: float
    """Speed at which no driving torque is left [rad/s]."""
    delay: float
    """From command to effect [s]."""
    timestep: float
    """Physics step [s]."""
    decimation: int
    """Physics steps in a control step."""
    overload_torque: FloatArray
    """Torques of the motor's overload table [N m]."""
    overload_seconds: FloatArray
    """How long each may last from 25 degC [s]."""
    poses: Mapping[str, FloatArray]
    """Named joint poses [rad]: lie, four, upright."""
    pose_height: dict[str, float]
    """Base height in each pose [m]."""
    upright_direction: FloatArray
    """Unit vector that base x points along when upright, heading frame (3,)."""
    goals: Goals
    toe_radius: float
    """[m]"""
    raw: dict[str, Any]
    """The whole file, for what has no field here."""

    @property
    def dt(self) -> float:
        """Control step [s]."""
        return self.timestep * self.decimation

    @property
    def mjcf(self) -> Path:
        """The robot alone."""
        return self.folder / "cyberdog2.xml"

    @property
    def scene(self) -> Path:
        """The robot on a floor."""
        return self.folder / "scene.xml"

    def torque_limits(self, dq: Any, low: Any = np.minimum, high: Any = np.maximum) -> tuple[Any, Any]:
        """Return the least and the greatest torque [N m] that a motor gives at joint speed dq [rad/s].

        Full torque to speed_flat, from there on a line to none at speed_max, in the direction of motion only: braking
        torque stays whole. Works element by element.

        Source: CyberGear manual, torque-speed chart; cyberdog_locomotion actuator_model.hpp.
        """
        slope = self.torque_max / (self.speed_max - self.speed_flat)
        up = low(high((self.speed_max - dq) * slope, 0.0), self.torque_max)
        down = low(high((self.speed_max + dq) * slope, 0.0), self.torque_max)
        return -down, up


def joint_limits(raw: dict[str, Any]) -> FloatArray:
    """Return lower and upper limits (12, 2) [rad] in the order of JOINTS."""
    rows = []
    for leg in LEGS:
        end = "front" if leg.startswith("F") else "rear"
        rows += [raw["abad"]["range"], raw["hip"][f"range_{end}"], raw["knee"]["range"]]
    return np.array(rows, dtype=np.float64)


@cache
def load_description(name: str = "cyberdog2") -> RobotDescription:
    """Read the description of a shipped robot.

    Raises:
        AssetError: If the robot does not ship, or its file lacks a number.
    """
    folder = shipped("assets", name)
    try:
        raw = tomllib.loads((folder / "robot.toml").read_text(encoding="utf-8"))
        limits, motor, physics, goals = joint_limits(raw), raw["motor"], raw["physics"], raw["goals"]
        upright = np.array(raw["upright"]["direction"])
        poses = {pose: np.array(values["q"], dtype=np.float64) for pose, values in raw["pose"].items()}
        if any(q.shape != (len(JOINTS),) for q in poses.values()):
            raise AssetError(f"{folder / 'robot.toml'}: a pose does not have {len(JOINTS)} joints")
        return RobotDescription(
            name=raw["name"],
            folder=folder,
            q_min=limits[:, 0],
            q_max=limits[:, 1],
            kp=motor["kp"],
            kd=motor["kd"],
            torque_max=motor["torque_max"],
            torque_rated=motor["torque_rated"],
            speed_flat=motor["speed_flat"],
            speed_max=motor["speed_max"],
            delay=motor["delay"],
            timestep=physics["timestep"],
            decimation=physics["decimation"],
            overload_torque=np.array(motor["overload"]["torque"]),
            overload_seconds=np.array(motor["overload"]["seconds"]),
            poses=poses,
            pose_height={pose: values["z"] for pose, values in raw["pose"].items()},
            upright_direction=upright / np.linalg.norm(upright),
            goals=Goals(
                share=np.array([g["share"] for g in goals]),
                low=np.array([g["low"] for g in goals]),
                high=np.array([g["high"] for g in goals]),
            ),
            toe_radius=raw["toe"]["radius"],
            raw=raw,
        )
    except KeyError as missing:
        raise AssetError(f"{folder / 'robot.toml'} lacks {missing}") from None


def with_timestep(description: RobotDescription, timestep: float) -> RobotDescription:
    """Return the robot with another physics step [s] at the same control step.

    Raises:
        ConfigError: If the control step is no multiple of it.
    """
    decimation = round(description.dt / timestep)
    if not np.isclose(decimation * timestep, description.dt, rtol=1e-9):
        raise ConfigError(
            f"the timestep is {timestep:g} s; the control step of {description.dt:g} s must be a multiple"
        )
    return dataclasses.replace(description, timestep=timestep, decimation=decimation)

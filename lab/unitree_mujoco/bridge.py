"""Unitree's own bridge between its simulator and its SDK, from the folder that MIMIC_UNITREE names; none of it is here.

The folder is a checkout of unitreerobotics/unitree_mujoco, fetched by hand, with a folder ``sdk`` that holds the
package unitree_sdk2py (pip install --no-deps --target sdk unitree-sdk2py-dimos). Its files are not edited.
"""

from __future__ import annotations

import os
import random
import sys
import types
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mimic.dynamics.lying import sink
from mimic.hardware.go2.messages import LOWCMD, LOWSTATE
from mimic.records import JOINTS
from mimic.robot.description import RobotDescription

STEP = 0.002
"""Of the physics [s]; the bridge's own default is 5 ms."""

PARTS = {"abad": "hip", "hip": "thigh", "knee": "calf"}
"""Part of a leg -> its name in Unitree's model."""


class NotHere(Exception):
    """What is judged with is not on this computer."""


def folder() -> Path:
    """Return the folder of Unitree's files.

    Raises:
        NotHere: If it is not named, or not complete.
    """
    name = os.environ.get("MIMIC_UNITREE")
    if name is None:
        raise NotHere("MIMIC_UNITREE names no folder: a checkout of unitreerobotics/unitree_mujoco with sdk/ in it")
    for part in ("simulate_python/unitree_sdk2py_bridge.py", "unitree_robots/go2/scene.xml", "sdk/unitree_sdk2py"):
        if not (Path(name) / part).exists():
            raise NotHere(f"there is no {part} in {name} (MIMIC_UNITREE)")
    return Path(name)


def load() -> Any:
    """Import the module of the bridge.

    Raises:
        NotHere: If it cannot be imported.
    """
    there = folder()
    sys.path[:0] = [str(there / "sdk"), str(there / "simulate_python")]
    sys.modules.setdefault("pygame", types.ModuleType("pygame"))  # for a joystick; there is none
    try:
        import unitree_sdk2py_bridge  # type: ignore[import-not-found]
    except ImportError as reason:
        raise NotHere(f"Unitree's bridge cannot be imported: {reason}") from None
    return unitree_sdk2py_bridge


def model_of(description: RobotDescription, seed: int) -> tuple[Any, Any]:
    """Return Unitree's model and its data: a robot without power, sunk from up to 0.05 rad beside the crouch."""
    model = mujoco.MjModel.from_xml_path(str(folder() / "unitree_robots" / "go2" / "scene.xml"))
    model.opt.timestep = STEP
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    yaw = rng.uniform(-np.pi, np.pi)
    data.qpos[:7] = 0.0, 0.0, description.pose_height["lie"] + 0.01, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)
    for name, q in zip(JOINTS, description.poses["lie"] + rng.uniform(-0.05, 0.05, len(JOINTS)), strict=True):
        leg, part = name.split("_")
        joint = model.joint(f"{leg}_{PARTS[part]}_joint")
        data.qpos[joint.qposadr[0]] = np.clip(q, joint.range[0] + 0.01, joint.range[1] - 0.01)
    sink(model, data)
    return model, data


class LockstepBus:
    """The bridge as the bus of `mimic.hardware.go2.driver`: listening steps Unitree's simulator.

    Messages pass as bytes that the SDK's own types read and write; only the network between is left out.
    """

    def __init__(self, description: RobotDescription, seed: int, *, curve: bool = False) -> None:
        """Put the robot down.

        Args:
            description: Where it lies, and its motors.
            seed: Of its pose and of lost messages.
            curve: Give the motors of Unitree's model, which turn at any speed, the torque-speed curve of the Go2.
        """
        bridge = load()
        waits = types.SimpleNamespace(Start=lambda: None)
        bridge.RecurrentThread = lambda **_: waits  # its clock is this bus
        bridge.ChannelPublisher = lambda topic, kind: types.SimpleNamespace(
            Init=lambda: None, Write=lambda message: self._say(topic, message)
        )
        bridge.ChannelSubscriber = lambda topic, kind: types.SimpleNamespace(Init=lambda handler, queue: None)
        self.model, self.data = model_of(description, seed)
        self._commands = bridge.LowCmd_
        self._bridge = bridge.UnitreeSdk2Bridge(self.model, self.data)
        self.heard: Any = lambda channel, data, t: None
        self.source = 0
        self.hook: Any = lambda t: None
        self.loss: Any = lambda t: 0.0
        """Share of messages that are lost at a time, both ways."""
        self._chance = random.Random(seed)
        self._flat, self._top, self._most = (  # the same for all legs
            np.asarray(number, dtype=np.float64)
            for number in (description.speed_flat, description.speed_max, description.torque_max)
        )
        self._curve = curve
        self.last: Any = None
        """The last command."""

    def _lost(self) -> bool:
        return self._chance.random() < self.loss(self.now())

    def _say(self, topic: str, message: Any) -> None:
        if topic == LOWSTATE and not self._lost():
            self.heard(LOWSTATE, message.serialize(), self.now())

    def now(self) -> float:
        return float(self.data.time)

    def publish(self, channel: str, data: bytes) -> None:
        if channel == LOWCMD and not self._lost():
            self.last = self._commands.deserialize(data)
            self._bridge.LowCmdHandler(self.last)

    def listen(self, until: float, wake: int | None = None) -> None:
        while self.now() < until - 1e-9:
            self.hook(self.now())
            wanted = self.data.ctrl.copy()
            if self._curve:
                speed = self.data.sensordata[len(JOINTS) : 2 * len(JOINTS)]
                left = np.clip((self._top - np.abs(speed)) / (self._top - self._flat), 0.0, 1.0) * self._most
                self.data.ctrl[:] = np.where(wanted * speed > 0.0, np.clip(wanted, -left, left), wanted)
            mujoco.mj_step(self.model, self.data)
            self.data.ctrl[:] = wanted
            self._bridge.PublishLowState()

    def ready(self, topic: str) -> bool:
        return True

    def others(self, topic: str = LOWCMD) -> list[str]:
        return []

    def close(self) -> None: ...

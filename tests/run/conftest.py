"""A robot that lives in memory, and a policy that answers what it is told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimic.policy.contract import PolicyContract
from mimic.robot.description import RobotDescription
from mimic.types import CommandTrack, JointCommand, RobotState, Tick


@dataclass
class MemoryPlant:
    """Joints follow their commands at once; the base does what ``pitch`` says. Base position is not measured."""

    description: RobotDescription
    pitch: Callable[[int], float] = lambda tick: min(np.pi / 2, 0.1 * tick)
    """Angle of base x above the ground after a number of ticks [rad]."""
    heading: float = 0.0
    limit: float = np.inf
    """Joint positions that go out are clipped to plus and minus this [rad]."""
    fail: Callable[[int], None] = lambda tick: None
    """Called at each step before anything is sent; may raise."""
    sent: list[JointCommand] = field(default_factory=list)
    closed: int = 0

    def start(self) -> RobotState:
        self.sent.clear()
        return self._state(self.description.poses["lie"])

    def step(self, command: JointCommand) -> Tick:
        self.fail(len(self.sent))
        clipped = np.clip(command.q_des, -self.limit, self.limit)
        out = JointCommand(q_des=clipped, dq_des=command.dq_des, kp=command.kp, kd=command.kd, tau_ff=command.tau_ff)
        self.sent.append(out)
        return Tick(state=self._state(clipped), sent=out)

    def close(self) -> None:
        self.closed += 1

    def _state(self, q: np.ndarray) -> RobotState:
        tick = len(self.sent)
        turn = Rotation.from_euler("ZY", [self.heading, -self.pitch(tick)])
        return RobotState(
            t=tick * self.description.dt,
            q=np.array(q),
            dq=np.zeros(12),
            tau=np.zeros(12),
            quat_WB=turn.as_quat(scalar_first=True),
            omega_B=np.zeros(3),
            p_WB=np.full(3, np.nan),
            v_WB=np.full(3, np.nan),
        )


@dataclass
class ToldPolicy:
    """Answers ``says`` of the number of the call."""

    contract: PolicyContract
    says: Callable[[int], np.ndarray] = lambda call: np.zeros(12)
    path: Path = Path("told.onnx")
    seen: list[np.ndarray] = field(default_factory=list)

    def act(self, observation: np.ndarray) -> np.ndarray:
        self.seen.append(observation)
        return self.says(len(self.seen) - 1)


@pytest.fixture
def memory_plant(description) -> Callable[..., MemoryPlant]:
    return lambda **options: MemoryPlant(description, **options)


@pytest.fixture
def told_policy(contract) -> Callable[..., ToldPolicy]:
    return lambda **options: ToldPolicy(contract, **options)


@pytest.fixture
def track(contract) -> Callable[..., CommandTrack]:
    """Return a function that makes commands of a number of ticks: toes that sway, a walk, a turn."""

    def make(ticks: int = 20, *, v: float = 0.2, turn: float = 0.3) -> CommandTrack:
        t = contract.dt * np.arange(ticks)
        toes = np.array(contract.neutral_toes).reshape(2, 3) + 0.05 * np.sin(4 * t + 1)[:, None, None]
        speed = np.tile([v, 0.0], (ticks, 1))
        return CommandTrack(t=t, v=speed, heading=np.full(ticks, turn), p_BE=toes)

    return make

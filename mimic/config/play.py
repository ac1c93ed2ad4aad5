"""Playing commands on a robot, and the robot that is simulated."""

from __future__ import annotations

import math
from typing import Literal

from mimic.config.ranges import Limited, within
from mimic.frozen import frozen

DEFAULT_ROBOT = "cyberdog2"
"""The robot where none is named."""

RAMP = 2.0
"""Time in which a robot that lies without power is brought into the crouch, where its policy begins [s]."""
TRIM = 0.5
"""Time in which its targets then move on until the joints are there [s]."""


@frozen
class RunSettings(Limited):
    """Timing of a run, and its policy."""

    policy: str | None = None
    """ONNX file; default: the shipped policy."""
    seed: int = within(0, 0, 2**63)
    """Seed of the simulated start."""
    stand_up: float = within(2.0, 1.0, 10.0, "s")
    """Time from lying to the first target [s]; the policy stands up in about 1 s."""
    blend: float = within(0.5, 0.1, 5.0, "s")
    """Time to move from the measured toes to the first target [s]."""
    hold_last: float = within(1.0, 0.0, 30.0, "s")
    """Time to hold the last target [s]."""
    sit_down: float = within(2.5, 1.5, 10.0, "s")
    """Time to sit down at the end [s]; the policy needs about half."""
    hold_position: bool = True
    """Bring a robot that drifts back to where it stood, and let it come as far as it is asked to, by leg odometry."""
    arms: Literal["network", "inverse_kinematics"] | None = None
    """Who moves the front legs; default: what the policy's contract says."""
    lean_against_pulls: bool = True
    """Lean against a pull that is felt in the front legs, and turn to it (mimic/robot/pull.py)."""


@frozen
class EffectsSettings(Limited):
    """Which robot is simulated, and its calibrated effects."""

    robot_model: str = DEFAULT_ROBOT
    """cyberdog2, go2, or the folder of another robot with its robot.toml and MJCF."""
    effects: str | None = None
    """effects.toml of a calibration; default: no effects."""
    timestep: float = within(0.0025, 2.5e-4, 0.01, "s")
    """Physics step with effects [s]."""


AS_DESCRIBED = EffectsSettings()
"""The robot without effects."""


@frozen
class Randomisation:
    """Ranges of the paper's Table II and of the start; a pair is uniform between its ends.

    Source: Li et al. 2024, Table II, and its public code (c2_common_config.py, c2_standdance_env.py).
    """

    dry_friction: tuple[float, float] = (0.6, 1.6)
    """Factor on the dry friction of each joint; the paper has 0.03 to 0.08 N m, for a CyberDog 2 the same."""
    viscous_friction: tuple[float, float] = (0.5, 1.5)
    """Factor on the viscous friction of each joint; the paper has 0.02 to 0.06 N m s/rad."""
    ground_friction: tuple[float, float] = (1.0, 3.0)
    """Sliding friction coefficient of the ground."""
    restitution: tuple[float, float] = (0.0, 0.4)
    """Rebound speed over impact speed of the ground."""
    base_mass: tuple[float, float] = (-0.5, 0.5)
    """Added to the trunk [kg]."""
    abad_mass: tuple[float, float] = (0.0, 0.1)
    """Added to each abad link [kg]; the paper's 'hip'."""
    hip_mass: tuple[float, float] = (-0.05, 0.05)
    """Added to each hip link [kg]; the paper's 'thigh'."""
    knee_mass: tuple[float, float] = (-0.05, 0.05)
    """Added to each knee link [kg]; the paper's 'calf'."""
    toe_mass: tuple[float, float] = (0.0, 0.01)
    """Added at each toe [kg]; the paper's 'foot'."""
    com: tuple[float, float] = (-0.01, 0.01)
    """Shift of the trunk's centre of mass along each axis [m]."""
    kp: tuple[float, float] = (0.8, 1.2)
    """Factor on each joint's position gain."""
    kd: tuple[float, float] = (0.8, 1.2)
    """Factor on each joint's velocity gain."""
    delay: tuple[float, float] = (0.005, 0.030)
    """From a command's decision to its effect [s]; drawn anew for every episode, rounded to physics steps."""
    push: tuple[float, float] = (0.0, 0.2)
    """Speed of a horizontal push to the trunk every push_interval [m/s]."""
    push_interval: float = 5.0
    """Time between two pushes [s]."""
    start_q: tuple[float, float] = (-0.1, 0.1)
    """Added to each joint of the lying pose [rad]."""
    start_height: tuple[float, float] = (0.0, 0.02)
    """Added to the base height of the lying pose [m]."""
    heading: tuple[float, float] = (-3.141592653589793, 3.141592653589793)
    """Heading at the start [rad]."""


DESCRIBED_REBOUND = math.exp(-2.0)
"""Restitution of the robot description's ground: a contact at MuJoCo's default damping ratio of 1 rebounds so."""

NOMINAL = Randomisation(
    dry_friction=(1.0, 1.0),
    viscous_friction=(1.0, 1.0),
    ground_friction=(1.0, 1.0),
    restitution=(DESCRIBED_REBOUND, DESCRIBED_REBOUND),
    base_mass=(0.0, 0.0),
    abad_mass=(0.0, 0.0),
    hip_mass=(0.0, 0.0),
    knee_mass=(0.0, 0.0),
    toe_mass=(0.0, 0.0),
    com=(0.0, 0.0),
    kp=(1.0, 1.0),
    kd=(1.0, 1.0),
    delay=(0.015, 0.015),
    push=(0.0, 0.0),
    start_q=(0.0, 0.0),
    start_height=(0.0, 0.0),
    heading=(0.0, 0.0),
)
"""No randomisation: the model of the robot description."""

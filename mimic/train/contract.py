"""What a policy that is trained here promises."""

from __future__ import annotations

from typing import Any

from mimic.config.play import RunSettings
from mimic.config.training import MdpSettings
from mimic.policy.contract import (
    ARM_TERMS,
    BY_JOINT,
    DQ_SCALE,
    GYRO_SCALE,
    INVERSE_KINEMATICS,
    NETWORK,
    TERMS,
    PolicyContract,
)
from mimic.records import JOINTS
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import front_toes

STAND_UP_STEPS = 50
"""Control steps until goals and terminations begin; the paper's."""

ACTION_CLIP = 6.0
"""Actions are clipped to plus and minus this."""

CLOCK_FADE = 0.2
"""Time in which the gait clock fades in and out as the robot is asked to step and to stand [s]."""

SIT_DOWN_CLOCK_HZ = 0.08
"""Frequency of the clock that starts with sitting down and tells the policy how far it should be [Hz]."""

WALK_SPEED = 0.05
"""Velocity command above which the robot is asked to step [m/s]."""

WALK_TURN = 0.2
"""Heading error above which it is asked to step [rad]; half as much once it steps."""


def make_contract(description: RobotDescription, settings: MdpSettings, training: str = "") -> PolicyContract:
    """Return what a policy trained with these settings promises."""
    neutral = front_toes(description.poses["upright"], description)
    by_joint: dict[str, Any] = {name: tuple(getattr(description, name).tolist()) for name in BY_JOINT}
    sits = settings.task == "sit_down"
    return PolicyContract(
        robot=description.name,
        joints=JOINTS,
        default_q=tuple(description.poses["upright"].tolist()),
        action_scale=(settings.action_scale,) * len(JOINTS),
        action_clip=ACTION_CLIP,
        q_min=tuple((description.q_min + settings.command_margin).tolist()),
        q_max=tuple((description.q_max - settings.command_margin).tolist()),
        **by_joint,
        dt=description.dt,
        history=settings.history,
        terms=TERMS,
        clock_hz=SIT_DOWN_CLOCK_HZ if sits else settings.clock_hz,
        neutral_toes=tuple(neutral.reshape(-1).tolist()),
        stand_up_steps=STAND_UP_STEPS,
        blend_steps=round(RunSettings().blend / description.dt),
        velocity_max=(0.0, 0.0) if sits else (settings.fastest, 0.0),
        toe_low=tuple(description.goals.low.min(axis=0).tolist()),
        toe_high=tuple(description.goals.high.max(axis=0).tolist()),
        delay=description.delay,
        arms=NETWORK if sits else INVERSE_KINEMATICS,
        once=() if sits else ARM_TERMS,
        training=training,
        task=settings.task,
        interpolate=True,
        clock_fade=0.0 if sits else CLOCK_FADE,
        walk_speed=WALK_SPEED,
        walk_turn=WALK_TURN,
        noise=(
            ("joint_position", settings.noise_q),
            ("down", settings.noise_axes),
            ("forward", settings.noise_axes),
            ("gyro", settings.noise_gyro * GYRO_SCALE),
            ("joint_velocity", settings.noise_dq * DQ_SCALE),
        ),
    )

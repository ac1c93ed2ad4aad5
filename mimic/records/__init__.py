"""Frozen records that flow from a source to a log; the vocabulary of mimic.

Arrays are copied, made read-only and checked for shape when a record is made. Each array field declares its axes after
the first; `mimic.io.store` names its columns by them.
"""

from mimic.records.base import (
    AXES,
    ELBOWS,
    HIPS,
    JOINTS,
    KNEES,
    LANDMARKS,
    LEGS,
    SHOULDERS,
    SIDES,
    WRISTS,
    BoolArray,
    FloatArray,
    IntArray,
    Provenance,
    Record,
    array,
    joint_names,
    landmarks_of,
)
from mimic.records.motion import Command, CommandTrack, LiveCommands, LiveTrack, PoseTrack, TargetTrack, WristTrack
from mimic.records.run import DOUBLED, PHASES, Health, HealthLog, JointCommand, JointSamples, RobotState, RunLog, Tick

__all__ = [
    "AXES",
    "DOUBLED",
    "ELBOWS",
    "HIPS",
    "JOINTS",
    "KNEES",
    "LANDMARKS",
    "LEGS",
    "PHASES",
    "SHOULDERS",
    "SIDES",
    "WRISTS",
    "BoolArray",
    "Command",
    "CommandTrack",
    "FloatArray",
    "Health",
    "HealthLog",
    "IntArray",
    "JointCommand",
    "JointSamples",
    "LiveCommands",
    "LiveTrack",
    "PoseTrack",
    "Provenance",
    "Record",
    "RobotState",
    "RunLog",
    "TargetTrack",
    "Tick",
    "WristTrack",
    "array",
    "joint_names",
    "landmarks_of",
]

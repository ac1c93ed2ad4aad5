"""Human motion from a video, played by a CyberDog 2 standing on its hind legs.

The functions and records below load on first use, so that importing mimic is cheap.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mimic.version import __version__ as __version__

if TYPE_CHECKING:
    from mimic.config.evaluation import EvaluateSettings as EvaluateSettings
    from mimic.config.hardware import BusSettings as BusSettings
    from mimic.config.play import EffectsSettings as EffectsSettings
    from mimic.config.play import RunSettings as RunSettings
    from mimic.config.pose import LanguageSettings as LanguageSettings
    from mimic.config.pose import LiveSettings as LiveSettings
    from mimic.config.pose import MocapSettings as MocapSettings
    from mimic.config.pose import PoseSettings as PoseSettings
    from mimic.config.retarget import RetargetSettings as RetargetSettings
    from mimic.config.sysid import CalibrateSettings as CalibrateSettings
    from mimic.config.sysid import LogSettings as LogSettings
    from mimic.dynamics.effect_set import EffectSet as EffectSet
    from mimic.dynamics.effect_set import read_effects as read_effects
    from mimic.errors import MimicError as MimicError
    from mimic.flows.environment import Env as Env
    from mimic.flows.evaluate import evaluate as evaluate
    from mimic.flows.logs.calibrate import calibrate as calibrate
    from mimic.flows.logs.machine_log import predict_log as predict_log
    from mimic.flows.logs.machine_log import simulate_log as simulate_log
    from mimic.flows.motions.motion import InputSettings as InputSettings
    from mimic.flows.motions.motion import Motion as Motion
    from mimic.flows.motions.motion import load_motion as load_motion
    from mimic.flows.motions.motion import motion_from_text as motion_from_text
    from mimic.flows.motions.motion import retarget as retarget
    from mimic.flows.motions.motion import track_video as track_video
    from mimic.flows.play import load_policy as load_policy
    from mimic.flows.play import load_robot as load_robot
    from mimic.flows.play import load_run as load_run
    from mimic.flows.play import play as play
    from mimic.flows.play import play_source as play_source
    from mimic.flows.reporter import Reporter as Reporter
    from mimic.flows.run_folder import Run as Run
    from mimic.flows.run_folder import SavedRun as SavedRun
    from mimic.io.joint_log import JointLog as JointLog
    from mimic.io.joint_log import read_log as read_log
    from mimic.policy.runtime import Policy as Policy
    from mimic.records import CommandTrack as CommandTrack
    from mimic.records import HealthLog as HealthLog
    from mimic.records import JointCommand as JointCommand
    from mimic.records import PoseTrack as PoseTrack
    from mimic.records import RobotState as RobotState
    from mimic.records import RunLog as RunLog
    from mimic.records import TargetTrack as TargetTrack
    from mimic.records import Tick as Tick
    from mimic.records import WristTrack as WristTrack
    from mimic.robot.description import RobotDescription as RobotDescription
    from mimic.sysid.result import Calibration as Calibration

_OWNERS = {
    "mimic.config.evaluation": ("EvaluateSettings",),
    "mimic.config.hardware": ("BusSettings",),
    "mimic.config.play": (
        "EffectsSettings",
        "RunSettings",
    ),
    "mimic.config.pose": (
        "LanguageSettings",
        "LiveSettings",
        "MocapSettings",
        "PoseSettings",
    ),
    "mimic.config.retarget": ("RetargetSettings",),
    "mimic.config.sysid": (
        "CalibrateSettings",
        "LogSettings",
    ),
    "mimic.dynamics.effect_set": ("EffectSet", "read_effects"),
    "mimic.errors": ("MimicError",),
    "mimic.flows.logs.calibrate": ("calibrate",),
    "mimic.flows.environment": ("Env",),
    "mimic.flows.logs.machine_log": ("predict_log", "simulate_log"),
    "mimic.flows.evaluate": ("evaluate",),
    "mimic.flows.motions.motion": (
        "InputSettings",
        "Motion",
        "load_motion",
        "motion_from_text",
        "retarget",
        "track_video",
    ),
    "mimic.flows.play": ("load_policy", "load_robot", "load_run", "play", "play_source"),
    "mimic.flows.reporter": ("Reporter",),
    "mimic.flows.run_folder": ("Run", "SavedRun"),
    "mimic.io.joint_log": ("JointLog", "read_log"),
    "mimic.policy.runtime": ("Policy",),
    "mimic.records": (
        "CommandTrack",
        "HealthLog",
        "JointCommand",
        "PoseTrack",
        "RobotState",
        "RunLog",
        "TargetTrack",
        "Tick",
        "WristTrack",
    ),
    "mimic.robot.description": ("RobotDescription",),
    "mimic.sysid.result": ("Calibration",),
}
"""Which module each public name comes from."""

_KINDS = {"MachineModel": "mimic.dynamics.machine", "Safety": "mimic.control.tick"}
"""Which module each other kind of their arguments comes from."""

_MODULE_OF = {name: module for module, names in _OWNERS.items() for name in names}

__all__ = ["__version__", *sorted(_MODULE_OF.keys() - {"Env"})]  # Env needs the extra env: no part of import *


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"mimic has no {name!r}; it has {', '.join(sorted(_MODULE_OF))}")
    value = _found(name)
    if type(value).__name__ == "function":
        from mimic.arguments import checked

        value = checked(value, _found)
    globals()[name] = value
    return value


def _found(name: str) -> Any:
    """Return what stands for a public name, or for a kind of their arguments; None for any other name."""
    module = _MODULE_OF.get(name) or _KINDS.get(name)
    return None if module is None else getattr(importlib.import_module(module), name)


def __dir__() -> list[str]:
    return __all__

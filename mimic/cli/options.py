"""Groups of options that commands share."""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from mimic.config import sysid
from mimic.config.emulator import EmulateSettings, ServeOptions
from mimic.config.hardware import (
    BusSettings,
    DriveSettings,
    LookSettings,
    ProbeSettings,
    WiringSettings,
)
from mimic.config.leading import HandSettings, LeadingSettings
from mimic.config.play import EffectsSettings, RunSettings
from mimic.config.pose import LanguageSettings, LiveSettings, MocapSettings, PoseSettings
from mimic.config.retarget import RetargetSettings
from mimic.config.sysid import CalibrateSettings, LogSettings
from mimic.errors import ConfigError

if TYPE_CHECKING:
    from mimic.flows.motions.motion import InputSettings

OUTPUT = Group("Output", sort_key=1)


def _group(name: str, order: int) -> Parameter:
    return Parameter(name="*", group=Group(name, sort_key=order))


def only(group: str, *shown: str) -> Parameter:
    """Return which settings of a parameter's group are options; all others are read from --config alone."""
    return Parameter(parse=re.compile(f"^({'|'.join((group, *shown))})$"))


def input_settings(**parts: Any) -> InputSettings:
    """Return the settings of an input; parts that were not given (None) keep their defaults."""
    from mimic.flows.motions.motion import InputSettings

    return InputSettings(**{name: part for name, part in parts.items() if part is not None})


def _check_robot(kind: Any, name: str | None) -> None:
    """Refuse a name that is nearly that of a board: as a CAN interface nobody would find it."""
    if name is None:
        return
    from mimic.hardware.robot.board_wiring import BOARDS

    close = get_close_matches(name.lower(), BOARDS, n=1, cutoff=0.8)
    if close and name not in BOARDS:
        raise ConfigError(f"there is no robot {name}; did you mean {close[0]}?")


BusUrl = Annotated[str, Parameter(validator=_check_robot)]
Flag = Parameter(negative="")
Out = Annotated[Path | None, Parameter(name=["--out", "-o"], group=OUTPUT)]
RequiredOut = Annotated[Path, Parameter(name=["--out", "-o"], group=OUTPUT)]
View = Annotated[bool | None, Parameter(group=OUTPUT)]

Retarget = Annotated[RetargetSettings | None, _group("Retargeting", 2)]
Run = Annotated[RunSettings | None, _group("Playing", 3)]
Effects = Annotated[EffectsSettings | None, _group("Simulated robot", 4)]
Pose = Annotated[PoseSettings | None, _group("Video", 5)]
Stored = Annotated[MocapSettings | None, _group("Recorded motion (.npz, .trc, .bvh)", 6)]
Language = Annotated[LanguageSettings | None, _group("Sentences (--text)", 7)]
Live = Annotated[LiveSettings | None, _group("Camera (--camera)", 8)]
Bus = Annotated[BusSettings | None, _group("Real robot (--robot)", 9)]
Drive = Annotated[DriveSettings | None, _group("Robot", 3)]
Look = Annotated[LookSettings | None, _group("Robot", 3)]
WiringFile = Annotated[WiringSettings | None, _group("Robot", 3)]
Probe = Annotated[ProbeSettings | None, _group("Motion", 2)]
Calibrate = Annotated[CalibrateSettings | None, _group("Calibration", 2)]
LogMotion = Annotated[sysid.LogMotion | None, Parameter(name="*")]
SimulatedLog = Annotated[LogSettings | None, _group("Readings", 3)]
Serve = Annotated[ServeOptions | None, Parameter(name="*")]
Emulate = Annotated[EmulateSettings | None, _group("Emulated robot", 2)]

SECTIONS: Mapping[str, type] = {
    "retarget": RetargetSettings,
    "play": RunSettings,
    "effects": EffectsSettings,
    "pose": PoseSettings,
    "mocap": MocapSettings,
    "text": LanguageSettings,
    "camera": LiveSettings,
    "robot": BusSettings,
    "probe": ProbeSettings,
    "lead": HandSettings,
    "answer": LeadingSettings,
    "calibrate": CalibrateSettings,
    "log": LogSettings,
    "emulate": EmulateSettings,
}
"""Section of the file -> its settings."""

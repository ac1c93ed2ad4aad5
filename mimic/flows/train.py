"""Training policies: settings from recipes, and the training itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mimic.config.play import DEFAULT_ROBOT, EffectsSettings
from mimic.config.text_file import from_toml
from mimic.config.training import LearnSettings, MdpSettings
from mimic.config.values import made, read_toml
from mimic.errors import AssetError, ConfigError, MissingExtra
from mimic.flows.play import load_robot, warn_of_stand_effects
from mimic.flows.reporter import Reporter, reporting
from mimic.io.assets import shipped

RECIPES = ("stand_track", "sit_down", "go2_stand_track")
"""Shipped recipes, in policies/."""


def training_settings(recipe: str = RECIPES[0], words: Sequence[str] = ()) -> tuple[MdpSettings, LearnSettings]:
    """Return the settings of a training.

    Args:
        recipe: A TOML file of settings, or the name of a shipped recipe; what it does not name has its default.
        words: "name=value" for single settings, such as "worlds=16" or "rewards.slip=-0.4"; the last one wins.

    Raises:
        ConfigError: If there is no such recipe or setting, or a value does not fit.
    """
    path = Path(recipe)
    if path.suffix != ".toml":
        if recipe not in RECIPES:
            raise ConfigError(f"there is no recipe {recipe!r}; give a .toml file or one of {', '.join(RECIPES)}")
        path = shipped("policies", f"{recipe}.toml")
    settings: tuple[Any, ...] = MdpSettings(), LearnSettings()
    for table in (read_toml(path), *map(_table, words)):
        for name, value in table.items():
            at = next((i for i, s in enumerate(settings) if name in _names(s)), None)
            if at is None:
                known = ", ".join(name for s in settings for name in _names(s))
                raise ConfigError(f"there is no setting {name!r}; there are {known}")
            changed = made(type(settings[at]), {name: value}, base=settings[at])
            settings = (*settings[:at], changed, *settings[at + 1 :])
    return settings  # type: ignore[return-value]


def _table(word: str) -> dict[str, Any]:
    """Return name=value as TOML has it; a value that is none in TOML is text."""
    name, equals, text = word.partition("=")
    if not equals:
        raise ConfigError(f"{word!r} is not a setting; expected name=value")
    for value in (text, f"'{text}'"):
        try:
            return from_toml(f"{name} = {value}")
        except ValueError:
            pass
    raise ConfigError(f"{word!r} is not a setting; expected name=value, such as rewards.slip=-0.4")


def _names(settings: Any) -> list[str]:
    return [f.name for f in dataclasses.fields(settings)]


def train(
    out: Path,
    mdp: MdpSettings | None = None,
    learn: LearnSettings | None = None,
    *,
    robot: str | Path = DEFAULT_ROBOT,
    resume: Path | None = None,
    report: Callable[[int, dict[str, float]], None] | None = None,
    reporter: Reporter | None = None,
) -> Path:
    """Train a policy with PPO in MuJoCo Warp and return its ONNX file.

    Args:
        out: Folder for checkpoints, TensorBoard files, settings.json and policy.onnx.
        mdp: The worlds, rewards and randomisation; by default those of stand_track. See `training_settings`.
        learn: PPO and the length of the training.
        robot: Which robot is trained: its name, or its folder (see `load_robot`).
        resume: Checkpoint (.pt) or policy (.onnx) to go on from.
        report: Called after each update with its number and its figures.
        reporter: Receives warnings.

    Raises:
        MissingExtra: If the extra ``train`` is not installed.
        AssetError: If there is no such checkpoint.
        ConfigError: If the device is not there.
    """
    try:
        from mimic.train.learning.learn import train as learn_policy
    except ModuleNotFoundError as missing:
        raise MissingExtra(str(missing.name), "train") from None
    mdp = mdp or MdpSettings()
    learn = learn or LearnSettings()
    warn_of_stand_effects(EffectsSettings(effects=mdp.effects or None), reporting(reporter))
    if resume is not None and not resume.is_file():
        raise AssetError(f"there is no checkpoint {resume}")
    kept = sorted(out.glob("*.pt"))
    if kept and resume is None:
        raise ConfigError(
            f"{out} holds a training ({kept[-1].name}); name another folder, or go on with it by --resume"
        )
    return learn_policy(out, mdp, learn, load_robot(robot), resume=resume, report=report)

"""Evaluating policies."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from mimic.config.evaluation import (
    CalmSettings,
    EpisodeSettings,
    EvaluateSettings,
    LeadSettings,
    RobustnessSettings,
    SitDownEvaluateSettings,
    StandUpSettings,
    TableSettings,
)
from mimic.config.play import DEFAULT_ROBOT
from mimic.flows.play import load_policy, load_robot, warn_of_stand_effects
from mimic.flows.provenance import provenance
from mimic.flows.reporter import Reporter, reporting
from mimic.io import store

KINDS: dict[str, tuple[type[EpisodeSettings], str]] = {
    "stand_track": (EvaluateSettings, "policy:evaluate"),
    "sit_down": (SitDownEvaluateSettings, "sit_down:evaluate_sit_down"),
    "table": (TableSettings, "paper_table:evaluate_table"),
    "stand-up": (StandUpSettings, "stand_up:evaluate_stand_up"),
    "calm": (CalmSettings, "calm:evaluate_calm"),
    "lead": (LeadSettings, "led_by_hand:evaluate_leading"),
    "robustness": (RobustnessSettings, "robustness:evaluate_robustness"),
}
"""Kinds of evaluation: settings and the function in mimic.evaluation; the first two are chosen by a policy's task."""


def evaluate(
    policy: str | Path | None = None,
    settings: EpisodeSettings | None = None,
    *,
    out: Path | None = None,
    reporter: Reporter | None = None,
) -> dict[str, Any]:
    """Evaluate a policy in plain MuJoCo, from the lying start, episodes in parallel.

    Args:
        policy: ONNX file with its contract inside, or the name of a shipped policy; by default stand_track.
        settings: Their class says what is measured: EvaluateSettings (standing up, reaching, walking, turning),
            SitDownEvaluateSettings (for policies that sit down), TableSettings (Table III of the paper),
            StandUpSettings, CalmSettings (how calmly it stands), LeadSettings (being led by the hand),
            RobustnessSettings (which disturbances it survives).
            By default what fits the policy.
        out: Also write the figures, with their provenance, into this JSON file.
        reporter: Receives warnings and progress.

    Returns:
        Figures as plain data; ``summary`` holds those that decide. The same seeds give the same figures on one machine.

    Raises:
        AssetError, ContractError: If the policy cannot be run on this robot.
        ConfigError: If the effects cannot be used.
    """
    from mimic.policy.runtime import find_policy
    from mimic.simulation.plant import plant_options

    reporter = reporting(reporter)
    description = load_robot(DEFAULT_ROBOT if settings is None else settings.robot.robot_model)
    path = find_policy("stand_track" if policy is None else policy, description.name)
    settings = settings or KINDS[load_policy(path, description).contract.task][0]()  # type: ignore[call-arg]
    if out is not None:
        store.check_writable(out.parent)
    warn_of_stand_effects(settings.robot, reporter)
    plant_options(settings.robot)  # refused before there is a progress bar
    module, _, name = next(where for kind, where in KINDS.values() if kind is type(settings)).partition(":")
    run = getattr(importlib.import_module(f"mimic.evaluation.{module}"), name)
    with reporter.progress("episodes") as progress:
        result = run(path, settings, progress=progress)
    if out is not None:
        inputs = {"policy": path}
        inputs |= {} if settings.robot.effects is None else {"effects": Path(settings.robot.effects)}
        store.save_json({**result, "provenance": provenance(settings, inputs)}, out)
    return result

"""Evaluating policies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mimic.config.evaluation import (
    CalmSettings,
    EvaluateSettings,
    LeadSettings,
    RobustnessSettings,
    SitDownEvaluateSettings,
    StandUpSettings,
    TableSettings,
)
from mimic.flows.play import warn_of_stand_effects
from mimic.flows.provenance import provenance
from mimic.flows.reporter import Reporter, SilentReporter
from mimic.io import store

AnyEvaluation = (
    EvaluateSettings
    | SitDownEvaluateSettings
    | TableSettings
    | StandUpSettings
    | CalmSettings
    | LeadSettings
    | RobustnessSettings
)


def evaluate(
    policy: str | Path | None = None,
    settings: AnyEvaluation | None = None,
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
    from mimic.simulation.plant import plant_options

    reporter = reporter or SilentReporter()
    path = policy_path(policy)
    if settings is None:
        settings = SitDownEvaluateSettings() if task_of(path) == "sit_down" else EvaluateSettings()
    if out is not None:
        store.check_writable(out.parent)
    warn_of_stand_effects(settings.robot, reporter)
    plant_options(settings.robot)  # refused before there is a progress bar
    run = _evaluation(settings)
    with reporter.progress("episodes") as progress:
        result = run(path, settings, progress=progress)
    if out is not None:
        inputs = {"policy": path}
        inputs |= {} if settings.robot.effects is None else {"effects": Path(settings.robot.effects)}
        store.save_json({**result, "provenance": provenance(settings, inputs)}, out)
    return result


def _evaluation(settings: AnyEvaluation) -> Callable[..., dict[str, Any]]:
    if isinstance(settings, TableSettings):
        from mimic.evaluation.paper_table import evaluate_table

        return evaluate_table
    if isinstance(settings, RobustnessSettings):
        from mimic.evaluation.robustness import evaluate_robustness

        return evaluate_robustness
    if isinstance(settings, CalmSettings):
        from mimic.evaluation.calm import evaluate_calm

        return evaluate_calm
    if isinstance(settings, LeadSettings):
        from mimic.evaluation.leading import evaluate_leading

        return evaluate_leading
    if isinstance(settings, StandUpSettings):
        from mimic.evaluation.stand_up import evaluate_stand_up

        return evaluate_stand_up
    if isinstance(settings, SitDownEvaluateSettings):
        from mimic.evaluation.sit_down import evaluate_sit_down

        return evaluate_sit_down
    from mimic.evaluation.policy import evaluate as evaluate_tracking

    return evaluate_tracking


def policy_path(policy: str | Path | None) -> Path:
    """Return the file of a policy: a path, or the name of a shipped one, such as stand_track.

    Raises:
        AssetError: If there is no such policy.
    """
    from mimic.policy.runtime import find_policy

    return find_policy("stand_track" if policy is None else policy)


def task_of(policy: Path) -> str:
    """Return what a policy was trained to do: stand_track or sit_down.

    Raises:
        AssetError, ContractError: If it cannot be run on this robot.
    """
    from mimic.policy.runtime import Policy
    from mimic.robot.description import load_description

    return Policy(policy, load_description()).contract.task

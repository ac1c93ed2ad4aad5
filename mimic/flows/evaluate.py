"""Evaluating policies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mimic.config.evaluation import EpisodeSettings, EvaluateSettings, SitDownEvaluateSettings
from mimic.config.play import DEFAULT_ROBOT
from mimic.flows.play import load_policy, load_robot, warn_of_stand_effects
from mimic.flows.provenance import provenance
from mimic.flows.reporter import Reporter, reporting
from mimic.io import store

SETTINGS: dict[str, type[EvaluateSettings | SitDownEvaluateSettings]] = {
    "stand_track": EvaluateSettings,
    "sit_down": SitDownEvaluateSettings,
}
"""Task of a policy -> settings of its evaluation."""


def evaluate(
    policy: str | Path | None = None,
    settings: EvaluateSettings | SitDownEvaluateSettings | None = None,
    *,
    out: Path | None = None,
    reporter: Reporter | None = None,
) -> dict[str, Any]:
    """Evaluate a policy in plain MuJoCo, from the lying start, episodes in parallel.

    Args:
        policy: ONNX file with its contract inside, or the name of a shipped policy; by default stand_track.
        settings: EvaluateSettings (standing up, reaching, walking, turning, pushes), or SitDownEvaluateSettings for
            policies that sit down; by default what fits the policy.
        out: Also write the figures, with their provenance, into this JSON file.
        reporter: Receives warnings and progress.

    Returns:
        Figures as plain data; ``summary`` holds those that decide. The same seeds give the same figures on one machine.

    Raises:
        AssetError, ContractError: If the policy cannot be run on this robot.
        ConfigError: If the effects cannot be used.
    """
    from mimic.evaluation.policy import evaluate as evaluate_tracking
    from mimic.evaluation.sit_down import evaluate_sit_down
    from mimic.policy.runtime import find_policy
    from mimic.simulation.plant import plant_options

    reporter = reporting(reporter)
    description = load_robot(DEFAULT_ROBOT if settings is None else settings.robot.robot_model)
    path = find_policy("stand_track" if policy is None else policy, description.name)
    settings = settings or SETTINGS[load_policy(path, description).contract.task]()
    if out is not None:
        store.check_file(out)
    warn_of_stand_effects(settings.robot, reporter)
    plant_options(settings.robot)  # refused before there is a progress bar
    with reporter.progress("episodes") as progress:
        if isinstance(settings, SitDownEvaluateSettings):
            result = evaluate_sit_down(path, settings, progress=progress)
        else:
            result = evaluate_tracking(path, settings, progress=progress)
    if out is not None:
        save_evaluation(result, path, settings, out)
    return result


def save_evaluation(result: dict[str, Any], policy: Path, settings: EpisodeSettings, out: Path) -> None:
    """Write the figures of an evaluation as JSON, with the hashes of what was evaluated."""
    inputs = {"policy": policy}
    if settings.robot.effects is not None:
        inputs["effects"] = Path(settings.robot.effects)
    store.save_json({**result, "provenance": provenance(settings, inputs)}, out)

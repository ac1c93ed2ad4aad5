"""Studies of a policy, beyond what `mimic evaluate` judges; prints Markdown, and writes all figures as JSON.

    python -m lab.policies table POLICY        # the paper's Table III with its sensor noise; speeds reached
    python -m lab.policies stand-up POLICY     # 500 lying starts, and standing still for 20 s
    python -m lab.policies calm POLICY         # standing for 60 s, with and without noise; pushes and pulls
    python -m lab.policies trunk POLICY        # crouching and leaning, with and without pushes
    python -m lab.policies lead POLICY         # led by a front toe, 5 m in any direction
    python -m lab.policies robustness POLICY   # survived share along each disturbance, with a heat map

POLICY is an ONNX file or the name of a shipped policy. `policy_report` measures four of them for lab/results.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lab.policies import policy_report as report
from lab.policies.studies.calm import evaluate_calm
from lab.policies.studies.heat_map import draw_heat_map
from lab.policies.studies.led_by_hand import evaluate_leading
from lab.policies.studies.paper_table import evaluate_table
from lab.policies.studies.robustness import evaluate_robustness
from lab.policies.studies.settings import (
    CalmSettings,
    LeadSettings,
    RobustnessSettings,
    StandUpSettings,
    TableSettings,
    TrunkSettings,
)
from lab.policies.studies.stand_up import evaluate_stand_up
from lab.policies.studies.trunk import evaluate_trunk
from mimic.cli.terminal.console import ConsoleReporter
from mimic.config.evaluation import EpisodeSettings
from mimic.config.play import EffectsSettings
from mimic.errors import MimicError
from mimic.flows.evaluate import save_evaluation
from mimic.flows.play import load_robot, warn_of_stand_effects
from mimic.io import store
from mimic.policy.runtime import find_policy


@dataclass(frozen=True)
class Study:
    """What is played, and how its figures are shown."""

    settings: type[EpisodeSettings]
    evaluate: Callable[..., dict[str, Any]]
    show: Callable[[dict[str, Any]], str]


STUDIES = {
    "table": Study(TableSettings, evaluate_table, report.paper_and_walking),
    "stand-up": Study(StandUpSettings, evaluate_stand_up, report.stand_up_table),
    "calm": Study(CalmSettings, evaluate_calm, report.calm_table),
    "trunk": Study(TrunkSettings, evaluate_trunk, report.trunk_table),
    "lead": Study(LeadSettings, evaluate_leading, report.lead_table),
    "robustness": Study(RobustnessSettings, evaluate_robustness, report.robustness_table),
}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m lab.policies", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("policy", nargs="?", default="stand_track")
    parser.add_argument("--out", type=Path, help="JSON file; default: STUDY-POLICY.json in the current folder")
    parser.add_argument("--episodes", type=int, help="at each point, of each kind, or of each evaluation seed")
    parser.add_argument("--seconds", type=float, help="length of an episode [s]")
    parser.add_argument("--seed", type=int, help="seed of the first episode")
    parser.add_argument("--workers", type=int, help="processes; by default one per core")
    parser.add_argument("--robot-model", help="shipped robot, or the folder of another one")
    parser.add_argument("--effects", help="effects.toml of a calibration")
    given = vars(parser.parse_args(arguments))
    robot = {name: given[name] for name in ("robot_model", "effects") if given[name] is not None}
    options = {name: given[name] for name in ("episodes", "seconds", "seed", "workers") if given[name] is not None}
    try:
        run(given["study"], given["policy"], given["out"], options | {"robot": EffectsSettings(**robot)})
    except MimicError as reason:
        print(f"lab.policies: {reason}", file=sys.stderr)
        return 2
    return 0


def run(name: str, policy: str, out: Path | None, options: dict[str, Any]) -> None:
    study = STUDIES[name]
    settings = study.settings(**options)
    path = find_policy(policy, load_robot(settings.robot.robot_model).name)
    out = out or Path(f"{name}-{path.stem}.json")
    store.check_writable(out.parent)
    reporter = ConsoleReporter()
    warn_of_stand_effects(settings.robot, reporter)
    with reporter.progress("episodes") as progress:
        result = study.evaluate(path, settings, progress=progress)
    save_evaluation(result, path, settings, out)
    if name == "robustness":
        draw_heat_map(result, out.with_suffix(".png"))
    print(study.show(result))


if __name__ == "__main__":
    sys.exit(main())

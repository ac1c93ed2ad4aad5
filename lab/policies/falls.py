"""Compares answers to a fall: sit down, damp at once, or damp after the fall.

python -m lab.policies.falls policies/stand_track.onnx policies/sit_down.onnx [episodes]

The same pushes of 0.5 to 1.3 m/s every 3 s for each answer, on robots of the paper's Table II in plain MuJoCo; only
episodes that fall count. Measured from the moment when the robot is about to fall, for the same time.
"""

from __future__ import annotations

import dataclasses
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from mimic.config.play import Randomisation
from mimic.control.damping import damping_command
from mimic.evaluation.contact_recorder import ContactRecorder
from mimic.evaluation.episode import play_episode
from mimic.evaluation.policy import TIMING, command_script
from mimic.geometry import rotation_from_quat
from mimic.jobs.local import run_all
from mimic.policy.runtime import cached_policy
from mimic.records import PHASES
from mimic.robot.description import load_description
from mimic.simulation.plant import SimulatedPlant

PUSHED = dataclasses.replace(Randomisation(), push=(0.5, 1.3), push_interval=3.0)

ANSWERS = ("sit down", "damped", "damped after the fall")

SECONDS = 2.5
"""How long the answer lasts [s]; the loop's own."""


def play(seed: int, answer: str, tracker: str, sit_down: str) -> dict[str, Any] | None:
    """Return how gently a fall went, or None where nothing fell."""
    description = load_description()
    sitter: Any = cached_policy(sit_down)
    limp = SimpleNamespace(
        contract=dataclasses.replace(sitter.contract, kp=0.0), path=Path("damping"), act=lambda seen: np.zeros(12)
    )
    track = command_script(description, 10.0 - TIMING.stand_up - TIMING.blend, np.random.default_rng([seed, 11]))
    recorder = ContactRecorder(description)
    plant = SimulatedPlant(description, ranges=PUSHED, seed=seed, samples=False, observer=recorder)
    policy = cached_policy(tracker)
    responses = {"sit down": sitter, "damped": limp, "damped after the fall": None}
    result = play_episode(plant, policy, track, TIMING, sit_down=responses[answer])
    if result.fell_at is None:
        return None
    state, begin = None, result.fell_at
    if answer == "damped after the fall":  # the loop stops at once
        q = result.log.q[-1]
        for _ in range(round(SECONDS / description.dt)):
            state = plant.step(damping_command(q, description.kd)).state
            q = state.q
        begin -= 0.2  # a fall is detected this much later, in the median
    quat = result.log.quat_WB[-1] if state is None else state.quat_WB
    touchdown = recorder.touchdown(begin)
    belly_down = bool(rotation_from_quat(quat)[2, 2] > 0.8)
    sat = int((result.log.phase == PHASES.index("sit_down")).sum())
    return dataclasses.asdict(touchdown) | {"belly_down": belly_down, "ticks": sat, "seed": seed}


def main() -> None:
    """Print a row for each answer."""
    tracker, sit_down = sys.argv[1:3]
    episodes = int(sys.argv[3]) if len(sys.argv) > 3 else 400
    heads = ("falls", "head", "trunk", "impact [m/s]", "sinking [m/s]", "toes [m/s]", "base [m/s^2]", "belly down")
    print("| answer | " + " | ".join(heads) + " |\n|" + "---|" * (len(heads) + 1))
    for answer in ANSWERS:
        rows = run_all(partial(play, answer=answer, tracker=tracker, sit_down=sit_down), range(1, episodes + 1))
        falls = [r for r in rows if r is not None]

        def share(name: str, falls: list[dict[str, Any]] = falls) -> str:
            return f"{np.mean([r[name] for r in falls]):.0%}"

        def spread(name: str, falls: list[dict[str, Any]] = falls, only: str | None = None) -> str:
            values = [r[name] for r in falls if only is None or r[only]]
            return f"{np.median(values):.2f}, {np.quantile(values, 0.95):.2f}" if values else "-"

        cells = (
            str(len(falls)),
            share("head_touched"),
            share("trunk_touched"),
            spread("impact_speed", only="trunk_touched"),
            spread("sinking_speed"),
            spread("toe_speed"),
            spread("acceleration"),
            share("belly_down"),
        )
        print(f"| {answer} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()

"""Standing up from where a robot without power lies, with motors and grounds that are not the described ones.

python -m lab.policies.limp_starts [robot [starts of each cell]]

Each cell has its own share of the motors' torque and of their speeds (1000: full torque at any speed, as in Unitree's
simulator), and its own friction of the ground. The starts of a cell differ in heading, delay and how the robot sank.
"""

from __future__ import annotations

import re
import shutil
import sys
from collections import Counter
from functools import cache, partial
from itertools import product
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from lab.policies.standing import standing_track
from mimic.config.play import NOMINAL, EffectsSettings, Randomisation
from mimic.control.start import not_crouched
from mimic.evaluation.episode import TIMING, Job, play_episode
from mimic.evaluation.policy import stands_at_end
from mimic.jobs.local import run_all
from mimic.policy.runtime import cached_policy, find_policy
from mimic.records import RobotState, RunLog
from mimic.robot.description import load_description

TORQUES, SPEEDS, FRICTIONS = (0.8, 1.0, 1.2), (0.7, 1.0, 1.3, 2.0, 1000.0), (0.4, 0.8, 1.2)
FULL = 100.0
"""A share of speed beyond this is none of a real motor."""

SECONDS = 4.0
"""With the policy [s]."""

STATE = ("t", "q", "dq", "tau", "quat_WB", "omega_B", "p_WB", "v_WB")

Cell = tuple[float, float, float]


@cache
def variant(robot: str, torque: float, speed: float) -> str:
    """Return the folder of a robot whose motors have these shares of torque and speed."""
    described = load_description(robot)
    folder = Path(mkdtemp()) / robot
    shutil.copytree(described.folder, folder)
    file = folder / described.names.file
    text = file.read_text()
    shares = {"motorconst": 1.0 / speed, "resistance": 1.0 / (speed * torque), "saturation": torque}
    for name, share in shares.items():
        parts = re.split(rf'({name}=")([\d.]+)', text)
        parts[2::3] = [f"{float(number) * share:.8g}" for number in parts[2::3]]
        text = "".join(parts)
    file.write_text(text)
    return str(folder)


def first_state(log: RunLog) -> RobotState:
    """Return the state in which the policy takes over."""
    return RobotState(**{name: getattr(log, name)[0] for name in STATE})


def start(case: tuple[Cell, int], robot: str) -> dict[str, Any]:
    """Let one robot stand up."""
    cell, seed = case
    torque, speed, friction = cell
    effects = EffectsSettings(robot_model=variant(robot, torque, speed))
    policy = cached_policy(str(find_policy("stand_track", robot)), effects.robot_model)
    drawn, given = Randomisation(), (friction, friction)
    own = {name: getattr(drawn, name) for name in ("start_q", "start_height", "heading")}
    ranges = Randomisation(**{**_plain(), **own, "ground_friction": given, "delay": (0.005, 0.02)})
    plant = Job(seed=seed, seconds=SECONDS, ranges=ranges, robot=effects).plant(policy.description)
    result = play_episode(plant, policy, standing_track(policy, SECONDS), TIMING)
    state, d = first_state(result.log), policy.description
    return {
        "cell": cell,
        "refused": bool(not_crouched(state, d)),
        "stood": stands_at_end(result, d),
        "away": float(abs(state.q - d.poses["lie"]).max()),
        "height": float(state.p_WB[2]),
    }


def _plain() -> dict[str, Any]:
    """Return the ranges of the robot as described."""
    return {name: getattr(NOMINAL, name) for name in Randomisation.__dataclass_fields__}


def main() -> int:
    """Print how many of each cell stood up."""
    robot = sys.argv[1] if len(sys.argv) > 1 else "go2"
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 4
    cases = [(cell, seed) for cell in product(TORQUES, SPEEDS, FRICTIONS) for seed in range(count)]
    rows = run_all(partial(start, robot=robot), cases, workers=1)
    stood = Counter(row["cell"] for row in rows if row["stood"])
    for torque, speed in product(TORQUES, SPEEDS):
        shown = ", ".join(f"{stood[torque, speed, friction]}" for friction in FRICTIONS)
        print(f"torque x {torque:g}, speed x {speed:g}: {shown} of {count} at frictions {FRICTIONS}")
    curve = [row for row in rows if row["cell"][1] < FULL]
    alone = [row for row in curve if row["cell"][0] == 1.0 or row["cell"][1] == 1.0]
    for name, some in (("torque or speed", alone), ("torque and speed", curve), ("all", rows)):
        print(f"{name}: {sum(row['stood'] for row in some)} of {len(some)}")
    away, height = max(row["away"] for row in rows), min(row["height"] for row in rows)
    print(f"at the hand-over {away:.3f} rad, {height:.3f} m, refused {sum(row['refused'] for row in rows)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

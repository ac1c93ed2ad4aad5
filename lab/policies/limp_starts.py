"""Standing up from where the physics lets a robot without power lie, with motors and grounds that are not the described ones.

python -m lab.policies.limp_starts [robot [starts of each cell]]

Each cell has its own share of the motors' torque, of their speeds (infinite: full torque at any speed, as in Unitree's
simulator) and its own friction of the ground; the starts of a cell differ in joints, heading and delay.
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

from mimic.config.play import EffectsSettings, Randomisation
from mimic.control.start import not_crouched
from mimic.control.plant import Plant
from mimic.evaluation.episode import Job, play_episode, TIMING
from mimic.evaluation.policy import standing_track, stands_at_end
from mimic.jobs.local import run_all
from mimic.metrics import stand_up_time
from mimic.policy.runtime import cached_policy, find_policy
from mimic.records import RobotState
from mimic.robot.description import load_description

TORQUES, SPEEDS, FRICTIONS = (0.8, 1.0, 1.2), (0.7, 1.0, 1.3, 2.0, 1000.0), (0.4, 0.8, 1.2)
SECONDS = 4.0
"""With the policy [s]."""


@cache
def variant(robot: str, torque: float, speed: float) -> str:
    """Return the folder of a robot whose motors have these shares of torque and speed."""
    folder = Path(mkdtemp()) / robot
    shutil.copytree(load_description(robot).folder, folder)
    file = folder / load_description(robot).names.file
    text = file.read_text()
    for name, share in (("motorconst", 1.0 / speed), ("resistance", 1.0 / (speed * torque)), ("saturation", torque)):
        text = re.sub(rf'{name}="([\d.]+)"', lambda found, s=share: f'{found[0].split("=")[0]}="{float(found[1]) * s:.8g}"', text)
    file.write_text(text)
    return str(folder)


def start(cell: tuple[float, float, float, int], robot: str) -> dict[str, Any]:
    """Let one robot stand up."""
    torque, speed, friction, seed = cell
    effects = EffectsSettings(robot_model=variant(robot, torque, speed))
    policy = cached_policy(str(find_policy("stand_track", robot)), effects.robot_model)
    ranges = Randomisation(
        **{name: (1.0, 1.0) for name in ("dry_friction", "viscous_friction", "kp", "kd")},
        **{name: (0.0, 0.0) for name in ("base_mass", "abad_mass", "hip_mass", "knee_mass", "toe_mass", "com", "push")},
        ground_friction=(friction, friction),
        restitution=(0.1, 0.1),
        delay=(0.005, 0.02),
    )
    plant = Job(seed=seed, seconds=SECONDS, ranges=ranges, robot=effects).plant(policy.description)
    states: list[RobotState] = []
    result = play_episode(plant, policy, standing_track(policy, SECONDS), TIMING)
    log, d = result.log, policy.description
    first = RobotState(**{name: getattr(log, name)[0] for name in ("t", "q", "dq", "tau", "quat_WB", "omega_B", "p_WB", "v_WB")})
    return {
        "cell": cell,
        "crouched": not_crouched(first, d),
        "stood": stands_at_end(result, d),
        "away": float(abs(first.q - d.poses["lie"]).max()),
        "height": float(first.p_WB[2]),
        "seconds": stand_up_time(log, d),
    }


def main() -> int:
    """Print how many of each cell stood up."""
    robot = sys.argv[1] if len(sys.argv) > 1 else "go2"
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 4
    cells = [(*cell, seed) for cell in product(TORQUES, SPEEDS, FRICTIONS) for seed in range(count)]
    rows = run_all(partial(start, robot=robot), cells, workers=1)
    stood, refused = Counter(row["cell"][:3] for row in rows if row["stood"]), Counter(row["cell"][:3] for row in rows if row["crouched"])
    for torque, speed in product(TORQUES, SPEEDS):
        shown = [f"{stood[torque, speed, f]}/{count}" + (f" ({refused[torque, speed, f]} refused)" if refused[torque, speed, f] else "") for f in FRICTIONS]
        print(f"torque x {torque:g}, speed x {speed:g}: {', '.join(shown)} at friction {FRICTIONS}")
    described = [row for row in rows if row["cell"][1] < 100.0]
    print(f"{sum(r['stood'] for r in described)} of {len(described)} with the curve, {sum(r['stood'] for r in rows)} of {len(rows)} in all")
    print(f"farthest joint {max(r['away'] for r in rows):.3f} rad, lowest base {min(r['height'] for r in rows):.3f} m, refused {sum(bool(r['crouched']) for r in rows)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

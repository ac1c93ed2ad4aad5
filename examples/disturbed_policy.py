"""Evaluate a policy on disturbed robots: how does a load on one toe change the toe error?

python examples/disturbed_policy.py [POLICY]
"""

import sys
from pathlib import Path

import mimic
from mimic.simulation.plant import SimulatedPlant

MOTION = Path(__file__).parent / "motions" / "step_and_wave.yaml"


def main(policy: str | None = None, payloads: tuple[float, ...] = (0.0, 0.5, 1.0)) -> None:
    robot = mimic.load_robot()
    motion = mimic.load_motion(MOTION)
    print("load [kg]  toe error [cm]  fell at [s]")
    for payload in payloads:
        plant = SimulatedPlant(robot, seed=1, payloads={"FL": payload})
        run = mimic.play(motion, plant=plant, policy=policy)
        fell = run.metrics["fell_at_s"]
        print(
            f"{payload:9.1f}  {run.metrics['toe_error_cm']['left']:14.1f}  {'-' if fell is None else f'{fell:.1f}':>11}"
        )


if __name__ == "__main__":
    main(*sys.argv[1:])

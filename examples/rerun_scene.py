"""Record a Rerun scene of a run with entities of your own beside the robot.

    python examples/rerun_scene.py [scene.rrd]

Open it with `rerun scene.rrd`.
"""

import sys
from pathlib import Path

import numpy as np
import rerun as rr

import mimic
from mimic.view.scene.layout import time_column
from mimic.view.scene.robot_drawing import draw_robot
from mimic.view.scene.timing import shared_time

MOTION = Path(__file__).parent / "motions" / "step_and_wave.yaml"


def main(out: str | Path = "scene.rrd") -> None:
    run = mimic.play(mimic.load_motion(MOTION))
    log, t = run.complete_log, shared_time(run.complete_log)
    with rr.RecordingStream("mimic_example") as scene:
        scene.save(out)
        draw_robot(scene, log, run.description)

        # Your own entities: the path of the base on the ground, and the power of all motors.
        path = np.column_stack([log.p_WB[:, :2], np.zeros(len(t))])
        scene.log("robot/base_path", rr.LineStrips3D([path], radii=0.005, colors=[255, 160, 0]), static=True)
        power = np.sum(log.tau * log.dq, axis=1)
        scene.send_columns("power", indexes=[time_column(t)], columns=rr.Scalars.columns(scalars=power))
    print(f"{out}: {len(t)} ticks, mean power {power.mean():.0f} W")


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Play a motion in simulation and plot how well the toes follow their targets.

python examples/play_and_plot.py [MOTION] [toes.png]
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import mimic

MOTION = Path(__file__).parent / "motions" / "step_and_wave.yaml"


def main(motion: str | Path = MOTION, out: str | Path = "toes.png") -> None:
    run = mimic.play(mimic.load_motion(motion))
    error = run.metrics["toe_error_cm"]
    print(f"stood up in {run.metrics['stand_up_s']:.2f} s, toe error {error['mean']:.1f} cm on average")

    log = run.complete_log
    figure, axes = plt.subplots(3, sharex=True, figsize=(8, 6))
    for row, axis in enumerate("xyz"):
        axes[row].plot(log.t, log.p_BE_des[:, 0, row], label="target")
        axes[row].plot(log.t, log.p_BE[:, 0, row], label="left toe")
        axes[row].set_ylabel(f"{axis} [m]")
    axes[0].legend()
    axes[-1].set_xlabel("time [s]")
    figure.savefig(out)


if __name__ == "__main__":
    main(*sys.argv[1:])

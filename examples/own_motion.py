"""Play a motion of your own: wrist positions in an array.

    python examples/own_motion.py

Both hands draw circles in front of the shoulders. Positions are in arm lengths, so no size of a person or robot is
needed; `retarget` scales them into the robot's workspace.
"""

import numpy as np

import mimic

SECONDS, RATE_HZ, LEFT, RIGHT = 6.0, 30.0, 0, 1


def circles() -> mimic.WristTrack:
    """Return hands that circle once in two seconds, in opposite phase."""
    t = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    p_SH = np.zeros((len(t), 2, 3))  # shoulder to wrist; torso axes: x forward, y left, z up
    for side, phase in ((LEFT, 0.0), (RIGHT, np.pi)):
        angle = np.pi * t + phase
        p_SH[:, side] = np.stack([0.6 + 0 * t, 0.2 * np.cos(angle), 0.3 * np.sin(angle)], axis=-1)
    return mimic.WristTrack(t=t, p_SH=p_SH, heading=np.zeros(len(t)), valid=np.ones((len(t), 2), dtype=bool))


def main() -> None:
    targets = mimic.retarget(circles())
    run = mimic.play(targets)
    print(f"largest shift by clamping: {100 * targets.moved.max():.1f} cm")
    print(f"toe error: {run.metrics['toe_error_cm']['mean']:.1f} cm, falls: {run.metrics['falls']}")


if __name__ == "__main__":
    main()

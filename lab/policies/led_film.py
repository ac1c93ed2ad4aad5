"""Lead a simulated robot by its left front toe: it follows the hand, and stops when it is let go.

python -m lab.policies.led_film [DIRECTION [WAY [FILM]]]
"""

import sys
from pathlib import Path

import numpy as np

import mimic
from lab.policies.hand import Hand, HandSettings
from lab.policies.leading import lead_figures, lead_robot
from mimic.config.leading import LeadingSettings
from mimic.evaluation.episode import OF_EPISODES
from mimic.simulation.plant import SimulatedPlant


def main(direction: str = "30", way: str = "2", film: str | None = None) -> None:
    robot = mimic.load_robot()
    settings = HandSettings(direction=float(direction), way=float(way))
    plant = SimulatedPlant(robot, **OF_EPISODES)
    hand = Hand(plant.model, settings)
    plant.watch(hand)
    run = lead_robot(plant, mimic.load_policy(), LeadingSettings(), seconds=settings.end + settings.after)
    print(lead_figures(run, hand, settings))
    if film is not None:
        from mimic.view.film.side_by_side import save_video

        rows = np.clip(np.searchsorted(hand.t, run.log.t), 0, len(hand.t) - 1)
        held = (run.log.t >= settings.begin) & (run.log.t < settings.end)
        pull = [np.where(held[:, None], np.array(values)[rows], 0.0) for values in (hand.at, hand.force)]
        save_video(Path(film), log=run.log, description=robot, pull=tuple(pull))


if __name__ == "__main__":
    main(*sys.argv[1:])

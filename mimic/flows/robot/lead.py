"""Leading a simulated robot by the hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.leading import HandSettings, LeadingSettings
from mimic.config.play import AS_DESCRIBED, EffectsSettings
from mimic.config.ranges import check_range
from mimic.flows.play import load_robot, warn_of_stand_effects
from mimic.flows.reporter import Reporter, reporting
from mimic.frozen import frozen_arrays
from mimic.io import store
from mimic.records import RunLog


@frozen_arrays
class Led:
    """How a robot was led."""

    figures: dict[str, Any]
    """Way, pull, and whether it followed and stopped."""
    log: RunLog
    fell_at: float | None
    """When it fell [s]."""


def lead(
    hand: HandSettings | None = None,
    leading: LeadingSettings | None = None,
    *,
    policy: str | Path | None = None,
    robot: EffectsSettings = AS_DESCRIBED,
    seed: int = 0,
    film: Path | None = None,
    reporter: Reporter | None = None,
) -> Led:
    """Stand a simulated robot up and lead it by a front toe.

    Args:
        hand: The scripted hand.
        leading: How the robot answers a pull.
        policy: ONNX file, or the name of a shipped policy; by default stand_track.
        robot: Which robot is simulated.
        seed: Of the start.
        film: Also write a film in which the pull is drawn (.mp4).
        reporter: Receives warnings and progress.

    Raises:
        AssetError, ContractError: If the policy cannot be run on this robot.
        ConfigError: If the effects cannot be used.
        NoOffscreenGL: If there is no off-screen rendering for the film.
    """
    from mimic.evaluation.episode import OF_EPISODES
    from mimic.evaluation.leading import lead_figures, lead_robot
    from mimic.policy.runtime import load_policy
    from mimic.simulation.hand import Hand
    from mimic.simulation.plant import SimulatedPlant, plant_options

    check_range("seed", seed, 0, 2**63)
    reporter = reporting(reporter)
    hand = hand or HandSettings()
    leading = leading or LeadingSettings()
    warn_of_stand_effects(robot, reporter)
    description = load_robot(robot.robot_model)
    player = load_policy(policy, description)
    if film is not None:
        store.check_file(film)
    plant = SimulatedPlant(description, seed=seed, **OF_EPISODES, **plant_options(robot))
    pull = Hand(plant.model, hand)
    end = hand.end + hand.after
    with reporter.progress("ticks") as progress:
        total = round(end / description.dt)
        done = 0

        def follow(tick: object) -> bool:
            nonlocal done
            done += 1
            progress(min(done, total), total)
            return True

        plant.watch(pull)
        result = lead_robot(plant, player, leading, seconds=end, follow=follow)
    if result.interrupted:
        raise KeyboardInterrupt
    if film is not None:
        from mimic.view.film.side_by_side import save_video

        rows = np.clip(np.searchsorted(pull.t, result.log.t), 0, max(len(pull.t) - 1, 0))
        held = (result.log.t >= hand.begin) & (result.log.t < hand.end)
        at, force = (np.where(held[:, None], np.array([*v, np.zeros(3)])[rows], 0.0) for v in (pull.at, pull.force))
        save_video(film, log=result.log, description=description, pull=(at, force))
    return Led(figures=lead_figures(result, pull, hand), log=result.log, fell_at=result.fell_at)

"""Leading a simulated robot by the hand: a scripted hand, or the mouse."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.leading import HandSettings, LeadingSettings
from mimic.config.play import AS_DESCRIBED, EffectsSettings
from mimic.errors import MimicError
from mimic.flows.play import load_robot, warn_of_stand_effects
from mimic.flows.reporter import Reporter, reporting
from mimic.io import store
from mimic.records import RunLog

MOST_BY_MOUSE = 15.0
"""The mouse pulls no harder than this [N]."""


class NoViewer(MimicError):
    """The live viewer needs a display."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Led:
    """How a robot was led."""

    figures: dict[str, Any]
    """Way, pull, and whether it followed and stopped; empty for the mouse."""
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
    interactive: bool = False,
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
        interactive: Open MuJoCo's viewer, in which the mouse pulls; ends when it is closed.
        reporter: Receives warnings and progress.

    Raises:
        AssetError, ContractError: If the policy cannot be run on this robot.
        ConfigError: If the effects cannot be used.
        NoViewer: If there is no display for the viewer.
        NoOffscreenGL: If there is no off-screen rendering for the film.
    """
    from mimic.evaluation.episode import OF_EPISODES
    from mimic.evaluation.leading import lead_figures, lead_robot
    from mimic.policy.runtime import load_policy
    from mimic.simulation.hand import Hand
    from mimic.simulation.plant import SimulatedPlant, plant_options

    reporter = reporting(reporter)
    hand = hand or HandSettings()
    leading = leading or LeadingSettings()
    warn_of_stand_effects(robot, reporter)
    description = load_robot(robot.robot_model)
    player = load_policy(policy, description)
    if film is not None:
        store.check_writable(film.parent)
    plant = SimulatedPlant(description, seed=seed, **OF_EPISODES, **plant_options(robot))
    if interactive:
        result = _by_mouse(plant, player, leading)
        return Led(figures={}, log=result.log, fell_at=result.fell_at)
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


def _by_mouse(plant: Any, policy: Any, leading: LeadingSettings) -> Any:
    """Play in real time in MuJoCo's viewer, until it is closed."""
    import mujoco
    import mujoco.viewer

    from mimic.evaluation.leading import lead_robot
    from mimic.robot.model import BASE
    from mimic.view.scene.viewer import display_available

    if not display_available():  # MuJoCo would end the process
        raise NoViewer("there is no display; --interactive opens MuJoCo's viewer and needs one")
    try:
        viewer = mujoco.viewer.launch_passive(plant.model, plant.data, show_left_ui=False, show_right_ui=False)
    except RuntimeError as reason:
        raise NoViewer(f"MuJoCo's viewer does not open: {reason}; on macOS run mimic with mjpython") from None

    def pull(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.xfrc_applied[:] = 0.0
        with viewer.lock():
            mujoco.mjv_applyPerturbForce(model, data, viewer.perturb)
        strongest = float(np.linalg.norm(data.xfrc_applied[:, :3], axis=1).max())
        data.xfrc_applied[:] *= min(1.0, MOST_BY_MOUSE / max(strongest, 1e-9))

    viewer.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    viewer.cam.trackbodyid = plant.model.body(BASE).id
    viewer.cam.distance = 1.8
    viewer.cam.elevation = -12.0
    viewer.cam.azimuth = 150.0
    viewer.opt.geomgroup[:] = 1  # it has collision shapes only
    begin = time.monotonic()

    def follow(tick: Any) -> bool:
        viewer.sync()
        time.sleep(max(0.0, begin + tick.state.t - time.monotonic()))
        return bool(viewer.is_running())

    with viewer:
        plant.watch(pull)
        return lead_robot(plant, policy, leading, follow=follow)

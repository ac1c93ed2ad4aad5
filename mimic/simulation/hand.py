"""A simulated hand that takes a front toe, walks off with it, and lets go."""

from __future__ import annotations

import mujoco
import numpy as np

from mimic.config.leading import HandSettings
from mimic.geometry import heading_from_quat
from mimic.records import SIDES, FloatArray
from mimic.robot.model import TOES


class Hand:
    """Pulls like a spring that slips at its strongest pull; an observer for `SimulatedPlant.watch`."""

    def __init__(self, model: mujoco.MjModel, settings: HandSettings) -> None:
        """Prepare for a robot that stands at ``settings.begin``."""
        self._settings = settings
        self._site = model.site(TOES[SIDES.index(settings.toe)]).id
        self._body = int(model.site_bodyid[self._site])
        self._from: FloatArray | None = None
        self.unit = np.zeros(3)
        """Direction in which it goes, world axes (3,)."""
        self.t: list[float] = []
        """Times at which it pulled [s]."""
        self.at: list[FloatArray] = []
        """Where the toe was then, world axes (3,) [m]."""
        self.force: list[FloatArray] = []
        """Pull at these times, world axes (3,) [N]."""
        self.behind: list[float] = []
        """How far the toe was from the hand [m]."""

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Set the force for the next physics step."""
        s = self._settings
        data.xfrc_applied[self._body] = 0.0
        if not s.begin <= data.time < s.end:
            return
        toe = data.site_xpos[self._site]
        if self._from is None:
            self._from = toe.copy()
            angle = float(heading_from_quat(data.qpos[3:7])) + np.deg2rad(s.direction)
            self.unit = np.array([np.cos(angle), np.sin(angle), 0.0])
        away = self._from + self.unit * s.speed * (data.time - s.begin) - toe
        away[2] = 0.0  # it follows the toe up and down
        distance = float(np.linalg.norm(away))
        force = away * min(s.stiffness, s.most / max(distance, 1e-9))
        data.xfrc_applied[self._body, :3] = force
        data.xfrc_applied[self._body, 3:] = np.cross(toe - data.xipos[self._body], force)
        self.t.append(float(data.time))
        self.at.append(toe.copy())
        self.force.append(force)
        self.behind.append(distance)

"""Being led by the hand: a pull on a front toe becomes a walk in its direction.

The pull is estimated from the torques of the front legs: what they give beyond holding up their own weight. An
admittance turns it into commands: the stronger the pull forward or back, the faster the walk, and the robot turns
towards where it is pulled. When the hand lets go, it stops. The policy itself knows nothing of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from mimic.config.leading import HandSettings, LeadingSettings
from mimic.control.loop import RunResult, run_policy
from mimic.control.plant import Plant
from mimic.control.safety.safety_rules import FALLEN
from mimic.control.safety.supervisor import Supervisor
from mimic.evaluation.episode import TIMING, of_episode, without_start
from mimic.geometry import heading_from_quat, wrap_angle
from mimic.policy.leading import MOST_AHEAD, answer_to_pull
from mimic.policy.runtime import Policy
from mimic.records import Command, FloatArray, Tick
from mimic.robot.description import RobotDescription
from mimic.robot.pull import PullEstimator
from mimic.simulation.hand import Hand

STOPS_WITHIN = 1.0
"""A robot that is let go should stand still from here on [s]."""

FOLLOWS = 0.3
"""It has followed if its toe is at most this far behind the hand when that lets go [m]."""

STANDS_STILL = 0.08
"""It has stopped if its mean velocity is at most this [m/s]: stepping in place it may sway and drift."""


class HandLeading:
    """Commands of a robot that is led by the hand, for `run_policy`; give it `see` as the sink."""

    def __init__(
        self,
        description: RobotDescription,
        toes: FloatArray,
        settings: LeadingSettings,
        *,
        seconds: float = math.inf,
    ) -> None:
        """Hold out the front toes.

        Args:
            description: The robot.
            toes: Base -> front toe (2, 3), base axes [m].
            settings: How it answers a pull.
            seconds: How long it may be led [s].
        """
        self._estimator = PullEstimator(description)
        self._toes = toes
        self._settings = settings
        self._dt = description.dt
        self._left = seconds
        self._pulls = np.zeros((2, 3))
        self._began: float | None = None
        self._now = 0.0
        self._turned = 0.0

    @property
    def pull(self) -> FloatArray:
        """Smoothed pull on the toe that is pulled harder (3,), world axes [N]."""
        return self._pulls[int(np.argmax(np.linalg.norm(self._pulls[:, :2], axis=1)))]

    def see(self, tick: Tick) -> None:
        """Take the state after a control step."""
        share = self._dt / (self._settings.smoothing + self._dt)
        self._pulls += share * (self._estimator.force(tick.state) - self._pulls)
        self._now = float(heading_from_quat(tick.state.quat_WB))
        if self._began is None:
            self._began = self._now

    def stop(self) -> None:
        """Let the motion end."""
        self._left = 0.0

    def newest(self) -> Command | None:
        """Return what the pull asks for; None when the time is over."""
        self._left -= self._dt
        if self._left < 0:
            return None
        forward, left = turned(self.pull[:2], -self._now)
        speed, rate, share = answer_to_pull(forward, left, self._settings, np)
        if share > 0:
            self._turned += float(rate) * self._dt
            behind = float(wrap_angle(self._now - (self._began or 0.0) - self._turned))
            self._turned += behind - float(np.clip(behind, -MOST_AHEAD, MOST_AHEAD))
        return Command(v=np.array([float(speed), 0.0]), heading=self._turned, p_BE=self._toes)


def turned(vector: FloatArray, angle: float) -> tuple[float, float]:
    """Return a horizontal vector (2,) turned to the left by an angle [rad]."""
    c = math.cos(angle)
    s = math.sin(angle)
    return float(c * vector[0] - s * vector[1]), float(s * vector[0] + c * vector[1])


def lead_robot(
    plant: Plant,
    policy: Policy,
    settings: LeadingSettings,
    *,
    seconds: float = math.inf,
    follow: Callable[[Tick], bool] | None = None,
) -> RunResult:
    """Let a simulated robot stand up and be led, until it falls or the time is over.

    Args:
        plant: The robot; whatever pulls it acts on it by itself.
        policy: Stands and walks.
        settings: How the robot answers.
        seconds: Length of the run [s].
        follow: Called with every tick; False ends the run.

    Raises:
        ContractError: If the policy does not fit.
        PlantError: If the simulation is no longer finite.
        Exception: Whatever else fails.
    """
    neutral = np.array(policy.contract.neutral_toes).reshape(2, 3)
    leading = HandLeading(plant.description, neutral, settings, seconds=seconds - TIMING.stand_up)

    def see(tick: Tick) -> None:
        leading.see(tick)
        if follow is not None and not follow(tick):
            leading.stop()

    safety = of_episode(Supervisor(plant.description, rules=(FALLEN,)))
    timing = replace(TIMING, lean_against_pulls=False)  # it walks along instead
    result = run_policy(plant, policy, leading, timing, sink=see, safety=safety)
    if result.error is not None:
        raise result.error
    return without_start(result)


def lead_figures(result: RunResult, hand: Hand, settings: HandSettings) -> dict[str, Any]:
    """Return how a robot was led: way and pull while it was, speed when it was let go."""
    log = result.log
    force = np.linalg.norm(hand.force, axis=1) if hand.force else np.zeros(1)
    held = log.t[(log.t >= settings.begin) & (log.t < settings.end)]
    figures: dict[str, Any] = {
        "direction_deg": settings.direction,
        "toe": settings.toe,
        "fell_at_s": result.fell_at,
        "pull_mean_n": float(force.mean()),
        "pull_max_n": float(force.max()),
    }
    if result.fell_at is not None or len(held) < 2:
        return figures | {"followed": False, "stopped": False}
    first, last = np.searchsorted(log.t, held[[0, -1]])
    way = float((log.p_WB[last] - log.p_WB[first]) @ hand.unit)
    after = np.flatnonzero(log.t > settings.end + STOPS_WITHIN)
    passed = log.p_WB[after[-1], :2] - log.p_WB[after[0], :2]
    speed = float(np.linalg.norm(passed) / (log.t[after[-1]] - log.t[after[0]]))
    return figures | {
        "way_m": way,
        "behind_m": hand.behind[-1],
        "speed_after_m_s": speed,
        "followed": hand.behind[-1] <= FOLLOWS,
        "stopped": speed <= STANDS_STILL,
    }

"""What each world is asked for over time: toe goals, velocity and heading. Element-wise over static buffers."""

from __future__ import annotations

import math

import numpy as np
import torch

from mimic.config.leading import LeadingSettings
from mimic.config.training import MdpSettings
from mimic.geometry import smoothstep
from mimic.policy.contract import PolicyContract
from mimic.policy.leading import MOST_AHEAD, answer_to_pull
from mimic.robot.description import RobotDescription
from mimic.robot.goals import draw_goals
from mimic.train.tensors import Chance, in_heading_frame, put

POOL = 20_000
"""Reachable goal pairs drawn once for a training."""

ANYWHERE = 0.35
"""Share of them drawn over the whole reachable set instead of the paper's boxes."""

GOAL_SECONDS = (0.1, 3.0)
"""Time between two toe goals [s], log-uniform."""

PAPER_GOAL_SECONDS, PAPER_GOAL_SHARE = 3.0, 0.35
"""Time between two goals in the paper [s], and share of goals that take it, on a straight line."""

GOAL_SPEED = 2.0
"""Fastest mean speed of a toe goal [m/s]."""

FAST_SHARE = 0.5
"""Share of velocities drawn evenly up to the fastest; the others are the paper's 0.1, 0.2 and 0.3 m/s."""

TURNING_SHARE = 0.4
"""Share of heading commands that turn steadily; the others jump by up to 90 degrees, as the paper's."""

TURN_RATE = 1.2
"""Fastest steady turn [rad/s]."""

FIRST_COMMAND = 1.04
"""The first command comes no earlier than this [s]: just after standing up."""

SETTLES = 2.0
"""A robot that is asked to stand has turned to its heading by this time [s]."""


class GoalSchedule(Chance):
    """Front-toe goals: neutral while standing up, then from goal to goal, some slow and straight, some fast."""

    def __init__(
        self, description: RobotDescription, contract: PolicyContract, settings: MdpSettings, device: str, seed: int
    ) -> None:
        super().__init__(settings.worlds, device)
        self._hold_share, self._dt = settings.hold_share, contract.dt
        rng = np.random.default_rng([seed, 29])
        self._pool = self._tensor(draw_goals(description, POOL, rng, anywhere=ANYWHERE))
        self._neutral = self._tensor(contract.neutral_toes).reshape(2, 3)
        self.now = self._zeros(2, 3)
        """Desired base -> front toe (worlds, 2, 3) [m]."""
        self._begin, self._end = torch.zeros_like(self.now), torch.zeros_like(self.now)
        self._time, self._straight, self._length = self._zeros(), self._zeros(), self._zeros() + 1.0

    def advance(self, tracking: torch.Tensor, first: torch.Tensor, toes: torch.Tensor) -> None:
        """Let one control step pass.

        Args:
            tracking: True where goals count (N,).
            first: True where they count from this step on; the path then begins at the measured toes (N,).
            toes: Measured base -> front toe (N, 2, 3) [m].
        """
        self._time.add_(self._dt)
        due = ((self._time >= self._length) | first) & tracking
        start = torch.where(first[:, None, None], toes, self._end)
        goal = self._pool[torch.randint(0, len(self._pool), (self._n,), device=self._device)]
        goal = torch.where((self._rand() < self._hold_share)[:, None, None], start, goal)
        low, high = (math.log(v) for v in GOAL_SECONDS)
        straight = self._rand() < PAPER_GOAL_SHARE
        length = torch.where(straight, PAPER_GOAL_SECONDS, torch.exp(self._uniform(low, high)))
        far = (goal - start).norm(dim=-1).amax(-1)
        shrink = torch.clamp(GOAL_SPEED * length / far.clamp(min=1e-6), max=1.0)[:, None, None]
        put(self._begin, due, start)
        put(self._end, due, start + (goal - start) * shrink)
        put(self._length, due, length)
        put(self._straight, due, straight.float())
        put(self._time, due, 0.0)
        share = torch.clamp(self._time / self._length, 0, 1)
        share = torch.where(self._straight > 0, share, smoothstep(share))[:, None, None]
        path = self._begin + share * (self._end - self._begin)
        self.now.copy_(torch.where(tracking[:, None, None], path, self._neutral))

    def reset(self, mask: torch.Tensor, upright: torch.Tensor, toes: torch.Tensor) -> None:
        """Begin anew where ``mask``: at the measured toes of worlds that start upright, else at neutral."""
        begin = torch.where(upright[:, None, None], toes, self._neutral)
        for goal in (self._begin, self._end, self.now):
            put(goal, mask, begin)
        put(self._time, mask, 0.0)
        put(self._length, mask, self._uniform(0.1, 0.5))


class MoveSchedule(Chance):
    """Velocity and heading commands, drawn anew every few seconds."""

    def __init__(self, contract: PolicyContract, settings: MdpSettings, device: str) -> None:
        super().__init__(settings.worlds, device)
        self._settings, self._dt = settings, contract.dt
        self.velocity = self._zeros(2)
        """Desired base velocity in the heading frame (N, 2) [m/s]."""
        self.heading = self._zeros()
        """Desired heading, world (N,) [rad]."""
        self.wanted = self._zeros(2)
        """Velocity that the robot is judged by: the desired one, and sideways that of the hand that leads it (N, 2)."""
        self._felt = self._zeros(2)
        self._rate, self._left, self._since = (self._zeros() for _ in range(3))

    @property
    def settled(self) -> torch.Tensor:
        """True where a robot has been asked to stand for so long that it should (N,)."""
        stands = (self.velocity == 0.0).all(-1) & (self._rate == 0.0)
        return stands & (self._since > SETTLES)

    def advance(self) -> None:
        """Let one control step pass."""
        s = self._settings
        self._left.sub_(self._dt)
        self._since.add_(self._dt)
        due = self._left <= 0
        put(self._left, due, self._uniform(*s.command_seconds))
        put(self._since, due, 0.0)
        stands = self._rand() < s.stand_share
        speed = torch.randint(1, 4, (self._n,), device=self._device) * 0.1
        speed = torch.where(self._rand() < FAST_SHARE, s.fastest * self._rand(), speed)
        speed = torch.where(self._rand() < 0.5, speed, -speed)
        speed = torch.where(stands | (self._rand() < s.still_share), 0.0, speed)
        put(self.velocity, due, torch.stack([speed, torch.zeros_like(speed)], -1))
        keeps = stands | (self._rand() < s.still_share)
        jumps = self._rand() >= TURNING_SHARE
        turn = torch.where(keeps | ~jumps, 0.0, math.pi * (self._rand() - 0.5))
        put(self._rate, due, torch.where(keeps | jumps, 0.0, TURN_RATE * (2 * self._rand() - 1)))
        put(self.heading, due, self.heading + turn)
        self.heading.add_(self._rate * self._dt)
        self.wanted.copy_(self.velocity)

    def lead(self, led: torch.Tensor, pull: torch.Tensor, hand: torch.Tensor, heading: torch.Tensor) -> None:
        """Let a pull say what is asked, as it does when the robot is led by the hand (mimic.evaluation.leading).

        Args:
            led: True where it does, until the end of the episode (N,).
            pull: Pull on the toe now, world axes (N, 2) [N].
            hand: Velocity of the hand, world axes (N, 2) [m/s].
            heading: Heading of the robot (N,) [rad].
        """
        s = LeadingSettings()
        self._felt.add_((pull - self._felt) * (self._dt / (s.smoothing + self._dt)) * led[:, None])
        forward, left = in_heading_frame(self._felt, heading).unbind(-1)
        speed, rate, share = answer_to_pull(forward, left, s, torch)
        put(self.velocity, led, torch.stack([speed, torch.zeros_like(speed)], -1))
        sideways = share * in_heading_frame(hand, heading)[:, 1]
        self.wanted.copy_(torch.where(led[:, None], torch.stack([speed, sideways], -1), self.velocity))
        put(self._rate, led, rate)
        ahead = torch.arctan2(torch.sin(self.heading - heading), torch.cos(self.heading - heading))
        put(self.heading, led & (share > 0), heading + ahead.clamp(-MOST_AHEAD, MOST_AHEAD))
        put(self._since, led & (share > 0), 0.0)
        put(self._left, led, self._settings.command_seconds[1])

    def reset(self, mask: torch.Tensor, heading: torch.Tensor) -> None:
        """Stand still at this heading (N,) [rad] where ``mask``."""
        put(self.heading, mask, heading)
        for buffer in (self.velocity, self.wanted, self._felt, self._rate, self._since):
            put(buffer, mask, 0.0)
        put(self._left, mask, self._uniform(FIRST_COMMAND, self._settings.command_seconds[1]))

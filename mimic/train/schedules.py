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

POOL = 20_000
"""Reachable goal pairs drawn once for a training."""

PAPER_GOAL_SECONDS = 3.0
"""Time between two goals in the paper [s]."""


LEADING = LeadingSettings()
"""How a robot that is led answers a pull."""


class GoalSchedule:
    """Front-toe goals: neutral while standing up, then from goal to goal, some slow and straight, some fast."""

    def __init__(
        self, description: RobotDescription, contract: PolicyContract, settings: MdpSettings, device: str, seed: int
    ) -> None:
        n = settings.worlds
        self._settings, self._dt = settings, contract.dt
        rng = np.random.default_rng([seed, 29])
        pool = draw_goals(description, POOL, rng, anywhere=settings.goals_anywhere)
        self._pool = torch.as_tensor(pool, dtype=torch.float32, device=device)
        self._neutral = torch.tensor(contract.neutral_toes, dtype=torch.float32, device=device).reshape(2, 3)
        self.now = torch.zeros(n, 2, 3, device=device)
        """Desired base -> front toe (worlds, 2, 3) [m]."""
        self._begin, self._end = torch.zeros_like(self.now), torch.zeros_like(self.now)
        self._time, self._length = torch.zeros(n, device=device), torch.ones(n, device=device)
        self._straight = torch.zeros(n, device=device)

    def advance(self, tracking: torch.Tensor, first: torch.Tensor, toes: torch.Tensor) -> None:
        """Let one control step pass.

        Args:
            tracking: True where goals count (N,).
            first: True where they count from this step on; the path then begins at the measured toes (N,).
            toes: Measured base -> front toe (N, 2, 3) [m].
        """
        s, n = self._settings, len(self._time)
        self._time.add_(self._dt)
        due = ((self._time >= self._length) | first) & tracking
        start = torch.where(first[:, None, None], toes, self._end)
        goal = self._pool[torch.randint(0, len(self._pool), (n,), device=toes.device)]
        goal = torch.where((self._rand() < s.hold_share)[:, None, None], start, goal)
        low, high = (math.log(v) for v in s.goal_seconds)
        straight = self._rand() < s.paper_goal_share
        length = torch.exp(low + (high - low) * self._rand())
        length = torch.where(straight, torch.full_like(length, PAPER_GOAL_SECONDS), length)
        far = (goal - start).norm(dim=-1).amax(-1)
        shrink = torch.clamp(s.goal_speed * length / far.clamp(min=1e-6), max=1.0)[:, None, None]
        goal = start + (goal - start) * shrink
        wide = due[:, None, None]
        self._begin.copy_(torch.where(wide, start, self._begin))
        self._end.copy_(torch.where(wide, goal, self._end))
        self._length.copy_(torch.where(due, length, self._length))
        self._straight.copy_(torch.where(due, straight.float(), self._straight))
        self._time.copy_(torch.where(due, torch.zeros_like(self._time), self._time))
        share = torch.clamp(self._time / self._length, 0, 1)
        smooth = smoothstep(share)
        share = torch.where(self._straight > 0, share, smooth)[:, None, None]
        path = self._begin + share * (self._end - self._begin)
        self.now.copy_(torch.where(tracking[:, None, None], path, self._neutral.expand_as(path)))

    def reset(self, mask: torch.Tensor, upright: torch.Tensor, toes: torch.Tensor) -> None:
        """Begin anew where ``mask``: at the measured toes of worlds that start upright, else at neutral."""
        begin = torch.where(upright[:, None, None], toes, self._neutral.expand_as(toes))
        for goal in (self._begin, self._end, self.now):
            goal.copy_(torch.where(mask[:, None, None], begin, goal))
        self._time.copy_(torch.where(mask, torch.zeros_like(self._time), self._time))
        self._length.copy_(torch.where(mask, 0.1 + 0.4 * self._rand(), self._length))

    def _rand(self) -> torch.Tensor:
        return torch.rand_like(self._time)


class MoveSchedule:
    """Velocity and heading commands, drawn anew every few seconds."""

    FIRST = 1.04
    """The first command comes no earlier than this [s]: just after standing up."""

    SETTLES = 2.0
    """A robot that is asked to stand has turned to its heading by this time [s]."""

    def __init__(self, contract: PolicyContract, settings: MdpSettings, device: str) -> None:
        n = settings.worlds
        self._settings, self._dt = settings, contract.dt
        self.velocity = torch.zeros(n, 2, device=device)
        """Desired base velocity in the heading frame (N, 2) [m/s]."""
        self.heading = torch.zeros(n, device=device)
        """Desired heading, world (N,) [rad]."""
        self.wanted = torch.zeros(n, 2, device=device)
        """Velocity that the robot is judged by: the desired one, and sideways that of the hand that leads it (N, 2)."""
        self._rate = torch.zeros(n, device=device)
        self._felt = torch.zeros(n, 2, device=device)
        self._left = torch.zeros(n, device=device)
        self._since = torch.zeros(n, device=device)

    @property
    def settled(self) -> torch.Tensor:
        """True where a robot has been asked to stand for so long that it should (N,)."""
        stands = (self.velocity == 0.0).all(-1) & (self._rate == 0.0)
        return stands & (self._since > self.SETTLES)

    def advance(self) -> None:
        """Let one control step pass."""
        s, n = self._settings, len(self._left)
        self._left.sub_(self._dt)
        self._since.add_(self._dt)
        due = self._left <= 0
        low, high = s.command_seconds
        self._left.copy_(torch.where(due, low + (high - low) * self._rand(), self._left))
        self._since.copy_(torch.where(due, torch.zeros_like(self._since), self._since))
        stands = self._rand() < s.stand_share
        speed = torch.randint(1, 4, (n,), device=self._left.device) * 0.1
        speed = torch.where(self._rand() < s.fast_share, s.fastest * self._rand(), speed)
        speed = torch.where(self._rand() < 0.5, speed, -speed)
        speed = torch.where(stands | (self._rand() < s.still_share), torch.zeros_like(speed), speed)
        velocity = torch.stack([speed, torch.zeros_like(speed)], -1)
        self.velocity.copy_(torch.where(due[:, None], velocity, self.velocity))
        keeps = stands | (self._rand() < s.still_share)
        jumps = self._rand() >= s.turning_share
        turn = torch.where(keeps | ~jumps, torch.zeros_like(speed), math.pi * (self._rand() - 0.5))
        rate = torch.where(keeps | jumps, torch.zeros_like(speed), s.turn_rate * (2 * self._rand() - 1))
        self._rate.copy_(torch.where(due, rate, self._rate))
        self.heading.copy_(torch.where(due, self.heading + turn, self.heading) + self._rate * self._dt)
        self.wanted.copy_(self.velocity)

    def lead(self, led: torch.Tensor, pull: torch.Tensor, hand: torch.Tensor, heading: torch.Tensor) -> None:
        """Let a pull say what is asked, as it does when the robot is led by the hand (mimic.control.leading).

        Args:
            led: True where it does, until the end of the episode (N,).
            pull: Pull on the toe now, world axes (N, 2) [N].
            hand: Velocity of the hand, world axes (N, 2) [m/s].
            heading: Heading of the robot (N,) [rad].
        """
        s = LEADING
        self._felt.add_((pull - self._felt) * (self._dt / (s.smoothing + self._dt)) * led[:, None])
        cosine, sine = torch.cos(heading), torch.sin(heading)
        forward = cosine * self._felt[:, 0] + sine * self._felt[:, 1]
        left = cosine * self._felt[:, 1] - sine * self._felt[:, 0]
        speed, rate, share = answer_to_pull(forward, left, s, torch)
        led_now = torch.stack([speed, torch.zeros_like(speed)], -1)
        self.velocity.copy_(torch.where(led[:, None], led_now, self.velocity))
        sideways = share * (cosine * hand[:, 1] - sine * hand[:, 0])
        self.wanted.copy_(torch.where(led[:, None], torch.stack([speed, sideways], -1), self.velocity))
        self._rate.copy_(torch.where(led, rate, self._rate))
        ahead = torch.arctan2(torch.sin(self.heading - heading), torch.cos(self.heading - heading))
        near = heading + ahead.clamp(-MOST_AHEAD, MOST_AHEAD)
        self.heading.copy_(torch.where(led & (share > 0), near, self.heading))
        self._since.copy_(torch.where(led & (share > 0), torch.zeros_like(self._since), self._since))
        self._left.copy_(torch.where(led, self._settings.command_seconds[1], self._left))

    def reset(self, mask: torch.Tensor, heading: torch.Tensor) -> None:
        """Stand still at this heading (N,) [rad] where ``mask``."""
        self.heading.copy_(torch.where(mask, heading, self.heading))
        self.velocity.copy_(torch.where(mask[:, None], torch.zeros_like(self.velocity), self.velocity))
        for buffer in (self.wanted, self._felt):
            buffer.copy_(torch.where(mask[:, None], torch.zeros_like(buffer), buffer))
        self._rate.copy_(torch.where(mask, torch.zeros_like(self._rate), self._rate))
        first = self.FIRST + (self._settings.command_seconds[1] - self.FIRST) * self._rand()
        self._left.copy_(torch.where(mask, first, self._left))
        self._since.copy_(torch.where(mask, torch.zeros_like(self._since), self._since))

    def _rand(self) -> torch.Tensor:
        return torch.rand_like(self._left)

"""What each world is asked for over time: arms, velocity and heading. Element-wise over static buffers."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from mimic.config.leading import LeadingSettings
from mimic.config.training import MdpSettings
from mimic.policy.contract import AHEAD, FRONT, PolicyContract, lead_time
from mimic.policy.leading import MOST_AHEAD, answer_to_pull
from mimic.robot.description import RobotDescription
from mimic.robot.goals import draw_goals, leg_joints
from mimic.robot.trunk import HIND, TrunkPoses
from mimic.train.tensors import Chance, in_heading_frame, put

POOL = 20_000
"""Reachable goal pairs drawn once for a training."""

ANYWHERE = 0.35
"""Share of them drawn over the whole reachable set instead of the paper's boxes."""

ARM_SPEED = (0.8, 10.0)
"""Fastest joint speed on a way of the arms [rad/s], log-uniform; toes of boxing arms move at up to 1.5 m/s."""

PEAK = 1.875
"""Fastest speed on a way over its mean speed."""

SHORTEST_WAY = 0.35
"""No way takes less time than AHEAD looks and a command leads [s]."""

LONGEST_HOLD = 3.0
"""Arms stay no longer [s]."""

TRUNK_SECONDS = (0.4, 3.0)
"""How long the trunk takes from one height and pitch to the next [s]."""

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


class ArmSchedule(Chance):
    """Front legs that go from goal to goal in joint space, on polynomials of fifth degree that begin and end at rest.

    The goal after the next is known, so that a policy can be told what is to come. Source: Flash and Hogan 1985, "The
    coordination of arm movements" (minimum jerk).
    """

    def __init__(
        self, description: RobotDescription, contract: PolicyContract, settings: MdpSettings, device: str, seed: int
    ) -> None:
        super().__init__(settings.worlds, device)
        self._hold_share = settings.hold_share
        self._dt = contract.dt
        rng = np.random.default_rng([seed, 29])
        q, excess = leg_joints(draw_goals(description, POOL, rng, anywhere=ANYWHERE), description)
        self._pool = self._tensor(q[(excess <= 0.0).all(-1)])
        self._upright = self._tensor(contract.default_q[:FRONT]).reshape(2, 3)
        self._blend = contract.blend_steps * contract.dt
        self._times = self._tensor([lead_time(contract), *AHEAD])
        self._goals = self._zeros(3, 2, 3)
        """Where the way of now began, where it ends, and where the next one ends (N, 3, 2, 3) [rad]."""
        self._lengths = self._zeros(2) + 1.0
        """How long both ways take (N, 2) [s]."""
        self._time = self._zeros()
        self.q, self.dq, self.ddq = (self._zeros(len(self._times), FRONT) for _ in range(3))
        """Goals of a command that is sent now, and at the times AHEAD (N, 5, 6) [rad, rad/s, rad/s^2]."""

    def advance(self, tracking: Tensor, first: Tensor, q: Tensor) -> None:
        """Let one control step pass.

        Args:
            tracking: True where goals count (N,).
            first: True where they count from this step on; the path then begins at the measured joints (N,).
            q: Measured joints (N, 12) [rad].
        """
        self._time.add_(self._dt * tracking)
        due = self._time >= self._lengths[:, 0]
        put(self._time, due, self._time - self._lengths[:, 0])
        goal, length = self._next(self._goals[:, 2])
        put(self._goals, due, torch.cat([self._goals[:, 1:], goal[:, None]], 1))
        put(self._lengths, due, torch.stack([self._lengths[:, 1], length], -1))
        self._begin(first, q)
        self._look()

    def reset(self, mask: Tensor, upright: Tensor, q: Tensor) -> None:
        """Begin anew where ``mask``: at the measured joints of worlds that start upright, else at rest."""
        put(self._goals, mask, self._upright.expand_as(self._goals))
        put(self._time, mask, 0.0)
        self._begin(mask & upright, q)
        self._look()

    def _begin(self, where: Tensor, q: Tensor) -> None:
        here = q[:, :FRONT].reshape(-1, 2, 3)
        goal, _ = self._next(here)
        after, length = self._next(goal)
        put(self._goals, where, torch.stack([here, goal, after], 1))
        put(self._lengths, where, torch.stack([torch.full_like(length, self._blend), length], -1))
        put(self._time, where, 0.0)

    def _next(self, start: Tensor) -> tuple[Tensor, Tensor]:
        """Return where arms go from joints (N, 2, 3) [rad], and how long that takes (N,) [s]; one may stay."""
        goal = self._pool[torch.randint(0, len(self._pool), (self._n,), device=self._device)]
        stays = self._rand(2) < self._hold_share
        goal = torch.where(stays[..., None], start, goal)
        way = (goal - start).abs().amax((-1, -2))
        slowest, fastest = ARM_SPEED
        speed = torch.exp(self._uniform(math.log(slowest), math.log(fastest)))
        moving = (PEAK * way / speed).clamp(min=SHORTEST_WAY)
        return goal, torch.where(way > 0.0, moving, self._uniform(SHORTEST_WAY, LONGEST_HOLD))

    def _look(self) -> None:
        """Work out where the arms are to be."""
        t = self._time[:, None] + self._times
        ends = self._lengths[:, :1]
        later = t > ends
        length = torch.where(later, self._lengths[:, 1:], ends)
        share = (torch.where(later, t - ends, t) / length).clamp(0.0, 1.0)[..., None]
        length = length[..., None]
        begin, middle, end = (goal.reshape(-1, 1, FRONT) for goal in self._goals.unbind(1))
        begin = torch.where(later[..., None], middle, begin)
        end = torch.where(later[..., None], end, middle)
        way = end - begin
        left = 1 - share
        self.q.copy_(begin + way * share**3 * (10 - 15 * share + 6 * share * share))
        self.dq.copy_(way * 30 * (share * left).square() / length)
        self.ddq.copy_(way * 60 * share * left * (1 - 2 * share) / length.square())


class TrunkState(NamedTuple):
    """What lowering and leaning change."""

    hind: Tensor
    """Joints of the hind legs (N, 6) [rad]."""
    torque: Tensor
    """Torques of the hind legs (N, 6) [N m]."""
    base: Tensor
    """How far the base is forward and up (N, 2) [m]."""
    asked: Tensor
    """Height [m] and pitch [rad] that all this is of (N, 2)."""


WIDTHS = [HIND, HIND, 2, 2]
"""Numbers of each."""


class TrunkSchedule(Chance):
    """A trunk that is lowered and leant now and then; see mimic.robot.trunk."""

    def __init__(self, description: RobotDescription, contract: PolicyContract, settings: MdpSettings, device: str):
        super().__init__(settings.worlds, device)
        self._share = settings.trunk_share
        self._dt = contract.dt
        numbers = description.trunk_numbers
        self._poses: TrunkPoses | None = None
        if settings.task == "stand_track" and self._share > 0.0 and numbers is not None:
            self._poses = TrunkPoses(description, torch, device)
            self._low = self._tensor([numbers.height[0], numbers.pitch[0]])
            self._high = self._tensor([numbers.height[1], numbers.pitch[1]])
        kp = self._tensor(contract.kp[FRONT:])
        kd = self._tensor(contract.kd[FRONT:])
        self._gains = (kp, kd)
        self._lag = round(lead_time(contract) / contract.dt)
        self._way = self._zeros(2, 2)
        """Height and pitch where the way began, and where it ends (N, 2, 2) [m, rad]."""
        self._time = self._zeros()
        self._length = self._zeros() + 1.0
        self._hold = self._zeros()
        self._sent = self._zeros(self._lag + 2, sum(WIDTHS))
        """`TrunkState` of the newest commands, newest first (N, lag + 2, 16)."""
        self.targets = self._zeros(FRONT + HIND)
        """What position targets change by (N, 12) [rad]."""

    def _rate(self, age: int) -> Tensor:
        return (self._sent[:, age] - self._sent[:, age + 1]) / self._dt

    @property
    def now(self) -> TrunkState:
        """What is in effect."""
        return TrunkState(*self._sent[:, self._lag].split(WIDTHS, -1))

    @property
    def rate(self) -> TrunkState:
        """Its rate [1/s]."""
        return TrunkState(*self._rate(self._lag).split(WIDTHS, -1))

    def advance(self, tracking: Tensor) -> None:
        """Let one control step pass; before a robot tracks (N,) its trunk stays."""
        if self._poses is None:
            return
        self._time.add_(self._dt * tracking)
        due = self._time >= self._length + self._hold
        goal = self._low + (self._high - self._low) * self._rand(2)
        goal = torch.where((self._rand() < self._share)[:, None], goal, torch.zeros_like(goal))
        put(self._way, due, torch.stack([self._way[:, 1], goal], 1))
        put(self._length, due, self._uniform(*TRUNK_SECONDS))
        put(self._hold, due, self._uniform(0.0, LONGEST_HOLD))
        put(self._time, due, 0.0)
        share = (self._time / self._length).clamp(0.0, 1.0)[:, None]
        begin, end = self._way.unbind(1)
        now = begin + (end - begin) * share**3 * (10 - 15 * share + 6 * share * share)
        pose = self._poses.of(now[:, 0], now[:, 1])
        newest = torch.cat([*pose, now], -1)
        self._sent.copy_(torch.cat([newest[:, None], self._sent[:, :-1]], 1))
        kp, kd = self._gains
        change = pose.joints + (kd * self._rate(0)[:, :HIND] + pose.torque) / kp
        self.targets[:, FRONT:].copy_(change)

    def reset(self, mask: Tensor) -> None:
        """Stand as the robot does by itself where ``mask``."""
        for buffer in (self._way, self._time, self._sent, self.targets):
            put(buffer, mask, 0.0)
        put(self._length, mask, self._uniform(*TRUNK_SECONDS))
        put(self._hold, mask, self._uniform(0.0, LONGEST_HOLD))


class MoveSchedule(Chance):
    """Velocity and heading commands, drawn anew every few seconds."""

    def __init__(self, contract: PolicyContract, settings: MdpSettings, device: str) -> None:
        super().__init__(settings.worlds, device)
        self._settings = settings
        self._dt = contract.dt
        self.velocity = self._zeros(2)
        """Desired base velocity in the heading frame (N, 2) [m/s]."""
        self.heading = self._zeros()
        """Desired heading, world (N,) [rad]."""
        self.wanted = self._zeros(2)
        """Velocity that the robot is judged by: the desired one, and sideways that of the hand that leads it (N, 2)."""
        self._felt = self._zeros(2)
        self._rate, self._left, self._since = (self._zeros() for _ in range(3))

    @property
    def settled(self) -> Tensor:
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

    def lead(self, led: Tensor, pull: Tensor, hand: Tensor, heading: Tensor) -> None:
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

    def reset(self, mask: Tensor, heading: Tensor) -> None:
        """Stand still at this heading (N,) [rad] where ``mask``."""
        put(self.heading, mask, heading)
        for buffer in (self.velocity, self.wanted, self._felt, self._rate, self._since):
            put(buffer, mask, 0.0)
        put(self._left, mask, self._uniform(FIRST_COMMAND, self._settings.command_seconds[1]))

"""Causal retargeting for a camera: landmarks to commands, row by row.

Torso axes, arm length, scale, clamp and joint limits are the functions that a whole clip uses. Zero-phase filters are
replaced by a One-Euro filter, slow averages and causal joint limits.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mimic.config.pose import LiveSettings
from mimic.config.retarget import RetargetSettings
from mimic.geometry import wrap_angle
from mimic.records import HIPS, SHOULDERS, SIDES, WRISTS, BoolArray, Command, FloatArray
from mimic.retargeting.follow import Follower
from mimic.retargeting.limits import limit_step
from mimic.retargeting.one_euro import OneEuro
from mimic.retargeting.sampling import EASE, ease
from mimic.retargeting.targets import wanted_toes
from mimic.retargeting.trunk import LiveTrunk, trunk_goals
from mimic.retargeting.wrists import TURN_CUTOFF_HZ, arm_length, torso_vectors
from mimic.robot.arm_mapping import posture
from mimic.robot.reach import FRONT, Reach

HEADING_HZ = 0.03
"""Cut-off of the heading when turns are not followed: the median of a clip is not known yet [Hz]."""
REMEMBERED = 900
"""Rows from which the reach of the arms is taken; half a minute at 30 frames a second."""
SHORTEST_ARM = 0.35
"""Arms count as at least this long, as they may be bent at first [m]."""
FORGET = 0.5
"""A filter restarts after a gap of this length [s]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LiveTarget:
    """The target of one camera frame."""

    t: float
    """When the frame was taken, on the clock of the computer [s]."""
    q: FloatArray
    """Front joints within reach (6,) [rad]."""
    seen: BoolArray
    """Which hands were seen (2,), left and right of the robot."""
    heading: float
    """Of the robot against its start [rad]."""
    v: FloatArray
    """Velocity forward and left (2,) [m/s]."""
    trunk: tuple[float, float] = (0.0, 0.0)
    """Height of the hips [m] and lean [rad], from how the robot stands by itself."""


class LiveRetarget:
    """Turns landmarks of one person into targets, frame by frame and causally."""

    def __init__(self, reach: Reach, settings: RetargetSettings, live: LiveSettings) -> None:
        self._reach = reach
        self._settings = settings
        self._live = live
        self._turns = live.follow or settings.turns
        self._filters = [OneEuro(live.min_cutoff, live.beta) for _ in SIDES]
        self._arms = np.zeros((2, 3))
        self._last_seen = np.full(2, -np.inf)
        self._reaches: deque[FloatArray] = deque(maxlen=REMEMBERED)
        self._line: FloatArray | None = None
        self._line_t = 0.0
        self._first_heading: float | None = None
        self._heading0: float | None = None
        self._follower = Follower()
        self._trunk = LiveTrunk()
        self._q = reach.description.poses["upright"][:FRONT].copy()

    def see(self, t: float, landmarks: FloatArray, image: FloatArray, valid: BoolArray, aspect: float) -> LiveTarget:
        """Return the target of a frame.

        Args:
            t: Time of the frame [s].
            landmarks: Mid-hip -> landmark (33, 3), camera axes [m].
            image: Place in the image (33, 2), fraction of width and height.
            valid: Which landmarks count (33,).
            aspect: Width of the image over its height.
        """
        seen = valid[SHOULDERS] & valid[WRISTS]
        heading = self._turned(t, landmarks, valid)
        arms = landmarks[WRISTS] - landmarks[SHOULDERS]
        for side in np.flatnonzero(seen):
            if t - self._last_seen[side] > FORGET:
                self._filters[side].forget()
            self._arms[side] = self._filters[side](t, arms[side])
            self._last_seen[side] = t
        p_SH = torso_vectors(self._arms, heading) / self._arm(seen)
        asked = seen[::-1] if self._settings.mirror else seen
        if asked.any():
            wanted = wanted_toes(p_SH, self._reach, self._settings)
            wanted = np.where(asked[:, None], wanted, self._reach.toes(self._q))
            self._q = self._reach.closest(wanted, self._q).q
        turn, v = self._followed(t, heading, landmarks, image, valid, aspect)
        trunk = (0.0, 0.0)
        if self._settings.trunk:
            height, lean = trunk_goals(self._trunk.see(t, landmarks, valid, heading)[None], self._reach.description)[0]
            trunk = (float(height), float(lean))
        return LiveTarget(t=t, q=self._q.copy(), seen=np.array(asked), heading=turn, v=v, trunk=trunk)

    def _arm(self, seen: BoolArray) -> float:
        if seen.any():
            self._reaches.append(np.where(seen[:, None], self._arms, np.nan))
        if not self._reaches:
            return SHORTEST_ARM
        rows = np.array(self._reaches)
        known: BoolArray = np.array(np.isfinite(rows).all(axis=-1))
        return max(SHORTEST_ARM, arm_length(rows, known, self._settings.reach_quantile))

    def _turned(self, t: float, landmarks: FloatArray, valid: BoolArray) -> float:
        """Return the heading of the torso [rad]: of the slow average of the right -> left line, or the one given."""
        if valid[SHOULDERS].all():
            line = landmarks[SHOULDERS[0]] - landmarks[SHOULDERS[1]]
            if valid[HIPS].all():
                line = line + landmarks[HIPS[0]] - landmarks[HIPS[1]]
            tau = 1.0 / (2.0 * np.pi * (TURN_CUTOFF_HZ if self._turns else HEADING_HZ))
            share = 1.0 if self._line is None else min(1.0, (t - self._line_t) / tau)
            self._line = line if self._line is None else self._line + share * (line - self._line)
            self._line_t = t
        if self._line is None:
            return 0.0
        heading = float(np.arctan2(self._line[2], self._line[0]))
        if self._first_heading is None:
            self._first_heading = heading
        if self._settings.heading is None:
            return heading
        turned = heading - self._first_heading if self._turns else 0.0
        return float(wrap_angle(np.radians(self._settings.heading) + turned))

    def _followed(
        self, t: float, heading: float, landmarks: FloatArray, image: FloatArray, valid: BoolArray, aspect: float
    ) -> tuple[float, FloatArray]:
        """Return heading against the start [rad] and velocity (2,) [m/s] of the robot."""
        if self._heading0 is None and self._line is not None:
            self._heading0 = heading
        turn = float(wrap_angle(heading - (self._heading0 or 0.0))) if self._turns else 0.0
        v = np.zeros(2)
        if self._live.follow:
            most = self._reach.description.commands.velocity_max[0]
            v[0] = np.clip(self._follower.see(t, heading, landmarks, image, valid, aspect), -most, most)
        return (-turn if self._settings.mirror else turn), v


class LiveTargets:
    """The newest of what was asked, as smooth commands at the control rate; one thread puts, another one asks.

    A hand that is lost stays for ``lost_hold``, and the arm then goes down to hang; when it is back, it eases to where
    it is.
    """

    def __init__(
        self,
        reach: Reach,
        settings: LiveSettings,
        *,
        clock: Callable[[], float] = time.monotonic,
        begin: Callable[[], None] = lambda: None,
    ) -> None:
        """Prepare.

        Args:
            reach: The robot; not shared with another thread.
            settings: How long a lost hand is held.
            clock: The clock of `LiveTarget.t`.
            begin: Called when the first command is asked for.
        """
        self._reach = reach
        self._hold = settings.lost_hold
        self._clock = clock
        self._begin = begin
        self._hanging = posture("down", reach)
        self._q = self._hanging.copy()
        self._dq = np.zeros_like(self._hanging)
        self._goal = self._hanging.copy()
        self._present = np.zeros(2)
        self._seen_at = np.full(2, -np.inf)
        self._newest: LiveTarget | None = None
        self._used: LiveTarget | None = None
        self._heading = 0.0
        self._begun = False
        self._over = False

    def put(self, asked: LiveTarget) -> None:
        """Take what is asked now; what was asked before and not used yet is dropped."""
        self._newest = asked

    def end(self) -> None:
        """Say that nothing more will come."""
        self._over = True

    def newest(self) -> Command | None:
        """Return the command of this control tick, None when nothing more will come."""
        if not self._begun:
            self._begun = True
            self._begin()
        if self._over:
            return None
        now = self._clock()
        dt = self._reach.description.dt
        asked = self._newest
        if asked is not None and asked is not self._used:
            self._used = asked
            for side in np.flatnonzero(asked.seen):
                part = slice(3 * side, 3 * side + 3)
                self._goal[part] = asked.q[part]
                self._seen_at[side] = asked.t
        rising = now - self._seen_at <= self._hold
        self._present = np.clip(self._present + np.where(rising, dt, -dt) / EASE, 0.0, 1.0)
        share = np.repeat(ease(self._present), 3)
        wanted = self._hanging + share * (self._goal - self._hanging)
        speed = self._reach.speed_max
        self._q, self._dq = limit_step(self._q, self._dq, wanted, dt, speed, self._reach.acceleration_max)
        self._q = np.clip(self._q, self._reach.q_min, self._reach.q_max)
        toes = self._reach.toes(self._q)
        if not self._reach.is_clear(self._q):
            toes = self._reach.closest(toes, self._q).p_BE
        v = np.zeros(2)
        trunk = (0.0, 0.0)
        if asked is not None and now - float(self._seen_at.max()) <= self._hold:  # who is not seen does not walk
            v = asked.v
            trunk = asked.trunk
            most = self._reach.description.commands.turn_rate_max * dt
            self._heading += float(np.clip(wrap_angle(asked.heading - self._heading), -most, most))
        return Command(v=v, heading=self._heading, p_BE=toes, height=trunk[0], pitch=trunk[1])

"""How far the robot has come, by its hind legs; what holds its position, and makes a walk as long as asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mimic.geometry import rotation_from_quat
from mimic.records import Command, CommandTrack, FloatArray
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import all_legs

HIND = (2, 3)
"""Legs that stand, in the order of LEGS."""
LIFTED = 0.012
"""A foot that is higher than the other one by this does not carry the robot [m]."""
KEPT = 0.6
"""Share of the last velocity in the one that the next step is compared with."""
GAIN = 1.0
"""Velocity for each metre that is lacking [1/s]."""
STANDS = 0.05
"""A robot that is faster the other way comes to a stand first [m/s]."""
CORRECTED = 0.02
"""A robot that should stand, and is further away than this, walks there [m]."""
REACHED = 0.005
"""It then walks until it is as near as this [m]."""
SLOWEST = 0.1
"""Velocity with which it does so at least: slower ones the policies do not walk [m/s]."""
ARRIVAL = 4.0
"""How long a robot may walk on to where a motion should have brought it [s]."""
STEERED_FROM = 0.1
"""A walk that is slower than this is steered less, in proportion [m/s]."""
RESPONSE = 1.0
"""What lies between a command and the velocity that it causes [s]."""
SMOOTHED = 0.3
"""Time over which the velocity is smoothed [s]: more than a step takes."""
STEERED = 0.5
"""A walk that is off to the side heads for where it should be after this distance [m]."""
MOST_STEERED = 0.2
"""More than this it is never turned [rad]."""
MOST = 0.5
"""More than this is never made up for: somebody may hold the robot [m]."""
HOLDING = 0.5
"""Velocity for each metre that a robot which should stand is off [1/s]. With 0.5 and 1.0 it drifts by 0.2 m in a minute
(0.8 without); 0.5 is cooler."""


class LegOdometry:
    """Adds up the steps of the hind foot that carries the robot, which rolls on the ground without slipping.

    Of two feet that are both down, it is the one that agrees better with the velocity so far: the other one slips.
    """

    def __init__(self, description: RobotDescription) -> None:
        self._legs = [all_legs(description)[leg] for leg in HIND]
        self._radius = description.toe_radius
        self._before: tuple[FloatArray, FloatArray] | None = None
        self._dt = description.dt
        self._usual = np.zeros(2)
        self.velocity = np.zeros(2)
        """How fast the base moves, smoothed (2,), world axes [m/s]."""

    def step(self, q: FloatArray, quat_WB: FloatArray) -> FloatArray:
        """Return how far the base has come since the last call (2,), world axes [m].

        Args:
            q: Joints (12,) [rad].
            quat_WB: Orientation of the base (4,), wxyz.
        """
        own = q.reshape(4, 3)[list(HIND)]
        toes = np.stack([leg.forward(joints) for leg, joints in zip(self._legs, own, strict=True)])
        knees = np.stack([leg.knee(joints) for leg, joints in zip(self._legs, own, strict=True)])
        R = rotation_from_quat(quat_WB)
        toes = toes @ R.T
        shanks = toes - knees @ R.T
        shanks = shanks / np.linalg.norm(shanks, axis=1, keepdims=True)
        before = self._before or (toes, shanks)
        self._before = (toes, shanks)
        turned = np.cross(before[1], shanks)
        rolled = self._radius * np.cross(turned, [0.0, 0.0, 1.0])
        steps = (before[0] - toes + rolled)[:, :2]
        steps[toes[:, 2] > toes[:, 2].min() + LIFTED] = np.inf
        step = steps[int(np.argmin(np.linalg.norm(steps - self._usual, axis=1)))]
        self._usual = KEPT * self._usual + (1.0 - KEPT) * step
        self.velocity = self.velocity + (step / self._dt - self.velocity) * self._dt / SMOOTHED
        return step


class HeldPosition:
    """Lets a robot that is asked to stand come back to where it stood, forward or backward.

    The velocity that is asked for is in proportion to how far away it will be RESPONSE later; below the policy's
    walk_speed it only leans.
    """

    def __init__(self, description: RobotDescription) -> None:
        self._odometry = LegOdometry(description)
        self._dt = description.dt
        self._stands = 0.0
        self._away = np.zeros(2)

    def corrected(self, command: Command, q: FloatArray, quat_WB: FloatArray) -> Command:
        """Return a command that holds the position, once the robot has been asked to stand for RESPONSE.

        Called once each control step; arguments as those of `KeptDistance.corrected`.
        """
        step = self._odometry.step(q, quat_WB)
        self._stands = 0.0 if command.v.any() else self._stands + self._dt
        if self._stands < RESPONSE:
            self._away = np.zeros(2)
            return command
        self._away = self._away + step
        lacking = -self._away - RESPONSE * self._odometry.velocity
        excess = _excess(lacking)
        self._away = self._away + excess
        along = float(_turned(lacking - excess, -command.heading)[0])
        return replace(command, v=np.array([HOLDING * along, 0.0]))


class KeptDistance:
    """Corrects velocity and heading of a track so that the robot comes as far as they say, and there.

    A robot goes on for a while after its command changes. So it is told where it should be a little later, less what it
    will have come by then.
    """

    def __init__(self, track: CommandTrack, description: RobotDescription) -> None:
        self._track = track
        self._odometry = LegOdometry(description)
        self._dt = description.dt
        self._fastest = float(description.commands.velocity_max[0])
        ahead = np.stack([np.cos(track.heading), np.sin(track.heading)], axis=1)
        self._way = np.cumsum(track.v[:, :1] * ahead, axis=0) * self._dt
        self._row = 0
        self._came = np.zeros(2)
        self._walks_there = False
        self.arrived = True
        """Whether the robot is where it should be and stands, or has walked on for ARRIVAL."""

    def corrected(self, command: Command, q: FloatArray, quat_WB: FloatArray) -> Command:
        """Return a command that makes up for what is lacking; called once each control step.

        Args:
            command: What is asked for; its heading is in the world.
            q: Joints (12,) [rad].
            quat_WB: Orientation of the base (4,), wxyz.
        """
        last = len(self._way) - 1
        ahead = self._row + round(RESPONSE / self._dt)
        later = min(ahead, last)
        heading = float(self._track.heading[min(self._row, last)])
        start = command.heading - heading
        bend = float(self._track.heading[later]) - heading
        self._row += 1
        self._came = self._came + _turned(self._odometry.step(q, quat_WB), -start)
        velocity = self._odometry.velocity
        lacking = self._way[later] - self._came - RESPONSE * _turned(velocity, bend / 2.0 - start)
        excess = _excess(lacking)
        self._came = self._came + excess
        turn = start - command.heading
        along, aside = (float(value) for value in _turned(lacking - excess, turn))
        speed = float(_turned(velocity, -command.heading)[0])
        wanted = float(self._track.v[later, 0]) if ahead <= last else 0.0
        asked = wanted + GAIN * along
        steered = float(np.clip(aside / STEERED, -MOST_STEERED, MOST_STEERED))
        steered *= wanted / max(abs(wanted), STEERED_FROM)
        if not wanted:
            near = REACHED if self._walks_there else CORRECTED
            self._walks_there = abs(along) > near and along * speed > -abs(along) * STANDS
            asked = float(np.copysign(max(abs(asked), SLOWEST), along)) if self._walks_there else 0.0
        late = (self._row - last) * self._dt
        remains = along + RESPONSE * speed
        self.arrived = late > ARRIVAL or (abs(remains) <= CORRECTED and abs(speed) <= STANDS)
        limited = float(np.clip(asked, -self._fastest, self._fastest))
        return replace(command, v=np.array([limited, command.v[1]]), heading=command.heading + steered)


def _excess(lacking: FloatArray) -> FloatArray:
    """Return what is beyond MOST of a way (2,) [m]."""
    return lacking * max(0.0, 1.0 - MOST / max(float(np.linalg.norm(lacking)), MOST))


def _turned(vector: FloatArray, angle: float) -> FloatArray:
    """Return a vector (2,) turned by an angle [rad]."""
    sine = np.sin(angle)
    cosine = np.cos(angle)
    return np.array([cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1]])

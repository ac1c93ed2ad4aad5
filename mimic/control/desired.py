"""What is asked for at each control tick: standing up, a blend to the first command, the motion, a hold.

The policy is asked for toes, velocity and heading; where its contract leaves the front legs to inverse kinematics, they
have goals of their own from the blend on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from mimic.config.play import RunSettings
from mimic.control.arms import ArmGoal, LiveArms, StoredArms
from mimic.errors import ContractError
from mimic.frozen import frozen_arrays
from mimic.geometry import smoothstep
from mimic.policy.contract import INVERSE_KINEMATICS, PolicyContract
from mimic.records import PHASES, Command, CommandTrack, FloatArray, LiveCommands
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import front_legs, front_toes

STAND_UP, BLEND, TRACK, HOLD = (PHASES.index(name) for name in ("stand_up", "blend", "track", "hold"))


@frozen_arrays
class Desired:
    """What is asked for at one control tick."""

    phase: int
    """Index into PHASES."""
    command: Command
    arms: ArmGoal | None = None
    """Of the front legs; None where the policy moves them."""


class DesiredMotion(Protocol):
    """A motion, one control tick after another."""

    ticks: int
    """Control ticks that are known of it."""

    def at(self, tick: int, q: FloatArray) -> Desired | None:
        """Return what is asked for at a control tick, counted from standing up; None when the motion is over.

        Args:
            tick: Ticks are asked for in order, each once.
            q: Measured joints (12,) [rad].
        """
        ...


class _Timing:
    """Ticks of each phase, and what is asked for before the first command counts fully."""

    def __init__(self, settings: RunSettings, contract: PolicyContract, description: RobotDescription) -> None:
        self.stand, self.blend, self.hold = (
            round(seconds / contract.dt) for seconds in (settings.stand_up, settings.blend, settings.hold_last)
        )
        self.moves_arms = (settings.arms or contract.arms) == INVERSE_KINEMATICS
        """Whether the arms are moved by inverse kinematics."""
        self._description = description
        self._neutral = np.array(contract.neutral_toes).reshape(2, 3)
        self._begin: FloatArray | None = None

    def standing_up(self) -> Desired:
        """Return the neutral toes without a turn: the robot first stands, then turns."""
        return Desired(phase=STAND_UP, command=Command(v=np.zeros(2), heading=0.0, p_BE=self._neutral))

    def blending(self, tick: int, q: FloatArray, first: Command) -> Command:
        """Return toes on the way from where they were when blending began to a command."""
        if self._begin is None:
            self._begin = front_toes(q, self._description)
        share = smoothstep((tick - self.stand + 1) / self.blend)
        p_BE = self._begin + share * (first.p_BE - self._begin)
        return Command(v=np.zeros(2), heading=first.heading, p_BE=p_BE, height=first.height, pitch=first.pitch)


def _held(command: Command) -> Command:
    return replace(command, v=np.zeros(2))


class StoredMotion:
    """A motion that is known from its beginning to its end."""

    def __init__(
        self,
        track: CommandTrack,
        settings: RunSettings,
        contract: PolicyContract,
        description: RobotDescription,
        *,
        over: Callable[[], bool] = lambda: True,
    ) -> None:
        """Prepare a motion.

        Args:
            track: Commands, one each control step.
            settings: Times of the phases, and who moves the arms.
            contract: Of the policy that is asked.
            description: The robot.
            over: Whether the motion may be over at its end; until then its last command is held.

        Raises:
            ContractError: If the track is empty or has another control step than the policy.
        """
        if not len(track.t):
            raise ContractError("there are no commands to play; expected at least one row")
        if not np.allclose(np.diff(track.t), contract.dt, rtol=0.0, atol=1e-6):
            given = f"{float(np.median(np.diff(track.t))):g}"
            needed = f"the policy needs one every {contract.dt:g} s throughout"
            raise ContractError(f"the commands come every {given} s; {needed}")
        self._track = track
        self._timing = timing = _Timing(settings, contract, description)
        self._over = over
        self._arms: StoredArms | None = None
        if timing.moves_arms:
            self._arms = StoredArms(track.p_BE, timing.blend, contract, description)
        self.ticks = timing.stand + timing.blend + len(track.t) + timing.hold
        """Control ticks of the motion, if it is not held longer."""
        self.out_of_reach = 0 if self._arms is None else self._arms.out_of_reach
        """Targets that the arms cannot reach; they go to the closest point."""

    def _row(self, row: int) -> Command:
        track = self._track
        height, pitch = (float(value) for value in np.nan_to_num(track.trunk[row]))
        heading = float(track.heading[row])
        return Command(v=track.v[row], heading=heading, p_BE=track.p_BE[row], height=height, pitch=pitch)

    def at(self, tick: int, q: FloatArray) -> Desired | None:
        """Return what is asked for at a control tick; None when the motion is over."""
        timing = self._timing
        if tick < timing.stand:
            return timing.standing_up()
        if tick >= self.ticks and self._over():
            return None
        row = tick - timing.stand - timing.blend
        arms = None if self._arms is None else self._arms.at(row, q)
        if row < 0:
            return Desired(phase=BLEND, command=timing.blending(tick, q, self._row(0)), arms=arms)
        if row < len(self._track.t):
            return Desired(phase=TRACK, command=self._row(row), arms=arms)
        return Desired(phase=HOLD, command=_held(self._row(-1)), arms=arms)


class LiveMotion:
    """A motion that is made while the robot moves; its last command is held for a while when it ends."""

    def __init__(
        self, live: LiveCommands, settings: RunSettings, contract: PolicyContract, description: RobotDescription
    ) -> None:
        self._live = live
        self._timing = _Timing(settings, contract, description)
        self._hold_left = self._timing.hold
        self.ticks = self._timing.stand + self._timing.blend + self._timing.hold
        self._last: Command | None = None
        self._arms: LiveArms | None = None
        if self._timing.moves_arms:
            self._arms = LiveArms(self._timing.blend, contract, description)

    def at(self, tick: int, q: FloatArray) -> Desired | None:
        """Return what is asked for at a control tick; None when the motion and the hold are over."""
        timing = self._timing
        if tick < timing.stand:
            return timing.standing_up()
        newest = self._live.newest()
        command = newest or self._last
        if newest is None:
            self._hold_left -= 1
        if command is None or self._hold_left < 0:
            return None
        if newest is None:
            command = _held(command)
        self._last = command
        row = tick - timing.stand - timing.blend
        arms = None if self._arms is None else self._arms.at(row, q, command.p_BE)
        if newest is None:
            return Desired(phase=HOLD, command=command, arms=arms)
        if row < 0:
            return Desired(phase=BLEND, command=timing.blending(tick, q, command), arms=arms)
        return Desired(phase=TRACK, command=command, arms=arms)


def clamp_desired(
    v_des: FloatArray, p_BE_des: FloatArray, description: RobotDescription
) -> tuple[FloatArray, FloatArray, int]:
    """Return velocity (2,) and toes (2, 3) inside their limits, and how many of them were clamped.

    A toe beyond the length of its leg is clamped towards the hip axis; the finer limits are those of the retargeting.
    """
    v = np.clip(v_des, -description.commands.velocity_max, description.commands.velocity_max)
    clamped = int(np.count_nonzero(v != v_des))
    toes = np.array(p_BE_des, dtype=np.float64)
    for side, leg in enumerate(front_legs(description)):
        hip = leg.origin + np.array([0.0, leg.offset, 0.0])
        longest = float(np.hypot(leg.thigh + np.hypot(leg.toe[0], leg.toe[2]), 2 * abs(leg.offset)))
        away = float(np.linalg.norm(toes[side] - hip))
        if away > longest:
            toes[side] = hip + (toes[side] - hip) * longest / away
            clamped += 1
    return v, toes, clamped

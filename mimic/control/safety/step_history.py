"""What the safety rules look at: the report of a control step, and what is remembered of the steps before."""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.spatial.transform import Rotation

from mimic.dynamics.thermal import MotorHeat
from mimic.frozen import frozen_arrays
from mimic.geometry import rotation_from_quat
from mimic.records import JOINTS, PHASES, FloatArray, Health, RobotState
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import all_toes
from mimic.robot.parts import SafetyLimits

STANDING = ("blend", "track", "hold")
"""Phases in which the robot should be upright."""

MOVING = ("stand_up", *STANDING, "sit_down")
"""Phases in which a policy moves it."""


@frozen_arrays
class StepReport:
    """What a supervisor sees of a control step."""

    state: RobotState
    health: Health
    phase: int
    """Index into PHASES."""
    q_des: FloatArray | None = None
    """Targets of the joints in this step (12,) [rad]; None where they are not known."""
    interrupts: int = 0
    """How often Ctrl-C was pressed."""
    hung_up: bool = False
    """Whether one of them was the terminal that closed (SIGHUP)."""
    released: bool = False
    """Whether the key or button that must be held was let go."""
    terminated: bool = False
    """Whether SIGTERM asked the process to end."""


NOT_YET = 2
"""Newest targets that no joint can have followed yet: delay and ramp of a command take 35 ms of 20 ms steps."""


class StepHistory:
    """What the rules need of the steps before: counters, the change since the last step, and the thermal model."""

    def __init__(self, description: RobotDescription, limits: SafetyLimits, *, moves: bool = True) -> None:
        self.description = description
        self._limits = limits
        self.moves = moves
        """Whether the motors follow their targets; False in a dry run."""
        self.failed: set[int] = set()
        """Joints whose motor or encoder has failed."""
        self.distrusted: set[int] = set()
        """Joints whose measured positions are no longer used."""
        self.rise: FloatArray = np.zeros(len(JOINTS))
        """Rise of each winding by the thermal model (12,); 1 is its limit."""
        self.jump: FloatArray = np.full(len(JOINTS), np.nan)
        """Change of each joint since the last step (12,) [rad]."""
        self.imu_repeats = 0
        """Orientations in a row that equal the one before."""
        self.turn_mismatch = 0.0
        """Tilt of the orientation less that by the rate of turn since the last orientation that was trusted [rad]; for
        more than one control step it counts less."""
        self.heading_jump = self.heading_jumps = 0.0
        """Turn about up that the rate of turn does not explain, in this step and in all [rad]: the IMU set its
        heading anew."""
        self.doubtful = 0
        """Orientations in a row that the rate of turn contradicts."""
        self.frozen = np.zeros(len(JOINTS), dtype=bool)
        """Joints whose readings do not change although their targets do (12,)."""
        self.fast = self.off_target = np.zeros(len(JOINTS), dtype=int)
        """Steps in a row in which each joint was too fast, and too far from its target (12,)."""
        self.round_trip = self.voltage = float("nan")
        """Median of the last half second of answers [s], and of the last five seconds of supply voltages [V]."""
        self._round_trips: deque[float] = deque(maxlen=25)
        self._voltages: deque[float] = deque(maxlen=250)
        self._trusted: StepReport | None = None
        self._rows: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=limits.frozen_ticks)
        self.hind_apart = self.front_above = float("nan")
        """Difference in height of the hind toes, and height of the lower front toe above the lower hind toe [m]."""
        self.legs_contradict = 0
        """Steps in a row in which legs and IMU contradict each other."""
        self.overruns = self.small_overruns = 0
        """Steps in a row that ended later than planned, by the larger and by the smaller limit."""
        self._thermal: MotorHeat | None = None
        self._bus_errors: list[tuple[float, int]] = []
        self._foreign: list[tuple[float, int]] = []
        self._last: StepReport | None = None
        self._trusted_rotation = np.full((3, 3), np.nan)
        self.rotation = np.full((3, 3), np.nan)
        """R_WB, the orientation of the base (3, 3) at this step; NaN where it is not trusted."""

    def update_heat(self, report: StepReport) -> None:
        """Take a step of a damped robot: only the thermal model goes on."""
        self._warm(report)
        self._last = report

    def update(self, report: StepReport) -> None:
        """Take a step."""
        state = report.state
        health = report.health
        limits = self._limits
        self._warm(report)
        self.jump = np.abs(state.q - self._last.state.q) if self._last is not None else np.full(len(JOINTS), np.nan)
        self.overruns = self.overruns + 1 if health.late > limits.overrun else 0
        self.small_overruns = self.small_overruns + 1 if health.late > limits.small_overrun else 0
        self._bus_errors = _recent(self._bus_errors, state.t, health.bus_errors)
        self._foreign = _recent(self._foreign, state.t, health.foreign)
        self._keep_answers(report)
        self._compare_imu(report)
        self._compare_legs(report)
        self._compare_targets(report)
        self._last = report

    @property
    def new_errors(self) -> int:
        """Error frames of the last tenth of a second."""
        return self._bus_errors[-1][1] - self._bus_errors[0][1]

    @property
    def new_foreign(self) -> int:
        """Commands of other programs in the last tenth of a second."""
        return self._foreign[-1][1] - self._foreign[0][1]

    def _warm(self, report: StepReport) -> None:
        if self._thermal is None:
            self._thermal = MotorHeat(self.description, report.health.temperature)
        dt = 0.0 if self._last is None else max(report.state.t - self._last.state.t, 0.0)
        self.rise = self._thermal.add(report.state.tau, dt)

    def _compare_imu(self, report: StepReport) -> None:
        """Compare an orientation with the last one that was trusted: does it repeat it, and turn as the rates say?"""
        state = report.state
        trusted = self._trusted
        rotation = rotation_from_quat(state.quat_WB)
        if self._last is not None and report.health.imu_count == self._last.health.imu_count:
            self.rotation = np.full((3, 3), np.nan) if self.doubtful else rotation
            self.heading_jump = 0.0
            return
        self.turn_mismatch = self.heading_jump = 0.0
        if trusted is not None:
            before = trusted.state
            seconds = (state.t - report.health.imu_age) - (before.t - trusted.health.imu_age)
            rates = 0.5 * (state.omega_B + before.omega_B)
            if seconds > 0.0 and np.isfinite(rates).all() and np.isfinite(rotation).all():
                equal = np.array_equal(state.quat_WB, before.quat_WB) and np.array_equal(state.omega_B, before.omega_B)
                self.imu_repeats = self.imu_repeats + 1 if equal else 0
                predicted = self._trusted_rotation @ Rotation.from_rotvec(seconds * rates).as_matrix()
                steps = max(1.0, seconds / self.description.dt)
                allowed = self._limits.turn_mismatch * (0.75 + 0.25 * steps)
                angle = float(np.arccos(np.clip(predicted[2] @ rotation[2], -1.0, 1.0)))
                self.turn_mismatch = angle / (0.75 + 0.25 * steps)
                error = rotation @ predicted.T
                yaw = float(np.arctan2(error[1, 0] - error[0, 1], error[0, 0] + error[1, 1]))
                self.heading_jump = yaw if angle <= allowed < abs(yaw) else 0.0
                self.heading_jumps += self.heading_jump
        self.doubtful = self.doubtful + 1 if self.turn_mismatch > self._limits.turn_mismatch else 0
        if self.doubtful:
            self.rotation = np.full((3, 3), np.nan)
            return
        self.rotation = rotation
        if np.isfinite(rotation).all() and np.isfinite(state.omega_B).all():
            self._trusted = report
            self._trusted_rotation = rotation

    def _keep_answers(self, report: StepReport) -> None:
        """Keep times of answers and voltages; their medians are known once the memory is half full."""
        self.round_trip = _median(self._round_trips, report.health.round_trip)
        self.voltage = _median(self._voltages, report.health.voltage)

    def _compare_targets(self, report: StepReport) -> None:
        """Compare readings with targets: is a joint frozen, too fast, or far from where it should be?"""
        state = report.state
        limits = self._limits
        self.fast = np.where(np.abs(state.dq) > limits.overspeed, self.fast + 1, 0)
        if report.q_des is None:
            return
        away = np.abs(report.q_des - state.q) > limits.off_target
        self.off_target = np.where(away & (PHASES[report.phase] != "damp"), self.off_target + 1, 0)
        if PHASES[report.phase] not in MOVING:  # gains that rise move no joint at first
            self._rows.clear()
        self._rows.append((state.q, report.q_des))
        q, q_des = (np.array(rows) for rows in zip(*self._rows, strict=True))
        full = len(q) == limits.frozen_ticks
        in_effect = q_des[:-NOT_YET] if full else q_des
        moved = np.ptp(in_effect, axis=0) > limits.frozen_targets
        self.frozen = self.moves & full & np.all(q == q[0], axis=0) & moved

    def _compare_legs(self, report: StepReport) -> None:
        """Compute the heights of the toes against each other, by legs and IMU."""
        state = report.state
        limits = self._limits
        q = state.q.copy()
        q[list(self.distrusted)] = np.nan
        toes = all_toes(q, self.description) @ self.rotation[2]
        self.hind_apart = float(abs(toes[2] - toes[3]))
        self.front_above = float(toes[:2].min() - toes[2:].min())
        stands = PHASES[report.phase] in STANDING
        apart = self.hind_apart > (limits.toes_apart if stands else limits.toes_apart_moving)
        kneels = stands and self.front_above < limits.front_above
        self.legs_contradict = self.legs_contradict + 1 if apart or kneels else 0


def _recent(counts: list[tuple[float, int]], t: float, count: int) -> list[tuple[float, int]]:
    """Return a count of the last tenth of a second with its newest value added."""
    return [*((before, n) for before, n in counts if before > t - 0.1), (t, count)]


def _median(kept: deque[float], new: float) -> float:
    """Keep a number and return the median of those kept; NaN until half of them are there."""
    if np.isfinite(new):
        kept.append(new)
    return float(np.median(kept)) if 2 * len(kept) >= (kept.maxlen or 0) else float("nan")

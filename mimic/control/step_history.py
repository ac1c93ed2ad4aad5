"""What the safety rules look at: the report of a control step, and what is remembered of the steps before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mimic.control.safety_limits import Limits
from mimic.dynamics.thermal import MotorHeat
from mimic.geometry import rotation_from_quat
from mimic.records import JOINTS, PHASES, FloatArray, Health, RobotState
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import all_toes

STANDING = ("blend", "track", "hold")
"""Phases in which the robot should be upright."""

MOVING = ("stand_up", *STANDING, "sit_down")
"""Phases in which a policy moves it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StepReport:
    """What a supervisor sees of a control step."""

    state: RobotState
    health: Health
    phase: int
    """Index into PHASES."""
    interrupts: int = 0
    """How often Ctrl-C was pressed."""
    terminated: bool = False
    """Whether SIGTERM asked the process to end."""


class StepHistory:
    """What the rules need of the steps before: counters, the change since the last step, and the thermal model."""

    def __init__(self, description: RobotDescription, limits: Limits) -> None:
        self.description, self._limits = description, limits
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
        """Turn of the orientation less that of the rate of turn, per control step [rad]."""
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
        self._last_rotation = np.full((3, 3), np.nan)
        self.rotation = np.full((3, 3), np.nan)
        """R_WB, the orientation of the base (3, 3) at this step."""

    def update_heat(self, report: StepReport) -> None:
        """Take a step of a damped robot: only the thermal model goes on."""
        self._warm(report)
        self._last = report

    def update(self, report: StepReport) -> None:
        """Take a step."""
        state, health, limits = report.state, report.health, self._limits
        self._warm(report)
        self.jump = np.abs(state.q - self._last.state.q) if self._last is not None else np.full(len(JOINTS), np.nan)
        self.overruns = self.overruns + 1 if health.late > limits.overrun else 0
        self.small_overruns = self.small_overruns + 1 if health.late > limits.small_overrun else 0
        self._bus_errors = _recent(self._bus_errors, state.t, health.bus_errors)
        self._foreign = _recent(self._foreign, state.t, health.foreign)
        self._last_rotation, self.rotation = self.rotation, rotation_from_quat(state.quat_WB)
        self._compare_imu(report)
        self._compare_legs(report)
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
        """Compare an orientation with the last one: whether it repeats it, and whether it turned as the rates say."""
        self.turn_mismatch = 0.0
        if self._last is None or report.health.imu_count == self._last.health.imu_count:
            return
        state, before = report.state, self._last.state
        seconds = (state.t - report.health.imu_age) - (before.t - self._last.health.imu_age)
        known = np.isfinite(np.concatenate([state.quat_WB, before.quat_WB, state.omega_B, before.omega_B])).all()
        if not known or seconds <= 0.0:
            return
        equal = np.array_equal(state.quat_WB, before.quat_WB) and np.array_equal(state.omega_B, before.omega_B)
        self.imu_repeats = self.imu_repeats + 1 if equal else 0
        change = self._last_rotation.T @ self.rotation
        turned = 0.5 * np.array([change[2, 1] - change[1, 2], change[0, 2] - change[2, 0], change[1, 0] - change[0, 1]])
        integrated = 0.5 * seconds * (state.omega_B + before.omega_B)
        steps = max(1.0, seconds / self.description.dt)
        self.turn_mismatch = float(np.linalg.norm(turned - integrated)) / steps

    def _compare_legs(self, report: StepReport) -> None:
        """Compute the heights of the toes against each other, by legs and IMU."""
        state, limits = report.state, self._limits
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

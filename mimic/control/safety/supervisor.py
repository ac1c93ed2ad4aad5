"""Whether a robot may run on: a state machine that sees every control step and only ever becomes more careful.

It has no clock and does no I/O: time stamps and readings are given to it, so that its decisions are repeatable.
The rules and their limits are in `mimic.control.safety.safety_rules`.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np

from mimic.control.safety.safety_rules import FALLS, RULES, Alert, Rule
from mimic.control.safety.step_history import STANDING, StepHistory, StepReport
from mimic.frozen import frozen
from mimic.metrics import uprightness
from mimic.records import PHASES
from mimic.robot.description import RobotDescription
from mimic.robot.parts import SafetyLimits


class SafetyMode(IntEnum):
    """What the robot may do; only ever goes up."""

    RUN = 0
    SIT_DOWN = 1
    DAMP = 2
    STOPPED = 3


@frozen
class Event:
    """Something that a rule found."""

    t: float
    """Time of the plant [s]."""
    rule: str
    mode: SafetyMode
    """What follows from it; RUN where it is only logged."""
    text: str
    """What happened, as a sentence without its full stop."""


class Supervisor:
    """Decides after every control step whether a robot runs on, sits down, is damped, or is stopped."""

    def __init__(
        self,
        description: RobotDescription,
        limits: SafetyLimits | None = None,
        *,
        rules: Sequence[Rule] = RULES,
        sits: bool = True,
        strict: bool = False,
        moves: bool = True,
    ) -> None:
        """Begin with a robot that runs.

        Args:
            description: The robot.
            limits: Limits of the rules; by default those of the robot.
            rules: The rules to apply.
            sits: Whether the robot can sit down; if not, a rule that asks for it damps.
            strict: Sit down also at what would only be announced.
            moves: Whether the motors follow their targets; False in a dry run.
        """
        self._strict = strict
        limits = description.safety if limits is None else limits
        self._description = description
        self._limits = limits
        self._rules = rules
        self._sits = sits
        self.moves = moves
        """Whether the motors follow their targets."""
        self._history = StepHistory(description, limits, moves=moves)
        self._keeps_history = any(rule.reads_history for rule in rules)
        self._seen: set[tuple[str, str, int]] = set()
        self._damped_since = self._resting_since = float("nan")
        self.mode = SafetyMode.RUN
        self.events: list[Event] = []

    @property
    def distrusted(self) -> frozenset[int]:
        """Joints whose measured positions are no longer used."""
        return frozenset(self._history.distrusted)

    @property
    def doubts_orientation(self) -> bool:
        """Whether the newest orientation contradicts the rate of turn and should not be used."""
        return self._history.doubtful > 0

    @property
    def heading_jumps(self) -> float:
        """How far the IMU's heading has jumped so far, which nothing turned [rad]."""
        return self._history.heading_jumps

    @property
    def decisive(self) -> Event | None:
        """What first ended the run, if anything did."""
        return next((event for event in self.events if event.mode > SafetyMode.RUN), None)

    @property
    def fell_at(self) -> float | None:
        """When the robot fell or was about to [s], if that is what ended the run."""
        return self.decisive.t if self.decisive is not None and self.decisive.rule in FALLS else None

    def update(self, report: StepReport) -> SafetyMode:
        """Take the report of a control step and return what the robot may do from now on."""
        if self.mode >= SafetyMode.DAMP:
            self._history.update_heat(report)
            return self._rest(report)
        if self._keeps_history:
            self._history.update(report)
        for rule in self._rules:
            for alert in rule.check(report, self._history, self._limits):
                self._weigh(rule.name, alert, report)
        return self.mode

    def decide(self, rule: str, mode: SafetyMode, text: str, t: float) -> SafetyMode:
        """Record a decision of the control loop, such as the end of a run or a failure, and return what follows."""
        self._note(rule, "", mode, text, t)
        return self.mode

    def note(self, rule: str, text: str, t: float) -> None:
        """Log an event from which nothing follows."""
        self._note(rule, "", SafetyMode.RUN, text, t)

    def _weigh(self, rule: str, alert: Alert, report: StepReport) -> None:
        mode = SafetyMode[alert.outcome]
        text = alert.text
        if mode == SafetyMode.RUN and self._strict:
            mode = SafetyMode.SIT_DOWN
        if mode == SafetyMode.SIT_DOWN and not self._sits:
            mode = SafetyMode.DAMP
        elif mode == SafetyMode.SIT_DOWN:
            reason = self._cannot_sit_down(report, needs_upright=alert.needs_upright)
            if reason is not None:
                mode = SafetyMode.DAMP
                text = f"{text}; not sitting down, because {reason}"
        self._note(rule, alert.about, mode, text, report.state.t)

    def _note(self, rule: str, about: str, mode: SafetyMode, text: str, t: float) -> None:
        if (rule, about, mode) in self._seen:
            return
        self._seen.add((rule, about, mode))
        if mode == SafetyMode.RUN or mode > self.mode:
            self.events.append(Event(t=t, rule=rule, mode=mode, text=text))
        if mode >= SafetyMode.DAMP > self.mode:
            self._damped_since = t
        self.mode = max(self.mode, mode)

    def _cannot_sit_down(self, report: StepReport, *, needs_upright: bool) -> str | None:
        """Return why the policy that sits down would not get the robot down, or None."""
        failed = len(self._history.failed)
        if failed > self._limits.failed_motors:
            return f"{failed} motors have failed"
        if not np.isfinite(report.state.quat_WB).all():
            return "the orientation is not known"
        phase = PHASES[report.phase]
        if phase == "lie":
            return "it is already lying"
        upright = float(uprightness(report.state.quat_WB, self._description))
        if phase == "sit_down" or not needs_upright or upright >= self._limits.upright:
            return None
        return "it is not upright" if phase in STANDING else "it is not upright yet"

    def _rest(self, report: StepReport) -> SafetyMode:
        """Stop a damped robot once it rests, or after the longest time for damping."""
        t = report.state.t
        limits = self._limits
        moving = not np.nanmax(np.abs(report.state.dq), initial=0.0) < limits.rest_speed
        known = np.isfinite(report.state.dq).any()
        if moving or not known:
            self._resting_since = float("nan")
        elif np.isnan(self._resting_since):
            self._resting_since = t
        if t - self._resting_since >= limits.rest_seconds:
            self._note("at_rest", "", SafetyMode.STOPPED, "it came to rest", t)
        elif t - self._damped_since >= limits.damp_seconds:
            self._note("at_rest", "", SafetyMode.STOPPED, f"it was damped for {limits.damp_seconds:g} s", t)
        return self.mode

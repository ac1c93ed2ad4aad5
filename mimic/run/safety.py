"""What a robot may go on doing: a state machine that sees every control step and only ever gets more careful.

It has no clock and does no I/O: time stamps and readings are given to it, so that each of its decisions can be repeated.
The rules and their limits are in :mod:`mimic.run.safety_rules`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from mimic.metrics import uprightness
from mimic.robot.description import RobotDescription
from mimic.run.safety_rules import LIMITS, RULES, STANDING, Facts, Finding, Limits, Rule, Watch
from mimic.types import PHASES


class Mode(IntEnum):
    """What the robot may do; only ever goes up."""

    RUN = 0
    SIT_DOWN = 1
    DAMP = 2
    STOPPED = 3


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something that a rule found."""

    t: float
    """Time of the plant [s]."""
    rule: str
    mode: Mode
    """What follows from it; RUN for a mere announcement."""
    text: str
    """What happened, as a sentence without its full stop."""


class Supervisor:
    """Decides after every control step whether a robot runs on, sits down, is damped, or is stopped."""

    def __init__(
        self,
        description: RobotDescription,
        limits: Limits = LIMITS,
        *,
        rules: Sequence[Rule] = RULES,
        sits: bool = True,
    ) -> None:
        """Begin with a robot that runs.

        Args:
            description: The robot.
            limits: Where rules draw their lines.
            rules: Those that count.
            sits: Whether there is a way of sitting down; otherwise every rule that asks for it damps.
        """
        self._description, self._limits, self._rules, self._sits = description, limits, rules, sits
        self._watch = Watch(description, limits)
        self._seen: set[tuple[str, str, int]] = set()
        self._damped_since = self._still_since = float("nan")
        self.mode = Mode.RUN
        self.events: list[Event] = []

    @property
    def unbelieved(self) -> frozenset[int]:
        """Joints whose positions are not believed any more."""
        return frozenset(self._watch.unbelieved)

    @property
    def decisive(self) -> Event | None:
        """What first ended the run, if anything did."""
        return next((event for event in self.events if event.mode > Mode.RUN), None)

    def judge(self, facts: Facts) -> Mode:
        """Take the facts of a control step and return what the robot may do from now on."""
        if self.mode >= Mode.DAMP:
            self._watch.hear(facts)
            return self._rest(facts)
        self._watch.see(facts)
        for rule in self._rules:
            for finding in rule.check(facts, self._watch, self._limits):
                self._weigh(rule.name, finding, facts)
        return self.mode

    def decide(self, rule: str, mode: Mode, text: str, t: float) -> Mode:
        """Take a decision made elsewhere, such as the end of a run or a failure, and return what follows."""
        self._note(rule, "", mode, text, t)
        return self.mode

    def note(self, rule: str, text: str, t: float) -> None:
        """Keep an announcement; nothing follows from it."""
        self._note(rule, "", Mode.RUN, text, t)

    def _weigh(self, rule: str, finding: Finding, facts: Facts) -> None:
        mode, text = Mode[finding.outcome], finding.text
        if mode == Mode.SIT_DOWN and not self._sits:
            mode = Mode.DAMP
        elif mode == Mode.SIT_DOWN:
            reason = self._cannot_sit_down(facts, needs_upright=finding.needs_upright)
            if reason is not None:
                mode, text = Mode.DAMP, f"{text}; not sitting down, because {reason}"
        self._note(rule, finding.about, mode, text, facts.state.t)

    def _note(self, rule: str, about: str, mode: Mode, text: str, t: float) -> None:
        if (rule, about, mode) in self._seen:
            return
        self._seen.add((rule, about, mode))
        if mode == Mode.RUN or mode > self.mode:
            self.events.append(Event(t=t, rule=rule, mode=mode, text=text))
        if mode >= Mode.DAMP > self.mode:
            self._damped_since = t
        self.mode = max(self.mode, mode)

    def _cannot_sit_down(self, facts: Facts, *, needs_upright: bool) -> str | None:
        """Return why the policy that sits down would not get the robot down, or None."""
        lost = self._watch.lost
        if len(lost) > self._limits.lost_motors:
            return f"{len(lost)} motors are lost"
        if not np.isfinite(facts.state.quat_WB).all():
            return "the orientation is not known"
        phase = PHASES[facts.phase]
        if phase == "lie":
            return "it lies already"
        upright = float(uprightness(facts.state.quat_WB, self._description))
        if phase == "sit_down" or not needs_upright or upright >= self._limits.upright:
            return None
        return "it is not upright" if phase in STANDING else "it is not upright yet"

    def _rest(self, facts: Facts) -> Mode:
        """Return whether a damped robot may be switched off: it rests, or it has had its time."""
        t, limits = facts.state.t, self._limits
        if facts.interrupts >= limits.interrupts_stop:
            self._note("interrupt", "stop", Mode.STOPPED, "Ctrl-C was pressed while it was damped", t)
        moving = not np.nanmax(np.abs(facts.state.dq), initial=0.0) < limits.rest_speed
        heard = np.isfinite(facts.state.dq).any()
        if moving or not heard:
            self._still_since = float("nan")
        elif np.isnan(self._still_since):
            self._still_since = t
        if t - self._still_since >= limits.rest_seconds:
            self._note("at_rest", "", Mode.STOPPED, "it came to rest", t)
        elif t - self._damped_since >= limits.damp_seconds:
            self._note("at_rest", "", Mode.STOPPED, f"it was damped for {limits.damp_seconds:g} s", t)
        return self.mode

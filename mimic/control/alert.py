"""What a safety rule finds in a control step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

from mimic.control.safety_limits import Limits
from mimic.control.step_history import StepHistory, StepReport


@dataclass(frozen=True, kw_only=True)
class Alert:
    """What a rule found in one control step."""

    outcome: Literal["RUN", "SIT_DOWN", "DAMP", "STOPPED"]
    """What follows, as the name of a SafetyMode."""
    text: str
    """What happened, as a sentence without its full stop."""
    about: str = ""
    """Its subject, such as a joint; each subject is reported once."""
    needs_upright: bool = True
    """Whether sitting down makes sense only for a robot that is still upright."""


Check = Callable[[StepReport, StepHistory, Limits], Iterator[Alert]]

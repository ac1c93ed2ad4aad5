"""The time budget of a control step on CAN: computing, the parts of a command, and the motors' answers to each.

    |- computing -|- part 1 + answers -|- part 2 + answers -|- ... -|- part n + answers -|- spare -|
    0                                                                                              dt

An interpolated command goes out in parts. Part k is sent at ``(k - 1) dt / n`` after the planned begin of the step, or
as soon as computing is done.
"""

from __future__ import annotations

from mimic.frozen import frozen
from mimic.hardware.can.load import expected_load
from mimic.hardware.can.wiring import Wiring

PARTS = 4
"""Parts of an interpolated command: 200 Hz with a control step of 20 ms."""

OVERHEAD = 0.002
"""Allowed for one control step of the loop beside its policy [s]: observation, safety rules, log. Two quiet cores take
0.8 ms (median)."""

SPARE = 0.001
"""Must be left of every step [s], for an adapter and a computer that hesitate."""


@frozen
class StepBudget:
    """What a control step's time is spent on [s]."""

    dt: float
    """Control step."""
    parts: int
    """Commands to each motor in a step."""
    bus: float
    """Time in which the busiest bus carries the commands of a step, the answers to them and the IMU."""
    computing: float
    """Allowed for computing: the policy and OVERHEAD."""

    @property
    def spare(self) -> float:
        """What is left of a step [s]; negative where it does not fit."""
        return self.dt - self.computing - self.bus

    @property
    def fits(self) -> bool:
        """Whether enough is left of every step."""
        return self.spare >= SPARE

    def __str__(self) -> str:
        """Return the budget as a sentence without its full stop."""
        ms = [f"{1e3 * seconds:.1f}" for seconds in (self.dt, self.bus, self.computing, self.spare)]
        parts = "1 part" if self.parts == 1 else f"{self.parts} parts"
        return f"of {ms[0]} ms, {parts} with answers take {ms[1]} ms and computing {ms[2]} ms; {ms[3]} ms to spare"


def step_budget(wiring: Wiring, dt: float, parts: int, inference: float = 0.0) -> StepBudget:
    """Return the budget of a control step.

    Args:
        wiring: Which motor is on which bus, and how fast the buses are.
        dt: Control step [s].
        parts: Commands to each motor in a step.
        inference: Time that the policy takes on this computer [s].
    """
    bus = dt * float(expected_load(wiring, parts / dt).max())
    return StepBudget(dt=dt, parts=parts, bus=bus, computing=OVERHEAD + inference)

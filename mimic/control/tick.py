"""Control ticks on any plant: the command that is sent, the state that comes back, and what the supervisor makes of it.

What the supervisor decides goes to the plant at once: a robot that is to be damped is, whatever the loop does next.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mimic.config.play import RAMP
from mimic.control.dropouts import DropoutFilter
from mimic.control.plant import Plant
from mimic.control.recorder import Journal, RunRecorder
from mimic.control.safety.safety_rules import FAILURE
from mimic.control.safety.step_history import StepReport
from mimic.control.safety.supervisor import SafetyMode, Supervisor
from mimic.control.signals import Signals
from mimic.geometry import turned_about_up
from mimic.records import PHASES, JointCommand, RobotState, Tick
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import front_toes

Sink = Callable[[Tick], None]
"""Called after each tick; must not block."""


@dataclass(kw_only=True)
class Safety:
    """Supervision of a run. The defaults are those of a robot on its bus."""

    supervisor: Supervisor
    signals: Signals = field(default_factory=Signals)
    """Requests to end, counted by whoever catches the signals."""
    recorder: RunRecorder | None = None
    """Where every tick goes at once."""
    ramp: float = RAMP
    """Time in which gains rise and the joints come into the crouch [s]; 0 for a plant that starts in it."""
    tested: bool = True
    """Whether each joint then moves by itself, to show that legs and IMU are what the wiring says."""
    checked: bool = True
    """Whether a robot that is not in the crouch after that is damped."""
    endless: bool = False
    """Whether the last command is held until something ends the run."""
    damp_at_end: bool = True
    """Whether a run that went well ends by damping the robot until it rests."""


class Run:
    """A run in progress: the plant, its newest state, and the log so far."""

    def __init__(
        self,
        plant: Plant,
        width: int,
        sink: Sink | None,
        progress: Callable[[int], None] | None,
        safety: Safety,
    ) -> None:
        self.plant = plant
        self.sink = sink
        self.progress = progress
        self.safety = safety
        self.width = width
        """Of the log's observation column."""
        self.journal = Journal(safety.recorder, width)
        self._phase = 0
        self.ticks = 0
        self.state: RobotState
        self.sensed: RobotState
        """The state as a policy is told of it: estimates where there is no reading."""

    def begin(self) -> None:
        """Start the plant."""
        self.state = self.plant.start()
        self._dropouts = DropoutFilter(self.plant.description)
        self.sensed = self._dropouts.fill(self.state)

    @property
    def mode(self) -> SafetyMode:
        """What may still be done."""
        return self.safety.supervisor.mode

    @property
    def interrupted(self) -> bool:
        """Whether the process was asked to end."""
        return self.safety.signals.interrupts > 0 or self.safety.signals.terminated

    def decide(self, rule: str, mode: SafetyMode, text: str) -> None:
        """Record a decision of the control loop, and obey it."""
        self.safety.supervisor.decide(rule, mode, text, self.state.t if self.ticks else 0.0)
        self._obey()

    def note(self, rule: str, text: str) -> None:
        """Log an event from which nothing follows."""
        self.safety.supervisor.note(rule, text, self.state.t)

    def _obey(self) -> None:
        """Have the plant damped where that was decided, and write new events to the recorder."""
        if self.mode >= SafetyMode.DAMP:
            self.plant.damp()
        try:
            self.journal.note(self.safety.supervisor.events)
        except OSError as reason:
            self._stop_recording(reason)

    def hold(self, command: JointCommand, phase: int) -> None:
        """Send a command that no policy made, for one control step; a robot that lies shows the gyro's bias."""
        if PHASES[phase] == "lie":
            self._dropouts.rest(self.state)
        self.step(command, phase, 0)

    def step(self, command: JointCommand, phase: int, clamped: int, **asked: Any) -> None:
        """Send a command for one control step, log it and what was asked for, and let the supervisor judge it.

        Args:
            command: For the joints.
            phase: Index into PHASES.
            clamped: Numbers that were beyond their limits on the way to it.
            asked: Columns of the RunLog: what was asked of a policy, what it saw and answered.
        """
        self._phase = phase
        command, outside = clamp_command(command, self.plant.description)
        clamped += outside
        if clamped:
            self.note("clamped", f"{clamped} numbers beyond their limits were clamped")
        p_BE = front_toes(self.state.q, self.plant.description)
        asked |= {"t_host": time.monotonic(), "phase": phase, "p_BE": p_BE, "q_des": command.position_target()}
        done = None
        try:
            done = self.plant.step(command)
        finally:
            try:
                self.journal.add(self.state, done, clamped=clamped, mode=self.mode, **asked)
            except OSError as reason:
                self._stop_recording(reason)
        self.state = done.state
        self.ticks += 1
        self._supervise(done, phase, command)
        supervisor = self.safety.supervisor
        sensed = self._dropouts.fill(done.state, supervisor.distrusted, doubted=supervisor.doubts_orientation)
        if supervisor.heading_jumps:
            sensed = replace(sensed, quat_WB=turned_about_up(sensed.quat_WB, -supervisor.heading_jumps))
        self.sensed = sensed
        if self.sink is not None:
            self.sink(done)
        if self.progress is not None:
            self.progress(self.ticks)

    def _supervise(self, done: Tick, phase: int, command: JointCommand) -> None:
        signals = self.safety.signals
        report = StepReport(
            state=done.state,
            health=done.health,
            phase=phase,
            q_des=command.q_des,
            interrupts=signals.read(),
            hung_up=signals.hung_up,
            released=signals.released,
            terminated=signals.terminated,
        )
        self.safety.supervisor.update(report)
        self._obey()

    def _stop_recording(self, reason: OSError) -> None:
        """Go on without a log on disk: the rows stay in memory, and the robot sits down if it does not lie."""
        lies = PHASES[self._phase] == "lie"
        text = f"the log cannot be written: {reason.strerror or reason}"
        self.decide(FAILURE, SafetyMode.DAMP if lies else SafetyMode.SIT_DOWN, text)


def clamp_command(command: JointCommand, description: RobotDescription) -> tuple[JointCommand, int]:
    """Return the command inside joint limits and the motors' gains, and how many numbers were clamped."""
    inside = {
        "q_des": np.clip(command.q_des, description.q_min, description.q_max),
        "kp": np.clip(command.kp, 0.0, description.kp_max),
        "kd": np.clip(command.kd, 0.0, description.kd_max),
        "tau_ff": np.clip(command.tau_ff, -description.torque_max, description.torque_max),
    }
    clamped = sum(int(np.count_nonzero(value != getattr(command, name))) for name, value in inside.items())
    return (replace(command, **inside) if clamped else command), clamped

"""One control tick after another on any plant: what is sent, what comes back, and what is recorded of both."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mimic.policy.contract import ObservationBuilder, joint_command
from mimic.policy.runtime import Policy
from mimic.robot.leg import front_toes
from mimic.run.gaps import Gaps
from mimic.run.plant import Plant
from mimic.run.recorder import RunRecorder, health_row
from mimic.run.safety import Mode, Supervisor
from mimic.run.safety_rules import Facts
from mimic.run.signals import Signals
from mimic.run.targets_within import command_within, toes_within
from mimic.types import FloatArray, JointCommand, JointSamples, RobotState, Tick

Sink = Callable[[Tick], None]
"""Called after each tick; must not block."""


@dataclass(kw_only=True)
class Safety:
    """Supervision of a run."""

    supervisor: Supervisor
    signals: Signals
    recorder: RunRecorder | None = None
    """Where every tick goes at once."""
    ramp: float = 2.0
    """Time in which gains rise and the joints come into the lying pose [s]."""
    endless: bool = False
    """Whether the last command is held until something ends the run."""


def observation_width(*policies: Policy | None) -> int:
    """Return how many numbers the log of a run keeps of what these policies see: as many as the one that sees most."""
    return max(policy.contract.observation_size for policy in policies if policy is not None)


class Run:
    """A run on its way: the plant, its newest state, and what has been recorded."""

    def __init__(
        self,
        plant: Plant,
        width: int,
        sink: Sink | None,
        progress: Callable[[int], None] | None,
        safety: Safety | None,
    ) -> None:
        self.plant, self.sink, self.progress, self.safety = plant, sink, progress, safety
        self._width = width
        self._rows: dict[str, list[Any]] = {}
        self._health: dict[str, list[Any]] = {}
        self._events = 0
        self.samples: list[JointSamples] = []
        self.ticks = 0
        self.state: RobotState
        self.q: FloatArray
        """Joint positions (12,) [rad]; an estimate for joints that have not answered."""
        self.quat_WB: FloatArray
        """Orientation (4,); the last one known where none came."""

    def begin(self) -> None:
        """Start the plant."""
        self.state = self.plant.start()
        self._gaps = Gaps(self.plant.description)
        self.q, self.quat_WB = self._gaps.filled(self.state)

    @property
    def mode(self) -> Mode:
        """What may still be done; without supervision everything."""
        return Mode.RUN if self.safety is None else self.safety.supervisor.mode

    @property
    def interrupted(self) -> bool:
        """Whether the process was asked to end."""
        return self.safety is not None and (self.safety.signals.interrupts > 0 or self.safety.signals.terminated)

    def decide(self, rule: str, mode: Mode, text: str) -> None:
        """Take a decision of the loop itself."""
        assert self.safety is not None
        self.safety.supervisor.decide(rule, mode, text, self.state.t if self.ticks else 0.0)
        self._tell()

    def tick(
        self,
        policy: Policy,
        builder: ObservationBuilder,
        *,
        phase: int,
        v_des: FloatArray,
        heading_des: float,
        p_BE_des: FloatArray,
    ) -> None:
        """Let a policy act on the newest state, for one control step."""
        contract, clamped = policy.contract, 0
        if self.safety is not None:
            if not np.isfinite(np.concatenate([v_des, [heading_des], np.ravel(p_BE_des)])).all():
                return self.decide("not_finite", Mode.DAMP, "a target is not a number")
            v_des, p_BE_des, clamped = toes_within(v_des, p_BE_des, self.plant.description)
        observation = builder.observe(
            q=self.q, quat_WB=self.quat_WB, v_des=v_des, heading_des=heading_des, p_BE_des=p_BE_des
        )
        action = policy.act(observation)
        if self.safety is not None and not np.isfinite(action).all():
            return self.decide("not_finite", Mode.DAMP, "the policy answered with something that is not a number")
        builder.acted(action)
        q_des, zeros = joint_command(contract, action), np.zeros(12)
        gains = np.full(12, contract.kp), np.full(12, contract.kd)
        command = JointCommand(q_des=q_des, dq_des=zeros, kp=gains[0], kd=gains[1], tau_ff=zeros)
        if self.safety is not None:
            clamped += int(np.count_nonzero(np.abs(action) > contract.action_clip))
        asked = {"v_des": v_des, "heading_des": heading_des, "p_BE_des": p_BE_des}
        seen = np.full(self._width, np.nan)
        seen[: len(observation)] = observation
        self._step(command, phase, clamped, **asked, observation=seen, action=action)

    def hold(self, command: JointCommand, phase: int) -> None:
        """Send a command that no policy made, for one control step."""
        nothing = np.full(self._width, np.nan)
        asked = {"v_des": np.zeros(2), "heading_des": np.nan, "p_BE_des": np.full((2, 3), np.nan)}
        self._step(command, phase, 0, **asked, observation=nothing, action=np.full(12, np.nan))

    def _step(self, command: JointCommand, phase: int, clamped: int, **asked: Any) -> None:
        if self.safety is not None:
            command, outside = command_within(command, self.plant.description)
            clamped += outside
            if clamped:
                self.safety.supervisor.note("outside_limits", f"{clamped} numbers were clamped", self.state.t)
        state = self.state
        row: dict[str, Any] = {
            "t": state.t,
            "t_host": time.monotonic(),
            "phase": phase,
            **{name: getattr(state, name) for name in ("q", "dq", "tau", "quat_WB", "omega_B", "p_WB", "v_WB")},
            "p_BE": front_toes(state.q, self.plant.description),
            **asked,
            "q_des": command.q_des,
        }
        try:
            done = self.plant.step(command)
        except BaseException:
            if self.safety is not None:
                lost = dict.fromkeys(("q_sent", "kp", "kd"), np.full(12, np.nan))
                self._record(row | lost, health_row(None, state.t, clamped, self.mode))
            raise
        self._record(
            row | {"q_sent": done.sent.q_des, "kp": done.sent.kp, "kd": done.sent.kd},
            health_row(done.health, state.t, clamped, self.mode),
        )
        self.state = done.state
        self.ticks += 1
        if done.samples is not None:
            self.samples.append(done.samples)
        self._judge(done, phase)
        unbelieved = () if self.safety is None else self.safety.supervisor.unbelieved
        self.q, self.quat_WB = self._gaps.filled(done.state, unbelieved)
        if self.sink is not None:
            self.sink(done)
        if self.progress is not None:
            self.progress(self.ticks)

    def _judge(self, done: Tick, phase: int) -> None:
        if self.safety is None:
            return
        assert done.health is not None, "a supervised plant tells its health"
        signals = self.safety.signals
        facts = Facts(
            state=done.state,
            health=done.health,
            phase=phase,
            interrupts=signals.interrupts,
            terminated=signals.terminated,
        )
        self.safety.supervisor.judge(facts)
        self._tell()

    def _tell(self) -> None:
        """Hand new events to the recorder."""
        assert self.safety is not None
        events = self.safety.supervisor.events
        if self.safety.recorder is not None:
            for event in events[self._events :]:
                self.safety.recorder.event(event)
        self._events = len(events)

    def _record(self, row: dict[str, Any], health: dict[str, Any]) -> None:
        for columns, values in ((self._rows, row), (self._health, health)):
            for name, value in values.items():
                columns.setdefault(name, []).append(value)
        if self.safety is not None and self.safety.recorder is not None:
            self.safety.recorder.row(row, health)

    def columns(self) -> dict[str, Any]:
        """Return the columns of the RunLog."""
        return {name: np.array(values) for name, values in self._rows.items()}

    def health_columns(self) -> dict[str, Any]:
        """Return the columns of the HealthLog."""
        return {name: np.array(values) for name, values in self._health.items()}

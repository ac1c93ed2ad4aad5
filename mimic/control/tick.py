"""Control ticks on any plant: the command that is sent, inside its limits, the state that comes back, and their log."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mimic.config.play import RAMP
from mimic.control.arms import ArmGoal
from mimic.control.desired import clamp_desired
from mimic.control.dropouts import DropoutFilter
from mimic.control.plant import Plant
from mimic.control.recorder import RunRecorder, health_row
from mimic.control.safety.safety_rules import FAILURE
from mimic.control.safety.step_history import StepReport
from mimic.control.safety.supervisor import SafetyMode, Supervisor
from mimic.control.signals import Signals
from mimic.control.trunk import Trunk
from mimic.geometry import turned_about_up
from mimic.policy.contract import FRONT, ObservationBuilder, PolicyContract, joint_command
from mimic.policy.runtime import Policy
from mimic.records import JOINTS, PHASES, Command, FloatArray, JointCommand, JointSamples, RobotState, Tick
from mimic.robot.arm_torques import ArmTorques
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Asked:
    """What is asked of a policy in one control step, and what it sees."""

    phase: int
    """Index into PHASES."""
    command: Command
    """Within the robot's limits; its heading is in the world."""
    clamped: int
    """Numbers of it that were beyond them."""
    arms: ArmGoal | None
    observation: FloatArray
    """Observation (observation_size,)."""


def observation_width(*policies: Policy | None) -> int:
    """Return the width of the log's observation column: that of the policy with the largest observation."""
    return max(policy.contract.observation_size for policy in policies if policy is not None)


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
        self._width = width
        self._arm_torques = ArmTorques(plant.description)
        self._trunk = Trunk(plant.description)
        self._rows: dict[str, list[Any]] = {}
        self._health: dict[str, list[Any]] = {}
        self._events = self._phase = 0
        self.samples: list[JointSamples] = []
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
        """Record a decision of the control loop."""
        self.safety.supervisor.decide(rule, mode, text, self.state.t if self.ticks else 0.0)
        self._log_events()

    def tick(
        self,
        policy: Policy,
        builder: ObservationBuilder,
        phase: int,
        desired: Command,
        arms: ArmGoal | None = None,
    ) -> None:
        """Let a policy act on the newest state, for one control step.

        Args:
            policy: Answers.
            builder: Makes what the policy sees.
            phase: Index into PHASES.
            desired: What is asked for; its heading is in the world.
            arms: Where the front legs should be; None leaves them to the policy.
        """
        asked = self.ask(builder, phase, desired, arms)
        if asked is not None:
            self.act(asked, policy.contract, builder, policy.act(asked.observation))

    def ask(
        self, builder: ObservationBuilder, phase: int, desired: Command, arms: ArmGoal | None = None
    ) -> Asked | None:
        """Return what a policy sees of the newest state; None, and damp the robot, where a target is no number."""
        numbers = [*desired.v, desired.heading, *np.ravel(desired.p_BE), desired.height, desired.pitch]
        if not np.isfinite(np.array(numbers)).all():
            self.decide(FAILURE, SafetyMode.DAMP, "a target is not a number")
            return None
        v_des, p_BE_des, clamped = clamp_desired(desired.v, desired.p_BE, self.plant.description)
        clamped += self._trunk.advance(desired.height, desired.pitch)
        seen = self._trunk.seen(self.sensed)
        observation = builder.observe(
            q=seen.q,
            quat_WB=seen.quat_WB,
            v_des=v_des,
            heading_des=desired.heading,
            p_BE_des=p_BE_des,
            omega_B=seen.omega_B,
            dq=seen.dq,
            arms=None if arms is None else arms.seen,
        )
        command = replace(desired, v=v_des, p_BE=p_BE_des)
        return Asked(phase=phase, command=command, clamped=clamped, arms=arms, observation=observation)

    def act(self, asked: Asked, contract: PolicyContract, builder: ObservationBuilder, action: FloatArray) -> None:
        """Send what a policy answered (12,), for one control step."""
        if not np.isfinite(action).all():
            return self.decide(FAILURE, SafetyMode.DAMP, "the policy returned something that is not a number")
        builder.acted(action)
        arms = asked.arms
        q_des = joint_command(contract, action)
        dq_des = np.zeros(12)
        tau_ff = np.zeros(12)
        own = action
        if arms is not None:
            q_des[:FRONT] = arms.q
            dq_des[:FRONT] = arms.dq
            tau_ff[:FRONT] = self._given(self._arm_torques.of(arms.q, arms.dq, arms.ddq, self.sensed.quat_WB))
            own = action[FRONT:]
        command = JointCommand(
            q_des=q_des,
            dq_des=dq_des,
            kp=np.array(contract.kp),
            kd=np.array(contract.kd),
            tau_ff=tau_ff,
            ramp=contract.dt if contract.interpolate else 0.0,
        )
        command = self._trunk.added(command)
        clamped = asked.clamped + int(np.count_nonzero(np.abs(own) > contract.action_clip))
        wanted = {"v_des": asked.command.v, "heading_des": asked.command.heading, "p_BE_des": asked.command.p_BE}
        wanted["trunk_des"] = np.array(self._trunk.now)
        seen = np.full(self._width, np.nan)
        seen[: len(asked.observation)] = asked.observation
        self._step(command, asked.phase, clamped, **wanted, observation=seen, action=action)

    def _given(self, wanted: FloatArray) -> FloatArray:
        """Return torques of the front legs (6,) [N m] that the motors give; say once where more is wanted."""
        most = self.plant.description.torque_max[:FRONT]
        worst = int(np.argmax(np.abs(wanted) / most))
        if np.abs(wanted[worst]) > most[worst]:
            text = f"the motion needs {np.abs(wanted[worst]):.0f} N m at {JOINTS[worst]}, whose motor gives"
            self.safety.supervisor.note("arm_torque", f"{text} {most[worst]:g}: the toes lag there", self.state.t)
        return np.clip(wanted, -most, most)

    def hold(self, command: JointCommand, phase: int) -> None:
        """Send a command that no policy made, for one control step; a robot that lies shows the gyro's bias."""
        if PHASES[phase] == "lie":
            self._dropouts.rest(self.state)
        nothing = np.full(self._width, np.nan)
        asked = {"v_des": np.zeros(2), "heading_des": np.nan, "p_BE_des": np.full((2, 3), np.nan)}
        asked["trunk_des"] = np.full(2, np.nan)
        self._step(command, phase, 0, **asked, observation=nothing, action=np.full(12, np.nan))

    def _step(self, command: JointCommand, phase: int, clamped: int, **asked: Any) -> None:
        self._phase = phase
        command, outside = clamp_command(command, self.plant.description)
        clamped += outside
        if clamped:
            self.safety.supervisor.note("clamped", f"{clamped} numbers beyond their limits were clamped", self.state.t)
        state = self.state
        row: dict[str, Any] = {
            "t": state.t,
            "t_host": time.monotonic(),
            "phase": phase,
            **{name: getattr(state, name) for name in ("q", "dq", "tau", "quat_WB", "omega_B", "p_WB", "v_WB")},
            "p_BE": front_toes(state.q, self.plant.description),
            **asked,
            "q_des": command.position_target(),
        }
        try:
            done = self.plant.step(command)
        except BaseException:
            unsent = dict.fromkeys(("q_sent", "kp", "kd"), np.full(12, np.nan))
            self._record(row | unsent, health_row(None, state.t, clamped, self.mode))
            raise
        self._record(
            row | {"q_sent": done.sent.position_target(), "kp": done.sent.kp, "kd": done.sent.kd},
            health_row(done.health, state.t, clamped, self.mode),
        )
        self.state = done.state
        self.ticks += 1
        if done.samples is not None:
            self.samples.append(done.samples)
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
        self._log_events()

    def _log_events(self) -> None:
        """Write new events to the recorder."""
        events = self.safety.supervisor.events
        new = events[self._events :]
        self._events = len(events)
        if self.safety.recorder is not None:
            try:
                for event in new:
                    self.safety.recorder.event(event)
            except OSError as reason:
                self._stop_recording(reason)

    def _record(self, row: dict[str, Any], health: dict[str, Any]) -> None:
        for columns, values in ((self._rows, row), (self._health, health)):
            for name, value in values.items():
                columns.setdefault(name, []).append(value)
        if self.safety.recorder is not None:
            try:
                self.safety.recorder.row(row, health)
            except OSError as reason:
                self._stop_recording(reason)

    def _stop_recording(self, reason: OSError) -> None:
        """Go on without a log on disk: the rows stay in memory, and the robot sits down if it does not lie."""
        self.safety.recorder = None
        lies = PHASES[self._phase] == "lie"
        text = f"the log cannot be written: {reason.strerror or reason}"
        self.decide(FAILURE, SafetyMode.DAMP if lies else SafetyMode.SIT_DOWN, text)

    def health_so_far(self, name: str) -> FloatArray:
        """Return a column of the HealthLog up to now, (T, ...); NaN where the plant does not say."""
        return np.array(self._health.get(name, []), dtype=np.float64)

    def columns(self) -> dict[str, Any]:
        """Return the columns of the RunLog."""
        return {name: np.array(values) for name, values in self._rows.items()}

    def health_columns(self) -> dict[str, Any]:
        """Return the columns of the HealthLog."""
        return {name: np.array(values) for name, values in self._health.items()}


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

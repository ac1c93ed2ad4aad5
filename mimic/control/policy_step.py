"""Control steps of a policy: what it is asked and sees, and what its answer does to the joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mimic.control.arms import ArmGoal
from mimic.control.desired import clamp_desired
from mimic.control.safety.safety_rules import FAILURE
from mimic.control.safety.supervisor import SafetyMode
from mimic.control.tick import Run
from mimic.control.trunk import Trunk
from mimic.frozen import frozen_arrays
from mimic.policy.contract import FRONT, ObservationBuilder, PolicyContract, joint_command
from mimic.policy.runtime import Policy
from mimic.records import JOINTS, Command, FloatArray, JointCommand
from mimic.robot.arm_torques import ArmTorques
from mimic.robot.pull import StandsAgainstPull


@frozen_arrays
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


class Pilot:
    """Lets policies act in a run; the front legs and the trunk's lean are its own."""

    def __init__(self, run: Run, *, lean_against_pulls: bool = True) -> None:
        self.run = run
        self._description = run.plant.description
        self._arm_torques = ArmTorques(self._description)
        self._trunk = Trunk(self._description)
        self._pull = StandsAgainstPull(self._description) if lean_against_pulls else None

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
            self.run.decide(FAILURE, SafetyMode.DAMP, "a target is not a number")
            return None
        v_des, p_BE_des, clamped = clamp_desired(desired.v, desired.p_BE, self._description)
        seen = self.run.sensed
        lean = 0.0
        if arms is not None and self._pull is not None:
            seen = replace(seen, quat_WB=self._pull.shown(seen))
            lean = self._pull.lean
        clamped += self._trunk.advance(desired.height, desired.pitch, lean)
        seen = self._trunk.seen(seen)
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
            return self.run.decide(FAILURE, SafetyMode.DAMP, "the policy returned something that is not a number")
        builder.acted(action)
        arms = asked.arms
        q_des = joint_command(contract, action)
        dq_des = np.zeros(12)
        tau_ff = np.zeros(12)
        own = action
        if arms is not None:
            q_des[:FRONT] = arms.q
            dq_des[:FRONT] = arms.dq
            tau_ff[:FRONT] = self._given(self._arm_torques.of(arms.q, arms.dq, arms.ddq, self.run.sensed.quat_WB))
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
        beyond = int(np.count_nonzero(np.abs(own) > contract.action_clip))
        clamped = asked.clamped + beyond * self.run.safety.supervisor.moves  # of a robot that stays it says nothing
        wanted = {"v_des": asked.command.v, "heading_des": asked.command.heading, "p_BE_des": asked.command.p_BE}
        wanted["trunk_des"] = np.array(self._trunk.now)
        seen = np.full(self.run.width, np.nan)
        seen[: len(asked.observation)] = asked.observation
        self.run.step(command, asked.phase, clamped, **wanted, observation=seen, action=action)

    def _given(self, wanted: FloatArray) -> FloatArray:
        """Return torques of the front legs (6,) [N m] that the motors give; say once where more is wanted."""
        most = self._description.torque_max[:FRONT]
        worst = int(np.argmax(np.abs(wanted) / most))
        if np.abs(wanted[worst]) > most[worst]:
            text = f"the motion needs {np.abs(wanted[worst]):.0f} N m at {JOINTS[worst]}, whose motor gives"
            self.run.note("arm_torque", f"{text} {most[worst]:g}: the toes lag there")
        return np.clip(wanted, -most, most)

"""The robot as a Gymnasium environment: a policy's observation in, its action out, fifty times a second."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

try:
    import gymnasium
except ImportError:
    from mimic.errors import MissingExtra

    raise MissingExtra("gymnasium", "env") from None

from mimic.arguments import checked
from mimic.config.play import DEFAULT_ROBOT, NOMINAL, Randomisation
from mimic.control.desired import LiveMotion, StoredMotion
from mimic.control.policy_step import Asked, Pilot
from mimic.control.safety.supervisor import SafetyMode, Supervisor
from mimic.control.start import start
from mimic.control.tick import Run
from mimic.errors import ConfigError, PlantError
from mimic.evaluation.episode import OF_EPISODES, TIMING, TRACKING_RULES, of_episode
from mimic.evaluation.paper_reward import TRACKING_WEIGHTS, tracking
from mimic.evaluation.policy import command_script
from mimic.geometry import heading_from_quat
from mimic.policy.contract import ObservationBuilder
from mimic.policy.runtime import load_policy
from mimic.records import PHASES, Command, CommandTrack, LiveCommands
from mimic.robot.description import load_description
from mimic.robot.leg_kinematics import front_toes
from mimic.simulation.plant import SimulatedPlant

Observation = NDArray[np.float32]


class Env(gymnasium.Env[Observation, Observation]):
    """A robot that stands up and follows goals of its front toes, its velocity and its heading.

    An episode begins where a policy does: the robot has been brought into its crouch. For the first second it is asked
    to stand up, in the next half second its toes move to the first goal, then it follows the goals.

    The **observation** is that of the policy's contract, float32 (`mimic.policy.contract`): the policy's own output is
    an action. The goals are terms of it, as far as the contract has them; no shipped contract has a height.

    The **action** (12,) is what the policy answers: ``q_des = default_q + action_scale action`` for each joint. Where
    the contract leaves the arms to inverse kinematics, the first six numbers, of the front legs, act only until the
    toes begin to move to the first goal; from then on those legs follow their goals by themselves, and the action
    moves the hind legs.

    The **reward** of a step is the sum of the paper's terms velocity, heading, toes, height and upright, each with the
    paper's weight, at most 3.35. The episode is terminated by a fall, and truncated at the end of its time.

    ``gymnasium.vector.AsyncVectorEnv([mimic.Env] * 8)`` steps eight robots.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # as in the base class

    @checked
    def __init__(
        self,
        robot: str | Path = DEFAULT_ROBOT,
        *,
        commands: CommandTrack | LiveCommands | None = None,
        policy: str | Path | None = None,
        ranges: Randomisation = NOMINAL,
        seconds: float = 20.0,
    ) -> None:
        """Make an environment.

        Args:
            robot: A shipped robot, or the folder of another one.
            commands: What is asked for: a track, or commands that are asked for at each step, so that goals can be set
                from outside. By default each episode draws goals: toes every 3 s, velocity and heading every 10 s.
            policy: ONNX file whose contract counts; by default that of the shipped policy.
            ranges: What of the robot varies from episode to episode.
            seconds: Length of an episode [s].

        Raises:
            AssetError, ContractError: If there is no such robot or policy, or they do not fit.
            ConfigError: If the episode is too short to follow a goal.
        """
        if not TIMING.stand_up + TIMING.blend + 1.0 <= seconds < np.inf:
            raise ConfigError(f"seconds is {seconds:g}; standing up takes 1.5 s: give at least 2.5, and an end")
        self.description = load_description(robot)
        self.contract = load_policy(policy, self.description).contract
        self.commands = commands
        self.seconds = seconds
        self.plant = SimulatedPlant(self.description, ranges=ranges, **OF_EPISODES)
        size = self.contract.observation_size
        clip = self.contract.action_clip
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.action_space = gymnasium.spaces.Box(-clip, clip, (len(self.contract.joints),), np.float32)
        self._run: Run
        self._asked: Asked

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; the same seed gives the same robot, start and goals. There are no options."""
        super().reset(seed=seed)
        self.plant.restart(int(self.np_random.integers(2**31)))
        supervisor = Supervisor(self.description, rules=TRACKING_RULES)
        self._run = Run(self.plant, self.contract.observation_size, None, None, of_episode(supervisor))
        self._run.begin()
        self._pilot = Pilot(self._run)
        start(self._run)
        self._builder = ObservationBuilder(self.contract)
        self._heading = float(heading_from_quat(self._run.sensed.quat_WB))
        self._motion = self._drawn_motion()
        self._over = False
        self._ask()
        return self._seen()

    def step(self, action: Observation) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Let the robot act for one control step of 20 ms.

        Raises:
            PlantError: If the action has another shape than the space, or is not finite.
            ResetNeeded: If no episode has begun.
        """
        if not hasattr(self, "_asked"):
            raise gymnasium.error.ResetNeeded("no episode has begun; call reset before step")
        given = np.asarray(action, dtype=np.float64)
        if given.shape != self.action_space.shape:
            raise PlantError(f"the action has shape {given.shape}; expected {self.action_space.shape}")
        if not np.isfinite(given).all():
            raise PlantError(f"the action holds numbers that are not finite: {action}")
        asked = self._asked
        self._pilot.act(asked, self.contract, self._builder, given)
        reward = self._reward(asked.command)
        terminated = self._run.mode > SafetyMode.RUN
        self._ask()
        truncated = self._over or self._builder.steps * self.contract.dt > self.seconds
        seen, info = self._seen()
        return seen, reward, terminated, truncated, info

    def _drawn_motion(self) -> StoredMotion | LiveMotion:
        commands = self.commands
        if commands is None:
            commands = command_script(self.description, self.seconds, self.np_random)
        if isinstance(commands, CommandTrack):
            return StoredMotion(commands, TIMING, self.contract, self.description, over=lambda: False)
        return LiveMotion(commands, TIMING, self.contract, self.description)

    def _ask(self) -> None:
        """Take the next goals, or those of before where there are none left."""
        desired = self._motion.at(self._builder.steps, self._run.sensed.q)
        if desired is None:
            self._over = True
            return
        goal = desired.command
        command = Command(v=goal.v, heading=self._heading + goal.heading, p_BE=goal.p_BE)
        asked = self._pilot.ask(self._builder, desired.phase, command, desired.arms)
        if asked is None:
            raise ConfigError(f"the commands ask for what is not finite: {goal}")
        self._asked = asked

    def _reward(self, asked: Command) -> float:
        state = self._run.state
        terms = tracking(
            p_WB=state.p_WB,
            v_WB=state.v_WB,
            quat_WB=state.quat_WB,
            p_BE=front_toes(state.q, self.description),
            v_des=asked.v,
            heading_des=np.asarray(asked.heading),
            p_BE_des=asked.p_BE,
            step=np.asarray(self._builder.steps),
            description=self.description,
        )
        return float(sum(TRACKING_WEIGHTS[name] * value for name, value in terms.items()))

    def _seen(self) -> tuple[Observation, dict[str, Any]]:
        asked = self._asked
        toes = front_toes(self._run.state.q, self.description)
        info = {
            "phase": PHASES[asked.phase],
            "velocity": asked.command.v,
            "heading": asked.command.heading,
            "toes": asked.command.p_BE,
            "toe_error": np.linalg.norm(toes - asked.command.p_BE, axis=-1),
        }
        return asked.observation.astype(np.float32), info

"""The MDP: commands, observations, terminations and resets of all worlds, without a branch on the device's data.

Everything after the physics is element-wise tensor code over static buffers, so that on a GPU a whole control step is
two captured graphs: the physics (:mod:`mimic.train.worlds`) and the rest (here).
"""

from __future__ import annotations

import math
from dataclasses import asdict, fields
from typing import Any

import numpy as np
import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from mimic.frames import heading_sin_cos, upright_cosine
from mimic.policy.contract import (
    FRAME_SIZE,
    TERMS,
    PolicyContract,
    commanded_joints,
    observation_frame,
    push_frame,
)
from mimic.robot.description import RobotDescription, with_timestep
from mimic.robot.goals import MARGIN, leg_joints
from mimic.robot.graphs import capture_mode
from mimic.robot.leg import front_toes
from mimic.robot.model import command_in_effect
from mimic.settings import LATE, TASKS, MdpSettings
from mimic.store import plain
from mimic.train.disturbances import Disturbances, quat_multiply, quat_rotate
from mimic.train.feet import Feet, sliding
from mimic.train.rewards import Facts, reward_terms, total, weights_at
from mimic.train.schedules import GoalSchedule, MoveSchedule
from mimic.train.starts import Start, Starts
from mimic.train.worlds import Worlds
from mimic.types import JOINTS, LEGS

SWAY_SECONDS = 0.25
"""Time constant of the averaged base velocity [s]: half a gait cycle."""

DRIFT_SECONDS = 1.0
"""Time constant of the averaged velocity error [s]."""

MERCY_STEPS, EARLY_FOOT_HEIGHT, EARLY_JOINT_STEP = 30, 0.045, 0.28
"""Terminations in the first control steps: highest hind toe [m] and largest joint motion in a step [rad]; the paper's are
0.06 and 0.3, here with a margin. With 0.06 in training, three of 150 judged episodes ended with a toe at 0.06 to 0.07 m."""

STANDING = 0.7
"""Cosine between the trunk and upright from which on a front leg is told how to reach."""

CRITIC_EXTRAS = 3 + 2 + 3 + 12 + 1 + 1 + 1 + 2 + 2 + 6 + 1 + 1 + 11 + 3 + 3 + 4 + 1
"""Width of what the critic sees beyond the observation."""


def make_contract(description: RobotDescription, settings: MdpSettings, training: str = "") -> PolicyContract:
    """Return what a policy trained with these settings promises."""
    neutral = front_toes(description.poses["upright"], description)
    sits = settings.task == "sit_down"
    return PolicyContract(
        robot=description.name,
        joints=JOINTS,
        default_q=tuple(description.poses["upright"].tolist()),
        action_scale=(settings.action_scale,) * len(JOINTS),
        action_clip=settings.action_clip,
        q_min=tuple((description.q_min + settings.command_margin).tolist()),
        q_max=tuple((description.q_max - settings.command_margin).tolist()),
        kp=description.kp,
        kd=description.kd,
        dt=description.dt,
        history=settings.history,
        terms=TERMS,
        clock_hz=settings.sit_down.clock_hz if sits else settings.clock_hz,
        neutral_toes=tuple(neutral.reshape(-1).tolist()),
        stand_up_steps=settings.stand_up_steps,
        training=training,
        task=settings.task,
    )


class StandTrackEnv(VecEnv):
    """Worlds in which a robot stands up from lying, keeps a velocity and a heading, and brings its front toes to goals."""

    soft_margin = np.deg2rad(8.0)
    """A joint nearer to its limit than this costs [rad]."""

    def __init__(self, description: RobotDescription, settings: MdpSettings, device: str, seed: int) -> None:
        description = with_timestep(description, settings.timestep or description.timestep)
        self.description, self.settings = description, settings
        self._calls, self._ramp = 0, 0.0
        self.contract = make_contract(description, settings)
        self.device = device
        self.num_envs = settings.worlds
        self.num_actions = len(JOINTS)
        self.max_episode_length = settings.episode_steps
        self.cfg: Any = plain(settings)
        torch.manual_seed(seed)
        self.worlds = Worlds(description, settings, device, seed)
        self.goals = GoalSchedule(description, self.contract, settings, device, seed)
        self.moves = MoveSchedule(self.contract, settings, device)
        self._starts = Starts(description, settings, device)
        self._feet = Feet(description, device)
        self.disturbances = Disturbances(settings.disturbances, settings.worlds, description.dt, device)
        self._constants()
        self._buffers()
        self._graph: Any = None
        everyone = torch.ones(self.num_envs, dtype=torch.bool, device=device)
        self._reset(everyone)
        self.episode_length_buf.copy_(torch.randint(0, settings.episode_steps // 2, (self.num_envs,), device=device))
        self._observe(everyone, self.worlds.lowest())

    # ------------------------------------------------------------------ set-up

    def _tensor(self, values: Any) -> torch.Tensor:
        return torch.as_tensor(np.asarray(values), dtype=torch.float32, device=self.device)

    def _constants(self) -> None:
        d, c = self.description, self.contract
        self._default_q = self._tensor(c.default_q)
        self._q_min, self._q_max = self._tensor(c.q_min), self._tensor(c.q_max)
        self._near_min, self._near_max = self._tensor(d.q_min + MARGIN), self._tensor(d.q_max - MARGIN)
        self._soft_min, self._soft_max = (
            self._tensor(d.q_min + self.soft_margin),
            self._tensor(d.q_max - self.soft_margin),
        )
        self._upright = tuple(d.upright_direction.tolist())
        w = self.worlds
        self._front = w.geom_columns(
            "FL_thigh", "FL_shank", "FL_rubber", "FL_toe", "FR_thigh", "FR_shank", "FR_rubber", "FR_toe"
        )
        self._trunk = w.geom_columns("body", "head_0", "head_1", "shoulder", "_abad")
        self._hind_thighs = w.geom_columns("RL_thigh", "RR_thigh")
        self._knees = w.geom_columns("RL_rubber", "RR_rubber")
        self._front_low = w.geom_columns("FL_toe", "FR_toe", "FL_rubber", "FR_rubber")
        self._hind_toes = w.geom_columns("RL_toe", "RR_toe")
        knees = [w.mj_model.body(f"{leg}_knee").id for leg in LEGS[:2]]
        self._front_knees = slice(knees[0], knees[1] + 1, knees[1] - knees[0])
        self._floor_up = torch.tensor([[0.0, 0.0, 1.0]], device=self.device).expand(self.num_envs, 3)
        steps = self.settings.randomisation.delay
        self._delay_range = (round(steps[0] / d.timestep), round(steps[1] / d.timestep))

    def _buffers(self) -> None:
        n, device = self.num_envs, self.device

        def zeros(*shape: int) -> torch.Tensor:
            return torch.zeros(n, *shape, device=device)

        self.episode_length_buf = torch.zeros(n, dtype=torch.long, device=device)
        self._actions = zeros(12)
        self._last_action, self._before_last = zeros(12), zeros(12)
        self._commands = [zeros(12) for _ in range(3)]
        self._delay = torch.zeros(n, 1, dtype=torch.long, device=device)
        self._history = zeros(self.settings.history, FRAME_SIZE)
        self.phase_at_start = zeros()
        self._upright_start = torch.zeros(n, dtype=torch.bool, device=device)
        self._toes_at_start, self._dq_before, self._q_before = zeros(2, 3), zeros(12), zeros(12)
        self._rule_share = torch.zeros(1, device=device)
        self._policy_obs = zeros(self.settings.history * FRAME_SIZE)
        self._critic_obs = zeros(self.settings.history * FRAME_SIZE + CRITIC_EXTRAS)
        self._reaching = zeros(2, 2, 3)
        self._reward = zeros()
        self._done = torch.zeros(n, dtype=torch.bool, device=device)
        self._time_out = torch.zeros(n, dtype=torch.bool, device=device)
        self._mean_velocity, self._drift = zeros(2), zeros(2)
        start = weights_at(0.0, self._rewards, self.settings.regularisation, self._shares(0.0))
        self._weights = torch.tensor(start, device=device)
        self._terms = [f.name for f in fields(self._rewards)]
        self._log: dict[str, torch.Tensor] = {}

    def resume_at(self, steps: int) -> None:
        """Go on as if each world had already lived this many control steps; the regularisers stay grown."""
        self._calls = 240 * (steps // 240)
        self._ramp = min(max((self._calls - self.settings.ease_latest) / self.settings.ease_steps, 0.0), 1.0)

    # ------------------------------------------------------------------ the interface of rsl_rl

    def get_observations(self) -> TensorDict:
        """Return what actor (policy) and critic see of each world, and what nobody sees but the learner.

        ``reaching`` (N, 2, 2, 3): actions of the front legs that would bring their toes to where they are wanted if the
        joints followed at once, and 1 where that counts, 0 where there are none or the robot does not stand.
        """
        seen = {"policy": self._policy_obs, "critic": self._critic_obs, "reaching": self._reaching}
        return TensorDict({name: tensor.clone() for name, tensor in seen.items()}, batch_size=[self.num_envs])

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Apply actions (worlds, 12); return observations, rewards, ends, and figures for the log."""
        self._actions.copy_(actions)
        if self._calls % 240 == 0:
            progress = min(1.0, self._calls / self.settings.ramp_steps)
            ramp = self._grown()
            now = weights_at(progress, self._rewards, self.settings.regularisation, self._shares(ramp))
            self._weights.copy_(torch.tensor(now))
            self._rule_share.fill_(ramp**2)
            self._ease(ramp)
        if str(self.device).startswith("cuda"):
            self._step_captured()
        else:
            self._before_physics()
            self.worlds.step()
            self._after_physics()
        self._calls += 1
        extras: dict[str, Any] = {"time_outs": self._time_out.clone()}
        if self._calls % 12 == 0:
            extras["log"] = dict(zip(self._log, self._log_values.clone().unbind(), strict=True))
        return self.get_observations(), self._reward.clone(), self._done.long(), extras

    def _step_captured(self) -> None:
        if self._graph is None:
            side = torch.cuda.Stream()
            side.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(side):
                for _ in range(3):  # warm-up as graph capture needs it
                    self._before_physics()
                    self.worlds.step()
                    self._after_physics()
            torch.cuda.current_stream().wait_stream(side)
            before, after = torch.cuda.CUDAGraph(), torch.cuda.CUDAGraph()
            with torch.cuda.graph(before, capture_error_mode=capture_mode()):
                self._before_physics()
            with torch.cuda.graph(after, capture_error_mode=capture_mode()):
                self._after_physics()
            self._graph = (before, after)
            return
        before, after = self._graph
        before.replay()
        self.worlds.step()
        after.replay()

    # ------------------------------------------------------------------ one control step

    def _before_physics(self) -> None:
        c = self.contract
        action = torch.clamp(torch.nan_to_num(self._actions), -c.action_clip, c.action_clip)
        self._before_last.copy_(self._last_action)
        self._last_action.copy_(action)
        newest, before, before_that = self._commands
        before_that.copy_(before)
        before.copy_(newest)
        asked = commanded_joints(action, self._default_q, self.settings.action_scale, self._q_min, self._q_max, torch)
        arrives, motors = self.disturbances.arrives(), self.worlds.motors
        if motors is not None:
            arrives = arrives & motors.arrives()
        newest.copy_(torch.where(arrives, asked, before))
        self._pull()
        if motors is not None:
            motors.time.copy_(self.episode_length_buf[:, None] * c.dt)
            motors.send(newest)
            self.worlds.substep_ctrl.copy_(torch.stack(motors.targets(self._delay)))
            return
        for k in range(self.worlds.decimation):
            ctrl = command_in_effect(k, self.worlds.decimation, self._delay, newest, before, before_that, torch.where)
            self.worlds.substep_ctrl[k].copy_(ctrl)

    def _delay_seen(self) -> torch.Tensor:
        """Return the delay of each world in steps of 5 ms (N, 1), in which the critic has always seen it."""
        motors = self.worlds.motors
        steps = self._delay.float() if motors is None else motors.delay(self._delay).mean(-1, keepdim=True)
        return steps * (self.description.timestep / 0.005)

    def _pull(self) -> None:
        """Drag the front toes: a force at the toe is the same force at the lower leg's centre of mass, and its moment."""
        w = self.worlds
        force = self.disturbances.pull(self.episode_length_buf)
        lever = w.site_xpos[:, self._front_sites] - w.xipos[:, self._front_knees]
        moment = torch.linalg.cross(lever, force)
        w.xfrc_applied[:, self._front_knees].copy_(torch.nan_to_num(torch.cat([force, moment], -1)))

    def _grown(self) -> float:
        """Return how much of what makes the task hard is there by now, 0 to 1; asked every 240 steps."""
        falls = float(self._log["track/falls"]) if "track/falls" in self._log else 1.0  # waits for the device
        if self._calls and (falls < self.settings.ease_falls or self._calls > self.settings.ease_latest):
            self._ramp = min(self._ramp + 240 / self.settings.ease_steps, 1.0)
        return self._ramp

    def _ease(self, ramp: float) -> None:
        """Set what grows as the robot learns to stand, for the share of the ramp that is done."""
        s = self.settings
        share = s.calm_share + (1 - s.calm_share) * ramp
        self.worlds.ease(share)
        self.disturbances.share.fill_(share)
        self._starts.upright_share.fill_(s.upright_share_at_first + (s.upright_share - s.upright_share_at_first) * ramp)

    def _measure(self) -> None:
        """Work out, once for each state, what many look at.

        ``quat_WB`` is the orientation of the base in the true world, whose z is up also where the ground is inclined.
        """
        w = self.worlds
        self._quat_WB = quat_multiply(w.slope_quat, w.qpos[:, 3:7])
        self._heading = torch.arctan2(*heading_sin_cos(*self._quat()))
        self._up = upright_cosine(*self._quat(), heading=self._heading, direction=self._upright, xp=torch)
        self._toes = front_toes(w.qpos[:, 7:], self.description, torch)

    def _quat(self) -> tuple[torch.Tensor, ...]:
        return self._quat_WB.unbind(-1)

    def _velocity(self) -> torch.Tensor:
        """Base velocity forward and left in the heading frame (N, 2) [m/s]."""
        v, cosine, sine = self.worlds.qvel, torch.cos(self._heading), torch.sin(self._heading)
        return torch.stack([cosine * v[:, 0] + sine * v[:, 1], -sine * v[:, 0] + cosine * v[:, 1]], -1)

    def _tracking(self) -> torch.Tensor:
        return self._upright_start | (self.episode_length_buf > self.settings.stand_up_steps)

    def _rising(self) -> torch.Tensor:
        return torch.clamp(self.episode_length_buf * self.contract.dt / self.settings.rise_seconds, max=1.0)

    def _after_physics(self) -> None:
        w = self.worlds
        finite = torch.isfinite(w.qpos).all(-1) & torch.isfinite(w.qvel).all(-1) & (w.qvel.abs().amax(-1) < 300.0)
        w.qpos.copy_(torch.nan_to_num(w.qpos, nan=0.0, posinf=0.0, neginf=0.0))
        w.qvel.copy_(torch.nan_to_num(w.qvel, nan=0.0, posinf=0.0, neginf=0.0))
        self.episode_length_buf.add_(1)
        self._measure()
        self._command()
        low = w.lowest()
        terms, failed, figures = self._judge(finite, low)
        reward = self.settings.reward_scale * total(terms, self._weights, self._terms)
        self._reward.copy_(torch.where(finite, torch.nan_to_num(reward), torch.zeros_like(reward)))
        self._time_out.copy_((self.episode_length_buf >= self.max_episode_length) & ~failed & finite)
        self._done.copy_(failed | self._time_out | ~finite)
        self._dq_before.copy_(w.qvel[:, 6:])
        self._q_before.copy_(w.qpos[:, 7:])
        self._remember(terms, figures, finite)
        self._push()
        self._reset(self._done)
        self._observe(self._done, low)

    # ------------------------------------------------------------------ what another task does otherwise

    @property
    def _rewards(self) -> Any:
        """The weights of the task's reward terms."""
        return self.settings.rewards

    def _shares(self, ramp: float) -> dict[str, float]:
        """Return the share of their weight that terms have by now, for the share of the ramp that is done."""
        s = self.settings
        shares = {
            **dict.fromkeys(LATE, s.late_share + (1 - s.late_share) * ramp),
            **dict.fromkeys(TASKS, s.task_share + (1 - s.task_share) * ramp),
        }
        begin, end = s.finish_steps
        finished = min(max((self._calls - begin) / (end - begin), 0.0), 1.0)
        polish = {name: 1 + (factor - 1) * finished for name, factor in asdict(s.finish).items()}
        return shares | {name: shares.get(name, 1.0) * factor for name, factor in polish.items()}

    def _draw(self) -> Start:
        """Return a start for every world."""
        return self._starts.draw()

    def _command(self) -> None:
        """Let goals and velocity commands go on by a control step."""
        first = (self.episode_length_buf == self.settings.stand_up_steps + 1) & ~self._upright_start
        self.goals.advance(self._tracking(), first, self._toes)
        self.moves.advance()

    def _judge(
        self, finite: torch.Tensor, low: torch.Tensor
    ) -> tuple[dict[str, torch.Tensor], torch.Tensor, dict[str, torch.Tensor]]:
        """Return the reward terms, which worlds failed (N,), and figures for the log."""
        facts = self._facts(finite, low)
        return reward_terms(facts, self.settings), facts.fallen, self._figures(facts)

    def _first_phase(self, start: Start) -> torch.Tensor:
        """Return the gait phase (N,) at the first step [rad]."""
        return self._uniform(-math.pi, math.pi)

    # ------------------------------------------------------------------ the tracking task

    # sites: imu, then a toe for each leg
    _toe_sites, _front_sites, _hind_sites = slice(1, 5), slice(1, 3), slice(3, 5)

    def _facts(self, finite: torch.Tensor, low: torch.Tensor) -> Facts:
        w = self.worlds
        heading, up = self._heading, self._up
        step = self.episode_length_buf
        toes = w.site_xpos[:, self._toe_sites]
        hind = w.site_xpos[:, self._hind_sites]
        self._toes_at_start.copy_(torch.where((step == 1)[:, None, None], hind, self._toes_at_start))
        rising_up = ~self._upright_start & (step <= MERCY_STEPS)
        shift = (hind - self._toes_at_start).norm(dim=-1).mean(-1) * rising_up
        motion = self._feet.motion(w.qpos[:, 3:7], w.qvel[:, :3], w.qvel[:, 3:6], w.qpos[:, 7:], w.qvel[:, 6:])
        slip = sliding(toes[..., 2], *motion, below=self.settings.slip_height)
        height = w.qpos[:, 2]
        velocity = self._velocity()
        self._mean_velocity.add_((velocity - self._mean_velocity) * (self.contract.dt / SWAY_SECONDS))
        error = self.moves.heading - heading
        error = torch.arctan2(torch.sin(error), torch.cos(error))
        tracking = self._tracking()
        astray = velocity - self.moves.velocity - self._drift
        self._drift.add_(astray * (self.contract.dt / DRIFT_SECONDS)).mul_(tracking[:, None])
        grounded = (low[:, self._front].amin(-1) < 0.002) | (low[:, self._trunk].amin(-1) < 0.002)
        grounded |= low[:, self._hind_thighs].amin(-1) < 0.002
        fallen = tracking & (grounded | (height < 0.16) | (up < 0.3))
        q, dq = w.qpos[:, 7:], w.qvel[:, 6:]
        near = ((q < self._near_min) | (q > self._near_max)).any(-1) & (step > 3)
        early = rising_up & (step > 3)
        high = early & (hind[..., 2].amax(-1) > EARLY_FOOT_HEIGHT)
        jump = early & ((q - self._q_before).abs().amax(-1) > EARLY_JOINT_STEP)
        touch = ~self._upright_start & (step > MERCY_STEPS) & ~tracking & grounded
        broken = near | high | jump | touch
        fallen = finite & (fallen | (broken & (self._rand() < self._rule_share)))
        excess = torch.clamp(self._soft_min - q, min=0.0) + torch.clamp(q - self._soft_max, min=0.0)
        ddq = (dq - self._dq_before) / self.contract.dt
        ddq = torch.where((self.episode_length_buf > 1)[:, None], ddq, torch.zeros_like(ddq)).clamp(-2000, 2000)
        return Facts(
            height=height,
            up=up,
            velocity_error=velocity - self.moves.velocity,
            mean_velocity_error=self._mean_velocity - self.moves.velocity,
            drift=self._drift,
            moving=(self.moves.velocity.abs().sum(-1) > 0.05) | (error.abs() > self.settings.turn_threshold),
            heading_error=error,
            rising=torch.where(self._upright_start, torch.ones_like(height), self._rising()),
            toe_error=self._toes - self.goals.now,
            tracking=tracking.float(),
            contact=low[:, self._hind_toes] < 0.003,
            clearance=low[:, self._hind_toes],
            slip=slip,
            hind_speed=motion[0][:, 2:].norm(dim=-1),
            foot_shift=shift,
            rules_broken=near.float() + high.float() + jump.float() + touch.float(),
            phase=self._phase(),
            low=(low[:, self._front_low] < 0.03).float().sum(-1) + (low[:, self._knees] < 0.03).float().sum(-1),
            action_change=self._last_action - self._before_last,
            torque=w.motor_torque,
            dq=dq.clamp(-50, 50),
            ddq=ddq,
            limit_excess=excess,
            fallen=fallen,
        )

    def _figures(self, f: Facts) -> dict[str, torch.Tensor]:
        tracking = f.tracking
        count = tracking.sum().clamp(min=1.0)
        return {
            "track/up": (f.up * tracking).sum() / count,
            "track/height": (f.height * tracking).sum() / count,
            "track/toe_error_cm": 100 * (f.toe_error.norm(dim=-1).mean(-1) * tracking).sum() / count,
            "track/mean_velocity_error": (f.mean_velocity_error.norm(dim=-1) * tracking).sum() / count,
            "track/velocity_error": (f.velocity_error.norm(dim=-1) * tracking).sum() / count,
            "track/drift": (f.drift.norm(dim=-1) * tracking).sum() / count,
            "track/heading_error": (f.heading_error.abs() * tracking).sum() / count,
            "track/falls": (f.fallen.float() * tracking).sum() / count,
            "track/slip": (f.slip * tracking).sum() / count,
            "track/rules": (f.rules_broken * tracking).sum() / count,
            "rise/slip": (f.slip * (1 - tracking)).sum() / (1 - tracking).sum().clamp(min=1.0),
            "rise/rules": (f.rules_broken * (1 - tracking)).sum() / (1 - tracking).sum().clamp(min=1.0),
            "track/rule_share": self._rule_share.mean(),
            "track/knee_torque": (f.torque[:, 8::3].abs().mean(-1) * tracking).sum() / count,
        }

    def _remember(self, terms: dict[str, torch.Tensor], figures: dict[str, torch.Tensor], finite: torch.Tensor) -> None:
        # stacked, since on a GPU a launch costs more than the numbers
        means = torch.stack([value.float() for value in terms.values()]).mean(-1)
        others = torch.stack([*figures.values(), 1 - finite.float().mean()])
        values = torch.cat([means, others])
        if not self._log:
            names = [*(f"reward/{name}" for name in terms), *figures, "track/non_finite"]
            self._log_values = values.clone()
            self._log = dict(zip(names, self._log_values.unbind(), strict=True))
        self._log_values.copy_(values)

    def _phase(self) -> torch.Tensor:
        rate = 2 * math.pi * self.contract.clock_hz * self.contract.dt
        return self.phase_at_start + rate * self.episode_length_buf

    # ------------------------------------------------------------------ chance and pushes

    def _rand(self, *shape: int) -> torch.Tensor:
        return torch.rand(self.num_envs, *shape, device=self.device)

    def _uniform(self, low: float, high: float, *shape: int) -> torch.Tensor:
        return low + (high - low) * self._rand(*shape)

    def _push(self) -> None:
        r = self.settings.randomisation
        every = round(r.push_interval / self.contract.dt)
        due = (self.episode_length_buf % every == 0) & (self.episode_length_buf > self.settings.stand_up_steps)
        angle, speed = self._uniform(-math.pi, math.pi), self._uniform(*r.push) * self.disturbances.share
        kick = torch.stack([speed * torch.cos(angle), speed * torch.sin(angle)], -1)
        self.worlds.qvel[:, :2].add_(torch.where(due[:, None], kick, torch.zeros_like(kick)))

    # ------------------------------------------------------------------ resets and observations

    def _reset(self, mask: torch.Tensor) -> None:
        w, start = self.worlds, self._draw()

        def put(buffer: torch.Tensor, value: torch.Tensor) -> None:
            where = mask.view(-1, *[1] * (buffer.dim() - 1))
            buffer.copy_(torch.where(where, value, buffer))

        put(w.qpos, start.qpos)
        put(w.qvel, start.qvel)
        self._measure()
        for command in self._commands:
            put(command, start.command)
        for buffer in (w.warmstart, self._last_action, self._before_last, self._mean_velocity, self._drift):
            put(buffer, torch.zeros_like(buffer))
        low, high = self._delay_range
        put(self._delay, torch.randint_like(self._delay, low, high + 1))
        if w.motors is not None:
            w.motors.reset(mask, w.qpos[:, 7:], w.qvel[:, 6:], start.command)
        put(self._upright_start, start.upright)
        put(self.phase_at_start, self._first_phase(start))
        self.disturbances.reset(mask)
        put(self._q_before, start.q)
        put(self.episode_length_buf, torch.zeros_like(self.episode_length_buf))
        self.moves.reset(mask, start.heading)
        self.goals.reset(mask, start.upright, self._toes)

    def _observe(self, fresh: torch.Tensor, low: torch.Tensor) -> None:
        s, w = self.settings, self.worlds
        n = self.num_envs
        frame = observation_frame(
            q_offset=w.read_q - self._default_q,
            quat_WB=quat_multiply(self._quat_WB, self.disturbances.mount),
            last_action=self._last_action,
            v_des=self.moves.velocity,
            heading_des=self.moves.heading,
            toes_des=self.goals.now.reshape(n, 6),
            phase=self._phase(),
            xp=torch,
        )
        noisy = frame.clone()
        noisy[:, :12] += self._uniform(-s.noise_q, s.noise_q, 12)
        noisy[:, 12:18] += self._uniform(-s.noise_axes, s.noise_axes, 6)
        pushed = push_frame(self._history, noisy, torch)
        first = noisy[:, None, :].expand_as(pushed)
        self._history.copy_(torch.where(fresh[:, None, None], first, pushed))
        self._policy_obs.copy_(self._history.reshape(n, -1))
        feet = low[:, self._hind_toes]
        extras = [
            torch.cat([self._velocity(), w.qvel[:, 2:3]], -1),
            self._mean_velocity,
            w.qvel[:, 3:6].clamp(-20, 20) * 0.3,
            w.qvel[:, 6:].clamp(-40, 40) * 0.1,
            w.qpos[:, 2:3] * 3,
            self._up[:, None],
            (self._delay_seen() - 3.5) * 0.3,
            (feet < 0.003).float(),
            feet.clamp(max=0.2) * 10,
            (self._toes - self.goals.now).reshape(n, 6) * 5,
            self._tracking().float()[:, None],
            torch.clamp(self.episode_length_buf.float() / s.stand_up_steps, max=2.0)[:, None],
            w.features,
            quat_rotate(w.qpos[:, 3:7], self._floor_up, inverse=True),
            quat_rotate(self._quat_WB, self._floor_up, inverse=True),
            (self.disturbances.pull(self.episode_length_buf)[..., :2] * 0.2).reshape(n, 4),
            self.disturbances.lost_share * 10,
        ]
        seen = torch.cat(
            [self._policy_obs, *extras], -1
        )  # shapes of a world that exploded are known again after a step
        self._critic_obs.copy_(torch.nan_to_num(seen).clamp(-50, 50))
        self._show_reaching()

    def _show_reaching(self) -> None:
        """Put the front legs' closed form for the toe goals of now where the learner finds it."""
        q, excess = leg_joints(self.goals.now, self.description, torch)
        actions = (q - self._default_q[:6].view(2, 3)) / self.settings.action_scale
        counts = (excess <= 0) & (self._tracking() & (self._up > STANDING))[:, None]
        counts = counts[..., None].expand_as(actions)
        self._reaching[:, 0].copy_(torch.where(counts, actions, torch.zeros_like(actions)))
        self._reaching[:, 1].copy_(counts)

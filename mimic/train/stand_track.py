"""The MDP of all worlds, without a branch on the device's data, and the first task: standing up and tracking.

Everything after the physics is element-wise tensor code over static buffers, so that on a GPU a whole control step is
two captured graphs: the physics (`mimic.train.worlds`) and the rest (here).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor
from torch.nn.functional import pad

from mimic.config.training import MdpSettings
from mimic.dynamics.robot_model import command_in_effect
from mimic.errors import ConfigError
from mimic.geometry import heading_sin_cos, turned_by, upright_cosine, without_pitch, without_pitch_rate
from mimic.io.store import plain
from mimic.policy.contract import (
    AVERAGED,
    FRONT,
    INVERSE_KINEMATICS,
    arm_reference,
    commanded_joints,
    heading_error,
    next_gait,
    observation_frame,
    push_frame,
    with_slow_mean,
)
from mimic.records import JOINTS, LEGS
from mimic.robot.arm_torques import ArmTorques
from mimic.robot.description import RobotDescription, with_timestep
from mimic.robot.goals import MARGIN
from mimic.robot.leg_kinematics import front_toes
from mimic.robot.pull import BEGINS, SMOOTHING, PullBalance
from mimic.train import rewards
from mimic.train.contract import ACTION_CLIP, STAND_UP_STEPS, make_contract
from mimic.train.cuda_graphs import Replayed
from mimic.train.disturbances import Disturbances
from mimic.train.rewards import BEARS
from mimic.train.schedules import ArmSchedule, MoveSchedule, TrunkSchedule
from mimic.train.starts import Start, Starts
from mimic.train.tensors import Chance, in_heading_frame, put, quat_apply_inverse, quat_multiply
from mimic.train.weights import REWARD_SCALE, passed, weights_at
from mimic.train.worlds import Worlds

CRITIC_EXTRAS = 66
"""Width of what the critic sees beyond the observation; `_observe` lists it."""

CRITIC_TRUNK = 5.0
"""Units of what the critic sees a metre of the trunk's height, and a rad of its pitch."""

RISE_SECONDS = 0.7
"""Time that standing up should take [s]; faster and slower both cost."""

PUSHED_SIDEWAYS = 0.4
"""Share of the pushes that come from within 30 degrees of straight from the side, besides those from anywhere."""

SWAY_SECONDS = 0.25
"""Time constant of the averaged base velocity [s]: half a gait cycle."""

GRACE_STEPS = 30
"""Control steps in which a rising robot may touch the ground, but not lift a hind toe high or move a joint fast; as in
the paper, whose limits are 0.06 m and 0.3 rad (the description's are lower)."""

CAPTURE_REACH = 0.05
"""How far a capture point that has left the feet is before or behind the line between them [m]."""


def kept_tensors(value: Any) -> dict[Any, Tensor]:
    """Return the tensors of an attribute that have memory of their own."""
    if not isinstance(value, dict):
        several: Any = value if isinstance(value, (list, tuple)) else [value]
        value = dict(enumerate(several))
    return {key: t for key, t in value.items() if isinstance(t, Tensor) and 0 not in t.stride()}


Judged = tuple[dict[str, Tensor], Tensor, dict[str, Tensor]]


def mean(values: Tensor, weights: Tensor) -> Tensor:
    """Return the mean of values (N,) with these weights (N,)."""
    return (values * weights).sum() / weights.sum().clamp(min=1.0)


class HindToes(NamedTuple):
    """How the hind toes are and move."""

    clearance: Tensor
    """Height above the ground (N, 2) [m]."""
    contact: Tensor
    """1 on the ground (N, 2)."""
    speed: Tensor
    """Horizontal (N, 2) [m/s]."""
    slip: Tensor
    """Of all toes (N,), see `mimic.train.rewards.slip`."""


class StandTrackEnv(VecEnv, Chance):
    """Worlds, as rsl_rl steps them, in which a robot stands up, walks and turns as asked while its arms move."""

    soft_margin = np.deg2rad(8.0)
    """A joint nearer to its limit than this costs [rad]."""

    def __init__(self, description: RobotDescription, settings: MdpSettings, device: str, seed: int) -> None:
        description = with_timestep(description, settings.timestep or description.timestep)
        self.description = description
        self.settings = settings
        self._calls = 0
        self._ramp = 0.0
        self.contract = make_contract(description, settings)
        self.device = device
        Chance.__init__(self, settings.worlds, device)
        self.num_envs = settings.worlds
        self.num_actions = len(JOINTS)
        self.max_episode_length = settings.episode_steps
        self.cfg: Any = plain(settings)
        torch.manual_seed(seed)
        self.worlds = Worlds(description, settings, device, seed)
        self.arms = ArmSchedule(description, self.contract, settings, device, seed)
        self._arm_torques = ArmTorques(description, torch, device)
        self.trunk = TrunkSchedule(description, self.contract, settings, device)
        self._balance = PullBalance(description)
        self._drives_arms = self.contract.arms == INVERSE_KINEMATICS
        self.moves = MoveSchedule(self.contract, settings, device)
        self._starts = Starts(description, settings, device)
        self.disturbances = Disturbances(settings, description.dt, device, self.worlds.quiet)
        self._constants()
        self._buffers()
        self._before = Replayed(self._before_physics, device)
        self._after = Replayed(self._after_physics, device)
        everyone = torch.ones(self.num_envs, dtype=torch.bool, device=device)
        self._reset(everyone)
        self.episode_length_buf.copy_(torch.randint(0, settings.episode_steps // 2, (self.num_envs,), device=device))
        self._observe(everyone, self.worlds.lowest())

    def _constants(self) -> None:
        d = self.description
        c = self.contract
        self._default_q = self._tensor(c.default_q)
        self._kp = self._tensor(c.kp[:FRONT])
        self._kd = self._tensor(c.kd[:FRONT])
        self._q_min = self._tensor(c.q_min)
        self._q_max = self._tensor(c.q_max)
        self._near_min = self._tensor(d.q_min + MARGIN)
        self._near_max = self._tensor(d.q_max - MARGIN)
        self._soft_min = self._tensor(d.q_min + self.soft_margin)
        self._soft_max = self._tensor(d.q_max - self.soft_margin)
        self._rated = self._tensor(d.torque_rated)
        self._peak = self._tensor(d.torque_max)
        self._upright = tuple(d.upright_direction.tolist())
        self._lying_angle = math.asin(self._upright[2])  # between base x, level, and the upright direction
        w = self.worlds
        front = LEGS[:2]
        hind = LEGS[2:]
        self._grounding = torch.cat(
            [
                w.columns("thigh", "shank", "knee", "toe", legs=front),
                w.columns("trunk", "head", "shoulder", "abad"),
                w.columns("thigh", legs=hind),
            ]
        )
        self._near_ground = torch.cat([w.columns("toe", "knee", legs=front), w.columns("knee", legs=hind)])
        self._hind_toes = w.columns("toe", legs=hind)
        knees = [w.mj_model.body(f"{leg}_knee").id for leg in LEGS[:2]]
        self._front_knees = slice(knees[0], knees[1] + 1, knees[1] - knees[0])
        self._floor_up = torch.tensor([[0.0, 0.0, 1.0]], device=self.device).expand(self.num_envs, 3)
        half = np.zeros(c.frame_size - len(c.columns("slow_mean")))
        for name, width in c.noise:
            half[c.columns(name)] = width
        self._noise_half = self._tensor(half)
        self._averaged = torch.as_tensor(c.columns(*AVERAGED), device=self.device)

    def _buffers(self) -> None:
        n = self.num_envs
        device = self.device
        zeros = self._zeros
        self.episode_length_buf = zeros(dtype=torch.long)
        self._actions = zeros(12)
        self._last_action = zeros(12)
        self._before_last = zeros(12)
        self._commands = [zeros(12) for _ in range(4)]
        self._delay = zeros(1, dtype=torch.long)
        self._history = zeros(self.settings.history, self.contract.frame_size)
        self.phase_at_start = zeros()
        self._gait = zeros()
        self._noise = zeros()
        self._upright_start = zeros(dtype=torch.bool)
        self._heading = zeros()
        self._toes_at_start = zeros(2, 3)
        self._dq_before = zeros(12)
        self._q_before = zeros(12)
        self._termination_share = torch.zeros(1, device=device)
        seen = self.contract.observation_size
        self._policy_obs = zeros(seen)
        self._critic_obs = zeros(seen + CRITIC_EXTRAS)
        self._own = zeros(12) + 1.0
        self._known = zeros()
        self._reward = zeros()
        self._load = zeros(2)
        self._felt = zeros(2, 3)
        self._done = zeros(dtype=torch.bool)
        self._time_out = zeros(dtype=torch.bool)
        self._mean_velocity = zeros(2)
        self._anchor = zeros(2)
        self._slow = zeros(len(self._averaged))
        self._rank = torch.linspace(0.0, 1.0 - 1.0 / n, n, device=device)[torch.randperm(n, device=device)]
        self._rest_share = torch.full((1,), passed(self._calls, self.settings.rest_steps), device=device)
        weights = weights_at(self.settings, self._calls, self._ramp)
        self._rewarded = list(weights)
        self._weights = torch.tensor(list(weights.values()), device=device)
        self._log: dict[str, Tensor] = {}

    def resume_at(self, steps: int) -> None:
        """Go on as if each world had already lived this many control steps; the regularisers stay grown."""
        self._calls = 240 * (steps // 240)
        begin = self.settings.curriculum_latest
        self._ramp = passed(self._calls, (begin, begin + self.settings.curriculum_steps))

    def progress(self) -> dict[str, Any]:
        """Return how far the curriculum has come."""
        return {"calls": self._calls, "ramp": self._ramp, "log": {k: float(v) for k, v in self._log.items()}}

    def resume(self, progress: dict[str, Any]) -> None:
        """Go on with a curriculum, with worlds that begin anew."""
        self._calls = 240 * (progress["calls"] // 240)
        self._ramp = progress["ramp"]
        if progress["log"]:
            self._log_values = torch.tensor(list(progress["log"].values()), device=self.device)
            self._log = dict(zip(progress["log"], self._log_values.unbind(), strict=True))

    def state(self) -> dict[str, Any]:
        """Return all that the next step depends on: every tensor of the worlds, and the generators of chance."""
        generators = {"cpu": torch.get_rng_state()}
        if str(self.device).startswith("cuda"):
            generators["cuda"] = torch.cuda.get_rng_state(self.device)
        tensors = {name: tensor.clone() for name, tensor in self._tensors().items()}
        return {"progress": self.progress(), "tensors": tensors, "generators": generators}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on exactly from a state of as many worlds of the same settings.

        Raises:
            ConfigError: If it is of others.
        """
        self.resume(state["progress"])
        self._calls = state["progress"]["calls"]
        there = state["tensors"]
        for name, tensor in self._tensors().items():
            if name not in there:
                continue
            if there[name].shape != tensor.shape:
                raise ConfigError(
                    f"the worlds that were kept have {name} of shape {tuple(there[name].shape)}; the settings have "
                    f"{tuple(tensor.shape)}; remove their files to begin with new worlds"
                )
            tensor.copy_(there[name])
        torch.set_rng_state(state["generators"]["cpu"].cpu())
        if "cuda" in state["generators"]:
            torch.cuda.set_rng_state(state["generators"]["cuda"].cpu(), self.device)

    def _tensors(self) -> dict[str, Tensor]:
        owners = {
            "": self,
            "worlds": self.worlds,
            "arms": self.arms,
            "moves": self.moves,
            "trunk": self.trunk,
            "starts": self._starts,
        }
        owners |= {"disturbances": self.disturbances, "motors": self.worlds.motors}
        found: dict[str, Tensor] = {}
        for owner, holder in owners.items():
            for name, value in vars(holder).items() if holder is not None else ():
                for key, tensor in kept_tensors(value).items():
                    found[f"{owner}.{name}.{key}"] = tensor
        return found

    def get_observations(self) -> TensorDict:
        """Return what actor (policy) and critic see, and 1 for actions that count, else 0 (own, N, 12)."""
        seen = {"policy": self._policy_obs, "critic": self._critic_obs, "own": self._own}
        return TensorDict({name: tensor.clone() for name, tensor in seen.items()}, batch_size=[self.num_envs])

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        """Apply actions (worlds, 12); return observations, rewards, ends, and figures for the log."""
        self._actions.copy_(actions)
        if self._calls % 240 == 0:
            self._set_difficulty()
            self._weights.copy_(torch.tensor(list(weights_at(self.settings, self._calls, self._ramp).values())))
        self._before()
        self.worlds.step()
        self._after()
        self._calls += 1
        extras: dict[str, Any] = {"time_outs": self._time_out.clone()}
        if self._calls % 12 == 0:
            extras["log"] = dict(zip(self._log, self._log_values.clone().unbind(), strict=True))
        return self.get_observations(), self._reward.clone(), self._done.long(), extras

    def _before_physics(self) -> None:
        c = self.contract
        action = torch.clamp(torch.nan_to_num(self._actions), -ACTION_CLIP, ACTION_CLIP) * self._own
        self._before_last.copy_(self._last_action)
        self._last_action.copy_(action)
        for age in reversed(range(1, len(self._commands))):
            self._commands[age].copy_(self._commands[age - 1])
        newest, before, *_ = self._commands
        asked = commanded_joints(action, self._default_q, self.settings.action_scale, self._q_min, self._q_max, torch)
        asked = torch.clamp(asked + self.trunk.targets, self._q_min, self._q_max)
        if self._drives_arms:
            driven = torch.cat([self._arm_targets(), asked[:, FRONT:]], -1)
            asked = torch.where(self._own > 0.0, asked, driven)
        arrives = self.disturbances.arrives()
        motors = self.worlds.motors
        if motors is not None:
            arrives = arrives & motors.arrives()
        newest.copy_(torch.where(arrives, asked, before))
        self._pull()
        if motors is not None:
            motors.time.copy_(self.episode_length_buf[:, None] * c.dt)
            motors.send(newest, self._delay)
            return
        n = self.worlds.decimation
        for k in range(n):
            acting = command_in_effect(k, n, self._delay, self._commands, torch.where, interpolate=True)
            self.worlds.substep_ctrl[k].copy_(acting)

    def _arm_targets(self) -> Tensor:
        """Return the position targets of the front legs (N, 6) [rad]; see mimic.control.arms."""
        w = self.worlds
        arms = self.arms
        q, dq, ddq = (value[:, 0] for value in (arms.q, arms.dq, arms.ddq))
        tau = self._arm_torques.of(q, dq, ddq, quat_multiply(w.slope_quat, w.qpos[:, 3:7]))
        peak = self._peak[:FRONT]
        return q + (self._kd * dq + torch.clamp(tau, -peak, peak)) / self._kp

    def _pull(self) -> None:
        """Drag the front toes: a force at a toe is that force at the lower leg's centre of mass, and its moment."""
        w = self.worlds
        toes = w.toes[:, :2]
        force = self.disturbances.pull
        self.disturbances.advance(self.episode_length_buf, toes, self._heading)
        moment = torch.linalg.cross(toes - w.xipos[:, self._front_knees], force)
        w.xfrc_applied[:, self._front_knees].copy_(torch.nan_to_num(torch.cat([force, moment], -1)))
        share = self.contract.dt / (SMOOTHING + self.contract.dt)
        self._felt.add_(share * (force - self._felt))

    def _measure(self) -> None:
        """Work out, once for each state, what many look at.

        ``quat_WB`` is the orientation of the base in the true world, whose z is up also where the ground is inclined,
        as if the trunk were not leant and nobody pulled at the robot; the heading is the true one.
        """
        w = self.worlds
        quat = without_pitch(quat_multiply(w.slope_quat, w.qpos[:, 3:7]), self.trunk.now.asked[:, 1], torch)
        self._heading.copy_(torch.arctan2(*heading_sin_cos(*quat.unbind(-1))))  # both captured graphs read it
        from_feet = torch.nan_to_num(w.toes[:, :2] - w.toes[:, 2:].mean(1, keepdim=True))
        counts = self._stands_against_pulls().float()[:, None, None]
        self._quat_WB = turned_by(quat, self._balance.turn(counts * self._felt, from_feet, self._heading, torch), torch)
        shown = torch.arctan2(*heading_sin_cos(*self._quat()))
        self._up = upright_cosine(*self._quat(), heading=shown, direction=self._upright, xp=torch)

    def _stands_against_pulls(self) -> Tensor:
        """Return where a pull counts (N,): not yet where the arms have just begun to move, nor where a hand leads."""
        since = self.episode_length_buf - STAND_UP_STEPS * (~self._upright_start)
        return (since * self.contract.dt > BEGINS) & ~self.disturbances.led & self._drives_arms

    def _quat(self) -> tuple[Tensor, ...]:
        return self._quat_WB.unbind(-1)

    def _velocity(self) -> Tensor:
        """Base velocity forward and left in the heading frame (N, 2) [m/s], less that of leaning."""
        velocity = in_heading_frame(self.worlds.qvel[:, :2], self._heading)
        return velocity - pad(self.trunk.rate.base[:, :1], (0, 1))

    def _place(self) -> Tensor:
        """Where the base is on the ground (N, 2) [m], less where leaning brings it."""
        ahead = torch.stack([torch.cos(self._heading), torch.sin(self._heading)], -1)
        return self.worlds.qpos[:, :2] - ahead * self.trunk.now.base[:, :1]

    def _height(self) -> Tensor:
        """Height of the base (N,) [m], less what lowering and leaning change."""
        return self.worlds.qpos[:, 2] - self.trunk.now.base[:, 1]

    def _follow(self) -> None:
        """Bring up to date how each robot has moved, and where it came to rest."""
        w = self.worlds
        self._mean_velocity.add_((self._velocity() - self._mean_velocity) * (self.contract.dt / SWAY_SECONDS))
        self._load.copy_(w.load())
        self._settled = self.moves.settled & self._tracking() & (self._rank < self._rest_share)
        self._anchor.copy_(torch.where(self._settled[:, None], self._anchor, self._place()))

    def _tracking(self) -> Tensor:
        return self._upright_start | (self.episode_length_buf > STAND_UP_STEPS)

    def _after_physics(self) -> None:
        w = self.worlds
        finite = torch.isfinite(w.qpos).all(-1) & torch.isfinite(w.qvel).all(-1) & (w.qvel.abs().amax(-1) < 300.0)
        w.qpos.copy_(torch.nan_to_num(w.qpos, nan=0.0, posinf=0.0, neginf=0.0))
        w.qvel.copy_(torch.nan_to_num(w.qvel, nan=0.0, posinf=0.0, neginf=0.0))
        self.episode_length_buf.add_(1)
        self.trunk.advance(self._tracking())
        self._measure()
        self._command()
        low = w.lowest()
        self._follow()
        terms, failed, figures = self._evaluate(finite, low)
        earned = torch.stack([terms[name] for name in self._rewarded])
        reward = REWARD_SCALE * (earned * self._weights[:, None]).sum(0)
        self._reward.copy_(torch.where(finite, torch.nan_to_num(reward), torch.zeros_like(reward)))
        self._time_out.copy_((self.episode_length_buf >= self.max_episode_length) & ~failed & finite)
        self._done.copy_(failed | self._time_out | ~finite)
        self._dq_before.copy_(w.qvel[:, 6:])
        self._q_before.copy_(w.qpos[:, 7:])
        self._remember(earned, figures, finite)
        self._push()
        self._reset(self._done)
        self._observe(self._done, low)

    def _set_difficulty(self) -> None:
        """Set what grows as the robot learns to stand, and how far it has grown: ``_ramp``, 0 to 1."""
        s = self.settings
        rests = passed(self._calls, self.settings.rest_steps)
        ends = float(self._log["all/ends"]) if self._log else 1.0  # waits for the device
        if self._calls and (ends < s.curriculum_ends or self._calls > s.curriculum_latest):
            self._ramp = min(self._ramp + 240 / s.curriculum_steps, 1.0)
        self._termination_share.fill_(self._ramp**2)
        share = s.disturbance_share_at_first + (1 - s.disturbance_share_at_first) * rests
        self.worlds.set_share(share)
        self.disturbances.set_share(share)
        self._rest_share.fill_(rests)
        grown_by = (s.upright_share - s.upright_share_at_first) * self._ramp
        self._starts.upright_share.fill_(s.upright_share_at_first + grown_by)

    def _command(self) -> None:
        first = (self.episode_length_buf == STAND_UP_STEPS + 1) & ~self._upright_start
        self.arms.advance(self._tracking(), first, self.worlds.qpos[:, 7:])
        self.moves.advance()
        d = self.disturbances
        self.moves.lead(d.came, d.pull.sum(1)[:, :2], d.hand_velocity, self._heading)

    def _evaluate(self, finite: Tensor, low: Tensor) -> Judged:
        """Return the reward terms, which worlds failed (N,), and figures for the log."""
        w = self.worlds
        numbers = self.description.training
        height = self._height()
        hind = w.toes[:, 2:]
        rising = torch.clamp(self.episode_length_buf * self.contract.dt / RISE_SECONDS, max=1.0)
        rising = torch.where(self._upright_start, torch.ones_like(rising), rising)
        standing = torch.clamp((height - numbers.height_low) / numbers.height_span, 0, 1)
        standing = standing * torch.clamp(self._up, 0, 1) * rising
        ended, met = self._terminations(low, hind, self._tracking())
        ended = finite & ended
        tracking = self._tracking().float()
        toppling = self._toppling(hind)
        settled = self._settled.float()
        asked = (self._gait * (1 - settled))[:, None]  # or a robot turns away, so that its clock starts
        # by the command, or a robot that turns away a little would be asked to step, and need not rest
        pulled = self.disturbances.pulled
        resting = torch.maximum(1 - self._gait, settled) * rising.ge(1) * ~toppling * ~pulled

        toes = self._toes_now(low)
        stepping = rewards.stepping(self._phase(), toes.clearance, toes.contact, self.settings.swing_height)
        # a step that catches a fall is no fault
        planted = torch.maximum(rewards.both_planted(self._load), toppling[:, None].float())
        sway = self._mean_velocity - self.moves.wanted
        turn = heading_error(self._quat_WB, self.moves.heading, torch)
        drift = (self._place() - self._anchor).norm(dim=-1)
        change = (self._last_action - self._before_last)[:, 6:]
        overload = self._own * torch.clamp(w.motor_torque.abs() - self._rated, min=0.0) / self._peak
        terms = self._efforts()
        terms |= {
            "alive": torch.ones_like(height),
            "height": rewards.height(height, rising, numbers),
            "upright": rewards.upright(self._up, rising, self._lying_angle),
            "velocity": rewards.velocity(sway, self._velocity() - self.moves.wanted, standing),
            "heading": rewards.heading(turn, standing),
            "gait": rewards.gait(stepping, planted, asked, standing),
            "drift": rewards.drift(drift, tracking * ~pulled),
            "slip": toes.slip,
            "foot_shift": rewards.foot_shift(self._way_of_feet(hind), self._early()),
            "terminations": met,
            "flight": rewards.flight(toes.clearance),
            "low": rewards.low(low[:, self._near_ground]),
            "unrest": rewards.unrest(change, resting),
            "shuffle": rewards.shuffle(toes.speed, toes.contact, resting),
            "heat": rewards.heat(terms["torque"]) * ~pulled,
            "overload": rewards.squares(overload),
            "fall": ended.float(),
        }
        figures = self._standing_figures(tracking, toes, change, drift, terms["fall"])
        figures |= self._tracking_figures(tracking, sway, turn, terms["fall"])
        return terms, ended, figures

    def _standing_figures(
        self, tracking: Tensor, toes: HindToes, change: Tensor, drift: Tensor, fallen: Tensor
    ) -> dict[str, Tensor]:
        """Return how quietly robots stand, how they step, and how they are led."""
        d = self.disturbances
        quiet = self.worlds.quiet * tracking
        still = quiet * (self._gait == 0)
        asked = self.moves.velocity[:, 0]
        reached = (self._mean_velocity[:, 0] * asked * tracking).sum()
        return {
            "still/planted": mean(self._load.amin(-1) > BEARS, still),
            "still/action_change": mean(change.square().mean(-1), still).sqrt(),
            "still/shuffle": mean((toes.speed * toes.contact).mean(-1), still),
            "walk/speed_share": reached / (asked.square() * tracking).sum().clamp(min=1e-3),
            "walk/lift": mean(toes.clearance.amax(-1), tracking * (self._gait == 1)),
            "quiet/drift": mean(drift, still),
            "quiet/falls": mean(fallen, quiet),
            "led/falls": mean(fallen, d.held.float()),
            "led/behind": mean(d.behind, d.held.float()),
        }

    def _tracking_figures(self, tracking: Tensor, sway: Tensor, turn: Tensor, fallen: Tensor) -> dict[str, Tensor]:
        """Return how well robots follow what they are asked, and how many fall."""
        toes = front_toes(self.worlds.qpos[:, 7:], self.description, torch)
        off = toes - front_toes(self.arms.q[:, 1], self.description, torch)
        return {
            "track/toe_error_cm": 100 * mean(off.norm(dim=-1).mean(-1), tracking),
            "track/mean_velocity_error": mean(sway.norm(dim=-1), tracking),
            "track/heading_error": mean(turn.abs(), tracking),
            "track/falls": mean(fallen, tracking),
            "track/termination_share": self._termination_share[0],
            "all/ends": fallen.mean(),
        }

    def _terminations(self, low: Tensor, hind: Tensor, tracking: Tensor) -> tuple[Tensor, Tensor]:
        """Return where an episode ends in a fall or by one of the paper's terminations, and how many of them hold."""
        q = self.worlds.qpos[:, 7:]
        step = self.episode_length_buf
        numbers = self.description.training
        grounded = low[:, self._grounding].amin(-1) < 0.002
        fallen = tracking & (grounded | (self._height() < numbers.height_fallen) | (self._up < 0.3))
        beyond = (q < self._near_min) | (q > self._near_max)
        near = (beyond & (self._own > 0.0)).any(-1) & (step > 3)
        early = self._early() & (step > 3)
        high = early & (hind[..., 2].amax(-1) > numbers.early_toe_height)
        jump = early & ((q - self._q_before).abs().amax(-1) > numbers.early_joint_step)
        jump = jump & self.worlds.quiet  # motors of other worlds are up to half as strong again
        touch = ~self._upright_start & (step > GRACE_STEPS) & ~tracking & grounded
        met = torch.stack([near, high, jump, touch]).float().sum(0)
        return fallen | ((met > 0) & (self._rand() < self._termination_share)), met

    def _early(self) -> Tensor:
        return ~self._upright_start & (self.episode_length_buf <= GRACE_STEPS)

    def _way_of_feet(self, hind: Tensor) -> Tensor:
        """Return the ways of the hind toes from where they began (N, 2, 3) [m]."""
        first = (self.episode_length_buf == 1)[:, None, None]
        self._toes_at_start.copy_(torch.where(first, hind, self._toes_at_start))
        return hind - self._toes_at_start

    def _toes_now(self, low: Tensor) -> HindToes:
        """Return how the hind toes are and move."""
        w = self.worlds
        clearance = low[:, self._hind_toes]
        velocity, turning = w.toe_motion()
        slip = rewards.slip(w.toes[..., 2], velocity, turning, below=rewards.SLIP_HEIGHT)
        return HindToes(clearance, (clearance < 0.003).float(), velocity[:, 2:].norm(dim=-1), slip)

    def _efforts(self) -> dict[str, Tensor]:
        """Return the reward terms of motion and torque, which all tasks have; of the joints that the policy moves."""
        w = self.worlds
        own = self._own
        dq = own * w.qvel[:, 6:]
        ddq = own * (w.qvel[:, 6:] - self._dq_before) / self.contract.dt
        ddq = torch.where((self.episode_length_buf > 1)[:, None], ddq, torch.zeros_like(ddq)).clamp(-2000, 2000)
        dq = dq.clamp(-50, 50)
        return {
            "action_rate": rewards.squares(own * (self._last_action - self._before_last)),
            "torque": rewards.squares(own * w.motor_torque / self._peak),
            "joint_velocity": rewards.squares(dq),
            "joint_speed": rewards.joint_speed(dq, self.description.training.joint_speed),
            "joint_acceleration": rewards.squares(ddq),
            "limits": rewards.limits(w.qpos[:, 7:], self._soft_min, self._soft_max, own),
        }

    def _toppling(self, hind: Tensor) -> Tensor:
        """Return where the capture point lies before, behind or beside both hind toes (N,); toes (N, 2, 3) [m]."""
        w = self.worlds
        fall = torch.sqrt(w.com[:, 2].clamp(min=0.05) / abs(float(w.mj_model.opt.gravity[2])))
        capture = w.com[:, :2] + w.qvel[:, :2] * fall[:, None]
        ahead, aside = in_heading_frame(capture - hind[..., :2].mean(1), self._heading).abs().unbind(-1)
        apart = in_heading_frame(hind[:, 0, :2] - hind[:, 1, :2], self._heading)[:, 1].abs()
        return (ahead > CAPTURE_REACH) | (aside > 0.5 * apart)

    def _first_phase(self, start: Start) -> Tensor:
        """Return the gait phase (N,) at the first step [rad]."""
        return self._uniform(-math.pi, math.pi)

    def _remember(self, earned: Tensor, figures: dict[str, Tensor], finite: Tensor) -> None:
        # stacked, since on a GPU a launch costs more than the numbers
        values = torch.cat([earned.mean(-1), torch.stack([*figures.values(), 1 - finite.float().mean()])])
        if not self._log:
            names = [*(f"reward/{name}" for name in self._rewarded), *figures, "track/non_finite"]
            self._log_values = values.clone()
            self._log = dict(zip(names, self._log_values.unbind(), strict=True))
        self._log_values.copy_(values)

    def _phase(self) -> Tensor:
        rate = 2 * math.pi * self.contract.clock_hz * self.contract.dt
        return self.phase_at_start + rate * self.episode_length_buf

    def _push(self) -> None:
        r = self.settings.randomisation
        every = round(r.push_interval / self.contract.dt)
        due = (self.episode_length_buf % every == 0) & (self.episode_length_buf > STAND_UP_STEPS)
        side = math.pi * (torch.floor(self._uniform(0.0, 2.0)) - 0.5) + self._uniform(-1.0, 1.0) * (math.pi / 6)
        angle = self._uniform(-math.pi, math.pi)
        speed = self._uniform(*r.push) * self.disturbances.push_share
        angle = torch.where(self._rand() < PUSHED_SIDEWAYS, self._heading + side, angle)
        kick = torch.stack([speed * torch.cos(angle), speed * torch.sin(angle)], -1)
        self.worlds.qvel[:, :2].add_(kick * due[:, None])

    def _reset(self, mask: Tensor) -> None:
        w = self.worlds
        start = self._starts.draw()
        put(w.qpos, mask, start.qpos)
        put(w.qvel, mask, start.qvel)
        self.trunk.reset(mask)
        put(self._felt, mask, 0.0)
        self._measure()
        for command in self._commands:
            put(command, mask, start.command)
        past = self._last_action, self._before_last, self._mean_velocity, self._anchor, self._gait
        for buffer in (w.warmstart, *past):
            put(buffer, mask, 0.0)
        put(self._noise, mask, self._uniform(self.settings.noise_least, 1.0).clamp(min=0.0))
        low, high = (round(delay / self.description.timestep) for delay in self.settings.randomisation.delay)
        put(self._delay, mask, torch.randint_like(self._delay, low, high + 1))
        if w.motors is not None:
            w.motors.reset(mask, w.qpos[:, 7:], w.qvel[:, 6:], start.command)
        put(self._upright_start, mask, start.upright)
        put(self.phase_at_start, mask, self._first_phase(start))
        self.disturbances.reset(mask)
        put(self._q_before, mask, start.qpos[:, 7:])
        self.episode_length_buf.mul_(~mask)
        self.moves.reset(mask, start.heading)
        self.arms.reset(mask, start.upright, w.qpos[:, 7:])
        unknown = (self._rand() < self.settings.unknown_share) | self.disturbances.led
        put(self._known, mask, (~unknown).float())

    def _observe(self, fresh: Tensor, low: Tensor) -> None:
        w = self.worlds
        n = self.num_envs
        trunk = self.trunk.now
        rate = self.trunk.rate
        read_quat = quat_multiply(self._quat_WB, self.disturbances.mount)
        error = heading_error(read_quat, self.moves.heading, torch)
        gait = next_gait(self._gait, self.moves.velocity, error, self.contract, torch)
        self._gait.copy_(torch.where(self._rank < self._rest_share, gait, torch.ones_like(gait)))
        omega = quat_apply_inverse(self.disturbances.mount, w.qvel[:, 3:6]) + self.disturbances.gyro_bias
        omega = without_pitch_rate(omega, trunk.asked[:, 1], rate.asked[:, 1], torch)
        frame = observation_frame(
            terms=self.contract.terms,
            q_offset=w.read_q - self._default_q - pad(trunk.hind, (FRONT, 0)),
            quat_WB=read_quat,
            last_action=self._last_action,
            v_des=self.moves.velocity,
            error=error,
            toes_des=None,
            phase=self._phase(),
            gait=self._gait,
            omega_B=omega,
            dq=w.qvel[:, 6:] - pad(rate.hind, (FRONT, 0)),
            xp=torch,
        )
        noisy = frame + self._noise[:, None] * self._noise_half * (2 * torch.rand_like(frame) - 1)
        before = torch.where(fresh[:, None], noisy[:, self._averaged], self._slow)
        noisy, slow = with_slow_mean(noisy, before, self._averaged, self.contract.dt, torch)
        self._slow.copy_(slow)
        pushed = push_frame(self._history, noisy, torch)
        first = noisy[:, None, :].expand_as(pushed)
        self._history.copy_(torch.where(fresh[:, None, None], first, pushed))
        seen = [self._history.reshape(n, -1)]
        if self._drives_arms:
            driven = self._tracking()
            self._own[:, :FRONT] = (~driven[:, None]).float()
            known = torch.where(driven, self._known, 1.0)
            seen.append(arm_reference(self.arms.q[:, 1:], self.arms.dq[:, 1:], known, self._default_q[:FRONT], torch))
        self._policy_obs.copy_(torch.cat(seen, -1))
        feet = low[:, self._hind_toes]
        delay = self._delay.float() if w.motors is None else w.motors.delay(self._delay).mean(-1, keepdim=True)
        extras = [
            torch.cat([self._velocity(), w.qvel[:, 2:3]], -1),
            self._mean_velocity,
            in_heading_frame(self._place() - self._anchor, self._heading) * 3,
            w.qvel[:, 3:6].clamp(-20, 20) * 0.3,
            w.qvel[:, 6:].clamp(-40, 40) * 0.1,
            w.qpos[:, 2:3] * 3,
            self._up[:, None],
            (delay * (self.description.timestep / 0.005) - 3.5) * 0.3,
            (feet < 0.003).float(),
            self._load,
            feet.clamp(max=0.2) * 10,
            (w.qpos[:, 7 : 7 + FRONT] - self.arms.q[:, 1]) * 2,
            self._tracking().float()[:, None],
            torch.clamp(self.episode_length_buf.float() / STAND_UP_STEPS, max=2.0)[:, None],
            w.features,
            quat_apply_inverse(w.qpos[:, 3:7], self._floor_up),
            quat_apply_inverse(self._quat_WB, self._floor_up),
            (self.disturbances.pull[..., :2] * 0.2).reshape(n, 4),
            self.disturbances.lost_share * 10,
            self._gait[:, None],
            self._noise[:, None],
            w.quiet.float()[:, None],
            trunk.asked * CRITIC_TRUNK,
        ]
        known = torch.cat([self._policy_obs, *extras], -1)  # a world that exploded has its shapes back after a step
        self._critic_obs.copy_(torch.nan_to_num(known).clamp(-50, 50))

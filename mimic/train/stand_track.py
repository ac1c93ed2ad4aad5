"""The first task: stand up from lying, keep a velocity and a heading, and bring the front toes to goals."""

from __future__ import annotations

from dataclasses import asdict

import torch

from mimic.config.rewards import REFINING_TERMS
from mimic.robot.goals import leg_joints
from mimic.train.contract import STAND_UP_STEPS
from mimic.train.environment import Judged, WorldsEnv
from mimic.train.feet import sliding
from mimic.train.rewards import BEARS, Facts, grown, reward_terms

SWAY_SECONDS = 0.25
"""Time constant of the averaged base velocity [s]: half a gait cycle."""

GRACE_STEPS = 30
"""Control steps in which a rising robot may touch the ground, but not lift a hind toe high or move a joint fast; as in
the paper, whose limits are 0.06 m and 0.3 rad (the description's are lower)."""

REFINING_SHARE = 0.05
"""Share of their weight that the REFINING_TERMS have at first; it grows to 1."""

SLIP_HEIGHT = 0.033
"""A toe whose centre is lower than this pays for moving [m]; paper: 0.03, here with a margin."""

CAPTURE_REACH = 0.05
"""How far a capture point that has left the feet is before or behind the line between them [m]."""

STANDING = 0.7
"""Cosine between the trunk and upright from which on a front leg is shown how to reach."""


def mean(values: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Return the mean of values (N,) with these weights (N,)."""
    return (values * weights).sum() / weights.sum().clamp(min=1.0)


class StandTrackEnv(WorldsEnv):
    """Worlds in which a robot stands up, keeps a velocity and a heading, and brings its front toes to goals."""

    def _weights_at(self, ramp: float) -> dict[str, float]:
        s = self.settings
        begin, end = s.finish_steps
        finished = min(max((self._calls - begin) / (end - begin), 0.0), 1.0)
        factors: dict[str, float] = dict.fromkeys(REFINING_TERMS, REFINING_SHARE + (1 - REFINING_SHARE) * ramp)
        for name, factor in asdict(s.finish).items():
            factors[name] = factors.get(name, 1.0) * (1 + (factor - 1) * finished)
        return {name: w * factors.get(name, 1.0) for name, w in grown(asdict(s.rewards), self._calls).items()}

    def _ramp_share(self) -> float:
        ends = float(self._log["all/ends"]) if "all/ends" in self._log else 1.0  # waits for the device
        if self._calls and (ends < self.settings.curriculum_ends or self._calls > self.settings.curriculum_latest):
            self._ramp = min(self._ramp + 240 / self.settings.curriculum_steps, 1.0)
        return self._ramp

    def _set_difficulty(self, ramp: float) -> None:
        """Set what grows as the robot learns to stand, for the share of the ramp that is done."""
        s = self.settings
        share = s.disturbance_share_at_first + (1 - s.disturbance_share_at_first) * ramp
        self.worlds.set_share(share)
        self.disturbances.set_share(share)
        self._rest_share.fill_(s.rest_share_at_first + (1 - s.rest_share_at_first) * ramp)
        self._starts.upright_share.fill_(s.upright_share_at_first + (s.upright_share - s.upright_share_at_first) * ramp)

    def _command(self) -> None:
        first = (self.episode_length_buf == STAND_UP_STEPS + 1) & ~self._upright_start
        self.goals.advance(self._tracking(), first, self._toes)
        self.moves.advance()
        d = self.disturbances
        self.moves.lead(d.came, d.pull.sum(1)[:, :2], d.hand_velocity, self._heading)

    def _evaluate(self, finite: torch.Tensor, low: torch.Tensor) -> Judged:
        facts = self._facts(finite, low)
        return reward_terms(facts, self.settings.swing_height, self.description), facts.fallen, self._figures(facts)

    def _facts(self, finite: torch.Tensor, low: torch.Tensor) -> Facts:
        w = self.worlds
        heading, up = self._heading, self._up
        step = self.episode_length_buf
        toes = w.site_xpos[:, self._toe_sites]
        hind = w.site_xpos[:, self._toe_sites[2:]]
        self._toes_at_start.copy_(torch.where((step == 1)[:, None, None], hind, self._toes_at_start))
        rising_up = ~self._upright_start & (step <= GRACE_STEPS)
        shift = (hind - self._toes_at_start).norm(dim=-1).mean(-1) * rising_up
        motion = self._feet.motion(w.qpos[:, 3:7], w.qvel[:, :3], w.qvel[:, 3:6], w.qpos[:, 7:], w.qvel[:, 6:])
        slip = sliding(toes[..., 2], *motion, below=SLIP_HEIGHT)
        height = w.qpos[:, 2]
        velocity = self._velocity()
        self._mean_velocity.add_((velocity - self._mean_velocity) * (self.contract.dt / SWAY_SECONDS))
        error = self.moves.heading - heading
        error = torch.arctan2(torch.sin(error), torch.cos(error))
        tracking = self._tracking()
        self._load.copy_(w.load())
        rests = self._rank < self._rest_share
        settled = self.moves.settled & tracking & rests
        self._anchor.copy_(torch.where(settled[:, None], self._anchor, w.qpos[:, :2]))
        grounded = low[:, self._grounding].amin(-1) < 0.002
        fallen = tracking & (grounded | (height < self.description.training.height_fallen) | (up < 0.3))
        q, dq = w.qpos[:, 7:], w.qvel[:, 6:]
        near = ((q < self._near_min) | (q > self._near_max)).any(-1) & (step > 3)
        early = rising_up & (step > 3)
        high = early & (hind[..., 2].amax(-1) > self.description.training.early_toe_height)
        jump = early & ((q - self._q_before).abs().amax(-1) > self.description.training.early_joint_step)
        touch = ~self._upright_start & (step > GRACE_STEPS) & ~tracking & grounded
        broken = near | high | jump | touch
        fallen = finite & (fallen | (broken & (self._rand() < self._termination_share)))
        excess = torch.clamp(self._soft_min - q, min=0.0) + torch.clamp(q - self._soft_max, min=0.0)
        ddq = (dq - self._dq_before) / self.contract.dt
        ddq = torch.where((self.episode_length_buf > 1)[:, None], ddq, torch.zeros_like(ddq)).clamp(-2000, 2000)
        toppling = self._toppled = self._toppling(hind)
        return Facts(
            height=height,
            up=up,
            velocity_error=velocity - self.moves.wanted,
            mean_velocity_error=self._mean_velocity - self.moves.wanted,
            drift=w.qpos[:, :2] - self._anchor,
            gait=self._gait,
            toppling=toppling & ~w.quiet,
            settled=settled,
            heading_error=error,
            rising=torch.where(self._upright_start, torch.ones_like(height), self._rising()),
            toe_error=self._toes - self.goals.now,
            tracking=tracking.float(),
            contact=low[:, self._hind_toes] < 0.003,
            load=self._load,
            clearance=low[:, self._hind_toes],
            slip=slip,
            hind_speed=motion[0][:, 2:].norm(dim=-1),
            foot_shift=shift,
            terminations_met=near.float() + high.float() + jump.float() + touch.float(),
            phase=self._phase(),
            low=(low[:, self._near_ground] < 0.03).float().sum(-1),
            action_change=self._last_action - self._before_last,
            torque=w.motor_torque / self._peak,
            overload=torch.clamp(w.motor_torque.abs() - self._rated, min=0.0) / self._peak,
            dq=dq.clamp(-50, 50),
            ddq=ddq,
            limit_excess=excess,
            fallen=fallen,
        )

    def _toppling(self, hind: torch.Tensor) -> torch.Tensor:
        """Return where the capture point lies before, behind or beside both hind toes (N,); toes (N, 2, 3) [m]."""
        w = self.worlds
        fall = torch.sqrt(w.com[:, 2].clamp(min=0.05) / abs(float(w.mj_model.opt.gravity[2])))
        capture = w.com[:, :2] + w.qvel[:, :2] * fall[:, None]
        away = capture - hind[..., :2].mean(1)
        ahead = torch.stack([torch.cos(self._heading), torch.sin(self._heading)], -1)
        across = torch.stack([-ahead[:, 1], ahead[:, 0]], -1)
        half = 0.5 * ((hind[:, 0, :2] - hind[:, 1, :2]) * across).sum(-1).abs()
        return ((away * ahead).sum(-1).abs() > CAPTURE_REACH) | ((away * across).sum(-1).abs() > half)

    def _figures(self, f: Facts) -> dict[str, torch.Tensor]:
        d, tracking, rises = self.disturbances, f.tracking, 1 - f.tracking
        quiet = (self.worlds.quiet | (self.settings.quiet_share == 0.0)).float() * tracking
        still, asked, steps = quiet * (f.gait == 0), self.moves.velocity[:, 0], tracking * (f.gait == 1)
        held, fallen = d.held.float(), f.fallen.float()
        reached = (self._mean_velocity[:, 0] * asked * tracking).sum()
        return {
            "still/planted": mean(f.load.amin(-1) > BEARS, still),
            "still/action_change": mean(f.action_change[:, 6:].square().mean(-1), still).sqrt(),
            "still/torque_squares": mean(f.torque.square().sum(-1), still),
            "still/shuffle": mean((f.hind_speed * f.contact).mean(-1), still),
            "still/toppling": mean(self._toppled, still),
            "walk/speed_share": reached / (asked.square() * tracking).sum().clamp(min=1e-3),
            "walk/lift": mean(f.clearance.amax(-1), steps),
            "quiet/velocity_error": mean(f.velocity_error.norm(dim=-1), quiet),
            "quiet/drift": mean(f.drift.norm(dim=-1), still),
            "quiet/falls": mean(fallen, quiet),
            "led/falls": mean(fallen, held),
            "led/behind": mean(d.behind, held),
            "track/up": mean(f.up, tracking),
            "track/height": mean(f.height, tracking),
            "track/toe_error_cm": 100 * mean(f.toe_error.norm(dim=-1).mean(-1), tracking),
            "track/mean_velocity_error": mean(f.mean_velocity_error.norm(dim=-1), tracking),
            "track/velocity_error": mean(f.velocity_error.norm(dim=-1), tracking),
            "track/drift": mean(f.drift.norm(dim=-1), tracking),
            "track/heading_error": mean(f.heading_error.abs(), tracking),
            "track/falls": mean(fallen, tracking),
            "track/slip": mean(f.slip, tracking),
            "track/terminations": mean(f.terminations_met, tracking),
            "all/ends": fallen.mean(),
            "rise/slip": mean(f.slip, rises),
            "rise/terminations": mean(f.terminations_met, rises),
            "track/termination_share": self._termination_share.mean(),
            "track/knee_torque": mean(f.torque[:, 8::3].abs().mean(-1), tracking),
        }

    def _show_reaching(self) -> None:
        q, excess = leg_joints(self.goals.now, self.description, torch)
        actions = (q - self._default_q[:6].view(2, 3)) / self.settings.action_scale
        counts = (excess <= 0) & (self._tracking() & (self._up > STANDING))[:, None]
        counts = counts[..., None].expand_as(actions)
        self._reaching[:, 0].copy_(torch.where(counts, actions, torch.zeros_like(actions)))
        self._reaching[:, 1].copy_(counts)

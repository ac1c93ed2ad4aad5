"""The first task: stand up from lying, keep a velocity and a heading, and bring the front toes to goals."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import torch

from mimic.config.rewards import REFINING_TERMS
from mimic.robot.goals import leg_joints
from mimic.train.environment import WorldsEnv
from mimic.train.feet import sliding
from mimic.train.rewards import BEARS, Facts, reward_terms

SWAY_SECONDS = 0.25
"""Time constant of the averaged base velocity [s]: half a gait cycle."""

GRACE_STEPS = 30
"""Control steps in which a rising robot may touch the ground, but not lift a hind toe high or move a joint fast; as in
the paper, whose limits are 0.06 m and 0.3 rad (the description's are lower)."""

STANDING = 0.7
"""Cosine between the trunk and upright from which on a front leg is shown how to reach."""


class StandTrackEnv(WorldsEnv):
    """Worlds in which a robot stands up, keeps a velocity and a heading, and brings its front toes to goals."""

    @property
    def _rewards(self) -> Any:
        """The weights of the task's reward terms."""
        return self.settings.rewards

    def _shares(self, ramp: float) -> dict[str, float]:
        """Return the share of their weight that terms have by now, for the share of the ramp that is done."""
        s = self.settings
        shares: dict[str, float] = dict.fromkeys(
            REFINING_TERMS, s.refining_share_at_first + (1 - s.refining_share_at_first) * ramp
        )
        begin, end = s.finish_steps
        finished = min(max((self._calls - begin) / (end - begin), 0.0), 1.0)
        polish = {name: 1 + (factor - 1) * finished for name, factor in asdict(s.finish).items()}
        return shares | {name: shares.get(name, 1.0) * factor for name, factor in polish.items()}

    def _ramp_share(self) -> float:
        """Return how much of what makes the task hard is there by now, 0 to 1; asked every 240 steps."""
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
        """Let goals and velocity commands go on by a control step."""
        first = (self.episode_length_buf == self.settings.stand_up_steps + 1) & ~self._upright_start
        self.goals.advance(self._tracking(), first, self._toes)
        self.moves.advance()
        d = self.disturbances
        self.moves.lead(d.came, d.pull.sum(1)[:, :2], d.hand_velocity, self._heading)

    def _evaluate(
        self, finite: torch.Tensor, low: torch.Tensor
    ) -> tuple[dict[str, torch.Tensor], torch.Tensor, dict[str, torch.Tensor]]:
        """Return the reward terms, which worlds failed (N,), and figures for the log."""
        facts = self._facts(finite, low)
        return reward_terms(facts, self.settings, self.description), facts.fallen, self._figures(facts)

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
        slip = sliding(toes[..., 2], *motion, below=self.settings.slip_height)
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
            torque=w.motor_torque,
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
        return ((away * ahead).sum(-1).abs() > self.settings.capture_reach) | ((away * across).sum(-1).abs() > half)

    def _figures(self, f: Facts) -> dict[str, torch.Tensor]:
        tracking = f.tracking
        count = tracking.sum().clamp(min=1.0)
        quiet = (self.worlds.quiet | (self.settings.quiet_share == 0.0)).float()
        d = self.disturbances
        still, asked = tracking * quiet * (f.gait == 0), self.moves.velocity[:, 0]
        stills = still.sum().clamp(min=1.0)
        return {
            "still/planted": ((f.load.amin(-1) > BEARS) * still).sum() / stills,
            "still/action_change": (f.action_change[:, 6:].square().mean(-1) * still).sum().div(stills).sqrt(),
            "still/torque_squares": (f.torque.square().sum(-1) * still).sum() / stills,
            "still/shuffle": ((f.hind_speed * f.contact).mean(-1) * still).sum() / stills,
            "still/toppling": (self._toppled * still).sum() / stills,
            "walk/speed_share": (self._mean_velocity[:, 0] * asked * tracking).sum()
            / (asked.square() * tracking).sum().clamp(min=1e-3),
            "walk/lift": (f.clearance.amax(-1) * tracking * (f.gait == 1)).sum()
            / (tracking * (f.gait == 1)).sum().clamp(min=1.0),
            "quiet/velocity_error": (f.velocity_error.norm(dim=-1) * tracking * quiet).sum()
            / (tracking * quiet).sum().clamp(min=1.0),
            "quiet/drift": (f.drift.norm(dim=-1) * still).sum() / stills,
            "quiet/falls": (f.fallen.float() * tracking * quiet).sum() / (tracking * quiet).sum().clamp(min=1.0),
            "led/falls": (f.fallen & d.held).float().sum() / d.held.float().sum().clamp(min=1.0),
            "led/behind": (d.behind * d.held).sum() / d.held.float().sum().clamp(min=1.0),
            "track/up": (f.up * tracking).sum() / count,
            "track/height": (f.height * tracking).sum() / count,
            "track/toe_error_cm": 100 * (f.toe_error.norm(dim=-1).mean(-1) * tracking).sum() / count,
            "track/mean_velocity_error": (f.mean_velocity_error.norm(dim=-1) * tracking).sum() / count,
            "track/velocity_error": (f.velocity_error.norm(dim=-1) * tracking).sum() / count,
            "track/drift": (f.drift.norm(dim=-1) * tracking).sum() / count,
            "track/heading_error": (f.heading_error.abs() * tracking).sum() / count,
            "track/falls": (f.fallen.float() * tracking).sum() / count,
            "track/slip": (f.slip * tracking).sum() / count,
            "track/terminations": (f.terminations_met * tracking).sum() / count,
            "all/ends": f.fallen.float().mean(),
            "rise/slip": (f.slip * (1 - tracking)).sum() / (1 - tracking).sum().clamp(min=1.0),
            "rise/terminations": (f.terminations_met * (1 - tracking)).sum() / (1 - tracking).sum().clamp(min=1.0),
            "track/termination_share": self._termination_share.mean(),
            "track/knee_torque": (f.torque[:, 8::3].abs().mean(-1) * tracking).sum() / count,
        }

    def _show_reaching(self) -> None:
        """Put the front legs' closed form for the toe goals of now where the learner finds it."""
        q, excess = leg_joints(self.goals.now, self.description, torch)
        actions = (q - self._default_q[:6].view(2, 3)) / self.settings.action_scale
        counts = (excess <= 0) & (self._tracking() & (self._up > STANDING))[:, None]
        counts = counts[..., None].expand_as(actions)
        self._reaching[:, 0].copy_(torch.where(counts, actions, torch.zeros_like(actions)))
        self._reaching[:, 1].copy_(counts)

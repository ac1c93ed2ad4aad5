"""Clips that nobody rendered: random motions, and what the detector would see of them.

Rendering is slow. So a network learns from rendered clips how the detector sees a pose, a random motion is seen through
it, and what the network did not foresee in one of the rendered clips is added.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import nn

from lab.people.arm_motions import FAMILIES, Rng, motion_of
from lab.people.depth_clips import View, camera_axes, eye_of, random_view
from lab.people.skeleton import SIDES, TRUTH_NAMES, Build, pose
from mimic.records import LANDMARKS, FloatArray
from mimic.sources.video.depth import RATE_HZ

SEEN = [
    LANDMARKS.index(name)
    for name in (
        "nose", *(f"{side}_{part}" for part in ("shoulder", "elbow", "wrist", "index", "hip", "ear")
                  for side in ("left", "right")),
    )
]  # fmt: skip
"""The landmarks that the depth networks look at."""
_TRUE = [
    TRUTH_NAMES.index(name) for name in ("nose", *(p + s for p in ("shoulder", "elbow", "wrist", "hip") for s in SIDES))
]
_HIPS = [7, 8]
NEAR = np.radians(20)
"""What the network did not foresee comes from a clip with about this heading."""
FIRM = 0.8
"""Share of what the network adds to a linear fit; it is unsure of poses that it has not seen."""
FIT_S = 30.0
"""Time that each of the two networks is trained for [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """A clip with truth, at RATE_HZ."""

    world: FloatArray
    """What the detector says: mid-hip -> landmark (T, 33, 3) [m]."""
    flat: FloatArray
    """Place in the picture (T, 33, 2) [m], in the scale of `world`."""
    score: FloatArray
    """Visibility (T, 33)."""
    joints: FloatArray
    """True places (T, 13, 3) [m], camera axes."""
    eye: FloatArray
    """Place of the camera in the same axes (3,) [m]."""
    ratio: float
    """Metres of the detector over true metres."""
    yaw: float
    """Of the camera, against where the person looks [rad]."""


def imagine(clips: list[Tracked], count: int, seed: int) -> list[Tracked]:
    """Return clips of random motions as the detector would see them."""
    halves = clips[::2], clips[1::2]
    models = [_fitted(half, seed + k) for k, half in enumerate(halves)]
    missed = [  # each by the network that has not seen the clip
        (_said(clip) - model(_true(clip.joints, clip.eye, clip.ratio)), clip.yaw)
        for half, model in zip(halves, reversed(models), strict=True)
        for clip in half
    ]
    yaws = np.array([yaw for _, yaw in missed])
    rng, made = np.random.default_rng(seed), []
    while len(made) < count:
        view, ratio = random_view(rng), float(rng.choice([clip.ratio for clip in clips]))
        joints, eye = _random_motion(rng, view), eye_of(view)
        apart = np.abs((yaws - view.yaw + np.pi) % (2 * np.pi) - np.pi)
        chosen = missed[int(rng.choice(np.argsort(apart)[: max(3, int((apart < NEAR).sum()))]))][0]
        chosen = np.concatenate([chosen, chosen[::-1]] * 4)[rng.integers(0, len(chosen) // 2) :]
        said = models[int(rng.integers(2))](_true(joints, eye, ratio)) + chosen[: len(joints)]
        rows, n = len(joints), len(SEEN)
        world, flat, score = np.zeros((rows, 33, 3)), np.zeros((rows, 33, 2)), np.zeros((rows, 33))
        world[:, SEEN] = said[:, : 3 * n].reshape(rows, n, 3)
        flat[:, SEEN] = said[:, 3 * n : 5 * n].reshape(rows, n, 2)
        score[:, SEEN] = np.clip(said[:, 5 * n :], 0.0, 1.0)
        made.append(Tracked(world, flat, score, joints, eye, ratio, view.yaw))
    return made


def _random_motion(rng: Rng, view: View) -> FloatArray:
    """Return the joints of a person of random build (T, 13, 3) [m], camera axes."""
    seconds, arms = rng.uniform(4, 7), rng.uniform(0.88, 1.12)
    build = Build(
        upper_arm=0.29 * arms * rng.uniform(0.95, 1.05),
        forearm=0.255 * arms * rng.uniform(0.95, 1.05),
        shoulder_half=0.178 * rng.uniform(0.86, 1.12),
        hip_half=0.092 * rng.uniform(0.9, 1.12),
    )
    family = FAMILIES[str(rng.choice(list(FAMILIES)))]
    joints = pose(motion_of(family(rng, seconds), rng, seconds, RATE_HZ), build)[1]
    return joints @ (camera_axes(view) @ Rotation.from_euler("z", view.yaw).as_matrix().T).T


def _true(joints: FloatArray, eye: FloatArray, ratio: float) -> FloatArray:
    """Return the pose and its perspective picture from mid-hip [m of the detector] and the heading (T, 47)."""
    points, rows = joints[:, _TRUE], len(joints)
    middle = points[:, _HIPS].mean(axis=1, keepdims=True)
    ray = points - eye
    drawn = ray[..., :2] / ray[..., 2:] * (middle - eye)[:, :, 2:]
    drawn = drawn - drawn[:, _HIPS].mean(axis=1, keepdims=True)
    line = points[:, 1] - points[:, 2] + points[:, 7] - points[:, 8]
    heading = line[:, [0, 2]] / np.maximum(np.linalg.norm(line[:, [0, 2]], axis=1, keepdims=True), 1e-9)
    return np.concatenate(
        [3 * ratio * (points - middle).reshape(rows, -1), 3 * ratio * drawn.reshape(rows, -1), heading], axis=1
    )


def _said(clip: Tracked) -> FloatArray:
    rows, hips = len(clip.world), [LANDMARKS.index("left_hip"), LANDMARKS.index("right_hip")]
    flat = clip.flat - clip.flat[:, hips].mean(axis=1, keepdims=True)
    return np.concatenate(
        [clip.world[:, SEEN].reshape(rows, -1), flat[:, SEEN].reshape(rows, -1), clip.score[:, SEEN]], axis=1
    )


def _fitted(clips: list[Tracked], seed: int) -> Callable[[FloatArray], FloatArray]:
    """Return what the detector says of a pose: a linear fit and a network for the rest."""
    torch.manual_seed(seed)
    x = np.concatenate([_true(clip.joints, clip.eye, clip.ratio) for clip in clips])
    y = np.concatenate([_said(clip) for clip in clips])
    ones = np.column_stack([x, np.ones(len(x))])
    linear = np.linalg.solve(ones.T @ ones + 3.0 * np.eye(ones.shape[1]), ones.T @ y)
    rest = y - ones @ linear
    mean, sd = rest.mean(axis=0), rest.std(axis=0) + 0.02
    net = nn.Sequential(
        nn.Linear(x.shape[1], 160), nn.ReLU(), nn.Dropout(0.25), nn.Linear(160, 160), nn.ReLU(), nn.Dropout(0.25),
        nn.Linear(160, y.shape[1]),
    )  # fmt: skip
    optimiser = torch.optim.AdamW(net.parameters(), 2e-3, weight_decay=0.03)
    inputs, goals = (torch.tensor(v, dtype=torch.float32) for v in (x, (rest - mean) / sd))
    began = time.monotonic()
    while (done := (time.monotonic() - began) / FIT_S) < 1.0:
        optimiser.param_groups[0]["lr"] = 1e-3 * (1.0 + np.cos(np.pi * done))
        for _ in range(20):
            i = torch.randint(len(inputs), (512,))
            loss = ((net(inputs[i] + 0.02 * torch.randn_like(inputs[i])) - goals[i]) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    net.eval()

    def model(pose_: FloatArray) -> FloatArray:
        with torch.no_grad():
            more = net(torch.tensor(pose_, dtype=torch.float32)).numpy()
        return np.column_stack([pose_, np.ones(len(pose_))]) @ linear + mean + FIRM * sd * more

    return model

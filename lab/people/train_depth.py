"""Train the network that estimates the depth of arms, on clips with truth as the detector sees them.

    python -m lab.people.depth_clips CLIPS --clips 400                 # hours on one core; it can be interrupted
    python -m lab.people.train_depth CLIPS assets/depth/arms.onnx --minutes 6

Every eighth clip is left out and says how good the network is while it learns. Noise, another tempo, frames that hang
and a turned camera make each clip new every time; clips that are only imagined (imagined.py) are added.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from scipy.ndimage import gaussian_filter1d
from torch import nn

from lab.people.arm_motions import Rng
from lab.people.imagined import Tracked, imagine
from lab.people.skeleton import SIDES, TRUTH_NAMES
from mimic.config.pose import PoseSettings
from mimic.records import LANDMARKS, FloatArray
from mimic.sources.video.depth import FEATURES, RATE_HZ, WINDOW, framed, sight
from mimic.sources.video.left_right import decide_sides, swap_sides
from mimic.sources.video.smoothing import MAX_GAP, smooth

WIDTH, DILATIONS = 64, (1, 2, 4, 8)
ROWS, BATCH = 32, 64
"""Answers that each clip of a batch gives at a time, and arms in a batch."""
KEPT = 4
"""Noisy versions of the clips that are in use at a time."""
EVERY = 8
"""Every so many clips, one is left out."""
IMAGINED = 3000
VISIBLE, UNSEEN_WEIGHT = 0.5, 0.13
"""A wrist below this visibility counts little."""
_NO_SHOTS = np.zeros(0, dtype=np.int64)
_WRISTS = [LANDMARKS.index("left_wrist"), LANDMARKS.index("right_wrist")]
_TRUNK = [LANDMARKS.index(name) for name in ("left_shoulder", "right_shoulder", "left_hip", "right_hip")]


@dataclass(frozen=True, slots=True, eq=False)
class Raw:
    """A rendered clip: what the detector said of each frame, sides corrected, and the truth."""

    number: int
    t: FloatArray
    world: FloatArray
    image: FloatArray
    score: FloatArray
    size: tuple[int, int]
    joints: FloatArray
    eye: FloatArray
    yaw: float


Arm = tuple[FloatArray, FloatArray]
"""Features of one arm (T, FEATURES); depth of elbow and wrist [m], heading (x, z), visibility of the wrist (T, 5)."""


def read(path: Path) -> Raw | None:
    """Return the longest part of a clip with a person; None if that is short."""
    stored = np.load(path)
    rows = np.flatnonzero(np.isfinite(stored["world"][:, 0, 0]))
    t = stored["t"].astype(np.float64)
    parts = np.split(rows, np.flatnonzero(np.diff(t[rows]) > MAX_GAP) + 1)
    rows = max(parts, key=len)
    if len(rows) < ROWS or t[rows[-1]] - t[rows[0]] < 1.5 * ROWS / RATE_HZ:
        return None
    t, world, image, score, joints = (
        stored[name][rows].astype(np.float64) for name in ("t", "world", "image", "score", "joints")
    )
    swapped = decide_sides(t, world, _NO_SHOTS)
    world, image, score = (swap_sides(values, swapped) for values in (world, image, score))
    width, height = (int(v) for v in stored["size"])
    number = int("".join(filter(str.isdigit, path.stem)))
    return Raw(number, t, world, image, score, (width, height), joints, stored["eye"], float(stored["yaw"]))


def noisy(raw: Raw, rng: Rng) -> Raw:
    """Return a clip with more noise, in another tempo, seen by a camera that is rolled a little."""
    n, size, much = len(raw.t), np.asarray(raw.size, float), float(rng.choice([0.5, 1.0, 2.0]))
    metre = float(np.median(_spread(raw.image[:, _TRUNK] * size))) / 0.25  # [px]

    def wobble(sd: float, rows: float, *shape: int) -> FloatArray:
        noise = gaussian_filter1d(rng.standard_normal((n, *shape)), rows, axis=0, mode="nearest")
        return sd * np.sqrt(2 * np.sqrt(np.pi) * rows) * noise

    pixels = raw.image * size - 0.5 * size
    pixels = pixels + metre * much * (
        wobble(0.008, 2.0, 33, 2) + 0.004 * rng.standard_normal((n, 33, 2)) + 0.006 * rng.standard_normal((33, 2))
    )
    world = raw.world * (1.0, 1.0, np.exp(rng.normal(0, 0.08 * much)))
    world = world + much * (wobble(0.012, 3.0, 33, 3) + 0.012 * rng.standard_normal((33, 3)))
    world[..., 2] += rng.normal(0, 0.08 * much) * world[..., 1]  # leans
    turn, roll = rng.normal(0, np.radians(4) * much), rng.normal(0, np.radians(4))
    world[..., [0, 2]] = world[..., [0, 2]] @ _rotation(turn).T
    world[..., :2], pixels = world[..., :2] @ _rotation(roll).T, pixels @ _rotation(roll).T
    image, score = 0.5 + pixels / size, np.clip(raw.score + rng.normal(0, 0.05 * much, 33), 0, 1)
    if rng.random() < 0.3:  # the detector hangs
        for _ in range(rng.integers(1, 4)):
            first = int(rng.integers(1, n))
            rows, points = slice(first, first + int(rng.integers(1, 4))), rng.choice(33, rng.integers(1, 33), False)
            world[rows, points], image[rows, points] = world[first - 1, points], image[first - 1, points]
            score[rows, points] *= 0.7
    t = (raw.t - raw.t[0]) * np.exp(rng.uniform(-0.4, 0.4))
    return Raw(raw.number, t, world, image, score, raw.size, raw.joints, raw.eye, raw.yaw)


def arms(raw: Raw) -> list[Arm]:
    """Return both arms of a clip, the right one in the mirror."""
    world, image = (smooth(raw.t, v, _NO_SHOTS, PoseSettings().cutoff_hz) for v in (raw.world, raw.image))
    grid, seen = sight(raw.t, world, image, raw.score, raw.size)
    joints = _resampled(grid, raw.t, raw.joints)
    return _with_truth(seen.features(), joints, _ratio(seen.flat, joints), seen.score)


def imagined_arms(clip: Tracked) -> list[Arm]:
    """Return both arms of an imagined clip."""
    t, size = np.arange(len(clip.world)) / RATE_HZ, (1000, 1000)
    world, image = (smooth(t, v, _NO_SHOTS, PoseSettings().cutoff_hz) for v in (clip.world, 0.5 + clip.flat / 4.0))
    grid, seen = sight(t, world, image, clip.score, size)
    return _with_truth(seen.features(), _resampled(grid, t, clip.joints), clip.ratio, seen.score)


def tracked(raw: Raw) -> Tracked:
    """Return a clip for `imagine`."""
    grid, seen = sight(raw.t, raw.world, raw.image, raw.score, raw.size)
    joints = _resampled(grid, raw.t, raw.joints)
    return Tracked(seen.world, seen.flat, seen.score, joints, raw.eye, _ratio(seen.flat, joints), raw.yaw)


def _with_truth(features: FloatArray, joints: FloatArray, ratio: float, score: FloatArray) -> list[Arm]:
    place = {name: joints[:, i] for i, name in enumerate(TRUTH_NAMES)}
    line = place["shoulderL"] + place["hipL"] - place["shoulderR"] - place["hipR"]
    line = line / np.maximum(np.hypot(line[:, 0], line[:, 2]), 1e-9)[:, None]
    made = []
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        k = SIDES.index(side)
        depth = [ratio * (place[part + side] - place["shoulder" + side])[:, 2] for part in ("elbow", "wrist")]
        truth = np.stack([*depth, line[:, 0], sign * line[:, 2], score[:, _WRISTS[k]]], axis=1)
        made.append((features[k].astype(np.float32), truth.astype(np.float32)))
    return made


class Network(nn.Module):
    """Dilated convolutions over time: a row of answers for each WINDOW rows of features."""

    mean: torch.Tensor
    sd: torch.Tensor
    spread: torch.Tensor

    def __init__(self, features: FloatArray) -> None:
        super().__init__()
        self.register_buffer("mean", torch.tensor(features.mean(axis=0), dtype=torch.float32)[:, None])
        self.register_buffer("sd", torch.tensor(features.std(axis=0) + 0.015, dtype=torch.float32)[:, None])
        self.register_buffer("spread", torch.ones(1))
        self.hide = nn.Dropout1d(0.08)
        self.first = nn.Conv1d(FEATURES, WIDTH, 1)
        self.over_time = nn.ModuleList([nn.Conv1d(WIDTH, WIDTH, 3, dilation=d) for d in DILATIONS])
        self.mix = nn.ModuleList([nn.Conv1d(WIDTH, WIDTH, 1) for _ in DILATIONS])
        self.drop = nn.Dropout(0.25)
        self.last = nn.Conv1d(WIDTH, 6, 1)

    def answers(self, x: torch.Tensor) -> torch.Tensor:
        """Depth of elbow and wrist, logarithms of their spread, heading (N, 6, T') from (N, FEATURES, T)."""
        x = torch.relu(self.first(self.hide((x - self.mean) / self.sd)))
        for dilation, over_time, mix in zip(DILATIONS, self.over_time, self.mix, strict=True):
            more = self.drop(mix(torch.relu(over_time(x))))
            x = x[..., dilation:-dilation] + more
        return self.last(torch.relu(x))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """As mimic asks for it: depth of elbow and wrist, spread of the latter, heading (2, T', 5) from (2, T, F)."""
        found = self.answers(features.transpose(1, 2)).transpose(1, 2)
        return torch.cat([found[..., :2], self.spread * torch.exp(found[..., 3:4]), found[..., 4:]], dim=-1)


def loss_of(found: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Return the negative log likelihood of the depths (Student's t, 3 degrees of freedom), with squared errors."""
    weight = UNSEEN_WEIGHT + (truth[:, 4:5] > VISIBLE).float()
    log_scale, error = found[:, 2:4].clamp(-4.5, 0.5), truth[:, :2] - found[:, :2]
    likely = log_scale + 2.0 * torch.log1p((error * torch.exp(-log_scale)) ** 2 / 3.0)
    heading = ((found[:, 4:] - truth[:, 2:4]) ** 2).sum(dim=1).mean()
    return (weight * (likely + 30.0 * error**2)).mean() + 2.0 * heading


def train(clips: list[Raw], dreams: list[Tracked], minutes: float, seed: int) -> Network:
    """Return a trained network."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    learnt, checked = ([c for c in clips if (c.number % EVERY == 0) == out] for out in (False, True))
    clean, left_out = ([arm for clip in part for arm in arms(clip)] for part in (learnt, checked))
    more = [arm for clip in dreams for arm in imagined_arms(clip)]
    net = Network(np.concatenate([features for features, _ in clean]))
    optimiser = torch.optim.AdamW(net.parameters(), 2e-3, weight_decay=0.05)
    began, epoch, versions = time.monotonic(), 0, []
    while (done := (time.monotonic() - began) / 60.0 / minutes) < 1.0:
        optimiser.param_groups[0]["lr"] = 1e-5 + min(1.0, 0.1 + epoch / 3) * 1e-3 * (1.0 + np.cos(np.pi * done))
        if epoch % 2 == 0:
            versions = [*versions, [arm for c in learnt for arm in arms(noisy(c, rng))]][-KEPT:]
        pool = [*clean, *(arm for version in versions for arm in version)]
        share = 0.75 if done < 0.5 else 0.35  # of imagined clips
        if more:
            pool += [more[i] for i in rng.integers(0, len(more), int(len(pool) * share / (1.0 - share)))]
        pool = [(framed(x), y) for x, y in pool if len(y) >= ROWS]
        losses, order = [], rng.permutation(len(pool))
        net.train()
        for k in range(0, len(order) - BATCH + 1, BATCH):
            chosen = [pool[i] for i in order[k : k + BATCH]]
            starts = [int(rng.integers(0, len(y) - ROWS + 1)) for _, y in chosen]
            x = np.stack([x[a : a + ROWS + WINDOW - 1] for (x, _), a in zip(chosen, starts, strict=True)])
            y = np.stack([y[a : a + ROWS] for (_, y), a in zip(chosen, starts, strict=True)])
            x, y = (torch.from_numpy(np.ascontiguousarray(v)).transpose(1, 2) for v in (x, y))
            loss = loss_of(net.answers(x), y)
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimiser.step()
            losses.append(loss.item())
        epoch += 1
        if epoch % 5 == 0:
            print(
                f"{epoch:4d}  {60 * done * minutes:4.0f} s  {np.mean(losses):7.3f}  {check(net, left_out)}", flush=True
            )
    net.eval()
    print(f"{epoch:4d}  end  {check(net, left_out)}", flush=True)
    return net


def check(net: Network, left_out: list[Arm]) -> str:
    """Say how good a network is where the wrist is seen, and set its spread to the size of its errors."""
    net.eval()
    rows, errors, headings = [], [], []
    for features, truth in left_out:
        with torch.no_grad():
            x = torch.from_numpy(framed(features)).T[None]
            found = net.answers(x)[0].T.numpy()
        seen = truth[:, 4] > VISIBLE
        if seen.sum() < ROWS:
            continue
        found, truth = found[seen], truth[seen]
        wrist, true = found[:, 1], truth[:, 1]
        r = np.corrcoef(wrist, true)[0, 1]
        rows.append((r, r * wrist.std() / true.std(), np.mean((wrist - true) ** 2)))
        errors.append((wrist - true) / np.exp(found[:, 3]))
        (x, z), (a, b) = found[:, 4:].mean(axis=0), truth[:, 2:4].mean(axis=0)
        headings.append(np.degrees(np.arctan2(z * a - x * b, x * a + z * b)))
    net.spread[:] = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    r, gain, square = np.mean(rows, axis=0)
    return f"r {r:.2f}, gain {gain:.2f}, {100 * np.sqrt(square):.1f} cm, heading {np.mean(np.abs(headings)):.1f} deg"


def write(net: Network, path: Path) -> None:
    """Write a network as ONNX."""
    buffer: Any = io.BytesIO()
    with contextlib.redirect_stdout(io.StringIO()):
        torch.onnx.export(
            net.eval(), (torch.zeros(2, WINDOW, FEATURES),), buffer, opset_version=17, dynamo=False,
            input_names=["features"], output_names=["found"],
            dynamic_axes={"features": {1: "rows"}, "found": {1: "answers"}},
        )  # fmt: skip
    graph = onnx.load_model_from_string(buffer.getvalue())
    graph.producer_name = "mimic"
    path.write_bytes(graph.SerializeToString())
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


def _ratio(flat: FloatArray, joints: FloatArray) -> float:
    true = joints[:, [TRUTH_NAMES.index(name) for name in ("shoulderL", "shoulderR", "hipL", "hipR")], :2]
    return float(np.median(_spread(flat[:, _TRUNK])) / np.median(_spread(true)))


def _spread(points: FloatArray) -> FloatArray:
    return np.sqrt(((points - points.mean(axis=1, keepdims=True)) ** 2).sum(axis=-1).mean(axis=1))


def _rotation(angle: float) -> FloatArray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _resampled(grid: FloatArray, t: FloatArray, values: FloatArray) -> FloatArray:
    flat = values.reshape(len(t), -1)
    return np.stack([np.interp(grid, t, column) for column in flat.T], axis=1).reshape(len(grid), *values.shape[1:])


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("clips", type=Path, help="folder that depth_clips.py wrote")
    parser.add_argument("out", type=Path, help="network to write (.onnx)")
    parser.add_argument("--minutes", type=float, default=6.0, help="training time")
    parser.add_argument("--imagined", type=int, default=IMAGINED, help="number of imagined clips")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)
    clips = [clip for path in sorted(args.clips.glob("*.npz")) if (clip := read(path)) is not None]
    learnt = [tracked(clip) for clip in clips if clip.number % EVERY]
    dreams = imagine(learnt, args.imagined, args.seed) if args.imagined else []
    print(f"{len(clips)} clips with {sum(len(clip.t) for clip in clips)} frames, {len(dreams)} imagined", flush=True)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    write(train(clips, dreams, args.minutes, args.seed), args.out)


if __name__ == "__main__":
    main()

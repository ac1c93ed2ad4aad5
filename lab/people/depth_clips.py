"""Render random clips of the mannequin, look at them through BlazePose, and keep what it sees beside the truth.

    python -m lab.people.depth_clips OUT --set tuning --clips 5 --video              # clips to tune on
    python -m lab.people.depth_clips OUT --set aside --first 5 --clips 5 --video     # and five kept aside
    python -m lab.people.depth OUT/*.mp4                                                   # what they say
    python -m lab.people.depth_clips OUT/train --clips 500                            # clips to train on

Each clip is one .npz: what BlazePose found in each frame (world, image, score) and the exact joints. The clips are
small and plainly lit, because BlazePose looks at 256 x 256 pixels anyway. A clip depends on its number only.
Without a display set MUJOCO_GL to egl or osmesa.
"""

from __future__ import annotations

import argparse
import pickle
import time
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from lab.people import mannequin, rooms
from lab.people.arm_motions import FAMILIES, KEPT_ASIDE, TUNING, Rng, motion_of
from lab.people.scene import Shot, build_scene, text
from lab.people.skeleton import TRUTH_NAMES, Build, pose
from lab.people.surface import Array, mesh_of
from mimic.sources.video.pose_models.blazepose import BlazePose
from mimic.sources.video.pose_models.pose_model import pose_model

COARSE = 2.0
"""The meshes have cells this much larger than those of the example videos."""
BODIES = 24
SIZES = ((384, 288), (288, 384), (384, 216), (320, 320), (320, 240))


@dataclass(frozen=True)
class View:
    """Where the camera is, against the person."""

    yaw: float
    """From where the person looks toward the left [rad]."""
    height: float
    aim: float
    distance: float
    fovy: float
    pan: float
    roll: float
    size: tuple[int, int]


def person(number: int, cache: Path) -> tuple[mannequin.Look, Build, list[mannequin.Skin]]:
    """Return one of the bodies, meshed once."""
    path = cache / f"body{number}.pkl"
    if path.exists():
        return pickle.loads(path.read_bytes())
    rng = np.random.default_rng(1000 + number)
    arms, wide, legs = rng.uniform(0.9, 1.1), rng.uniform(0.88, 1.1), rng.uniform(0.93, 1.07)
    build = Build(
        upper_arm=0.290 * arms * rng.uniform(0.96, 1.04),
        forearm=0.255 * arms * rng.uniform(0.96, 1.04),
        shoulder_half=0.178 * wide,
        hip_half=0.092 * rng.uniform(0.92, 1.1),
        thigh=0.425 * legs,
        shin=0.405 * legs,
        hip_z=0.085 + (0.425 + 0.405) * legs,
    )
    if legs != 1.0:  # the trunk keeps its place: shorter legs would leave a gap
        build = replace(build, thigh=0.425, shin=0.405, hip_z=0.915)
    styles = [("tee", "trousers"), ("tank", "shorts"), ("leotard", "tights"), ("long", "trousers"), ("tee", "shorts")]
    top_style, bottom_style = styles[number % len(styles)]
    look = mannequin.Look(
        **{
            name: (0.5, 0.5, 0.5)
            for name in ("skin", "hair", "lips", "iris", "top", "bottom", "trim", "shoes", "soles")
        },
        bun=bool(rng.random() < 0.4),
        top_style=top_style,
        bottom_style=bottom_style,
        hands=("open", "gloves", "soft", "open")[int(rng.integers(4))],
        slender=float(rng.uniform(0, 1)),
    )
    mannequin.mesh_of = lambda solid, low, high, step: mesh_of(solid, low, high, COARSE * step)
    found = look, build, mannequin.skins(look, build)
    cache.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(found))
    return found


def colours(rng: Rng) -> dict[str, tuple[float, float, float]]:
    """Return random colours of skin, hair and clothes."""
    tone = rng.random()
    skin = tuple((1 - tone) * np.array([0.93, 0.75, 0.65]) + tone * np.array([0.32, 0.20, 0.14]))
    hair = tuple(rng.choice([[0.08, 0.06, 0.05], [0.3, 0.18, 0.1], [0.75, 0.6, 0.35], [0.55, 0.53, 0.5]]))
    any_ = {name: tuple(rng.uniform(0.05, 0.95, 3)) for name in ("top", "bottom", "trim", "shoes", "soles")}
    lips = tuple(np.array(skin) * [0.85, 0.5, 0.5])
    return {"skin": skin, "hair": hair, "lips": lips, "iris": (0.25, 0.25, 0.2), **any_}


def random_view(rng: Rng) -> View:
    """Return a view: mostly the front half, some from the side and from behind; any lens."""
    kind = rng.random()
    yaw = rng.uniform(-75, 75) if kind < 0.84 else rng.uniform(75, 110) * rng.choice([-1, 1])
    if kind > 0.92:
        yaw = rng.uniform(110, 250)
    size = SIZES[int(rng.integers(len(SIZES)))]
    fovy = rng.uniform(22, 58)
    share = rng.uniform(0.9, 2.0) if rng.random() < 0.35 else rng.uniform(0.5, 0.9)  # body height over picture
    if size[0] < size[1]:
        share = min(share, 0.9)
    distance = 0.5 * 1.75 / share / np.tan(np.radians(fovy) / 2)
    distance = max(distance, 1.6)
    top = distance * np.tan(np.radians(fovy) / 2)
    aim = rng.uniform(0.85, 1.05) if share < 0.9 else max(1.05, 1.85 - top)
    return View(
        np.radians(yaw), rng.uniform(0.7, 1.8), aim, distance, fovy,
        np.radians(rng.uniform(-4, 4)), np.radians(rng.normal(0, 1.5)), size,
    )  # fmt: skip


def camera_axes(view: View) -> Array:
    """Rows: right, down and away of the camera, in the room's axes (the camera stands on +x of the person)."""
    pitch = np.arctan2(view.height - view.aim, view.distance)
    away = np.array([-np.cos(pitch) * np.cos(view.pan), np.sin(view.pan), -np.sin(pitch) * np.cos(view.pan)])
    right = np.cross(away, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(away, right)
    c, s = np.cos(view.roll), np.sin(view.roll)
    return np.stack([c * right + s * down, c * down - s * right, away])


def eye_of(view: View) -> Array:
    """Return where the camera is, in its own axes from the floor under the person (3,) [m]."""
    return camera_axes(view) @ np.array([view.distance, 0.0, view.height])


_FIXED: dict[str, rooms.Room] = {}


def scene(view: View, look: mannequin.Look, build: Build, skins: list[mannequin.Skin], rng: Rng) -> mujoco.MjModel:
    """Return a plainly lit scene."""
    name = str(rng.choice(["gym", "studio", "lounge"]))
    if name not in _FIXED:
        _FIXED[name] = getattr(rooms, name)()
    paint = colours(rng)
    by_name = {"body": "skin", "head": "skin", "hair": "hair", "top": "top", "bottom": "bottom"}
    painted = []
    for part in skins:
        stem = part.name.split("_")[0]
        kind = by_name.get(stem, "shoes" if stem == "shoe" else "soles" if stem == "sole" else stem)
        colour = paint.get(kind, paint["trim"] if kind != "glove" else paint["soles"])
        painted.append(replace(part, colour=colour, shine=0.2))
    sun = rng.normal(0, 1, 3) * [1, 1, 0.3] + [-0.8, 0, -1.0]
    bright = rng.uniform(0.35, 0.65)
    visual = f"""
        <quality shadowsize="0" offsamples="0" numslices="12" numquads="2"/>
        <map znear="0.1" zfar="20"/>
        <headlight ambient="0.3 0.3 0.3" diffuse="{text([rng.uniform(0.05, 0.3)] * 3)}" specular="0 0 0"/>"""
    lights = f'<light directional="true" castshadow="false" dir="{text(sun)}" diffuse="{text([bright] * 3)}"/>'
    shot = Shot(
        eye=np.array([view.distance, 0.0, view.height]), axes=camera_axes(view), fovy=view.fovy, yaw=view.yaw,
        size=view.size, visual=visual, lights=lights, gloss=0.5,
    )  # fmt: skip
    return build_scene(_FIXED[name], replace(look, **paint), build, painted, shot)


def spoiled(
    rgb: np.ndarray, rng: Rng, quality: int, gamma: float, cover: tuple[int, int, int, int] | None
) -> np.ndarray:
    """Return a frame as a cheap camera would store it."""
    picture = cv2.LUT(rgb, (255 * (np.arange(256) / 255) ** gamma).astype(np.uint8))
    if cover is not None:
        x0, y0, x1, y1 = cover
        picture[y0:y1, x0:x1] = (picture[y0:y1, x0:x1] // 6) + 40
    coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR))


def clip(number: int, kind: str, cache: Path, out: Path, detect: BlazePose, video: bool) -> str:
    """Render one clip, track it and write its file; return what it shows."""
    rng = np.random.default_rng([number, {"train": 0, "tuning": 1, "aside": 2}[kind]])
    families = {"train": FAMILIES, "tuning": TUNING, "aside": KEPT_ASIDE}[kind]
    name = list(families)[number % len(families)] if kind != "train" else str(rng.choice(list(families)))
    rate = 30.0 if kind != "train" or rng.random() < 0.15 else 15.0
    seconds = 10.0 if kind != "train" else 4.0 if rate > 20 else rng.uniform(5.0, 8.0)
    view = random_view(rng)
    if kind != "train":  # headings over the whole range, evenly
        yaw = np.radians([8, -32, 52, -70, 20, -5, 40, -58, 74, -20][number % 10])
        view = replace(view, yaw=float(yaw), size=(480, 360))
    look, build, skins = person(int(rng.integers(BODIES)) if kind == "train" else BODIES + number % 10, cache)
    motion = motion_of(families[name](rng, seconds), rng, seconds, rate)
    model = scene(view, look, build, skins, rng)
    bones, joints = pose(motion, build)
    axes = camera_axes(view) @ Rotation.from_euler("z", view.yaw).as_matrix().T
    width, height = view.size
    quality, gamma = int(rng.integers(35, 95)), rng.uniform(0.7, 1.5)
    cover = None
    if rng.random() < 0.10:
        x, y = rng.uniform(0.2, 0.8) * width, rng.uniform(0.3, 0.9) * height
        left, top = max(0, int(x - 0.12 * width)), max(0, int(y - 0.12 * height))
        cover = left, top, int(x + 0.12 * width), int(y + 0.12 * height)
    data, renderer = mujoco.MjData(model), mujoco.Renderer(model, height, width)
    slot = {bone: int(model.body(bone).mocapid[0]) for bone in bones}
    quats = {bone: np.roll(Rotation.from_matrix(frames.R).as_quat(), 1, axis=1) for bone, frames in bones.items()}
    nothing = np.full((33, 3), np.nan), np.full((33, 2), np.nan), np.zeros(33)
    rows = []
    writer = (
        cv2.VideoWriter(str(out / f"{kind}{number}.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), rate, view.size)
        if video
        else None
    )
    try:
        for _ in range(2):  # it forgets the person of the clip before
            detect(np.zeros((height, width, 3), np.uint8))
        for i in range(len(motion.t)):
            for bone, frames in bones.items():
                data.mocap_pos[slot[bone]] = frames.p[i]
                data.mocap_quat[slot[bone]] = quats[bone][i]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, "film")
            picture = spoiled(renderer.render(), rng, quality, gamma, cover)
            if writer is not None:
                writer.write(picture[:, :, ::-1])
            rows.append(detect(picture) or nothing)
    finally:
        renderer.close()
        if writer is not None:
            writer.release()
    world, image, score = (np.array(column, np.float32) for column in zip(*rows, strict=True))
    np.savez_compressed(
        out / f"{kind}{number}.npz",
        t=motion.t, names=np.array(TRUTH_NAMES), world=world, image=image, score=score, size=view.size,
        joints=(joints @ axes.T).astype(np.float32), eye=eye_of(view), yaw=view.yaw, family=name, rate=rate,
    )  # fmt: skip
    return f"{kind}{number} {name} {np.degrees(view.yaw):.0f} deg, {len(motion.t)} frames"


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("out", type=Path, help="folder to write to")
    parser.add_argument("--clips", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="number of the first clip")
    parser.add_argument("--set", choices=("train", "tuning", "aside"), default="train", dest="kind")
    parser.add_argument("--video", action="store_true", help="also write the pictures")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    cache = args.out.parent / "bodies"
    with BlazePose(pose_model()) as detect:
        for number in range(args.first, args.first + args.clips):
            if not (args.out / f"{args.kind}{number}.npz").exists():
                began = time.perf_counter()
                said = clip(number, args.kind, cache, args.out, detect, args.video)
                print(f"{said}, {time.perf_counter() - began:.1f} s", flush=True)


if __name__ == "__main__":
    main()

"""A small made-up run: a robot that waves for a second, a person whose arms move, and a video of coloured frames."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from mimic.records import LANDMARKS, PHASES, PoseTrack, RunLog, TargetTrack
from mimic.robot.description import RobotDescription, load_description
from mimic.robot.leg_kinematics import front_toes
from mimic.view.film.footage import encode_h264

STAND_UP, BLEND, TRACKED, HELD = 20, 5, 50, 5
DT = 0.02


@pytest.fixture(scope="session")
def description() -> RobotDescription:
    return load_description("cyberdog2")


@pytest.fixture(scope="session")
def log(description: RobotDescription) -> RunLog:
    """Return a log of a robot that stands up in a moment and then moves its front legs; no physics."""
    counts = {"stand_up": STAND_UP, "blend": BLEND, "track": TRACKED, "hold": HELD}
    phase = np.repeat([PHASES.index(name) for name in counts], list(counts.values()))
    n = len(phase)
    share = np.clip(np.arange(n) / STAND_UP, 0, 1)[:, None]
    q = (1 - share) * description.poses["lie"] + share * description.poses["upright"]
    q[:, [1, 4]] += 0.4 * np.sin(np.arange(n) * 0.3)[:, None]
    angle = -share[:, 0] * np.pi / 2
    quat = np.column_stack([np.cos(angle / 2), np.zeros(n), np.sin(angle / 2), np.zeros(n)])
    height = (1 - share) * description.pose_height["lie"] + share * description.pose_height["upright"]
    toes = front_toes(q, description)
    zeros3, zeros12 = np.zeros((n, 3)), np.zeros((n, 12))
    return RunLog(
        t=5.0 + np.arange(n) * DT,
        t_host=np.arange(n) * DT,
        phase=phase,
        q=q,
        dq=zeros12,
        tau=zeros12 + np.sin(np.arange(n))[:, None],
        quat_WB=quat,
        omega_B=zeros3,
        p_WB=np.column_stack([0.3 * share, 0 * share, height]),
        v_WB=zeros3,
        p_BE=toes,
        v_des=np.zeros((n, 2)),
        heading_des=np.zeros(n),
        p_BE_des=toes + 0.02,
        observation=np.zeros((n, 1)),
        action=zeros12,
        q_des=q,
        q_sent=q,
        kp=zeros12,
        kd=zeros12,
    )


@pytest.fixture(scope="session")
def targets(log: RunLog) -> TargetTrack:
    rows = np.flatnonzero(log.phase == PHASES.index("track"))[::5]
    n = len(rows)
    return TargetTrack(
        t=log.t[rows] - log.t[rows[0]],
        p_BE=log.p_BE_des[rows],
        heading=np.zeros(n),
        valid=np.ones((n, 2), dtype=bool),
        moved=np.tile([0.0, 0.03], (n, 1)),
        limited=np.zeros((n, 2), dtype=bool),
        wanted=log.p_BE_des[rows] + [[0.0, 0.0, 0.0], [0.03, 0.0, 0.0]],
    )


@pytest.fixture(scope="session")
def pose() -> PoseTrack:
    """Return a person who faces the camera, on frames at uneven times; the right wrist is never seen."""
    n, names = 20, LANDMARKS
    points = np.zeros((n, len(names), 3))
    places = {
        "shoulder": (0.2, -0.5),
        "elbow": (0.4, -0.4),
        "wrist": (0.6, -0.3),
        "hip": (0.1, 0.0),
        "ankle": (0.1, 0.9),
    }
    for part, (out, down) in places.items():
        points[:, names.index(f"left_{part}")] = out, down, 0.0
        points[:, names.index(f"right_{part}")] = -out, down, 0.0
    valid = np.zeros((n, len(names)), dtype=bool)
    valid[:, [names.index(f"{side}_{part}") for part in places for side in ("left", "right")]] = True
    valid[:, names.index("right_wrist")] = False
    t = np.arange(n) / 20
    t[10:] += 0.1
    return PoseTrack(
        t=t,
        landmarks=points,
        image=np.clip(0.5 + points[..., :2] / 2, 0, 1),
        score=valid.astype(float),
        valid=valid,
        size=(96, 64),
        swapped=np.zeros(n, dtype=bool),
    )


@pytest.fixture(scope="session")
def video(pose: PoseTrack, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a video whose frames get brighter: frame k is grey 10 + 10 k."""
    path = tmp_path_factory.mktemp("video") / "grey.mp4"
    frames = (np.full((64, 96, 3), 10 + 10 * k, dtype=np.uint8) for k in range(len(pose.t)))
    encode_h264(frames, path, fps=Fraction(20))
    return path

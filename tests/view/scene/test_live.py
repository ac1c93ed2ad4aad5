from __future__ import annotations

import time

import cv2
import numpy as np
import pytest

from mimic.records import RobotState, Tick
from mimic.view.scene.live import EVERY, WAITING, LiveView


@pytest.fixture
def standing(description) -> Tick:
    state = RobotState(
        t=1.0,
        q=description.poses["upright"],
        dq=np.zeros(12),
        tau=np.zeros(12),
        quat_WB=np.array([0.7071, 0.0, -0.7071, 0.0]),
        omega_B=np.zeros(3),
        p_WB=np.full(3, np.nan),
        v_WB=np.full(3, np.nan),
    )
    return Tick(state=state, sent=None, health=None)  # type: ignore[arg-type]


def test_a_picture_a_robot_and_the_latency_go_into_the_scene(description, standing, tmp_path):
    jpeg = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    image, valid = np.full((33, 2), 0.5), np.ones(33, dtype=bool)
    with LiveView(description, path=tmp_path / "live.rrd") as view:
        for tick in range(2 * EVERY):
            view.tick(standing)
            view.frame(0.1 * tick, jpeg, image, valid, 0.03)
            time.sleep(0.05)
        view.frame(1.0, None, image, valid, 0.03)
    scene = (tmp_path / "live.rrd").read_bytes()
    for entity in (b"/video/skeleton/left", b"/robot/toes/right", b"/latency"):
        assert entity in scene, entity


def test_who_draws_too_slowly_drops_and_counts_instead_of_waiting(description, standing, tmp_path):
    view = LiveView(description, path=tmp_path / "live.rrd")  # its thread does not run yet
    for _ in range(EVERY * (WAITING + 3)):
        view.tick(standing)
    assert view.dropped == 3
    with view:
        pass
    assert (tmp_path / "live.rrd").stat().st_size > 0

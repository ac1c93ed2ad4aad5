import dataclasses

import mujoco
import numpy as np

from mimic.dynamics.robot_model import load_model
from mimic.geometry import rotation_from_quat
from mimic.records import RunLog
from mimic.robot.description import RobotDescription
from mimic.robot.model import TOES
from mimic.view.scene.robot_drawing import capsule_starts
from mimic.view.scene.robot_shapes import VISUAL_GROUP, body_poses, in_world, qpos_at_ticks, visual_shapes

TICK = 60


def test_shapes_are_where_mujoco_draws_its_geoms(log: RunLog, description: RobotDescription) -> None:
    model = load_model(description)
    data = mujoco.MjData(model)
    qpos = qpos_at_ticks(log, model)
    data.qpos[:] = qpos[TICK]
    mujoco.mj_forward(model, data)
    visual = np.flatnonzero(model.geom_group == VISUAL_GROUP)
    position, quat = body_poses(model, qpos)
    found = []
    for shapes in visual_shapes(model):
        body = model.body(shapes.body).id
        R_WL = rotation_from_quat(quat[TICK, body])
        centres = position[TICK, body] + shapes.position @ R_WL.T
        R_WG = R_WL @ rotation_from_quat(shapes.quat)
        for centre, rotation in zip(centres, R_WG, strict=True):
            distance = np.linalg.norm(data.geom_xpos[visual] - centre, axis=1)
            turned = np.abs(data.geom_xmat[visual].reshape(-1, 3, 3) - rotation).max(axis=(1, 2))
            found.append(int(np.argmin(distance + turned)))
            assert (distance + turned).min() < 1e-5
    assert sorted(found) == list(range(len(visual)))


def test_capsules_begin_at_the_end_of_their_axis(description: RobotDescription) -> None:
    model = load_model(description)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    capsules = [shapes for shapes in visual_shapes(model) if shapes.kind == "capsule"]
    assert capsules
    for shapes in capsules:
        ends = shapes.position - capsule_starts(shapes)
        np.testing.assert_allclose(np.linalg.norm(ends, axis=1), shapes.size[:, 1], atol=1e-9)
        np.testing.assert_allclose(np.cross(ends, rotation_from_quat(shapes.quat)[..., 2]), 0, atol=1e-9)


def test_spheres_have_equal_half_lengths_and_colours_come_from_materials(description: RobotDescription) -> None:
    model = load_model(description)
    shapes = list(visual_shapes(model))
    assert all((group.size > 0).all() for group in shapes if group.kind in ("ellipsoid", "box"))
    orange = model.material("accent").rgba
    assert any(np.allclose(rgba, orange) for group in shapes for rgba in group.rgba)


def test_robot_that_does_not_know_its_place_stands_on_its_lowest_toe(
    log: RunLog, description: RobotDescription
) -> None:
    model = load_model(description)
    lost = dataclasses.replace(log, p_WB=np.full_like(log.p_WB, np.nan))
    qpos = qpos_at_ticks(lost, model)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos[TICK]
    mujoco.mj_kinematics(model, data)
    lowest = min(data.site(name).xpos[2] for name in TOES)
    assert abs(lowest - description.toe_radius) < 1e-9
    np.testing.assert_array_equal(qpos[:, :2], 0.0)


def test_toes_in_the_world_are_the_models_toes(log: RunLog, description: RobotDescription) -> None:
    model = load_model(description)
    data = mujoco.MjData(model)
    qpos = qpos_at_ticks(log, model)
    data.qpos[:] = qpos[TICK]
    mujoco.mj_kinematics(model, data)
    toes = np.array([data.site(name).xpos for name in TOES[:2]])
    np.testing.assert_allclose(in_world(qpos, log.p_BE)[TICK], toes, atol=1e-6)

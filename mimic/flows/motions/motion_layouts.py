"""A run as a motion for programs that train a policy to imitate motions: mjlab and GMR.

Source: mujocolab/mjlab, src/mjlab/scripts/csv_to_npz.py and tasks/tracking/mdp/commands.py (MotionLoader);
YanjieZe/GMR, general_motion_retargeting/data_loader.py (load_robot_motion) and scripts/bvh_to_robot.py.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mimic.dynamics.robot_model import load_model
from mimic.records import FloatArray, RunLog
from mimic.robot.description import RobotDescription
from mimic.view.scene.robot_shapes import qpos_at_ticks


def mjlab_motion(log: RunLog, ticks: np.ndarray, fps: int, description: RobotDescription) -> dict[str, Any]:
    """Return the arrays of an mjlab motion file (.npz).

    ``joint_pos``, ``joint_vel`` (T, J): joints in the order of the robot's MJCF. ``body_pos_w``, ``body_quat_w``
    (wxyz), ``body_lin_vel_w``, ``body_ang_vel_w`` (T, B, ...): origin and velocity of each body in world axes, in the
    order of the MJCF, the base first. Velocities are central differences of the positions. ``fps`` (1,).

    Args:
        log: A run without gaps.
        ticks: Rows of the log at equal steps (T,).
        fps: Rows a second.
        description: The robot.
    """
    model = load_model(description)
    data = mujoco.MjData(model)
    qpos = qpos_at_ticks(log, model)[ticks]
    qvel = _velocities(model, qpos, 1.0 / fps)
    bodies = range(1, model.nbody)  # without the world
    pose = np.empty((len(qpos), len(bodies), 7))
    velocity = np.empty((len(qpos), len(bodies), 6))
    for row in range(len(qpos)):
        data.qpos[:] = qpos[row]
        data.qvel[:] = qvel[row]
        mujoco.mj_forward(model, data)
        pose[row] = np.hstack([data.xpos[1:], data.xquat[1:]])
        for body in bodies:
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity[row, body - 1], 0)
    arrays = {
        "joint_pos": qpos[:, 7:],
        "joint_vel": qvel[:, 6:],
        "body_pos_w": pose[..., :3],
        "body_quat_w": pose[..., 3:],
        "body_lin_vel_w": velocity[..., 3:],
        "body_ang_vel_w": velocity[..., :3],
    }
    return {"fps": np.array([fps]), **{name: values.astype(np.float32) for name, values in arrays.items()}}


def gmr_motion(log: RunLog, ticks: np.ndarray, fps: int, description: RobotDescription) -> dict[str, Any]:
    """Return the content of a GMR motion file (.pkl).

    ``fps``, ``root_pos`` (T, 3) [m], ``root_rot`` (T, 4) as xyzw, ``dof_pos`` (T, J) in the order of the robot's MJCF;
    ``local_body_pos`` and ``link_body_list`` are None, as in the files of GMR's own scripts.
    """
    qpos = qpos_at_ticks(log, load_model(description))[ticks]
    return {
        "fps": fps,
        "root_pos": qpos[:, :3],
        "root_rot": qpos[:, [4, 5, 6, 3]],
        "dof_pos": qpos[:, 7:],
        "local_body_pos": None,
        "link_body_list": None,
    }


def _velocities(model: mujoco.MjModel, qpos: FloatArray, dt: float) -> FloatArray:
    """Return MuJoCo's velocities (T, nv) as central differences, one-sided at the ends."""
    qvel = np.zeros((len(qpos), model.nv))
    for row in range(len(qpos)):
        before = max(row - 1, 0)
        after = min(row + 1, len(qpos) - 1)
        if after > before:
            mujoco.mj_differentiatePos(model, qvel[row], (after - before) * dt, qpos[before], qpos[after])
    return qvel

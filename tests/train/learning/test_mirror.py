from __future__ import annotations

import numpy as np
import pytest

from mimic.geometry import heading_from_quat
from mimic.policy.contract import AHEAD, FRONT, ObservationBuilder, arm_reference, joint_command
from mimic.records import JointCommand
from mimic.simulation.plant import SimulatedPlant

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
from mimic.config.training import MdpSettings  # noqa: E402
from mimic.train.contract import make_contract  # noqa: E402
from mimic.train.learning.mirror import mirrored_actions, mirrored_observations  # noqa: E402


def mirrored_arms(rows: np.ndarray) -> np.ndarray:
    """Return positions and velocities (2, 4, 6) of mirrored front legs."""
    swapped = np.concatenate([rows[..., 3:], rows[..., :3]], -1)
    return swapped * [-1.0, 1.0, 1.0, -1.0, 1.0, 1.0]


def test_a_mirrored_robot_with_mirrored_actions_sees_mirrored_observations(description):
    """Two robots in plain MuJoCo; the trunk's centre of mass is 0.2 mm off its middle, hence the tolerance."""
    contract = make_contract(description, MdpSettings())
    rng = np.random.default_rng(4)
    script = 0.4 * rng.normal(size=(10, 12))
    arm_rows = rng.normal(size=(10, 2, len(AHEAD), FRONT))
    seen = []
    for flip in (False, True):
        plant = SimulatedPlant(description)
        plant.model.opt.impratio = 1.0  # stiff contacts make small differences grow
        lying = [0.0, 0.0, description.pose_height["lie"] + 0.005, 1.0, 0.0, 0.0, 0.0, *description.poses["lie"]]
        state = plant.start_at(np.array(lying), np.zeros(18))
        heading0 = float(heading_from_quat(state.quat_WB))
        builder, rows = ObservationBuilder(contract), []
        for k, action in enumerate(script):
            if flip:
                action = mirrored_actions(torch.as_tensor(action)[None])[0].numpy()
            arms = mirrored_arms(arm_rows[k]) if flip else arm_rows[k]
            rows.append(
                builder.observe(
                    q=state.q,
                    quat_WB=state.quat_WB,
                    v_des=np.array([0.2, -0.1 if flip else 0.1]),
                    heading_des=heading0 + (-0.4 if flip else 0.4),
                    p_BE_des=np.zeros((2, 3)),
                    omega_B=state.omega_B,
                    dq=state.dq,
                    arms=arm_reference(*arms, np.ones(()), np.zeros(FRONT), np),
                )
            )
            builder.acted(action)
            command = JointCommand(
                q_des=joint_command(contract, action),
                dq_des=np.zeros(12),
                kp=np.array(contract.kp),
                kd=np.array(contract.kd),
                tau_ff=np.zeros(12),
            )
            state = plant.step(command).state
            assert k or flip or np.abs(state.dq).max() > 0.1
        seen.append(np.array(rows))
    image = mirrored_observations(torch.as_tensor(seen[0], dtype=torch.float32)).numpy()
    width = contract.history * contract.frame_size
    assert image[:, width:] == pytest.approx(seen[1][:, width:], abs=1e-6)
    mirrored, other = (rows[:, :width].reshape(10, contract.history, -1) for rows in (image, seen[1]))
    clock = contract.columns("clock")
    assert np.abs(np.delete(mirrored - other, clock, axis=2)).max() < 0.02
    assert np.allclose(mirrored[..., clock], -other[..., clock], atol=1e-6)  # half a cycle away

from __future__ import annotations

import numpy as np
import pytest

from mimic.geometry import heading_from_quat
from mimic.policy.contract import ObservationBuilder, joint_command
from mimic.records import JointCommand
from mimic.robot.leg_kinematics import front_toes
from mimic.simulation.plant import SimulatedPlant

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
from mimic.config.training import MdpSettings  # noqa: E402
from mimic.train.contract import make_contract  # noqa: E402
from mimic.train.mirror import mirrored_actions, mirrored_observations  # noqa: E402


def test_a_mirrored_robot_with_mirrored_actions_sees_mirrored_observations(description):
    """Two robots in plain MuJoCo; the trunk's centre of mass is 0.2 mm off its middle, hence the tolerance."""
    contract = make_contract(description, MdpSettings())
    rng = np.random.default_rng(4)
    script = 0.4 * rng.normal(size=(10, 12))
    goals = front_toes(rng.uniform(-0.3, 0.3, 12) + description.poses["upright"], description)
    seen = []
    for flip in (False, True):
        plant = SimulatedPlant(description)
        state = plant.start()
        heading0 = float(heading_from_quat(state.quat_WB))
        builder, rows = ObservationBuilder(contract), []
        for k, action in enumerate(script):
            if flip:
                action = mirrored_actions(torch.as_tensor(action)[None])[0].numpy()
            toes = goals[::-1] * [1.0, -1.0, 1.0] if flip else goals
            rows.append(
                builder.observe(
                    q=state.q,
                    quat_WB=state.quat_WB,
                    v_des=np.array([0.2, -0.1 if flip else 0.1]),
                    heading_des=heading0 + (-0.4 if flip else 0.4),
                    p_BE_des=toes,
                    omega_B=state.omega_B,
                    dq=state.dq,
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
    mirrored = (
        mirrored_observations(torch.as_tensor(seen[0], dtype=torch.float32)).numpy().reshape(10, contract.history, -1)
    )
    other = seen[1].reshape(10, contract.history, -1)
    clock = slice(39, 41)
    assert np.abs(np.delete(mirrored - other, np.r_[clock], axis=2)).max() < 0.02
    assert np.allclose(mirrored[..., clock], -other[..., clock], atol=1e-6)  # half a cycle away

"""The command that only damps."""

from __future__ import annotations

import numpy as np

from mimic.records import FloatArray, JointCommand


def damping_command(q: FloatArray, kd: float) -> JointCommand:
    """Return the command that only damps: no stiffness, velocity gain kd [N m s/rad]."""
    zeros = np.zeros_like(q)
    return JointCommand(q_des=q.copy(), dq_des=zeros, kp=zeros, kd=np.full_like(q, kd), tau_ff=zeros)

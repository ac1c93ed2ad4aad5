"""The first steps of a policy with made-up inputs, kept in its ONNX file: a new player can be checked with them."""

from __future__ import annotations

import json

import numpy as np

from mimic.policy.contract import ObservationBuilder, joint_command
from mimic.policy.runtime import Policy
from mimic.records import FloatArray

REFERENCE_KEY = "mimic_reference"
"""Key of the reference in the ONNX file's metadata."""

STEPS = 50
"""Control steps of a reference."""


def reference(policy: Policy) -> str:
    """Return STEPS control steps of a policy as JSON: made-up inputs, and what it answers.

    ``inputs`` has a row per step: q [rad], quat (wxyz), velocity [m/s], heading (desired, [rad]), toes [m], and
    for a policy that senses them gyro and dq [rad/s], and arms, the terms of ``once``.
    ``observation`` is what they become, ``action`` the clipped answer, ``q_des`` what is sent [rad].
    """
    contract = policy.contract
    rng = np.random.default_rng(0)
    phase = np.linspace(0.0, 2 * np.pi, STEPS)[:, None]

    def wave(width: int) -> FloatArray:
        return np.sin(phase * rng.uniform(0.5, 2.0, width) + rng.uniform(-np.pi, np.pi, width))

    quat = np.array([0.75, 0.0, -0.65, 0.0]) + 0.2 * wave(4)
    inputs = {
        "q": np.clip(np.array(contract.default_q) + 0.3 * wave(12), contract.q_min, contract.q_max),
        "quat": quat / np.linalg.norm(quat, axis=1, keepdims=True),
        "velocity": np.array(contract.velocity_max) * wave(2),
        "heading": 3.0 * wave(1)[:, 0],
        "toes": np.array(contract.neutral_toes) + 0.05 * wave(6),
    }
    if contract.columns("gyro").size:
        inputs |= {"gyro": 2.0 * wave(3), "dq": 5.0 * wave(12)}
    if contract.once:
        inputs["arms"] = wave(sum(width for _, width in contract.once))
    nothing = np.zeros((STEPS, 12))
    builder = ObservationBuilder(contract)
    observations: list[list[float]] = []
    actions: list[list[float]] = []
    sent: list[list[float]] = []
    for step in range(STEPS):
        observation = builder.observe(
            q=inputs["q"][step],
            quat_WB=inputs["quat"][step],
            v_des=inputs["velocity"][step],
            heading_des=float(inputs["heading"][step]),
            p_BE_des=inputs["toes"][step].reshape(2, 3),
            omega_B=inputs.get("gyro", nothing[:, :3])[step],
            dq=inputs.get("dq", nothing)[step],
            arms=inputs["arms"][step] if contract.once else None,
        )
        action = policy.act(observation)
        builder.acted(action)
        observations.append(observation.tolist())
        actions.append(np.clip(action, -contract.action_clip, contract.action_clip).tolist())
        sent.append(joint_command(contract, action).tolist())
    rows = {name: values.tolist() for name, values in inputs.items()}
    return json.dumps({"inputs": rows, "observation": observations, "action": actions, "q_des": sent})

"""The reference in the shipped files is what they do, read as a stranger would."""

from __future__ import annotations

import json

import numpy as np
import onnxruntime
import pytest

from mimic.io.assets import shipped
from mimic.policy.contract import ARM_TERMS, FORMULAS, METADATA_KEY, PAPER_TERMS, TERMS
from mimic.policy.reference import REFERENCE_KEY, STEPS, reference
from mimic.policy.runtime import SHIPPED, load_policy


@pytest.fixture(params=SHIPPED)
def file(request):
    return shipped("policies", f"{request.param}.onnx")


def test_the_network_answers_as_its_reference_says(file):
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    metadata = session.get_modelmeta().custom_metadata_map
    contract, known = json.loads(metadata[METADATA_KEY]), json.loads(metadata[REFERENCE_KEY])
    frames, gait, slow, names = None, 0.0, None, dict(contract["terms"])
    q, quat, action = np.array(known["inputs"]["q"]), np.array(known["inputs"]["quat"]), np.zeros(12)
    for k in range(STEPS):
        w, x, y, z = quat[k]
        heading = np.arctan2(-2 * (x * y - w * z), 1 - 2 * (x * x + z * z))
        error = (known["inputs"]["heading"][k] - heading + np.pi) % (2 * np.pi) - np.pi
        clock = 2 * np.pi * contract["clock_hz"] * contract["dt"] * k
        velocity, error = known["inputs"]["velocity"][k], min(max(error, -1.0), 1.0)
        walks = np.hypot(*velocity) > contract["walk_speed"]
        turns = abs(error) > contract["walk_turn"] * (1 - gait / 2)
        fade = contract["clock_fade"]
        gait = np.clip(gait + (1 if walks or turns else -1) * contract["dt"] / fade, 0, 1) if fade else 1.0
        frame = [
            *(q[k] - contract["default_q"]),
            *(-2 * (x * z - w * y), -2 * (y * z + w * x), -(1 - 2 * (x * x + y * y))),
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *action,
            *velocity,
            error,
            *(known["inputs"]["toes"][k] if "toe_command" in names else ()),
            *(gait * np.sin(clock), gait * np.cos(clock)),
        ]
        if "gyro" in names:
            now = np.array([*frame[:18], *velocity])  # joint positions, down, forward, velocity command
            slow = now if slow is None else slow + (now - slow) * contract["dt"] / 3.0
            turning, moving = np.array(known["inputs"]["gyro"][k]), np.array(known["inputs"]["dq"][k])
            frame += [*np.clip(0.25 * turning, -5, 5), *np.clip(0.05 * moving, -2, 2), *slow]
        frames = [frame] * contract["history"] if frames is None else [*frames[1:], frame]
        once = known["inputs"]["arms"][k] if contract.get("once") else []
        observation = np.concatenate([*frames, once])
        assert np.allclose(observation, known["observation"][k], rtol=0, atol=1e-9), k
        (answer,) = session.run(None, {"observation": observation.astype(np.float32)[None]})
        action = np.clip(answer[0], -contract["action_clip"], contract["action_clip"])
        assert np.allclose(action, known["action"][k], rtol=0, atol=1e-5)
        sent = np.clip(contract["default_q"] + contract["action_scale"] * action, contract["q_min"], contract["q_max"])
        assert np.allclose(sent, known["q_des"][k], rtol=0, atol=1e-5)
        if contract.get("once"):
            action[:6] = 0.0  # others move the arms


def test_the_reference_tries_what_is_clipped(file):
    metadata = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"]).get_modelmeta()
    known = json.loads(metadata.custom_metadata_map[REFERENCE_KEY])
    contract = json.loads(metadata.custom_metadata_map[METADATA_KEY])
    frames = contract["history"] * sum(width for _, width in contract["terms"])
    errors = np.array(known["observation"])[:, :frames].reshape(STEPS, contract["history"], -1)[:, -1, 32]
    assert errors.min() == -1.0
    assert errors.max() == 1.0
    assert len(known["action"]) == STEPS


def test_it_is_the_same_each_time(description):
    policy = load_policy(None, description)
    assert reference(policy) == reference(policy)


def test_every_term_is_explained_in_the_file(file):
    metadata = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"]).get_modelmeta()
    contract = json.loads(metadata.custom_metadata_map[METADATA_KEY])
    names = [name for name, _ in (*contract["terms"], *contract.get("once", ()))]
    assert contract["formulas"] == {name: FORMULAS[name] for name in names}
    assert set(FORMULAS) == {name for name, _ in (*PAPER_TERMS, *TERMS, *ARM_TERMS)}
    assert len(contract["how_to_play"]) > 4

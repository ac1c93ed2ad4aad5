"""Policies as rl_sar and unitree_rl_lab deploy them, read as their loops read them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import yaml

from mimic.cli import main
from mimic.errors import ConfigError
from mimic.flows.deploy import export_policy
from mimic.geometry import world_axes_in_base
from mimic.hardware.go2.wiring import load_go2
from mimic.hardware.stock.wiring import load_board
from mimic.policy.contract import PolicyContract
from mimic.policy.reference import reference
from mimic.policy.runtime import load_policy
from mimic.records import JOINTS
from mimic.robot.description import load_description

WRITING = "writing an ONNX file needs the extra 'train'"

RL_SAR = {
    "dof_pos": ("joint_position", "dof_pos_scale"),
    "gravity_vec": ("down", None),
    "actions": ("last_action", None),
    "ang_vel": ("gyro", "ang_vel_scale"),
    "dof_vel": ("joint_velocity", "dof_vel_scale"),
}
RL_LAB = {
    "joint_pos_rel": "joint_position",
    "projected_gravity": "down",
    "last_action": "last_action",
    "base_ang_vel": "gyro",
    "joint_vel_rel": "joint_velocity",
}


@pytest.fixture(scope="module")
def contract() -> PolicyContract:
    return load_policy(None, load_description("go2")).contract


def answers(robot: str) -> dict:
    """Return what the shipped policy answers to made-up inputs."""
    return json.loads(reference(load_policy(None, load_description(robot))))


def own_terms(known: dict, contract: PolicyContract, k: int) -> dict[str, np.ndarray]:
    """Return what a program measures in step k, in its units; anything else comes as the reference has it."""
    framed = contract.history * contract.frame_size
    newest, once = np.split(np.array(known["observation"][k])[framed - contract.frame_size :], [contract.frame_size])
    terms = {name: newest[contract.columns(name)] for name, _ in contract.terms}
    parts = np.split(once, np.cumsum([width for _, width in contract.once])[:-1])
    terms |= {name: part for (name, _), part in zip(contract.once, parts, strict=False)}
    down, _ = world_axes_in_base(*np.array(known["inputs"]["quat"][k]))
    measured = {
        "joint_position": np.array(known["inputs"]["q"][k]) - contract.default_q,
        "down": np.array(down),
        "last_action": np.array(known["action"][k - 1]) if k else np.zeros(12),
        "gyro": np.array(known["inputs"]["gyro"][k]),
        "joint_velocity": np.array(known["inputs"]["dq"][k]),
    }
    if contract.once:
        del measured["last_action"]  # theirs has no zeros for the arms
    return terms | measured


def run(file: Path, observation: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    (entry,) = session.get_inputs()
    (answer,) = session.run(None, {entry.name: observation.astype(np.float32)[None]})
    return answer[0]


@pytest.mark.train
def test_joints_and_gains_of_rl_sar_are_those_of_the_contract(contract, tmp_path):
    pytest.importorskip("onnx", reason=WRITING)
    export_policy("stand_track", tmp_path / "go2/mimic", "rl_sar", robot="go2")
    config = yaml.safe_load((tmp_path / "go2/mimic/config.yaml").read_text())["go2/mimic"]
    wire = ["FR_abad", "FR_hip", "FR_knee", "FL_abad", "FL_hip", "FL_knee"]
    wire += ["RR_abad", "RR_hip", "RR_knee", "RL_abad", "RL_hip", "RL_knee"]
    assert [wire[place] for place in config["joint_mapping"]] == list(JOINTS)
    assert (config["rl_kp"], config["rl_kd"]) == (list(contract.kp), list(contract.kd))
    assert config["default_dof_pos"] == list(contract.default_q)
    assert config["action_scale"] == list(contract.action_scale)
    assert config["dt"] * config["decimation"] == contract.dt
    assert config["num_observations"] == contract.frame_size + sum(width for _, width in contract.once)
    assert config["mimic"]["walk_speed"] == contract.walk_speed


@pytest.mark.train
@pytest.mark.parametrize("robot", ["cyberdog2", "go2"])
def test_the_loop_of_rl_sar_gets_the_actions_of_the_policy(robot, tmp_path):
    pytest.importorskip("onnx", reason=WRITING)
    known = answers(robot)
    contract = load_policy(None, load_description(robot)).contract
    export_policy("stand_track", tmp_path / robot / "mimic", "rl_sar", robot=robot)
    config = yaml.safe_load((tmp_path / robot / "mimic/config.yaml").read_text())[f"{robot}/mimic"]
    frames = []
    for k in range(20):
        terms = own_terms(known, contract, k)
        frame = []
        for name in config["observations"]:
            own, scale = RL_SAR.get(name, (name.removeprefix("mimic/"), None))
            frame.append(terms[own] * (config[scale] if scale else 1.0))
        frames.insert(0, np.clip(np.concatenate(frame), -config["clip_obs"], config["clip_obs"]))
    seen = np.concatenate([frames[age] for age in config["observations_history"]])
    action = run(tmp_path / robot / "mimic" / config["model_name"], seen)
    action = np.clip(action, config["clip_actions_lower"], config["clip_actions_upper"])
    np.testing.assert_allclose(action, known["action"][19], atol=1e-5)


@pytest.mark.train
@pytest.mark.parametrize(("robot", "wiring"), [("cyberdog2", load_board), ("go2", load_go2)])
def test_the_loop_of_unitree_rl_lab_gets_the_actions_of_the_policy(robot, wiring, tmp_path):
    pytest.importorskip("onnx", reason="writing an ONNX file needs the extra 'train'")
    known = answers(robot)
    contract = load_policy(None, load_description(robot)).contract
    export_policy("stand_track", tmp_path / "v0", "unitree_rl_lab", robot=robot)
    config = yaml.safe_load((tmp_path / "v0/params/deploy.yaml").read_text())
    seen = []
    for name, term in config["observations"].items():
        for k in range(20 - term["history_length"], 20):
            value = own_terms(known, contract, k)[RL_LAB.get(name, name.removeprefix("mimic_"))]
            seen.append(np.clip(value, *(term["clip"] or (-np.inf, np.inf))) * term["scale"])
    raw = run(tmp_path / "v0/exported/policy.onnx", np.concatenate(seen))
    np.testing.assert_allclose(raw, known["action"][19], atol=1e-5)
    action = config["actions"]["JointPositionAction"]
    sent = np.clip(raw * action["scale"] + action["offset"], *np.transpose(action["clip"]))
    np.testing.assert_allclose(sent, known["q_des"][19], atol=1e-5)
    assert config["joint_ids_map"] == wiring().index.tolist()
    assert np.array(config["stiffness"])[config["joint_ids_map"]].tolist() == list(contract.kp)


@pytest.mark.train
def test_the_file_says_which_terms_are_to_be_added(tmp_path, capsys):
    pytest.importorskip("onnx", reason=WRITING)
    go2 = ["--robot-model", "go2"]
    assert main(["export", "stand_track", *go2, "--format", "rl_sar", "-o", str(tmp_path / "p")]) == 0
    assert "mimic/arm_reference" in capsys.readouterr().out
    text = (tmp_path / "p/config.yaml").read_text()
    assert "# - mimic/forward (3): the world's (1, 0, 0) in base axes" in text


def test_a_policy_does_not_replace_what_is_there(tmp_path):
    (tmp_path / "p").mkdir()
    with pytest.raises(ConfigError, match="exists; name another place"):
        export_policy("stand_track", tmp_path / "p", "rl_sar")

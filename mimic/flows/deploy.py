"""A policy with the files by which rl_sar and unitree_rl_lab play theirs.

Source of keys, orders and terms: fan-ziqi/rl_sar, commit e384912 (rl_sdk.cpp, observation_buffer.cpp, policy/go2), and
unitreerobotics/unitree_rl_lab, commit e72a072 (deploy/include/isaaclab, export_deploy_cfg.py).
"""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mimic.config.play import DEFAULT_ROBOT
from mimic.errors import ConfigError, MissingExtra
from mimic.flows.play import load_robot
from mimic.io import store
from mimic.policy.contract import DQ_CLIP, DQ_SCALE, GYRO_CLIP, GYRO_SCALE, INVERSE_KINEMATICS, PolicyContract
from mimic.policy.runtime import Policy, find_policy
from mimic.records import IntArray
from mimic.version import __version__

TERMS = {
    "joint_position": ("dof_pos", "joint_pos_rel"),
    "down": ("gravity_vec", "projected_gravity"),
    "last_action": ("actions", "last_action"),
    "gyro": ("ang_vel", "base_ang_vel"),
    "joint_velocity": ("dof_vel", "joint_vel_rel"),
}
"""Terms of a contract that both programs know, under the names of rl_sar and unitree_rl_lab."""
SCALED = {"gyro": (GYRO_SCALE, GYRO_CLIP), "joint_velocity": (DQ_SCALE, DQ_CLIP)}
"""Factor [s/rad] and, behind it, the largest value of terms that the programs give in rad/s."""
STEPS = 4
"""Repetitions of a command within a control step of rl_sar, as in its own files."""
HEADING = {
    "rl_sar": (
        "Its history begins with zeros: fill it with the first frame.",
        "It sends q_des as it is: clip it to q_min and q_max.",
        "Its fsm_ROBOT.hpp names the folder that it loads (config_name), and base.yaml the robot's own gains.",
        "Add these terms to RL::ComputeObservation; it skips unknown ones, and the network then refuses its input:",
    ),
    "unitree_rl_lab": ("Add these terms with REGISTER_OBSERVATION; it does not start before:",),
}
"""What the loop of a program does otherwise, and where the terms are added that it lacks."""


def export_policy(policy: str | Path, out: Path, form: str, *, robot: str = DEFAULT_ROBOT) -> list[str]:
    """Write a policy as rl_sar (config.yaml, policy.onnx) or unitree_rl_lab (params, exported) deploys one.

    The network takes its input as the program gives it: each term's frames together (unitree_rl_lab), or every term in
    each frame (rl_sar).

    Args:
        policy: ONNX file with its contract inside, or the name of a shipped policy.
        out: New folder: policy/ROBOT/NAME of rl_sar, or config/policy/KIND/NAME of unitree_rl_lab.
        form: rl_sar or unitree_rl_lab.
        robot: That the policy is for.

    Returns:
        Names of the observation terms that the program must be taught.

    Raises:
        AssetError, ContractError: If the policy cannot be run on this robot.
        ConfigError: If ``out`` exists, or the program cannot hold the policy.
        MissingExtra: If a network must be written and onnx is not installed.
    """
    if out.exists():
        raise ConfigError(f"{out} exists; name another place with --out, or remove it")
    description = load_robot(robot)
    path = find_policy(policy, description.name)
    contract = Policy(path, description).contract
    order, notes = _order(description.name)
    if form == "rl_sar":
        settings = {f"{description.name}/{out.name}": _rl_sar(contract, order)}
        network = _with_input(path, contract, _by_frames(contract)) if contract.once else path.read_bytes()
        places = (out / "config.yaml", out / "policy.onnx")
    else:
        settings = _rl_lab(contract, order)
        network = _with_input(path, contract, _by_terms(contract))
        places = (out / "params/deploy.yaml", out / "exported/policy.onnx")
    store.check_writable(out.parent)
    text = _heading(path, form, contract, notes)
    text += yaml.safe_dump(settings, default_flow_style=None, sort_keys=False, width=120)
    for place, content in zip(places, (text.encode(), network), strict=True):
        with store.written_whole(place) as part:
            part.write_bytes(content)
    return [_name(term, form, contract) for term, _ in (*contract.terms, *contract.once) if _lacks(term, contract)]


def _lacks(term: str, contract: PolicyContract) -> bool:
    """Return whether the programs lack a term; their last action has no zeros for arms that left the network."""
    return term not in TERMS or (term == "last_action" and bool(contract.once))


def _name(term: str, form: str, contract: PolicyContract) -> str:
    """Return what a program calls a term."""
    if not _lacks(term, contract):
        return TERMS[term][form != "rl_sar"]
    return f"mimic{'/' if form == 'rl_sar' else '_'}{term}"


def _order(robot: str) -> tuple[list[int], str]:
    """Return the place of each joint in the robot's messages, and what else is to be known of them."""
    from mimic.hardware.go2.wiring import load_go2
    from mimic.hardware.stock.wiring import load_board

    load = {"cyberdog2": load_board, "go2": load_go2}.get(robot)
    if load is None:
        return list(range(12)), "not known: set the mapping of joints"
    wiring = load()
    return wiring.index.tolist(), f"as in the mapping of joints, with signs {wiring.signs.astype(int).tolist()}"


def _rl_sar(contract: PolicyContract, order: list[int]) -> dict[str, Any]:
    """Return what a config.yaml holds."""
    own = store.plain(contract)
    terms = (*contract.terms, *contract.once)
    return {
        "model_name": "policy.onnx",
        "num_observations": sum(width for _, width in terms),
        "observations": [_name(term, "rl_sar", contract) for term, _ in terms],
        "observations_history": list(reversed(range(contract.history))),
        "observations_history_priority": "time",
        "clip_obs": 100.0,
        "clip_actions_lower": [-contract.action_clip] * 12,
        "clip_actions_upper": [contract.action_clip] * 12,
        "rl_kp": own["kp"],
        "rl_kd": own["kd"],
        "num_of_dofs": 12,
        "action_scale": own["action_scale"],
        "wheel_indices": [],
        "ang_vel_scale": GYRO_SCALE,
        "dof_pos_scale": 1.0,
        "dof_vel_scale": DQ_SCALE,
        "torque_limits": own["torque_max"],
        "default_dof_pos": own["default_q"],
        "joint_mapping": order,
        "dt": contract.dt / STEPS,
        "decimation": STEPS,
        "mimic": own,
    }


def _rl_lab(contract: PolicyContract, order: list[int]) -> dict[str, Any]:
    """Return what a deploy.yaml holds. Gains are in the order of the messages, everything else in the policy's."""
    own = store.plain(contract)
    joint = np.argsort(order)
    observations = {}
    for term, width in (*contract.terms, *contract.once):
        scale, most = SCALED.get(term, (1.0, 0.0))
        observations[_name(term, "unitree_rl_lab", contract)] = {
            "params": {},
            "clip": [-most / scale, most / scale] if most else None,
            "scale": [scale] * width,
            "history_length": contract.history if (term, width) in contract.terms else 1,
        }
    action = {
        "clip": np.transpose([contract.q_min, contract.q_max]).tolist(),
        "joint_names": [".*"],
        "scale": own["action_scale"],
        "offset": own["default_q"],
        "joint_ids": None,
    }
    return {
        "joint_ids_map": order,
        "step_dt": contract.dt,
        "stiffness": np.array(contract.kp)[joint].tolist(),
        "damping": np.array(contract.kd)[joint].tolist(),
        "default_joint_pos": own["default_q"],
        "commands": {},
        "actions": {"JointPositionAction": action},
        "observations": observations,
        "mimic": own,
    }


def _by_terms(contract: PolicyContract) -> IntArray:
    """Return where a policy's inputs are among each term's frames, in the order of the terms."""
    framed = contract.history * contract.frame_size
    frames = np.arange(framed).reshape(contract.history, contract.frame_size)
    given = [frames[:, contract.columns(term)].ravel() for term, _ in contract.terms]
    return np.argsort(np.concatenate([*given, np.arange(framed, contract.observation_size)]))


def _by_frames(contract: PolicyContract) -> IntArray:
    """Return where a policy's inputs are among frames of all terms; what comes once is that of the newest."""
    whole = contract.frame_size + sum(width for _, width in contract.once)
    frames = np.arange(contract.history * whole).reshape(contract.history, whole)
    return np.concatenate([frames[:, : contract.frame_size].ravel(), frames[-1, contract.frame_size :]])


def _with_input(path: Path, contract: PolicyContract, place: IntArray) -> bytes:
    """Return a policy's network that finds its inputs at these places, under unitree_rl_lab's names, and clips."""
    try:
        import onnx
    except ImportError:
        raise MissingExtra("onnx", "deploy") from None
    model = onnx.load(str(path))
    graph = model.graph
    graph.input[0].type.tensor_type.shape.dim[1].dim_value = int(place.max()) + 1
    make = onnx.helper.make_node
    first = make("Gather", ["obs", "mimic_place"], [graph.input[0].name], axis=1)
    last = make("Clip", [graph.output[0].name, "mimic_low", "mimic_high"], ["actions"])
    graph.node.insert(0, first)
    graph.node.append(last)
    graph.input[0].name = "obs"
    graph.output[0].name = "actions"
    limit = np.float32(contract.action_clip)
    for name, value in (("place", place), ("low", -limit), ("high", limit)):
        graph.initializer.append(onnx.numpy_helper.from_array(np.asarray(value), f"mimic_{name}"))
    onnx.checker.check_model(model)
    return model.SerializeToString()


def _heading(path: Path, form: str, contract: PolicyContract, messages: str) -> str:
    """Return the comment at the top: what the program lacks, and how the policy is played."""
    guide = json.loads(contract.to_json())
    lines = [
        f"{path.name} for {form}, written by mimic {__version__}; its numbers are under mimic.",
        f"Joints: {', '.join(contract.joints)}; in the robot's messages {messages}.",
        "It has no inverse kinematics." * (contract.arms == INVERSE_KINEMATICS),
        "It changes q_des at once: move it in a straight line over a control step." * contract.interpolate,
        *HEADING[form],
    ]
    for term, width in (*contract.terms, *contract.once):
        if _lacks(term, contract):
            lines.append(f"- {_name(term, form, contract)} ({width}): {guide['formulas'][term]}")
    lines += ["How the policy is played:", *(f"- {line}" for line in guide["how_to_play"])]
    wrapped = [textwrap.fill(line, 118, initial_indent="# ", subsequent_indent="#   ") for line in lines if line]
    return "\n".join([*wrapped, "", ""])

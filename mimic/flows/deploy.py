"""A policy with the files by which rl_sar and unitree_rl_lab play theirs.

Source of keys, orders and terms: fan-ziqi/rl_sar, commit e384912 (rl_sdk.cpp, observation_buffer.cpp, policy/go2), and
unitreerobotics/unitree_rl_lab, commit e72a072 (deploy/include/isaaclab, export_deploy_cfg.py).
"""

from __future__ import annotations

import json
import textwrap
from dataclasses import dataclass
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
from mimic.version import __version__

SCALE = {"gyro": GYRO_SCALE, "joint_velocity": DQ_SCALE}
"""Factor of a term whose program gives it in units of its own [s/rad]."""
CLIP = {"gyro": GYRO_CLIP / GYRO_SCALE, "joint_velocity": DQ_CLIP / DQ_SCALE}
"""Largest value of such a term before that factor [rad/s]."""
KEPT = (
    *("q_min", "q_max", "velocity_max", "neutral_toes", "toe_low", "toe_high", "stand_up_steps", "blend_steps"),
    *("clock_hz", "clock_fade", "walk_speed", "walk_turn", "delay", "speed_flat", "speed_max"),
)
"""Fields of a contract that no program has a key for."""
STEPS = 4
"""Repetitions of a command within a control step of rl_sar, as in its own files."""


@dataclass(frozen=True, kw_only=True)
class Program:
    """How a program names what it observes, and what its loop does otherwise than mimic's."""

    terms: dict[str, str]
    """Its names of terms of a contract."""
    prefix: str
    """Of the names of terms that it lacks."""
    where: str
    """Where such a term is added."""
    lacks: tuple[str, ...]
    """What its loop does otherwise."""


RL_SAR = Program(
    terms={
        "joint_position": "dof_pos",
        "down": "gravity_vec",
        "last_action": "actions",
        "gyro": "ang_vel",
        "joint_velocity": "dof_vel",
    },
    prefix="mimic/",
    where="RL::ComputeObservation; it skips a name that it does not know, and the network then refuses its input",
    lacks=(
        "Its history begins with zeros: fill it with the first frame.",
        "It sends q_des as it is: clip it to q_min and q_max.",
    ),
)
RL_LAB = Program(
    terms={
        "joint_position": "joint_pos_rel",
        "down": "projected_gravity",
        "last_action": "last_action",
        "gyro": "base_ang_vel",
        "joint_velocity": "joint_vel_rel",
    },
    prefix="mimic_",
    where="REGISTER_OBSERVATION; it does not start before",
    lacks=(),
)
PROGRAMS = {"rl_sar": RL_SAR, "unitree_rl_lab": RL_LAB}


def export_policy(policy: str | Path, out: Path, form: str, *, robot: str = DEFAULT_ROBOT) -> list[str]:
    """Write a policy as rl_sar (config.yaml, policy.onnx) or unitree_rl_lab (params, exported) deploys one.

    The network for unitree_rl_lab takes each term's frames together, as that program gives them.

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
    program = PROGRAMS[form]
    unknown = [program.prefix + name for name, _ in (*contract.terms, *contract.once) if name not in program.terms]
    order, notes = _order(description.name)
    if form == "rl_sar":
        settings = _rl_sar(contract, f"{description.name}/{out.name}", order)
        network = path.read_bytes()
        places = (out / "config.yaml", out / "policy.onnx")
    else:
        settings = _rl_lab(contract, order)
        network = _by_terms(path, contract)
        places = (out / "params/deploy.yaml", out / "exported/policy.onnx")
    store.check_writable(out.parent)
    text = _heading(path, form, contract, notes)
    text += yaml.safe_dump(settings, default_flow_style=None, sort_keys=False, width=120)
    for place, content in zip(places, (text.encode(), network), strict=True):
        with store.written_whole(place) as part:
            part.write_bytes(content)
    return unknown


def _order(robot: str) -> tuple[list[int], tuple[str, ...]]:
    """Return the place of each joint in the robot's messages, and what else is to be known of them."""
    from mimic.hardware.go2.wiring import load_go2
    from mimic.hardware.stock.wiring import load_board

    load = {"cyberdog2": load_board, "go2": load_go2}.get(robot)
    if load is None:
        return list(range(12)), (f"The order of {robot}'s messages is not known: the mapping of joints is to be set.",)
    wiring = load()
    turned = f"The robot's messages have these signs of joints: {wiring.sign.astype(int).tolist()}."
    return wiring.index.tolist(), (turned,) * bool(np.any(wiring.sign < 0))


def _rl_sar(contract: PolicyContract, name: str, order: list[int]) -> dict[str, Any]:
    """Return what a config.yaml holds."""
    if contract.once:
        raise ConfigError(
            f"rl_sar repeats every term with the history, and this policy has {contract.once[0][0]} once; "
            "use --format unitree_rl_lab"
        )
    settings = {
        "model_name": "policy.onnx",
        "num_observations": contract.frame_size,
        "observations": [RL_SAR.terms.get(term, RL_SAR.prefix + term) for term, _ in contract.terms],
        "observations_history": list(reversed(range(contract.history))),
        "observations_history_priority": "time",
        "clip_obs": 100.0,
        "clip_actions_lower": [-contract.action_clip] * 12,
        "clip_actions_upper": [contract.action_clip] * 12,
        "rl_kp": list(contract.kp),
        "rl_kd": list(contract.kd),
        "num_of_dofs": 12,
        "action_scale": list(contract.action_scale),
        "wheel_indices": [],
        "ang_vel_scale": GYRO_SCALE,
        "dof_pos_scale": 1.0,
        "dof_vel_scale": DQ_SCALE,
        "torque_limits": list(contract.torque_max),
        "default_dof_pos": list(contract.default_q),
        "joint_mapping": order,
        "dt": contract.dt / STEPS,
        "decimation": STEPS,
    }
    return {name: settings | _kept(contract)}


def _rl_lab(contract: PolicyContract, order: list[int]) -> dict[str, Any]:
    """Return what a deploy.yaml holds. Gains are in the order of the messages, everything else in the policy's."""
    joint = np.argsort(order)
    observations = {}
    for term, width in (*contract.terms, *contract.once):
        most = CLIP.get(term)
        observations[RL_LAB.terms.get(term, RL_LAB.prefix + term)] = {
            "params": {},
            "clip": most and [-most, most],
            "scale": [SCALE.get(term, 1.0)] * width,
            "history_length": contract.history if (term, width) in contract.terms else 1,
        }
    action = {
        "clip": [[low, high] for low, high in zip(contract.q_min, contract.q_max, strict=True)],
        "joint_names": [".*"],
        "scale": list(contract.action_scale),
        "offset": list(contract.default_q),
        "joint_ids": None,
    }
    settings = {
        "joint_ids_map": order,
        "step_dt": contract.dt,
        "stiffness": np.array(contract.kp)[joint].tolist(),
        "damping": np.array(contract.kd)[joint].tolist(),
        "default_joint_pos": list(contract.default_q),
        "commands": {},
        "actions": {"JointPositionAction": action},
        "observations": observations,
    }
    return settings | _kept(contract)


def _kept(contract: PolicyContract) -> dict[str, Any]:
    return {"mimic": {name: store.plain(getattr(contract, name)) for name in KEPT}}


def _by_terms(path: Path, contract: PolicyContract) -> bytes:
    """Return a policy's network that takes each term's frames together, under unitree_rl_lab's names, and clips."""
    try:
        import onnx
    except ImportError:
        raise MissingExtra("onnx", "train") from None
    framed = contract.history * contract.frame_size
    frames = np.arange(framed).reshape(contract.history, contract.frame_size)
    given = [frames[:, contract.columns(term)].ravel() for term, _ in contract.terms]
    place = np.argsort(np.concatenate([*given, np.arange(framed, contract.observation_size)]))
    model = onnx.load(str(path))
    graph = model.graph
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


def _heading(path: Path, form: str, contract: PolicyContract, notes: tuple[str, ...]) -> str:
    """Return the comment at the top: the terms to be added, and how the policy is played."""
    program = PROGRAMS[form]
    guide = json.loads(contract.to_json())
    terms = (*contract.terms, *contract.once)
    lines = [f"{path.name} for {form}, written by mimic {__version__}. Joints: {', '.join(contract.joints)}."]
    if contract.interpolate:
        notes = (*notes, "It changes q_des at once: move it in a straight line over a control step.")
    if contract.arms == INVERSE_KINEMATICS:
        notes = (*notes, "It has no inverse kinematics; what the front legs need is said below.")
    lines += [f"{form} lacks:", *(f"- {note}" for note in (*program.lacks, *notes))]
    lines += [f"Terms to be added to {program.where}:"]
    lines += [
        f"- {program.prefix}{name} ({width}): {guide['formulas'][name]}"
        for name, width in terms
        if name not in program.terms
    ]
    lines += ["How the policy is played:", *(f"- {line}" for line in guide["how_to_play"])]
    wrapped = [textwrap.fill(line, 118, initial_indent="# ", subsequent_indent="#   ") for line in lines]
    return "\n".join([*wrapped, "", ""])

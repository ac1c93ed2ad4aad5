"""Training goes on from a policy (.onnx), which has a network but no critic and no state of the optimiser."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper

from mimic.errors import AssetError, ConfigError
from mimic.policy.contract import AVERAGED, METADATA_KEY, PolicyContract

SEEN = 10**9
"""Observations that count as seen by the normalisation taken over, so that new ones hardly move it."""

NEW_SPREAD = {"gyro": 0.2, "joint_velocity": 0.1, "slow_mean": 0.2, "arm_reference": 0.5, "arms_known": 0.5}
"""Spread of the terms of an observation that a policy lacked, for its normalisation."""

MEANING = ("joints", "action_scale", "action_clip", "dt")
"""Fields of the contract without which the numbers of a network mean something else."""


def take_over(actor: Any, path: Path, contract: PolicyContract, spread: float) -> bool:
    """Put the network of a policy into an actor of rsl_rl, which then acts as the policy does.

    The actor may see more frames than the policy, which come first in an observation, and other terms; those have
    weights of zero. Where it does not see the toe command that the policy saw, it acts as the policy does for neutral
    toes.

    Args:
        actor: An MLPModel with normalised observations, changed in place.
        path: An ONNX policy as this package writes it.
        contract: Of the training.
        spread: Spread of the actions.

    Returns:
        Whether the policy was on the same robot.

    Raises:
        AssetError: If the file is no such policy.
        ContractError: If it declares no contract.
        ConfigError: If its observations or actions mean something else, or the settings shape another network.
    """
    try:
        model = onnx.load(str(path))
    except Exception as reason:  # protobuf has errors of its own
        raise AssetError(f"{path} is no ONNX file ({reason})") from reason
    known = PolicyContract.from_json({entry.key: entry.value for entry in model.metadata_props}.get(METADATA_KEY, "{}"))
    _compare(path.name, known, contract)
    values = {i.name: numpy_helper.to_array(i).copy() for i in model.graph.initializer}
    nodes = [n for n in model.graph.node if n.op_type != "Elu"]
    if [n.op_type for n in nodes[:2]] != ["Sub", "Div"] or {n.op_type for n in nodes[2:]} != {"Gemm"}:
        raise AssetError(f"{path} is no policy that can be trained on: {' '.join(n.op_type for n in model.graph.node)}")
    mean, scale = (values[n.input[1]].reshape(-1) for n in nodes[:2])  # of the observation
    layers = [(values[n.input[1]], values[n.input[2]]) for n in nodes[2:]]  # weights (out, in), biases (out,)
    linear = [m for m in actor.mlp if isinstance(m, torch.nn.Linear)]
    here = [(m.out_features, m.in_features) for m in linear]
    there = [w.shape for w, _ in layers]
    if known.history > contract.history or [(o, i) for o, i in there[1:]] != here[1:] or there[0][0] != here[0][0]:
        raise ConfigError(
            f"{path.name} has layers of {_sizes(there)}; the settings shape {_sizes(here)}; "
            "set hidden and history to those of the policy (history may be longer)"
        )
    first, bias = layers[0]
    fresh = [(name, at) for name, at in _places(contract) if name not in dict(known.terms + known.once)]
    means, scales = np.zeros(here[0][1], mean.dtype), np.ones(here[0][1], mean.dtype)
    columns = np.zeros(here[0], first.dtype)
    for frame in range(-contract.history, 0):
        source = max(frame, -known.history)
        for name, _ in contract.terms:
            if name not in dict(known.terms):
                continue
            at = (contract.history + frame) * contract.frame_size + contract.columns(name)
            old = (known.history + source) * known.frame_size + known.columns(name)
            means[at], scales[at] = mean[old], scale[old]
            if frame == source:
                columns[:, at] = first[:, old]
    before = {name: at for name, at in _places(known) if name in dict(known.once)}
    for name, at in _places(contract):
        if name in before and name in dict(contract.once):
            old = before[name]
            means[at], scales[at] = mean[old], scale[old]
            columns[:, at] = first[:, old]
    for name, at in fresh:
        scales[at] = NEW_SPREAD[name]
        if name == "slow_mean":  # it begins at the mean of what it averages
            means[at] = means[at[0] - contract.columns(name)[0] + contract.columns(*AVERAGED)]
    if known.columns("toe_command").size:  # which is no longer seen: as if arms were at rest
        at = (np.arange(known.history)[:, None] * known.frame_size + known.columns("toe_command")).reshape(-1)
        rest = np.tile(known.neutral_toes, known.history)
        bias = bias + first[:, at] @ ((rest - mean[at]) / scale[at]).astype(first.dtype)
    layers = [(columns, bias), *layers[1:]]
    normalizer = actor.obs_normalizer
    with torch.no_grad():
        normalizer._mean.copy_(torch.as_tensor(means)[None])
        normalizer._std.copy_(torch.as_tensor(scales)[None] - normalizer.eps)
        normalizer._var.copy_(normalizer._std.square())
        normalizer.count.fill_(SEEN)
        for module, (weight, bias) in zip(linear, layers, strict=True):
            module.weight.copy_(torch.as_tensor(weight))
            module.bias.copy_(torch.as_tensor(bias))
        actor.distribution.log_std_param.fill_(math.log(spread))
    return known.robot == contract.robot


def _compare(name: str, there: PolicyContract, here: PolicyContract) -> None:
    """Refuse a policy whose numbers mean something else."""
    for field in MEANING:
        old, new = getattr(there, field), getattr(here, field)
        if old != new:
            raise ConfigError(
                f"{name} has {field} {old}; the settings have {new}, and the network would mean "
                "something else; use the settings of its training"
            )


def _places(contract: PolicyContract) -> list[tuple[str, Any]]:
    """Return the columns of an observation that each term of each frame has, and then each term that comes once."""
    found = []
    for frame in range(contract.history):
        found += [(name, frame * contract.frame_size + contract.columns(name)) for name, _ in contract.terms]
    begin = contract.history * contract.frame_size
    for name, width in contract.once:
        found.append((name, np.arange(begin, begin + width)))
        begin += width
    return found


def _sizes(shapes: Sequence[tuple[int, ...]]) -> str:
    return "-".join(str(i) for _, i in shapes) + f"-{shapes[-1][0]}"

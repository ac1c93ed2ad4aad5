"""Training goes on from a policy (.onnx), which has a network but no critic and no state of the optimiser."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper

from mimic.errors import AssetError, ConfigError
from mimic.policy.contract import AVERAGED, METADATA_KEY, PolicyContract
from mimic.records import FloatArray, IntArray

SEEN = 10**9
"""Observations that count as seen by the normalisation taken over, so that new ones hardly move it."""

NEW_SPREAD = {"gyro": 0.2, "joint_velocity": 0.1, "slow_mean": 0.2, "arm_reference": 0.5, "arms_known": 0.5}
"""Spread of the terms of an observation that a policy lacked, for its normalisation."""

MEANING = ("joints", "action_scale", "action_clip", "dt")
"""Fields of the contract without which the numbers of a network mean something else."""


@dataclass(frozen=True)
class Network:
    """The numbers of a policy's network."""

    mean: FloatArray
    """Mean of the observation (seen,)."""
    scale: FloatArray
    """What the rest is divided by (seen,)."""
    layers: list[tuple[FloatArray, FloatArray]]
    """Weights (out, in) and biases (out,)."""


def as_seen(path: Path, contract: PolicyContract, sizes: Sequence[tuple[int, int]]) -> tuple[PolicyContract, Network]:
    """Return the contract of a policy, and its network for the observations of another contract.

    Args:
        path: An ONNX policy as this package writes it.
        contract: Whose observations the network sees.
        sizes: Of its layers (out, in).

    Raises:
        AssetError, ContractError, ConfigError: As by `take_over`.
    """
    model = _load(path)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    known = PolicyContract.from_json(metadata.get(METADATA_KEY, "{}"))
    _compare(path.name, known, contract)
    network = _network(path, model)
    _compare_layers(path.name, known, contract, network, sizes)
    means, scales, columns = _first_layer(network, known, contract)
    _, bias = network.layers[0]
    if known.columns("toe_command").size:  # which is no longer seen: as if arms were at rest
        bias = bias + _of_neutral_toes(network, known)
    return known, Network(means, scales, [(columns, bias), *network.layers[1:]])


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
    linear = [m for m in actor.mlp if isinstance(m, torch.nn.Linear)]
    known, network = as_seen(path, contract, [(m.out_features, m.in_features) for m in linear])
    normalizer = actor.obs_normalizer
    with torch.no_grad():
        normalizer._mean.copy_(torch.as_tensor(network.mean)[None])
        normalizer._std.copy_(torch.as_tensor(network.scale)[None] - normalizer.eps)
        normalizer._var.copy_(normalizer._std.square())
        normalizer.count.fill_(SEEN)
        for module, (weight, bias) in zip(linear, network.layers, strict=True):
            module.weight.copy_(torch.as_tensor(weight))
            module.bias.copy_(torch.as_tensor(bias))
        actor.distribution.log_std_param.fill_(math.log(spread))
    return known.robot == contract.robot


def _load(path: Path) -> onnx.ModelProto:
    try:
        return onnx.load(str(path))
    except Exception as reason:  # protobuf has errors of its own
        raise AssetError(f"{path} is no ONNX file ({reason})") from reason


def _network(path: Path, model: onnx.ModelProto) -> Network:
    """Return the network of an ONNX policy: (observation - mean) / scale, then layers with ELUs between them."""
    values = {i.name: numpy_helper.to_array(i).copy() for i in model.graph.initializer}
    nodes = [n for n in model.graph.node if n.op_type != "Elu"]
    kinds = [n.op_type for n in nodes]
    if kinds[:2] != ["Sub", "Div"] or {*kinds[2:]} != {"Gemm"}:
        raise AssetError(f"{path} is no policy that can be trained on: {' '.join(n.op_type for n in model.graph.node)}")
    mean, scale = (values[n.input[1]].reshape(-1) for n in nodes[:2])
    return Network(mean, scale, [(values[n.input[1]], values[n.input[2]]) for n in nodes[2:]])


def _compare_layers(
    name: str, known: PolicyContract, contract: PolicyContract, network: Network, here: Sequence[tuple[int, int]]
) -> None:
    """Refuse a network whose layers (out, in) differ from those here in more than what it observes."""
    there = [weights.shape for weights, _ in network.layers]
    same = there[0][0] == here[0][0] and there[1:] == here[1:]
    if known.history > contract.history or not same:
        raise ConfigError(
            f"{name} has layers of {_sizes(there)}; the settings shape {_sizes(here)}; "
            "set hidden and history to those of the policy (history may be longer)"
        )


def _first_layer(
    network: Network, known: PolicyContract, contract: PolicyContract
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean and scale of the observation here (seen,), and the weights of the first layer (out, seen)."""
    first, _ = network.layers[0]
    there = _places(known)
    here = _places(contract)
    means = np.zeros(contract.observation_size, network.mean.dtype)
    scales = np.ones(contract.observation_size, network.mean.dtype)
    columns = np.zeros((len(first), contract.observation_size), first.dtype)
    for (age, name), at in here.items():
        oldest = min(age, known.history - 1)  # frames that the policy does not see are normalised as its oldest one
        if (oldest, name) in there:
            old = there[oldest, name]
            means[at] = network.mean[old]
            scales[at] = network.scale[old]
            if oldest == age:
                columns[:, at] = first[:, old]
            continue
        scales[at] = NEW_SPREAD[name]
        if name == "slow_mean":  # it begins at the mean of what it averages
            means[at] = means[np.concatenate([here[age, averaged] for averaged in AVERAGED])]
    return means, scales, columns


def _of_neutral_toes(network: Network, known: PolicyContract) -> FloatArray:
    """Return what the command of neutral toes adds to the first layer (out,)."""
    first, _ = network.layers[0]
    at = (np.arange(known.history)[:, None] * known.frame_size + known.columns("toe_command")).reshape(-1)
    rest = np.tile(known.neutral_toes, known.history)
    return first[:, at] @ ((rest - network.mean[at]) / network.scale[at]).astype(first.dtype)


def _compare(name: str, there: PolicyContract, here: PolicyContract) -> None:
    """Refuse a policy whose numbers mean something else."""
    for field in MEANING:
        old = getattr(there, field)
        new = getattr(here, field)
        if old != new:
            raise ConfigError(
                f"{name} has {field} {old}; the settings have {new}, and the network would mean "
                "something else; use the settings of its training"
            )


def _places(contract: PolicyContract) -> dict[tuple[int, str], IntArray]:
    """Return the columns of an observation by the age of a frame, 0 the newest, and term; what comes once has age 0."""
    found = {}
    for age in range(contract.history):
        begin = (contract.history - 1 - age) * contract.frame_size
        found |= {(age, name): begin + contract.columns(name) for name, _ in contract.terms}
    begin = contract.history * contract.frame_size
    for name, width in contract.once:
        found[0, name] = np.arange(begin, begin + width)
        begin += width
    return found


def _sizes(shapes: Sequence[tuple[int, ...]]) -> str:
    return "-".join(str(i) for _, i in shapes) + f"-{shapes[-1][0]}"

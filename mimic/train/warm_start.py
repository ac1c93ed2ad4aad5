"""Training goes on from a policy (.onnx), which has a network but no critic and no state of the optimiser."""

from __future__ import annotations

import json
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper

from mimic.errors import AssetError, ConfigError
from mimic.policy.contract import FRAME_SIZE, METADATA_KEY, PolicyContract

log = logging.getLogger(__name__)

SEEN = 10**9
"""Observations that count as seen by the normalisation taken over, so that new ones hardly move it."""

SPREAD = 0.2
"""Spread of the actions with which the training begins, where the settings give none."""

MEANING = ("robot", "joints", "default_q", "action_scale", "action_clip", "dt", "terms")
"""Fields of the contract without which the numbers of a network mean something else."""

WAY_OF_PLAYING = ("kp", "kd", "clock_hz", "clock_fade", "interpolate")
"""Fields that a training can get used to."""


def compare_contracts(path: Path, contract: PolicyContract) -> None:
    """Tell how a policy was played otherwise than it will be.

    Args:
        path: An ONNX policy as this package writes it; of one without a contract nothing is known.
        contract: Of the training.

    Raises:
        AssetError: If the file is no ONNX file.
        ConfigError: If its observations or actions mean something else.
    """
    stored = {entry.key: entry.value for entry in _loaded(path).metadata_props}.get(METADATA_KEY)
    there, here = json.loads(stored or "{}"), json.loads(contract.to_json())
    for name in (*MEANING, *WAY_OF_PLAYING):
        if there.get(name, here[name]) == here[name]:
            continue
        if name in MEANING:
            raise ConfigError(
                f"{path.name} has {name} {there[name]}; the settings have {here[name]}, and the network would mean "
                "something else; use the settings of its training"
            )
        log.info("%s was trained with %s %s and goes on with %s", path.name, name, there[name], here[name])


def take_over(actor: Any, path: Path, spread: float = 0.0) -> None:
    """Put the network of a policy into an actor of rsl_rl; the actor then acts as the policy does.

    The actor may see more frames than the policy. Those come first in an observation and have weights of zero.

    Args:
        actor: An MLPModel with normalised observations, changed in place.
        path: An ONNX policy as this package writes it.
        spread: Spread of the actions; 0 takes ``SPREAD``.

    Raises:
        AssetError: If the file is no such policy.
        ConfigError: If the settings shape another network.
    """
    mean, scale, layers = _network(path)
    linear = [m for m in actor.mlp if isinstance(m, torch.nn.Linear)]
    more = linear[0].in_features - len(mean)
    here = [(m.out_features, m.in_features) for m in linear]
    there = [w.shape for w, _ in layers]
    if more < 0 or more % FRAME_SIZE or [(o, i + more * (k == 0)) for k, (o, i) in enumerate(there)] != here:
        raise ConfigError(
            f"{path.name} has layers of {_sizes(there)}; the settings shape {_sizes(here)}; "
            "set hidden and history to those of the policy (history may be longer)"
        )
    frames = more // FRAME_SIZE
    mean, scale = (np.concatenate([np.tile(v[:FRAME_SIZE], frames), v]) for v in (mean, scale))
    first, bias = layers[0]
    layers = [(np.concatenate([np.zeros((len(first), more), first.dtype), first], 1), bias), *layers[1:]]
    normalizer = actor.obs_normalizer
    with torch.no_grad():
        normalizer._mean.copy_(torch.as_tensor(mean)[None])
        normalizer._std.copy_(torch.as_tensor(scale)[None] - normalizer.eps)
        normalizer._var.copy_(normalizer._std.square())
        normalizer.count.fill_(SEEN)
        for module, (weight, bias) in zip(linear, layers, strict=True):
            module.weight.copy_(torch.as_tensor(weight))
            module.bias.copy_(torch.as_tensor(bias))
        actor.distribution.log_std_param.fill_(math.log(spread or SPREAD))


def _network(path: Path) -> tuple[np.ndarray, np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """Return mean and scale (inputs,) of the observation, and the weights (out, in) and biases (out,) of each layer."""
    graph = _loaded(path).graph
    values = {i.name: numpy_helper.to_array(i).copy() for i in graph.initializer}
    nodes = [n for n in graph.node if n.op_type != "Elu"]
    if [n.op_type for n in nodes[:2]] != ["Sub", "Div"] or {n.op_type for n in nodes[2:]} != {"Gemm"}:
        raise AssetError(f"{path} is no policy that can be trained on: {' '.join(n.op_type for n in graph.node)}")
    mean, scale = (values[n.input[1]].reshape(-1) for n in nodes[:2])
    return mean, scale, [(values[n.input[1]], values[n.input[2]]) for n in nodes[2:]]


def _loaded(path: Path) -> Any:
    try:
        return onnx.load(str(path))
    except Exception as reason:  # protobuf has errors of its own
        raise AssetError(f"{path} is no ONNX file ({reason})") from reason


def _sizes(shapes: list[tuple[int, ...]]) -> str:
    return "-".join(str(i) for _, i in shapes) + f"-{shapes[-1][0]}"

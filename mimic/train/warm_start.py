"""Training goes on from a policy (.onnx), which has a network but no critic and no state of the optimiser."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper

from mimic.errors import AssetError, ConfigError
from mimic.policy.contract import AVERAGED, METADATA_KEY, PAPER_TERMS, PolicyContract, stored_fields, term_columns

log = logging.getLogger(__name__)

SEEN = 10**9
"""Observations that count as seen by the normalisation taken over, so that new ones hardly move it."""

NEW_SPREAD = {"gyro": 0.2, "joint_velocity": 0.1, "slow_mean": 0.2}
"""Spread of the terms of an observation that a policy lacked, for its normalisation."""

SPREAD = 0.2
"""Spread of the actions with which the training begins, where the settings give none."""

MEANING = ("joints", "action_scale", "action_clip", "dt")
"""Fields of the contract without which the numbers of a network mean something else."""

WAY_OF_PLAYING = ("robot", "default_q", "kp", "kd", "clock_hz", "clock_fade", "interpolate")
"""Fields that a training can get used to."""


def compare_contracts(path: Path, contract: PolicyContract) -> bool:
    """Tell how a policy was played otherwise than it will be; return whether it was on the same robot.

    Args:
        path: An ONNX policy as this package writes it; of one without a contract nothing is known.
        contract: Of the training.

    Raises:
        AssetError: If the file is no ONNX file.
        ConfigError: If its observations or actions mean something else.
    """
    there, here = _stored(_loaded(path)), stored_fields(contract.to_json())
    given, expected = (tuple(map(tuple, c.get("terms", PAPER_TERMS))) for c in (there, here))
    if given != expected[: len(given)]:
        raise ConfigError(
            f"{path.name} has the terms {given} in a frame; a training goes on from {expected} or its first"
        )
    for name in (*MEANING, *WAY_OF_PLAYING):
        if there.get(name, here[name]) == here[name]:
            continue
        if name in MEANING:
            raise ConfigError(
                f"{path.name} has {name} {there[name]}; the settings have {here[name]}, and the network would mean "
                "something else; use the settings of its training"
            )
        log.info("%s was trained with %s %s and goes on with %s", path.name, name, there[name], here[name])
    return bool(there.get("robot", here["robot"]) == here["robot"])


def take_over(actor: Any, path: Path, terms: tuple[tuple[str, int], ...], spread: float = 0.0) -> None:
    """Put the network of a policy into an actor of rsl_rl; the actor then acts as the policy does.

    The actor may see more frames than the policy, which come first in an observation, and more terms, which come last
    in a frame. Those have weights of zero.

    Args:
        actor: An MLPModel with normalised observations, changed in place.
        path: An ONNX policy as this package writes it.
        terms: Name and width of each term of a frame that the actor sees.
        spread: Spread of the actions; 0 takes ``SPREAD``.

    Raises:
        AssetError: If the file is no such policy.
        ConfigError: If the settings shape another network.
    """
    model = _loaded(path)
    values = {i.name: numpy_helper.to_array(i).copy() for i in model.graph.initializer}
    nodes = [n for n in model.graph.node if n.op_type != "Elu"]
    if [n.op_type for n in nodes[:2]] != ["Sub", "Div"] or {n.op_type for n in nodes[2:]} != {"Gemm"}:
        raise AssetError(f"{path} is no policy that can be trained on: {' '.join(n.op_type for n in model.graph.node)}")
    mean, scale = (values[n.input[1]].reshape(-1) for n in nodes[:2])  # of the observation
    layers = [(values[n.input[1]], values[n.input[2]]) for n in nodes[2:]]  # weights (out, in), biases (out,)
    linear = [m for m in actor.mlp if isinstance(m, torch.nn.Linear)]
    here = [(m.out_features, m.in_features) for m in linear]
    there = [w.shape for w, _ in layers]
    known = tuple((name, width) for name, width in _stored(model).get("terms", PAPER_TERMS))
    width, old = (sum(w for _, w in t) for t in (terms, known))
    frames, had = here[0][1] // width, len(mean) // old
    if frames < had or [(o, frames * width if k == 0 else i) for k, (o, i) in enumerate(there)] != here:
        raise ConfigError(
            f"{path.name} has layers of {_sizes(there)}; the settings shape {_sizes(here)}; "
            "set hidden and history to those of the policy (history may be longer)"
        )
    means, scales = np.zeros((frames, width), mean.dtype), np.ones((frames, width), mean.dtype)
    means[:, :old], scales[:, :old] = mean.reshape(had, old)[0], scale.reshape(had, old)[0]
    means[-had:, :old], scales[-had:, :old] = mean.reshape(had, old), scale.reshape(had, old)
    for name in [name for name, _ in terms if (name, dict(terms)[name]) not in known]:
        scales[:, term_columns(terms, name)] = NEW_SPREAD[name]
        if name == "slow_mean":  # it begins at the mean of what it averages
            means[:, term_columns(terms, name)] = means[:, term_columns(terms, *AVERAGED)]
    first, bias = layers[0]
    columns = np.zeros((len(first), frames, width), first.dtype)
    columns[:, -had:, :old] = first.reshape(len(first), had, old)
    layers = [(columns.reshape(len(first), -1), bias), *layers[1:]]
    mean, scale = means.reshape(-1), scales.reshape(-1)
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


def _stored(model: Any) -> dict[str, Any]:
    """Return the contract in a policy as it is written; empty without one."""
    entries = {entry.key: entry.value for entry in model.metadata_props}
    return stored_fields(entries.get(METADATA_KEY, "{}"))


def _loaded(path: Path) -> Any:
    try:
        return onnx.load(str(path))
    except Exception as reason:  # protobuf has errors of its own
        raise AssetError(f"{path} is no ONNX file ({reason})") from reason


def _sizes(shapes: Sequence[tuple[int, ...]]) -> str:
    return "-".join(str(i) for _, i in shapes) + f"-{shapes[-1][0]}"

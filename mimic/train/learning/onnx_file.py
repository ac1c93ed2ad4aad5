"""Writes policies: the network, its contract, and a reference that others can check their player with."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import onnx
import torch

from mimic.io.store import written_whole
from mimic.policy.contract import METADATA_KEY, PolicyContract
from mimic.policy.reference import REFERENCE_KEY, reference
from mimic.policy.runtime import Policy
from mimic.robot.description import RobotDescription


def export_network(network: Any, contract: PolicyContract, description: RobotDescription, path: Path) -> None:
    """Write a network of PyTorch as an ONNX policy.

    Args:
        network: Module from observations (N, observation_size) to actions (N, 12); it may be on any device.
        contract: What it promises.
        description: The robot that it is for.
        path: Where it goes.
    """
    buffer: Any = io.BytesIO()
    with contextlib.redirect_stdout(io.StringIO()):
        torch.onnx.export(
            network.to("cpu").eval(),
            (torch.zeros(1, contract.observation_size),),
            buffer,
            opset_version=17,
            input_names=["observation"],
            output_names=["action"],
            dynamo=False,
        )
    graph = onnx.load_model_from_string(buffer.getvalue())
    graph.producer_name = "mimic"
    write_policy(graph, contract, description, path)


def write_policy(graph: Any, contract: PolicyContract, description: RobotDescription, path: Path) -> None:
    """Write an onnx.ModelProto with its contract and its reference for a robot; no half-written file is left."""
    with written_whole(path) as part:
        onnx.helper.set_model_props(graph, {METADATA_KEY: contract.to_json()})
        onnx.checker.check_model(graph)
        onnx.save(graph, str(part))
        answers = reference(Policy(part, description))
        onnx.helper.set_model_props(graph, {METADATA_KEY: contract.to_json(), REFERENCE_KEY: answers})
        onnx.save(graph, str(part))

"""Writes policies: the network, its contract, and a reference that others can check their player with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import onnx

from mimic.io.store import written_whole
from mimic.policy.contract import METADATA_KEY, PolicyContract
from mimic.policy.reference import REFERENCE_KEY, reference
from mimic.policy.runtime import Policy
from mimic.robot.description import RobotDescription


def write_policy(graph: Any, contract: PolicyContract, description: RobotDescription, path: Path) -> None:
    """Write an ONNX policy with its contract and its reference; no half-written file is left.

    Args:
        graph: An onnx.ModelProto.
        contract: What it promises.
        description: The robot that it is for.
        path: Where it goes.
    """
    with written_whole(path) as part:
        onnx.helper.set_model_props(graph, {METADATA_KEY: contract.to_json()})
        onnx.checker.check_model(graph)
        onnx.save(graph, str(part))
        answers = reference(Policy(part, description))
        onnx.helper.set_model_props(graph, {METADATA_KEY: contract.to_json(), REFERENCE_KEY: answers})
        onnx.save(graph, str(part))

"""What most tests need: the robot, what a policy promises, and policies that always give the same answer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mimic.policy.contract import METADATA_KEY, PolicyContract
from mimic.policy.runtime import load_policy
from mimic.robot.description import RobotDescription, load_description


@pytest.fixture(scope="session")
def description() -> RobotDescription:
    return load_description()


@pytest.fixture(scope="session")
def contract(description: RobotDescription) -> PolicyContract:
    """The contract of the shipped policy."""
    return load_policy(None, description).contract


@pytest.fixture(scope="session")
def constant_onnx(contract: PolicyContract) -> Callable[..., Path]:
    """Return a function that writes an ONNX policy which ignores what it sees."""
    onnx = pytest.importorskip("onnx", reason="writing an ONNX file needs the extra 'train'")

    def write(
        path: Path, *, metadata: str | None = contract.to_json(), seen: int = contract.observation_size, width: int = 12
    ) -> Path:
        helper, real = onnx.helper, onnx.TensorProto.FLOAT
        weights = onnx.numpy_helper.from_array(np.zeros((seen, width), dtype=np.float32), "weights")
        graph = helper.make_graph(
            [helper.make_node("MatMul", ["observation", "weights"], ["action"])],
            "constant",
            [helper.make_tensor_value_info("observation", real, [1, seen])],
            [helper.make_tensor_value_info("action", real, [1, width])],
            [weights],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        if metadata is not None:
            helper.set_model_props(model, {METADATA_KEY: metadata})
        onnx.save(model, str(path))
        return path

    return write

"""A policy between that which a training began from and that which it made: the weighted mean of their networks.

    python -m lab.policies.average BEGAN.onnx MADE.onnx SHARE OUT.onnx ROBOT

SHARE is that of MADE, 0 to 1. A training that goes on from a policy stays near it, so that networks between both act
too, and have some of what each does better (Wortsman et al. 2022, "Robust fine-tuning of zero-shot models").
"""

from __future__ import annotations

import sys
from pathlib import Path

import onnx
from onnx import numpy_helper

from mimic.policy.runtime import Policy
from mimic.robot.description import RobotDescription, load_description
from mimic.train.learning.onnx_file import write_policy
from mimic.train.learning.warm_start import as_seen


def average(began: Path, made: Path, share: float, out: Path, description: RobotDescription) -> None:
    """Write the policy whose weights and biases are a share of those of `made`, and for the rest those of `began`.

    The mean and spread of observations are those of `made`. Errors are those of `as_seen`.
    """
    contract = Policy(made, description).contract
    graph = onnx.load(str(made))
    layers = [node for node in graph.graph.node if node.op_type == "Gemm"]
    values = {value.name: value for value in graph.graph.initializer}
    sizes = [(values[node.input[1]].dims[0], values[node.input[1]].dims[1]) for node in layers]
    _, network = as_seen(began, contract, sizes)
    for node, numbers in zip(layers, network.layers, strict=True):
        for name, at_first in zip(node.input[1:], numbers, strict=True):
            at_last = numpy_helper.to_array(values[name])
            mean = (1.0 - share) * at_first + share * at_last
            values[name].CopyFrom(numpy_helper.from_array(mean.astype(at_last.dtype), name))
    write_policy(graph, contract, description, out)


def main() -> int:
    began, made, share, out, robot = sys.argv[1:]
    average(Path(began), Path(made), float(share), Path(out), load_description(robot))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""Averages the weights of policies that continue from one checkpoint, or of checkpoints of one training.

    python -m lab.policies.mean_policy OUT.onnx ONE.onnx OTHER.onnx …

Policies that continue from the same checkpoint lie in one basin of the loss, and their mean is a policy between them
(Wortsman et al. 2022, "Model soups"). Policies trained from scratch do not, and their mean falls.
Evaluate the mean like any other policy.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

from mimic.policy.contract import METADATA_KEY, PolicyContract
from mimic.robot.description import load_description
from mimic.train.onnx_file import write_policy


def contract_of(model: onnx.ModelProto) -> PolicyContract:
    """Return what the policy promises."""
    return PolicyContract.from_json({entry.key: entry.value for entry in model.metadata_props}[METADATA_KEY])


def mean_policy(models: list[onnx.ModelProto]) -> onnx.ModelProto:
    """Return the policy whose weights, and whose observation normalisation, are the means of those given.

    Raises:
        SystemExit: If they do not promise the same, their training apart, or are not built alike.
    """
    contracts = [contract_of(model) for model in models]
    if any(dataclasses.replace(c, training="") != dataclasses.replace(contracts[0], training="") for c in contracts):
        raise SystemExit("these policies promise different things; expected the same contract in each")
    weights = [{tensor.name: numpy_helper.to_array(tensor) for tensor in model.graph.initializer} for model in models]
    if any({k: v.shape for k, v in w.items()} != {k: v.shape for k, v in weights[0].items()} for w in weights):
        raise SystemExit("these policies have different networks; expected the same names and shapes in each")
    mean = onnx.ModelProto()
    mean.CopyFrom(models[0])
    for tensor in mean.graph.initializer:
        values = [w[tensor.name] for w in weights]
        if values[0].dtype.kind == "f":
            tensor.CopyFrom(numpy_helper.from_array(np.mean(values, axis=0).astype(values[0].dtype), tensor.name))
    both = dataclasses.replace(contracts[0], training=" + ".join(dict.fromkeys(c.training for c in contracts)))
    onnx.helper.set_model_props(mean, {METADATA_KEY: both.to_json()})
    onnx.checker.check_model(mean)
    return mean


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("policies", type=Path, nargs="+")
    arguments = parser.parse_args()
    mean = mean_policy([onnx.load(str(path)) for path in arguments.policies])
    contract = contract_of(mean)
    write_policy(mean, contract, load_description(contract.robot), arguments.out)


if __name__ == "__main__":
    main()

"""Observation -> action, by ONNX Runtime."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime

from mimic.errors import AssetError, ContractError
from mimic.policy.contract import METADATA_KEY, PolicyContract
from mimic.robot.description import RobotDescription
from mimic.shipped import shipped
from mimic.types import FloatArray


class Policy:
    """A policy read from an ONNX file together with its contract."""

    def __init__(self, path: Path, description: RobotDescription) -> None:
        """Load a policy and check it against the robot.

        Raises:
            AssetError: If the file is missing or is no ONNX model.
            ContractError: If it declares no contract, or one that does not fit.
        """
        if not path.is_file():
            raise AssetError(f"there is no policy {path}; the shipped one is policies/stand_track.onnx")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as reason:  # onnxruntime has no common base class for its errors
            raise AssetError(f"{path} is not an ONNX model: {str(reason).splitlines()[0]}") from None
        metadata = self._session.get_modelmeta().custom_metadata_map
        if METADATA_KEY not in metadata:
            raise ContractError(f"{path} declares no contract; export it with mimic train")
        self.path = path
        self.contract = PolicyContract.from_json(metadata[METADATA_KEY])
        self.contract.check(description)
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        widths = (inputs[0].shape[-1], outputs[0].shape[-1])
        expected = (self.contract.observation_size, len(self.contract.joints))
        if widths != expected:
            raise ContractError(f"{path} maps {widths[0]} numbers to {widths[1]}; its contract says {expected}")
        self._input, self._output = inputs[0].name, outputs[0].name

    def act(self, observation: FloatArray) -> FloatArray:
        """Return the action (12,) for an observation (observation_size,)."""
        batch = np.asarray(observation, dtype=np.float32)[None, :]
        (action,) = self._session.run([self._output], {self._input: batch})
        return np.asarray(action, dtype=np.float64)[0]


def load_policy(path: str | Path | None, description: RobotDescription, *, task: str = "stand_track") -> Policy:
    """Load a policy for a task; None takes the shipped one.

    Raises:
        AssetError: If the file is missing or is no ONNX model.
        ContractError: If it declares no contract, or one that does not fit, or was trained for another task.
    """
    policy = Policy(shipped("policies", f"{task}.onnx") if path is None else Path(path), description)
    if policy.contract.task != task:
        raise ContractError(f"{policy.path} was trained for {policy.contract.task}; expected a policy for {task}")
    return policy

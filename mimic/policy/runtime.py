"""Observation -> action, by ONNX Runtime."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import numpy as np
import onnxruntime

from mimic.arguments import checked
from mimic.config.play import DEFAULT_ROBOT
from mimic.errors import AssetError, ContractError
from mimic.io.assets import shipped
from mimic.io.reading import refuse_pointer
from mimic.policy.contract import METADATA_KEY, PolicyContract
from mimic.records import FloatArray
from mimic.robot.description import RobotDescription, load_description


class Policy:
    """A policy read from an ONNX file together with its contract."""

    @checked
    def __init__(self, path: Path, description: RobotDescription) -> None:
        """Load a policy and check it against the robot.

        Raises:
            AssetError: If the file is missing or is no ONNX model.
            ContractError: If it declares no contract, or one that does not fit.
        """
        if not path.is_file():
            raise AssetError(f"there is no policy {path}")
        refuse_pointer(path, AssetError)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        options.add_session_config_entry(*_NO_EXTERNAL_DATA)  # its hash would not say which weights it has
        try:
            self._session = onnxruntime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])
        except Exception as reason:  # onnxruntime has no common base class for its errors
            raise AssetError(f"{path} is not an ONNX model in one file: {str(reason).splitlines()[0]}") from None
        metadata = self._session.get_modelmeta().custom_metadata_map
        if METADATA_KEY not in metadata:
            raise ContractError(f"{path} declares no contract; export it with mimic train")
        self.path = path
        self.description = description
        try:
            self.contract = PolicyContract.from_json(metadata[METADATA_KEY])
            self.contract.check(description)
        except ContractError as reason:
            raise ContractError(f"{path}: {reason}") from None
        inputs = self._session.get_inputs()
        outputs = self._session.get_outputs()
        widths = (inputs[0].shape[-1], outputs[0].shape[-1])
        expected = (self.contract.observation_size, len(self.contract.joints))
        if widths != expected:
            raise ContractError(f"{path} maps {widths[0]} numbers to {widths[1]}; its contract says {expected}")
        self._input = inputs[0].name
        self._output = outputs[0].name

    def act(self, observation: FloatArray) -> FloatArray:
        """Return the action (12,) for an observation (observation_size,)."""
        batch = np.asarray(observation, dtype=np.float32)[None, :]
        (action,) = self._session.run([self._output], {self._input: batch})
        return np.asarray(action, dtype=np.float64)[0]


_NO_EXTERNAL_DATA = ("session.model_external_initializers_file_folder_path", os.devnull)
"""A folder without files, for the weights of a model that are not in its own file."""

SHIPPED = ("stand_track", "sit_down")
"""Names of the policies that come with mimic."""


def robot_file(name: str, robot: str) -> str:
    """Return the name of a robot's file in policies/; the default robot's has no prefix."""
    return name if robot == DEFAULT_ROBOT else f"{robot}_{name}"


def find_policy(policy: str | Path, robot: str) -> Path:
    """Return the file of a policy: an ONNX file, or a shipped policy of a robot by its name.

    Args:
        policy: A path; or stand_track, stand_track.onnx or policies/stand_track.onnx for the shipped policy, which is
            found from any folder.
        robot: Name of the robot.

    Raises:
        AssetError: If there is no such policy.
    """
    path = Path(policy)
    if path.is_file():
        return path
    if path.stem in SHIPPED and path.suffix in ("", ".onnx") and path.parent in (Path(), Path("policies")):
        file = shipped("policies") / robot_file(f"{path.stem}.onnx", robot)
        if file.is_file():
            return file
        raise AssetError(
            f"there is no shipped {policy} policy for {robot}; give your own ONNX file, or train one: "
            f"mimic train OUT --recipe {path.stem} --robot-model {robot}, or its folder"
        )
    raise AssetError(f"there is no policy {policy}; give an ONNX file or a shipped policy: {', '.join(SHIPPED)}")


def load_policy(path: str | Path | None, description: RobotDescription, *, task: str = "stand_track") -> Policy:
    """Load a policy for a task from a file or by its shipped name; by default the shipped one.

    Raises:
        AssetError: If the file is missing or is no ONNX model.
        ContractError: If it declares no contract, or one that does not fit, or was trained for another task.
    """
    policy = Policy(find_policy(task if path is None else path, description.name), description)
    if policy.contract.task != task:
        raise ContractError(f"{policy.path} was trained for {policy.contract.task}; expected a policy for {task}")
    return policy


@cache
def cached_policy(path: str, robot: str) -> Policy:
    """Return the policy of a file for a robot (see `load_description`), read once in each process.

    Raises:
        AssetError, ContractError: If it cannot be run on this robot.
    """
    return Policy(Path(path), load_description(robot))

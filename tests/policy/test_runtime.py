from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.errors import AssetError, ContractError
from mimic.policy.runtime import Policy, load_policy


def test_the_shipped_policy_fits_and_answers(description):
    policy = load_policy(None, description)
    action = policy.act(np.zeros(policy.contract.observation_size))
    assert action.shape == (12,)
    assert np.isfinite(action).all()
    assert policy.path.name == "stand_track.onnx"


def test_the_same_observation_gives_the_same_action(description):
    observation = np.random.default_rng(0).normal(size=load_policy(None, description).contract.observation_size)
    first, second = (load_policy(None, description) for _ in range(2))
    assert np.array_equal(first.act(observation), second.act(observation))
    assert np.array_equal(first.act(observation), first.act(observation))


def test_the_contract_comes_from_inside_the_file(tmp_path, constant_onnx, contract, description):
    other = dataclasses.replace(contract, kp=tuple(kp + 1 / 3 for kp in contract.kp))
    policy = Policy(constant_onnx(tmp_path / "a.onnx", metadata=other.to_json()), description)
    assert policy.contract == other


def test_a_missing_file_is_reported(tmp_path, description):
    with pytest.raises(
        AssetError, match=r"there is no policy .*nowhere\.onnx; give an ONNX file or a shipped policy: stand_track"
    ):
        load_policy(tmp_path / "nowhere.onnx", description)


def test_a_file_that_is_no_model_is_reported_in_one_line(tmp_path, description):
    path = tmp_path / "a.onnx"
    path.write_text("not a model")
    with pytest.raises(AssetError, match=r"a\.onnx is not an ONNX model") as error:
        Policy(path, description)
    assert "\n" not in str(error.value)


def test_a_pointer_of_git_lfs_says_how_to_get_the_model(tmp_path, description):
    path = tmp_path / "a.onnx"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 4448742\n")
    with pytest.raises(AssetError, match=r"a\.onnx is a git LFS pointer, not the file itself; run git lfs pull"):
        Policy(path, description)


def test_a_model_without_a_contract_is_refused(tmp_path, constant_onnx, description):
    with pytest.raises(ContractError, match="declares no contract; export it with mimic train"):
        Policy(constant_onnx(tmp_path / "a.onnx", metadata=None), description)


def test_a_model_for_another_robot_is_refused(tmp_path, constant_onnx, contract, description):
    other = dataclasses.replace(contract, robot="cyberdog9")
    with pytest.raises(ContractError, match=r"a\.onnx: .* trained for cyberdog9; it cannot drive the robot cyberdog2"):
        Policy(constant_onnx(tmp_path / "a.onnx", metadata=other.to_json()), description)


@pytest.mark.parametrize("sizes", [{"seen": 40}, {"width": 11}])
def test_a_model_of_other_widths_than_its_contract_is_refused(sizes, tmp_path, constant_onnx, description):
    with pytest.raises(ContractError, match="its contract says"):
        Policy(constant_onnx(tmp_path / "a.onnx", **sizes), description)


def test_a_model_whose_weights_are_in_another_file_is_refused(tmp_path, constant_onnx, description):
    onnx = pytest.importorskip("onnx", reason="writing an ONNX file needs the extra 'train'")
    model = onnx.load(constant_onnx(tmp_path / "whole.onnx"))
    onnx.save_model(
        model, tmp_path / "split.onnx", save_as_external_data=True, location="weights.bin", size_threshold=0
    )
    with pytest.raises(AssetError, match=r"split\.onnx is not an ONNX model in one file"):
        Policy(tmp_path / "split.onnx", description)

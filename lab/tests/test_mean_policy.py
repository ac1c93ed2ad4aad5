"""The mean of policies: weights, contract, refusals."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

onnx = pytest.importorskip("onnx", reason="the train extra brings onnx")

from onnx import numpy_helper  # noqa: E402

from lab.policies.mean_policy import contract_of, mean_policy  # noqa: E402
from mimic.io.assets import shipped  # noqa: E402
from mimic.policy.contract import METADATA_KEY  # noqa: E402


@pytest.fixture
def shipped_model():
    return onnx.load(str(shipped("policies", "stand_track.onnx")))


def changed(model, factor=1.0, **contract):
    """Return the policy with its weights times a factor, and with another contract."""
    other = onnx.ModelProto()
    other.CopyFrom(model)
    for tensor in other.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype.kind == "f":
            tensor.CopyFrom(numpy_helper.from_array((values * factor).astype(values.dtype), tensor.name))
    onnx.helper.set_model_props(other, {METADATA_KEY: dataclasses.replace(contract_of(model), **contract).to_json()})
    return other


def test_the_weights_are_the_mean_and_both_trainings_are_named(shipped_model):
    mean = mean_policy([changed(shipped_model, training="one"), changed(shipped_model, 3.0, training="other")])
    for tensor, before in zip(mean.graph.initializer, shipped_model.graph.initializer, strict=True):
        values, was = numpy_helper.to_array(tensor), numpy_helper.to_array(before)
        np.testing.assert_allclose(values, 2 * was if was.dtype.kind == "f" else was, rtol=1e-6)
    assert contract_of(mean).training == "one + other"


def test_policies_that_promise_different_things_are_refused(shipped_model):
    with pytest.raises(SystemExit, match="promise different things"):
        mean_policy([shipped_model, changed(shipped_model, clock_hz=2.5)])


def test_policies_of_different_networks_are_refused(shipped_model):
    other = changed(shipped_model)
    other.graph.initializer[0].name = "another"
    with pytest.raises(SystemExit, match="different networks"):
        mean_policy([shipped_model, other])

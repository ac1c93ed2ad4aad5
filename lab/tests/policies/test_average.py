from __future__ import annotations

import numpy as np
import pytest

onnx = pytest.importorskip("onnx", reason="training needs the extra 'train'")
pytest.importorskip("torch", reason="training needs the extra 'train'")
from onnx import numpy_helper  # noqa: E402

from lab.policies.average import average  # noqa: E402
from mimic.policy.runtime import Policy, find_policy  # noqa: E402
from mimic.robot.description import load_description  # noqa: E402

pytestmark = pytest.mark.slow


def test_a_quarter_of_the_way_from_one_network_to_another(tmp_path):
    description = load_description("go2")
    began = find_policy("stand_track", "go2")
    graph = onnx.load(str(began))
    last = next(value for value in graph.graph.initializer if value.name.endswith("6.bias"))
    last.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(last) + np.float32(0.4), last.name))
    onnx.save(graph, str(tmp_path / "made.onnx"))
    average(began, tmp_path / "made.onnx", 0.25, tmp_path / "between.onnx", description)
    before = Policy(began, description)
    between = Policy(tmp_path / "between.onnx", description)
    seen = np.random.default_rng(1).normal(0.0, 0.3, before.contract.observation_size)
    assert between.act(seen) == pytest.approx(before.act(seen) + 0.1, abs=1e-5)

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.io.store import save_json
from mimic.sysid.result import (
    Alternative,
    Calibration,
    Candidate,
    Correlations,
    Errors,
    Found,
    Stage,
    Traces,
    UnexplainedResidual,
)


def small() -> Calibration:
    """Return a calibration of two joints that found backlash."""
    row = np.array([1.0, 3.0])
    tried = Candidate(name="backlash", joints=("a", "b"), gain=float("nan"), fitted=True)
    return Calibration(
        joints=("a", "b"),
        unit="rad",
        noise=row,
        nominal=Errors(train=8 * row, held_out=8 * row),
        baseline=Errors(train=4 * row, held_out=5 * row),
        final=Errors(train=2 * row, held_out=4 * row),
        found=(Found(name="backlash", joints=("a",), evidence=30.0, share=0.9),),
        alternatives=(Alternative(effects=(("spring", ("b",)),), behind=2.0),),
        tried=(Stage(beside=(), candidates=(tried,)),),
        effects=EffectSet((EffectValues(name="delay", values={"time": np.array([0.01])}),)),
        unexplained=(UnexplainedResidual(joint="a", ratio=1.0, torque=0.1, depends_on=(("speed", 0.5),)),),
        sentence="The model lacked backlash.",
        traces=Traces(**dict.fromkeys(("t", "q", "dq", "tau", "before", "after"), np.zeros((5, 2)))),
    )


def test_all_but_the_traces_comes_out_as_json(tmp_path: Path) -> None:
    save_json(small().to_json(), tmp_path / "calibration.json")
    data = json.loads((tmp_path / "calibration.json").read_text())
    assert data["format"] == 5
    assert data["found"] == [{"name": "backlash", "joints": ["a"], "evidence": 30.0, "share": 0.9}]
    assert data["alternatives"][0]["effects"] == [["spring", ["b"]]]
    assert data["errors"]["nominal"]["held_out"] == {"a": 8.0, "b": 24.0, "all": np.sqrt(320.0)}
    assert data["errors"]["final"]["train"]["b"] == 6.0
    assert data["tried"][0]["candidates"][0]["gain"] is None
    assert data["effects"][0]["values"] == {"time": [0.01]}
    assert data["unexplained"][0]["depends_on"] == [["speed", 0.5]]
    assert "traces" not in data


def test_pairs_of_correlated_numbers_come_strongest_first() -> None:
    matrix = np.array([[1.0, 0.8, 0.1], [0.8, 1.0, -0.95], [0.1, -0.95, 1.0]])
    found = Correlations(names=("a", "b", "c"), matrix=matrix)
    assert found.pairs(0.7) == (("b", "c", -0.95), ("a", "b", 0.8))
    assert len(found.pairs()) == 3
    assert replace(small(), correlations=found).to_json()["correlations"] == [["b", "c", -0.95], ["a", "b", 0.8]]
    assert small().to_json()["correlations"] == []

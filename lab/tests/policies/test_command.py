"""The command for studies of a policy."""

from __future__ import annotations

import json

import pytest

from lab.policies.__main__ import STUDIES, main
from lab.policies.studies import walking
from mimic.io import store


@pytest.mark.parametrize("study", STUDIES)
def test_each_study_refuses_a_missing_policy(study, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([study, "nowhere.onnx"]) == 2
    assert capsys.readouterr().err.startswith("lab.policies: there is no policy nowhere.onnx")
    assert list(tmp_path.iterdir()) == []


def test_the_table_is_printed_beside_the_paper_s_and_written(tmp_path, capsys, constant_onnx, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(walking, "SPEEDS", (0.3,))
    monkeypatch.setattr(walking, "TURNS", (0.5,))
    monkeypatch.setattr(walking, "SECONDS", 5.5)
    policy = constant_onnx(tmp_path / "still.onnx")
    assert main(["table", str(policy), "--episodes", "1", "--seconds", "2", "--workers", "1"]) == 0
    shown = capsys.readouterr().out
    for word in ("paper", "contacts", "826.7", "toes", "noise", "statue", "arms moving", "rad/s"):
        assert word in shown, word
    written = json.loads((tmp_path / "table-still.json").read_text())
    assert written["provenance"]["settings"]["episodes"] == 1
    assert written["provenance"]["inputs"]["policy"] == store.sha256_of(policy)
    assert set(written["paper"]) == set(written["table"]["the paper's noise"]["contacts"]["columns"])


def test_a_study_of_the_shipped_policy_is_printed(tmp_path, capsys):
    out = tmp_path / "figures.json"
    assert main(["lead", "--episodes", "1", "--workers", "1", "--out", str(out)]) == 0
    assert "followed the hand" in capsys.readouterr().out
    assert len(json.loads(out.read_text())["episodes"]) == 1

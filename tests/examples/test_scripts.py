"""Each script and the notebook in examples/ runs as it is."""

from __future__ import annotations

import os
import runpy
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
SCRIPTS = {
    "calibrate_any_machine": (["out"], "coulomb {'level': [0.4", "out/report.html"),
    "disturbed_policy": ([], "toe error [cm]", None),
    "gymnasium_env": (["go2", "3"], "150 steps, fell: False", None),
    "own_motion": ([], "falls: 0", None),
    "play_and_plot": ([str(EXAMPLES / "motions" / "step_and_wave.yaml"), "toes.png"], "stood up in 0.3", "toes.png"),
    "rerun_scene": (["scene.rrd"], "mean power", "scene.rrd"),
    "video_to_targets": (["CLIP", "t.parquet"], "targets", "t.parquet"),
}
"""Script -> its arguments, what it prints, a file that it writes."""


def environment() -> dict[str, str]:
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    return {"MUJOCO_GL": "egl", **os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}


def test_every_script_of_examples_is_run_here_or_has_tests_of_its_own() -> None:
    own = {path.stem.removeprefix("test_") for path in Path(__file__).parent.glob("test_*.py")}
    assert set(SCRIPTS) == {path.stem for path in EXAMPLES.glob("*.py")} - own


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_runs(
    name: str, tmp_path: Path, short_clip: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if name == "play_and_plot":
        pytest.importorskip("matplotlib")
    arguments, printed, written = SCRIPTS[name]
    words = [str(short_clip) if word == "CLIP" else word for word in arguments]
    script = EXAMPLES / f"{name}.py"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(script), *words])
    runpy.run_path(str(script), run_name="__main__")
    assert printed in capsys.readouterr().out
    assert written is None or (tmp_path / written).stat().st_size > 0


def test_the_notebook_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat = pytest.importorskip("nbformat", reason="running the notebook needs the extra 'docs'")
    nbclient = pytest.importorskip("nbclient", reason="running the notebook needs the extra 'docs'")
    for name, value in environment().items():
        monkeypatch.setenv(name, value)
    notebook = nbformat.read(EXAMPLES / "first_steps.ipynb", as_version=4)
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(EXAMPLES)}}).execute()
    printed = [
        out["text"] for cell in notebook.cells for out in cell.get("outputs", ()) if out["output_type"] == "stream"
    ]
    assert any("toe error" in text for text in printed)


def test_the_notebook_is_stored_without_outputs() -> None:
    import json

    cells = json.loads((EXAMPLES / "first_steps.ipynb").read_text(encoding="utf-8"))["cells"]
    assert [cell["outputs"] for cell in cells if cell["cell_type"] == "code" and cell["outputs"]] == []

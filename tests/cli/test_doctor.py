"""`mimic doctor`: what it finds missing has the line that mends it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mimic.cli import main
from mimic.flows import doctor


def test_doctor_looks_at_everything_and_what_is_missing_has_a_fix(capsys):
    assert main(["doctor"]) in (0, 2)
    shown = capsys.readouterr().out
    for name in ("opencv", "pose model", "graphics", "gpu", "camera", "CAN adapter", "multicast route", "extra train"):
        assert name in shown
    assert shown.count("→") >= shown.count("– ")


def test_a_look_that_fails_is_a_finding(monkeypatch):
    def fails() -> doctor.Finding:
        raise RuntimeError("no such thing")

    monkeypatch.setitem(doctor.LOOKS, "camera", fails)
    found = next(f for f in doctor.examine() if f.name == "camera")
    assert (found.ok, found.text) == (False, "RuntimeError: no such thing")


def test_a_can_interface_that_is_down_is_told_from_one_that_is_up(monkeypatch, tmp_path):
    (tmp_path / "can0").mkdir()
    (tmp_path / "can0" / "type").write_text("280\n")
    (tmp_path / "can0" / "operstate").write_text("down\n")
    monkeypatch.setattr(doctor, "NETWORKS", tmp_path)
    found = next(f for f in doctor.examine() if f.name == "CAN adapter")
    assert found.fix == "ip link set can0 up type can bitrate 1000000"
    (tmp_path / "can0" / "operstate").write_text("up\n")
    assert next(f for f in doctor.examine() if f.name == "CAN adapter").ok


@pytest.mark.slow
def test_an_opencv_without_libgl_is_one_line_and_words_are_played_without_it(tmp_path):
    (tmp_path / "cv2.py").write_text("raise ImportError('libGL.so.1: cannot open shared object file')\n")
    clip = Path(__file__).parents[2] / "examples" / "videos" / "waving.mp4"
    program = "import sys; sys.path.insert(0, sys.argv.pop(1)); from mimic.cli import main; sys.exit(main())"

    def mimic(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", program, str(tmp_path), *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)

    video = mimic(str(clip), "--sim", "--no-view")
    assert video.returncode == 2
    assert video.stderr.splitlines()[-1].startswith("mimic: the system lacks a library (libGL.so.1")
    assert "opencv-python-headless" in video.stderr
    words = mimic("--text", "wave the left hand", "--sim", "--no-view", "-o", "run")
    assert words.returncode == 0, words.stderr
    assert (tmp_path / "run" / "scene.rrd").is_file()

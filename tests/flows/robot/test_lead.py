"""``mimic lead``: from the shell, with a film."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from mimic.cli import main
from mimic.view.film.footage import read_frames

SHORT = ["lead", "--way", "0.4", "--begin", "2.5", "--after", "2"]


@pytest.mark.slow
def test_a_robot_is_led_and_filmed(tmp_path, capsys):
    film = tmp_path / "lead.mp4"
    assert main([*SHORT, "--video", str(film)]) == 0
    said = capsys.readouterr()
    assert "followed the hand" in said.out + said.err
    assert len(list(read_frames(film))) == pytest.approx(30 * 6.5, abs=6)
    video, yellow = cv2.VideoCapture(str(film)), []
    while (read := video.read())[0]:
        blue, green, red = (channel.astype(int) for channel in cv2.split(read[1]))
        yellow.append(int(((red > 150) & (green > 110) & (blue < 90)).sum()))
    assert max(yellow[:75]) == 0
    assert max(yellow[75:135]) > 100  # the arrow of the pull, from 2.5 to 4.5 s
    assert max(yellow[136:]) == 0


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--speed", "9"], "speed is 9 m/s; it must be from 0.01 to 2 m/s"),
        (["--toe", "middle"], "middle"),
        (["--policy", "nowhere.onnx"], "nowhere.onnx"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(options, text, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*SHORT, *options]) == 2
    assert text in capsys.readouterr().err
    assert not list(Path(tmp_path).iterdir())

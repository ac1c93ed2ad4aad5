import socket
import sys
import time
import urllib.request
from pathlib import Path

import pytest
import rerun as rr

from mimic.errors import AssetError
from mimic.view.scene.viewer import display_available, open_viewer, serve_scene

COMPLETE = b"RRF2 content RRF2FOOT\1\0\0\0"


def test_display_is_one_of_x11_or_wayland(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert not display_available()
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert display_available()


def test_a_mac_has_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    assert display_available()


def test_no_window_without_a_display(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("mimic.view.scene.viewer.display_available", lambda: False)
    (tmp_path / "scene.rrd").write_bytes(COMPLETE)
    assert open_viewer(tmp_path / "scene.rrd") is False


def test_a_missing_scene_is_named(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match=r"no\.rrd"):
        open_viewer(tmp_path / "no.rrd")


@pytest.mark.parametrize(
    ("content", "said"), [(COMPLETE[:-8], "is cut short; copy it again"), (b"", "is no Rerun scene"), (b"PK", "is no")]
)
def test_a_damaged_scene_is_not_shown(tmp_path: Path, content: bytes, said: str) -> None:
    scene = tmp_path / "scene.rrd"
    scene.write_bytes(content)
    for show in (open_viewer, lambda path: serve_scene(path, print)):
        with pytest.raises(AssetError, match=said):
            show(scene)


@pytest.mark.slow
def test_a_scene_is_served_to_browsers_of_this_computer_only(tmp_path: Path) -> None:
    stream = rr.RecordingStream("test")
    stream.save(tmp_path / "scene.rrd")
    stream.log("points", rr.Points3D([[0.0, 0.0, 0.0]]))
    stream.flush()
    stream.disconnect()
    pages = []

    def seen(address: str) -> None:
        pages.append((address, urllib.request.urlopen(address.partition("?")[0], timeout=10.0).status))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        serve_scene(tmp_path / "scene.rrd", seen)
    address, status = pages[0]
    assert address.startswith("http://127.0.0.1:")
    assert status == 200
    port = int(address.removeprefix("http://127.0.0.1:").partition("?")[0])
    until = time.monotonic() + 2.0  # a dying process closes its output a moment before its sockets
    while _listens(port) and time.monotonic() < until:
        time.sleep(0.01)
    assert not _listens(port), "the server outlives the call"


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_a_viewer_listens_on_this_computer_only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    started: list[list[str]] = []
    monkeypatch.setattr("subprocess.Popen", lambda words, **_: started.append(words))
    monkeypatch.setattr("mimic.view.scene.viewer.display_available", lambda: True)
    (tmp_path / "scene.rrd").write_bytes(COMPLETE)
    assert open_viewer(tmp_path / "scene.rrd")
    assert started[0][-2:] == ["--bind", "127.0.0.1"]

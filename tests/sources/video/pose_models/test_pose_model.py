"""The bundle of models: made from the maker's wheel, kept in the user's cache, and what happens without a network."""

from __future__ import annotations

import os
import shutil
import stat
import zipfile
from pathlib import Path

import pytest

from mimic.errors import AssetError
from mimic.io.assets import user_cache
from mimic.sources.video.pose_models.blazepose import BlazePose
from mimic.sources.video.pose_models.pose_model import BUNDLE, MODELS, WHEEL, is_here, pose_model


@pytest.fixture(scope="module")
def bundle() -> Path:
    """The bundle in the real cache of the user; the first test of a new machine downloads it."""
    return pose_model()


@pytest.fixture
def cache(bundle, tmp_path, monkeypatch) -> Path:
    """An empty cache of the user."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "mimic" / "models"


@pytest.fixture
def offline(monkeypatch, tmp_path):
    """No registry can be reached: neither by pip nor by uv, and nothing comes from their caches."""
    nowhere = str(tmp_path / "nowhere")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", nowhere)
    monkeypatch.setenv("UV_OFFLINE", "1")
    monkeypatch.setenv("UV_FIND_LINKS", nowhere)


def wheel_like(path: Path, **contents: bytes) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for member, content in contents.items():
            archive.writestr(member, content)
    return path


def test_the_bundle_holds_both_models_stored_and_aligned(bundle):
    assert bundle == user_cache("models") / BUNDLE
    with zipfile.ZipFile(bundle) as archive:
        assert archive.testzip() is None
        entries = archive.infolist()
        assert [entry.filename for entry in entries] == list(MODELS)
        assert {entry.compress_type for entry in entries} == {zipfile.ZIP_STORED}
        content = bundle.read_bytes()
        for entry in entries:
            assert content.find(archive.read(entry)) % 16 == 0


def test_a_cached_bundle_is_used_without_a_network(bundle, cache, offline):
    kept = shutil.copy(bundle, _folder(cache) / BUNDLE)
    assert is_here()
    assert pose_model() == kept


def test_a_damaged_bundle_is_not_used(bundle, cache, offline):
    content = bytearray(bundle.read_bytes())
    content[len(content) // 2] ^= 255
    (_folder(cache) / BUNDLE).write_bytes(content)
    with pytest.raises(AssetError, match="could not be downloaded"):
        pose_model()


def test_without_a_network_one_line_says_which_file_to_put_where(cache, offline):
    assert not is_here()
    with pytest.raises(AssetError) as refusal:
        pose_model()
    message = str(refusal.value)
    assert WHEEL in message
    assert str(cache) in message
    assert "\n" not in message
    assert list(cache.glob("*.task")) == []


def test_a_cache_that_cannot_be_written_is_an_error_in_one_line(cache, offline):
    cache.parent.parent.write_text("a file, not a folder")
    with pytest.raises(AssetError, match="set XDG_CACHE_HOME"):
        pose_model()


@pytest.mark.parametrize(
    ("contents", "reason"),
    [
        ({"other": b"x"}, "holds no BlazePose model"),
        ({member: b"x" for member, _ in MODELS.values()}, "is not that of mediapipe"),
    ],
    ids=["another archive", "other models"],
)
def test_a_wheel_without_the_models_is_refused(cache, contents, reason):
    wheel_like(_folder(cache) / WHEEL, **contents)
    with pytest.raises(AssetError, match=reason):
        pose_model()
    assert list(cache.glob("*.task")) == []


def test_a_bundle_that_mediapipe_refuses_gives_one_line(tmp_path, capfd):
    given = wheel_like(tmp_path / "other.task", **{name: b"x" * 64 for name in MODELS})
    with pytest.raises(AssetError, match=r"cannot use the pose model .*other\.task") as refusal, BlazePose(given):
        pass
    assert "\n" not in str(refusal.value)
    assert capfd.readouterr().err == ""


@pytest.mark.slow
@pytest.mark.parametrize("program", ["pip", "uv"])
def test_the_models_come_from_the_registry_of_pip_or_uv(bundle, cache, monkeypatch, tmp_path, program):
    """A stand-in for the other program fails, so that this one must do it."""
    if program == "uv" and not (shutil.which("uv") or os.environ.get("UV")):
        pytest.skip("uv is not installed")
    if program == "pip":
        pytest.importorskip("pip")
        broken = tmp_path / "uv"
        broken.write_text("#!/bin/sh\necho error: broken >&2\nexit 2\n")
        broken.chmod(broken.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setenv("UV", str(broken))
    else:
        monkeypatch.setenv("UV", os.environ.get("UV") or str(shutil.which("uv")))
        monkeypatch.setenv("PIP_NO_INDEX", "1")
    assert pose_model().read_bytes() == bundle.read_bytes()


def _folder(path: Path) -> Path:
    path.mkdir(parents=True)
    return path

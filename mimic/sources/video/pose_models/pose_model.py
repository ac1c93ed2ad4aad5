"""The BlazePose models as mediapipe's Tasks API takes them: one bundle, made once and kept in the user's cache.

mediapipe 0.10.14 is the last release whose wheel carries the models of the detector and of the full landmarks; newer
ones carry none. So its wheel comes once from the package registry that pip or uv is set up with. The two models are
taken out of it by name, checked by SHA-256, and stored in a zip (a ``.task`` file).

The landmark model lacks one thing that the Tasks API asks for: how pictures are normalised. assets/pose/landmarks.head,
which lab/people/pose_head.py makes, goes before it and says so; weights and graph stay as they are.
"""

from __future__ import annotations

import hashlib
import struct
import zipfile
from pathlib import Path

from mimic.errors import AssetError
from mimic.io.assets import shipped, user_cache
from mimic.io.store import written_whole
from mimic.sources.video.registry import RegistryError, download

RELEASE = "0.10.14"
"""The release of mediapipe whose wheel carries the models."""
WHEEL = f"mediapipe-{RELEASE}-cp312-cp312-manylinux_2_17_x86_64.manylinux2014_x86_64.whl"
"""Its wheel for one platform; those of other platforms carry the same two files."""
_WHEELS = f"mediapipe-{RELEASE}-*.whl"
MODELS = {
    "pose_detector.tflite": (
        "mediapipe/modules/pose_detection/pose_detection.tflite",
        "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    ),
    "pose_landmarks_detector.tflite": (
        "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
        "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
    ),
}
"""Name in a bundle -> name in the wheel, and SHA-256."""
BUNDLE = f"blazepose_full_{RELEASE}.task"
LANDMARKS = "pose_landmarks_detector.tflite"
ALIGNMENT = 16
"""TFLite aligns the weights in a model to this [bytes]."""


def is_here() -> bool:
    """Return whether `pose_model` needs no download."""
    folder = user_cache("models")
    return (folder / BUNDLE).is_file() or any(folder.glob(_WHEELS))


def pose_model() -> Path:
    """Return the bundle of the BlazePose models; at the first use it is made from the package that carries them.

    It is the cached one, or is made of a wheel that a person put beside it or that is downloaded.

    Raises:
        AssetError: If the models are neither cached nor can be downloaded, or the wheel is another one.
    """
    path = user_cache("models") / BUNDLE
    if _names(path) >= set(MODELS):
        return path
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as reason:
        raise AssetError(
            f"the BlazePose models cannot be kept in {path.parent}: {reason.strerror}; set XDG_CACHE_HOME to a folder "
            "that can be written"
        ) from None
    if here := sorted(path.parent.glob(_WHEELS)):
        return _bundled(here[0], path)
    try:
        with download(f"mediapipe=={RELEASE}") as package:
            return _bundled(package, path)
    except RegistryError as reason:
        raise AssetError(
            f"the BlazePose models are not on this computer and could not be downloaded ({reason}); get "
            f"{WHEEL} from a package registry and put it into {path.parent}"
        ) from None


def _names(path: Path) -> set[str]:
    """Return the names in a zip file whose content is whole; none if it is no such file."""
    try:
        with zipfile.ZipFile(path) as archive:
            return set() if archive.testzip() else set(archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return set()


def _bundled(source: Path, path: Path) -> Path:
    """Write the bundle of the models in a wheel, or in the folder of an unpacked one.

    Raises:
        AssetError: If one is missing there, or is another model.
    """
    models = {name: _model(source, member, digest) for name, (member, digest) in MODELS.items()}
    models[LANDMARKS] = shipped("assets", "pose", "landmarks.head").read_bytes() + models[LANDMARKS]
    with written_whole(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_STORED) as archive:
        for name, content in models.items():
            entry = zipfile.ZipInfo(name)
            start = archive.start_dir + zipfile.sizeFileHeader + len(name)  # pyrefly: ignore[missing-attribute]
            padding = -(start + 4) % ALIGNMENT  # models are mapped into memory as they lie in the file
            entry.extra = struct.pack("<HH", 0xD935, padding) + bytes(padding)
            archive.writestr(entry, content)
    return path


def _model(source: Path, member: str, digest: str) -> bytes:
    try:
        if source.is_dir():
            content = (source / member).read_bytes()
        else:
            with zipfile.ZipFile(source) as archive:
                content = archive.read(member)
    except (OSError, KeyError, zipfile.BadZipFile):
        raise AssetError(f"{source.name} holds no BlazePose model {member}; put {WHEEL} in its place") from None
    if hashlib.sha256(content).hexdigest() != digest:
        raise AssetError(f"{member} in {source.name} is not that of mediapipe {RELEASE}; put {WHEEL} in its place")
    return content

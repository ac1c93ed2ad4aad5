"""What is put before the landmark model is read back by mediapipe's own classes of both file formats."""

from __future__ import annotations

import hashlib
import zipfile

import pytest

from mimic.io.assets import shipped
from mimic.sources.video.pose_models.pose_model import LANDMARKS, MODELS, pose_model

tflite = pytest.importorskip("mediapipe.tasks.metadata.schema_py_generated")
metadata = pytest.importorskip("mediapipe.tasks.metadata.metadata_schema_py_generated")


def read(content: bytes):
    return tflite.ModelT.InitFromPackedBuf(bytearray(content), 0)


@pytest.fixture(scope="module")
def landmarks() -> bytes:
    """The landmark model, with metadata."""
    with zipfile.ZipFile(pose_model()) as archive:
        return archive.read(LANDMARKS)


def declared(model) -> metadata.ModelMetadataT:
    place = next(entry.buffer for entry in reversed(model.metadata) if entry.name == b"TFLITE_METADATA")
    return metadata.ModelMetadataT.InitFromPackedBuf(bytes(model.buffers[place].data), 0)


def test_normalisation_is_declared_for_an_rgb_picture(landmarks):
    (subgraph,) = declared(read(landmarks)).subgraphMetadata
    (tensor,) = subgraph.inputTensorMetadata
    assert isinstance(tensor.content.contentProperties, metadata.ImagePropertiesT)
    assert tensor.content.contentProperties.colorSpace == metadata.ColorSpaceType.RGB
    (unit,) = tensor.processUnits
    assert (unit.options.mean, unit.options.std) == ([0.0], [255.0])


def test_graph_and_weights_are_those_of_the_maker(landmarks):
    head = shipped("assets", "pose", "landmarks.head").read_bytes()
    assert landmarks.startswith(head)
    assert hashlib.sha256(landmarks[len(head) :]).hexdigest() == MODELS[LANDMARKS][1]
    model = read(landmarks)
    assert len(model.subgraphs) == 1
    assert len(model.buffers) > 100

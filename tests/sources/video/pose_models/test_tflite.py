"""The metadata are read back by mediapipe's own classes of both file formats."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest

from mimic.sources.video.pose_models.pose_model import pose_model
from mimic.sources.video.pose_models.tflite import with_normalisation

tflite = pytest.importorskip("mediapipe.tasks.metadata.schema_py_generated")
metadata = pytest.importorskip("mediapipe.tasks.metadata.metadata_schema_py_generated")


def read(content: bytes):
    return tflite.ModelT.InitFromPackedBuf(bytearray(content), 0)


@pytest.fixture(scope="module")
def landmarks() -> bytes:
    """The landmark model, with metadata."""
    with zipfile.ZipFile(pose_model()) as archive:
        return archive.read("pose_landmarks_detector.tflite")


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


def test_graph_and_weights_stay_as_they_are(landmarks):
    before, after = read(landmarks), read(with_normalisation(landmarks, 127.5, 63.0))
    assert (before.version, before.description) == (after.version, after.description)
    assert len(after.buffers) == len(before.buffers) + 1
    assert all(np.array_equal(a.data, b.data) for a, b in zip(before.buffers, after.buffers, strict=False))
    assert [t.name for t in before.subgraphs[0].tensors] == [t.name for t in after.subgraphs[0].tensors]
    assert [o.opcodeIndex for o in before.subgraphs[0].operators] == [
        o.opcodeIndex for o in after.subgraphs[0].operators
    ]
    assert declared(after).subgraphMetadata[0].inputTensorMetadata[0].processUnits[0].options.std == [63.0]


def test_weights_keep_their_alignment(landmarks):
    after = with_normalisation(landmarks, 0.0, 255.0)
    largest = max(read(landmarks).buffers, key=lambda buffer: 0 if buffer.data is None else len(buffer.data))
    assert landmarks.find(bytes(largest.data)) % 16 == after.find(bytes(largest.data)) % 16 == 0

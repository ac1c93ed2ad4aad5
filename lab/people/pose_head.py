"""Makes assets/pose/landmarks.head: how the input picture of the landmark model is normalised.

    python -m lab.people.pose_head WHEEL assets/pose/landmarks.head

mediapipe's Tasks API asks for that, and the model in the wheel (mimic.sources.video.pose_models.pose_model) lacks it.
mediapipe's own classes write the metadata; packing the model with them would lose the alignment of its weights.

Source: TFLite's schema.fbs (Model, Buffer, Metadata); the numbers of fields are their places in this file.
"""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

from mimic.sources.video.pose_models.pose_model import ALIGNMENT, LANDMARKS, MODELS

if TYPE_CHECKING:
    from flatbuffers import Builder

MEAN = 0.0
"""Offset of the pictures of the landmark model.

Source: mediapipe 0.10.14, modules/pose_landmark/pose_landmark_by_roi_cpu.pbtxt, output_tensor_float_range.
"""
STD = 255.0
"""Their scale: pictures are 0 to 1. The detector's model says -1 to 1 itself."""

_VERSION = 0
_BUFFERS = 4
_METADATA = 6
_OTHER_OFFSETS = (1, 2, 3, 5, 7)
"""Fields of Model: besides its version, buffers and metadata it has operators, subgraphs, description, signatures."""


def with_normalisation(model: bytes, mean: float, std: float) -> bytes:
    """Return a model without such metadata with them: its input is an RGB picture, and takes (value - mean) / std.

    A new root table is put before the old content and refers to it, so that weights keep their bytes and alignment.

    Args:
        model: A TFLite model.
        mean, std: Normalisation of the picture's values, which are 0 to 255.
    """
    from flatbuffers import Builder, encode
    from flatbuffers.number_types import Uint32Flags, UOffsetTFlags
    from flatbuffers.packer import uoffset
    from flatbuffers.table import Table

    content = bytes(model) + bytes(-len(model) % ALIGNMENT)
    old = Table(content, encode.Get(uoffset, content, 0))

    def targets(field: int) -> list[int]:
        """Return where the elements of a vector of tables are, from the end of the content."""
        at = old.Offset(4 + 2 * field)
        start, count = (old.Vector(at), old.VectorLen(at)) if at else (0, 0)
        return [len(content) - old.Indirect(start + 4 * i) for i in range(count)]

    builder = Builder(len(content) + 65536)
    builder.CreateByteVector(content)  # the end of the new file
    data = builder.CreateByteVector(_metadata(mean, std))
    buffers = [*targets(_BUFFERS), _table(builder, {0: data})]
    entry = _table(builder, {0: builder.CreateString("TFLITE_METADATA")}, {1: len(buffers) - 1})
    offsets = {
        _BUFFERS: _vector(builder, buffers),
        _METADATA: _vector(builder, [*targets(_METADATA), entry]),
    }
    for field in _OTHER_OFFSETS:
        if at := old.Offset(4 + 2 * field):
            offsets[field] = len(content) - old.Indirect(old.Pos + at)
    version = old.Get(Uint32Flags, old.Pos + old.Offset(4 + 2 * _VERSION))
    root = _table(builder, offsets, {_VERSION: version})
    builder.Prep(ALIGNMENT, 2 * UOffsetTFlags.bytewidth)  # the root's offset and the identifier come before it
    builder.Finish(root, b"TFL3")
    return bytes(builder.Output())


def _metadata(mean: float, std: float) -> bytes:
    """Return a ModelMetadata file of one subgraph with one input picture."""
    from flatbuffers import Builder
    from mediapipe.tasks.metadata import metadata_schema_py_generated as schema

    picture = schema.ImagePropertiesT(colorSpace=schema.ColorSpaceType.RGB)
    content = schema.ContentT(schema.ContentProperties.ImageProperties, picture)
    normal = schema.NormalizationOptionsT([mean], [std])
    unit = schema.ProcessUnitT(schema.ProcessUnitOptions.NormalizationOptions, normal)
    tensor = schema.TensorMetadataT(name="image", content=content, processUnits=[unit])
    model = schema.ModelMetadataT(subgraphMetadata=[schema.SubGraphMetadataT(inputTensorMetadata=[tensor])])
    builder = Builder(256)
    builder.Finish(model.Pack(builder), b"M001")
    return bytes(builder.Output())


def _table(builder: Builder, offsets: dict[int, int], numbers: dict[int, int] | None = None) -> int:
    """Write a table of offsets and unsigned integers by field number, and return its place."""
    numbers = numbers or {}
    builder.StartObject(1 + max((*offsets, *numbers)))
    for field, place in offsets.items():
        builder.PrependUOffsetTRelativeSlot(field, place, 0)
    for field, value in numbers.items():
        builder.PrependUint32Slot(field, value, 0)
    return builder.EndObject()


def _vector(builder: Builder, tables: list[int]) -> int:
    builder.StartVector(4, len(tables), 4)
    for place in reversed(tables):
        builder.PrependUOffsetTRelative(place)
    return builder.EndVector()


def main() -> None:
    """Write what comes before the landmark model of a wheel."""
    wheel, out = sys.argv[1:]
    with zipfile.ZipFile(wheel) as archive:
        model = archive.read(MODELS[LANDMARKS][0])
    whole = with_normalisation(model, MEAN, STD)
    Path(out).write_bytes(whole[: whole.index(model)])


if __name__ == "__main__":
    main()

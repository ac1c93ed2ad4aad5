from pathlib import Path

import numpy as np
import pytest

from mimic.errors import SourceError
from mimic.view.film.footage import encode_av1, read_frames


def test_frames_are_shrunk_to_even_sides_and_never_enlarged(video: Path) -> None:
    assert next(iter(read_frames(video, width=50))).shape == (34, 50, 3)
    assert next(iter(read_frames(video, width=4000))).shape == (64, 96, 3)
    assert next(iter(read_frames(video, height=128))).shape == (128, 192, 3)


def test_av1_keeps_every_frame(video: Path, tmp_path: Path) -> None:
    import av

    before = list(read_frames(video))
    encode_av1(before, tmp_path / "clip.mp4")
    with av.open(str(tmp_path / "clip.mp4")) as container:
        assert container.streams.video[0].codec_context.codec.canonical_name == "av1"
        after = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    np.testing.assert_allclose([a.mean() for a in after], [b.mean() for b in before], atol=6)


def test_a_file_without_a_picture_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("not a video")
    with pytest.raises(SourceError, match="no picture"):
        list(read_frames(tmp_path / "text.mp4"))

from pathlib import Path

import numpy as np
import pytest

from mimic.errors import SourceError
from mimic.view.film.footage import encode_av1, frame_stamps, read_frames

SHARED = Path(__file__).parents[3] / ".." / "shared" / "data" / "videos"


def test_frames_are_shrunk_to_even_sides_and_never_enlarged(video: Path) -> None:
    assert next(iter(read_frames(video, width=50)))[1].shape == (34, 50, 3)
    assert next(iter(read_frames(video, width=4000)))[1].shape == (64, 96, 3)
    assert next(iter(read_frames(video, height=128)))[1].shape == (128, 192, 3)


def test_av1_keeps_every_frame(video: Path, tmp_path: Path) -> None:
    import av

    before = [rgb for _, rgb in read_frames(video)]
    encode_av1(before, tmp_path / "clip.mp4")
    with av.open(str(tmp_path / "clip.mp4")) as container:
        assert container.streams.video[0].codec_context.codec.canonical_name == "av1"
        after = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    np.testing.assert_allclose([a.mean() for a in after], [b.mean() for b in before], atol=6)


def test_stamps_are_those_of_the_file_where_frames_were_dropped() -> None:
    if not SHARED.is_dir():
        pytest.skip("the shared test data is not beside the repository (../shared/data)")
    gaps = np.diff(frame_stamps(SHARED / "nasty" / "vfr_dropped_frames.mp4"))
    assert gaps.min() == pytest.approx(0.033, abs=0.002)
    assert gaps.max() == pytest.approx(0.167, abs=0.005)


def test_a_file_without_a_picture_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("not a video")
    with pytest.raises(SourceError, match="no picture"):
        frame_stamps(tmp_path / "text.mp4")

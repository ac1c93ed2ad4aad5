import struct
from itertools import pairwise
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mimic.errors import SourceError
from mimic.sources.video.decoding import MAX_SIDE, open_video, true_times


def written(path: Path, *, frames: int = 12, size: tuple[int, int] = (64, 48), cut_at: int | None = None) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, size)
    for i in range(frames):
        picture = np.full(
            (size[1], size[0], 3), (0, 0, 255) if cut_at is None or i < cut_at else (255, 255, 255), np.uint8
        )
        writer.write(picture)
    writer.release()
    return path


def test_every_frame_comes_once_at_its_time(tmp_path):
    with open_video(written(tmp_path / "a.mp4", frames=12)) as video:
        stamps = [frame.stamp_ms for frame in video]
    assert stamps == pytest.approx([40.0 * i for i in range(12)])


def of_h264(path: Path, *, sizes: tuple[tuple[int, int], ...] = ((128, 96),), frames: int = 40) -> Path:
    """A clip with a stream of H.264 of each size, in which a bright square moves."""
    with av.open(str(path), "w") as container:
        streams = [container.add_stream("libx264", rate=25, options={"g": "10", "bf": "0"}) for _ in sizes]
        for stream, size in zip(streams, sizes, strict=True):
            stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        for i in range(frames):
            for stream, (width, height) in zip(streams, sizes, strict=True):
                picture = np.zeros((height, width, 3), np.uint8)
                picture[20:60, i : i + 30] = 200
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        for stream in streams:
            container.mux(stream.encode())
    return path


@pytest.mark.parametrize("ending", ["mp4", "mkv"])
@pytest.mark.parametrize("damaged", [range(12, 15), range(22, 23)], ids=["three frames", "one frame"])
def test_frames_behind_damage_are_used_at_their_times(ending, damaged, tmp_path):
    path = of_h264(tmp_path / f"a.{ending}")
    data = bytearray(path.read_bytes())
    with av.open(str(path)) as container:
        packets = [bytes(packet) for packet in container.demux(video=0) if packet.size]
    for i in damaged:
        at = data.index(packets[i])
        data[at : at + len(packets[i])] = bytes(len(packets[i]))
    path.write_bytes(data)
    with open_video(path) as video:
        stamps = [frame.stamp_ms for frame in video]
    assert stamps == pytest.approx([40.0 * i for i in range(40) if i not in damaged], abs=1.0)
    assert video.damaged == pytest.approx([0.04 * i for i in damaged], abs=0.001)


def test_of_several_picture_streams_the_largest_is_read(tmp_path):
    with open_video(of_h264(tmp_path / "a.mp4", sizes=((64, 48), (160, 120), (96, 72)))) as video:
        assert video.size == (160, 120)
        assert len(list(video)) == 40


@pytest.mark.parametrize(("turn", "size"), [(90, (96, 128)), (180, (128, 96))])
def test_a_picture_that_its_file_turns_is_upright(turn, size, tmp_path):
    path = of_h264(tmp_path / "a.mp4")
    data = bytearray(path.read_bytes())
    matrix = data.index(b"tkhd") + 4 + 40
    turned = {90: (0, 65536, 0, -65536, 0), 180: (-65536, 0, 0, 0, -65536)}[turn]
    struct.pack_into(">5i", data, matrix, *turned)
    path.write_bytes(data)
    with open_video(path) as video:
        first = next(iter(video)).rgb.mean(axis=-1)
        assert video.size == size
    y, x = np.argwhere(first > 128).mean(axis=0) / first.shape
    assert (y > 0.5, x > 0.5) == ((turn == 180), True)


@pytest.mark.parametrize("ending", ["mp4", "avi", "mkv"])
def test_a_file_that_is_cut_off_says_when_it_would_end(ending, tmp_path):
    path = of_h264(tmp_path / f"a.{ending}")
    whole = path.read_bytes()
    if ending == "mp4":  # its index comes first
        with (
            av.open(str(path)) as given,
            av.open(str(tmp_path / "b.mp4"), "w", options={"movflags": "faststart"}) as to,
        ):
            stream = to.add_stream_from_template(given.streams.video[0])
            for packet in given.demux(video=0):
                if packet.dts is not None:
                    packet.stream = stream
                    to.mux(packet)
        whole = (tmp_path / "b.mp4").read_bytes()
    for data, cut in ((whole, False), (whole[: 3 * len(whole) // 4], True)):
        path.write_bytes(data)
        with open_video(path) as video:
            last = [frame.stamp_ms for frame in video][-1]
        assert (video.end_ms - last > 60.0) == cut


def test_pictures_are_rgb(tmp_path):
    with open_video(written(tmp_path / "red.mp4")) as video:
        red, green, blue = next(iter(video)).rgb.reshape(-1, 3).mean(axis=0)
    assert red > 240
    assert max(green, blue) < 15


def test_a_large_picture_is_handed_on_smaller_and_its_size_is_kept(tmp_path):
    with open_video(written(tmp_path / "large.mp4", frames=2, size=(1920, 1080))) as video:
        shapes = {frame.rgb.shape for frame in video}
        assert video.size == (1920, 1080)
    assert shapes == {(720, MAX_SIDE, 3)}


def test_a_replaced_picture_shows_in_the_change_of_that_frame_only(tmp_path):
    with open_video(written(tmp_path / "cut.mp4", cut_at=7)) as video:
        change = [frame.change for frame in video]
    assert np.argmax(change) == 7
    assert change[7] > 100
    assert max(change[:7] + change[8:]) < 2


def test_a_reader_who_stops_early_does_not_hang(tmp_path):
    with open_video(written(tmp_path / "long.mp4", frames=200)) as video:
        assert next(iter(video)).stamp_ms == 0.0


@pytest.mark.parametrize("content", [b"", b"this is no video", bytes(range(256)) * 64])
def test_what_is_no_video_is_refused_with_its_name(tmp_path, content):
    path = tmp_path / "holiday.mp4"
    path.write_bytes(content)
    with pytest.raises(SourceError, match=r"holiday\.mp4"), open_video(path):
        pass


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(SourceError, match=r"no file .*nowhere\.mp4"), open_video(tmp_path / "nowhere.mp4"):
        pass


@given(st.lists(st.floats(0.01, 1e4), min_size=1, max_size=50))
def test_increasing_stamps_are_kept_and_start_at_zero(steps):
    stamps = 7.0 + np.cumsum(steps)
    t, repaired = true_times(stamps)
    assert repaired == 0
    assert t[0] == 0.0
    np.testing.assert_allclose(np.diff(t) * 1e3, np.diff(stamps), rtol=1e-9, atol=1e-9)


@given(st.lists(st.integers(0, 30), min_size=2, max_size=60).filter(lambda s: any(b > a for a, b in pairwise(s))))
def test_times_increase_whatever_the_stamps_do(stamps):
    t, repaired = true_times(np.array(stamps, dtype=float))
    assert len(t) == len(stamps)
    assert (np.diff(t) > 0).all()
    assert (repaired == 0) == all(b > a for a, b in pairwise(stamps))


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        ([0, 40, 40, 120], [0, 0.04, 0.08, 0.12]),
        ([0, 40, 9000, 120, 160], [0, 0.04, 0.08, 0.12, 0.16]),
        ([0, 40, 80, 0, 0], [0, 0.04, 0.08, 0.12, 0.16]),
    ],
    ids=["repeated", "wild", "lost at the end"],
)
def test_a_bad_stamp_is_replaced_by_an_even_one(stamps, expected):
    t, repaired = true_times(np.array(stamps, dtype=float))
    np.testing.assert_allclose(t, expected)
    assert repaired > 0

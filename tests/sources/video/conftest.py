"""The clips that nobody on this project made, and their tracks; each is tracked once a session."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from mimic.records import PoseTrack
from mimic.sources.video.video import track_video

VIDEOS = Path(__file__).parents[3] / ".." / "shared" / "data" / "videos"


@pytest.fixture(scope="session")
def clip() -> Callable[[str], Path]:
    """Return the path of a clip, or skip where the shared data is absent."""

    def find(name: str) -> Path:
        if not VIDEOS.is_dir():
            pytest.skip("the shared test data is not beside the repository (../shared/data)")
        return VIDEOS / name

    return find


@pytest.fixture(scope="session")
def tracked(clip: Callable[[str], Path]) -> Callable[[str], PoseTrack]:
    """Return the track of a clip."""

    @cache
    def track(name: str) -> PoseTrack:
        return track_video(clip(name))

    return track

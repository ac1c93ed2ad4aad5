"""A film of a robot that is led by the hand, with the pull as an arrow."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from mimic.io.store import written_whole
from mimic.records import FloatArray, RunLog
from mimic.robot.description import RobotDescription
from mimic.view.film import footage
from mimic.view.film.side_by_side import RobotFilm, write_texts

FPS = 30

SIZE = 480
"""Height and width of the film [px]."""


def save_leading_film(
    path: Path, *, log: RunLog, description: RobotDescription, at: FloatArray, force: FloatArray
) -> None:
    """Write an H.264 film (.mp4) of a robot that is pulled; the file is complete or not written at all.

    Args:
        path: File to write.
        log: Log of the robot, T ticks.
        description: The robot.
        at: Where it is pulled at each tick (T, 3), world axes [m].
        force: Pull at each tick (T, 3) [N].

    Raises:
        NoOffscreenGL: If off-screen rendering is not available.
    """
    times = np.arange(log.t[0], log.t[-1], 1.0 / FPS)
    pulled = np.flatnonzero(np.any(force != 0.0, axis=1))
    begin = int(pulled[0]) if len(pulled) else 0
    way = np.linalg.norm(log.p_WB[:, :2] - log.p_WB[begin, :2], axis=1) * (np.arange(len(log.t)) > begin)

    def frames() -> Iterator[np.ndarray]:
        with RobotFilm(log, description, width=SIZE, height=SIZE) as film:
            for tick in np.clip(np.searchsorted(log.t, times), 0, len(log.t) - 1):
                picture = film.picture(int(tick), (at[tick], force[tick]))
                texts = [f"{log.t[tick]:.1f} s", f"pull {np.linalg.norm(force[tick]):.1f} N", f"way {way[tick]:.1f} m"]
                write_texts(picture, [(text, (240, 243, 246)) for text in texts])
                yield picture

    with written_whole(path) as part:
        footage.encode_h264(frames(), part, fps=Fraction(FPS))

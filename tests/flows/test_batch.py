"""One file of a batch, without the processes around it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mimic.config.play import EffectsSettings, RunSettings
from mimic.flows.batch import Job, finished, key_of, play_job, settings_key
from mimic.flows.motions.motion import InputSettings

STANDING = {
    "left_shoulder": (0.0, 0.2, 1.4),
    "right_shoulder": (0.0, -0.2, 1.4),
    "left_wrist": (0.3, 0.2, 1.2),
    "right_wrist": (0.3, -0.2, 1.2),
    "left_hip": (0.0, 0.1, 0.9),
    "right_hip": (0.0, -0.1, 0.9),
}
QUICK = RunSettings(hold_last=0.0, stand_up=1.0, blend=0.1)


@pytest.fixture
def job(tmp_path: Path) -> Job:
    points = np.stack([np.zeros((20, 3)) + place for place in STANDING.values()], axis=1)
    source = tmp_path / "someone.npz"
    np.savez(source, points=points, names=list(STANDING), fps=50)
    settings = InputSettings()
    return Job(
        source=source,
        name=source.name,
        key=key_of(source, tmp_path, settings_key(settings, QUICK, EffectsSettings())),
        items=tmp_path / "items",
        settings=settings,
        run=QUICK,
        robot=EffectsSettings(),
        command="mimic batch",
    )


def test_a_file_becomes_a_row_and_a_folder_and_is_finished_then(job):
    assert finished(job) is None
    row = play_job(job)
    assert row["status"] == "done"
    (folder,) = job.items.iterdir()
    assert json.loads((folder / "metrics.json").read_text())["row"]["file"] == "someone.npz"
    assert finished(job) == row


def test_a_file_that_cannot_be_read_is_a_row_and_leaves_nothing(job, tmp_path):
    bad = tmp_path / "bad.trc"
    bad.write_text("nothing")
    row = play_job(replace(job, source=bad, name="bad.trc"))
    assert row["status"] == "failed"
    assert "bad.trc" in row["error"]
    assert not job.items.exists()


def test_another_setting_is_another_key(job):
    other = settings_key(InputSettings(), replace(QUICK, hold_last=1.0), EffectsSettings())
    assert key_of(job.source, job.source.parent, other) != job.key

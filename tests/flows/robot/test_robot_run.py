"""Playing on a robot, in one process with an emulated one: what Ctrl-C does before it moves and while it is saved."""

from __future__ import annotations

import os
import shutil
import signal
from dataclasses import replace

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from lab.in_process.sender_link import EmulatedSenderLink
from mimic.config.emulator import EmulateSettings
from mimic.config.hardware import BusSettings
from mimic.config.play import RunSettings
from mimic.emulator.robot import EmulatedRobot
from mimic.flows.reporter import SilentReporter
from mimic.flows.robot import robot_run as flow
from mimic.flows.robot.operator import Operator
from mimic.hardware import session
from mimic.hardware.can import open_driver
from mimic.hardware.can.wiring import load_wiring
from mimic.io import store
from mimic.policy.runtime import load_policy
from mimic.records import TargetTrack
from mimic.robot.description import load_description

BUS = BusSettings(zeroed=True, yes=True, ramp=0.5)

SHORT = RunSettings(stand_up=1.0, blend=0.2, hold_last=0.1, sit_down=1.5)


@pytest.fixture
def targets(monkeypatch, tmp_path):
    """Serve an emulated robot in this process, and return targets to play."""
    emulated = EmulatedRobot(load_description("cyberdog2"), load_wiring(), EmulateSettings(zeroed=True, placement=0.03))

    def opened(*_: object, **__: object) -> EmulatedLink:
        link = EmulatedLink(emulated)
        link.sleep(0.3)
        return link

    def process(settings, description, *, keep=()):
        return EmulatedSenderLink(open_driver.open_can_driver(settings), description)

    monkeypatch.setattr(open_driver, "open_buses", opened)
    monkeypatch.setattr(session, "SenderProcess", process)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    contract = load_policy(None, load_description("cyberdog2")).contract
    toes = np.tile(np.array(contract.neutral_toes).reshape(1, 2, 3), (20, 1, 1))
    no = np.zeros((20, 2), dtype=bool)
    track = {"valid": ~no, "moved": np.zeros((20, 2)), "limited": no, "wanted": toes, "heading": np.zeros(20)}
    store.save(
        TargetTrack(t=0.02 * np.arange(20), p_BE=toes, **track), tmp_path / "t.parquet", made_by=store.provenance()
    )
    return tmp_path / "t.parquet"


@pytest.mark.slow
def test_ctrl_c_while_the_run_is_saved_does_not_cost_the_run(targets, tmp_path, monkeypatch):
    save = flow.save_run

    def disturbed(*arguments, **options):
        os.kill(os.getpid(), signal.SIGINT)
        return save(*arguments, **options)

    monkeypatch.setattr(flow, "save_run", disturbed)
    done = flow.play_on_robot("can0", targets, run=SHORT, bus=BUS, out=tmp_path / "run")
    assert done.ending == "the robot was damped and all motors are off"
    assert (tmp_path / "run" / "log.parquet").is_file()
    assert not (tmp_path / "run" / "log.rows").exists()


@pytest.mark.slow
@pytest.mark.parametrize("tether", [False, True])
def test_on_a_rope_the_position_is_not_held(targets, tmp_path, tether):
    flow.play_on_robot("can0", targets, run=SHORT, bus=replace(BUS, tether=tether), out=tmp_path / "run")
    settings = store.header(tmp_path / "run" / "log.parquet")["provenance"]["settings"]["run"]
    assert settings["hold_position"] is not tether


@pytest.mark.slow
def test_insisting_while_the_run_is_saved_says_how_the_robot_was_left_and_how_to_get_the_run(
    targets, tmp_path, monkeypatch
):
    def insisted(*_, **__):
        for _ in range(5):
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(flow, "save_run", insisted)
    with pytest.raises(KeyboardInterrupt, match="all motors are off; to save the run: mimic log salvage"):
        flow.play_on_robot("can0", targets, run=SHORT, bus=BUS, out=tmp_path / "run")
    path, rows = flow.salvage(tmp_path / "run")
    assert (path.name, rows > 100) == ("log.parquet", True)


def test_ctrl_c_at_the_question_says_that_nothing_was_moved(targets, tmp_path):
    def interrupted(_: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="nothing was moved"):
        flow.play_on_robot(
            "can0", targets, run=SHORT, bus=BUS, out=tmp_path / "run", operator=Operator(confirm=interrupted)
        )
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_run_folder_that_is_removed_meanwhile_is_written_again_and_that_is_said(targets, tmp_path, monkeypatch):
    folder, reporter = tmp_path / "run", SilentReporter()
    played = flow.play

    def removed(*arguments, **more):
        shutil.rmtree(folder)
        return played(*arguments, **more)

    monkeypatch.setattr(flow, "play", removed)
    flow.play_on_robot("can0", targets, run=SHORT, bus=BUS, out=folder, reporter=reporter)
    assert any("was removed while the robot ran" in text for text in reporter.warnings)
    assert "finished" in (folder / "events.jsonl").read_text()
    assert (folder / "log.parquet").is_file()

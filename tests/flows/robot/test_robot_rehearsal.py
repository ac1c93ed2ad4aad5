"""Rehearsals across processes: an emulated robot, the command that drives it, and what is left of both.

Real processes and a real clock: nothing here looks at how long anything took, and limits are there for hangs only.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mimic.errors import FrameError
from mimic.hardware.can.opening import open_link
from mimic.hardware.motors.cybergear.codec import Codec, HostMessage
from mimic.hardware.motors.interface import Feedback, MotorMode
from mimic.io import store
from mimic.records import PHASES, HealthLog, RunLog

PATIENCE = 120.0

pytestmark = pytest.mark.slow


@pytest.fixture
def emulator(tmp_path) -> Iterator[Callable[..., str]]:
    """Return a function that starts an emulated robot and returns the word for its bus."""
    started: list[subprocess.Popen] = []

    def start(*options: str) -> str:
        command = [sys.executable, "-m", "mimic", "emulate", "--listen", "127.0.0.1:0", "--zeroed", *options]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=here(tmp_path))
        started.append(process)
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("ready"):
                return line.split()[1]
        raise AssertionError("the emulator did not start")

    yield start
    for process in started:
        process.terminate()
        process.communicate(timeout=PATIENCE)


def here(folder: Path) -> dict[str, str]:
    hidden = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return {**hidden, "XDG_STATE_HOME": str(folder / "state"), "XDG_CACHE_HOME": str(folder / "cache")}


def mimic(folder: Path, *words: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "mimic", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=here(folder))


class Listener:
    """Hears all that goes over a bus."""

    def __init__(self, bus_url: str) -> None:
        self.link, self.codec = open_link(bus_url), Codec()
        self.modes: dict[int, MotorMode] = {}
        self.gains: dict[int, tuple[float, float]] = {}

    def until(self, what: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not what():
            assert time.monotonic() < end, f"this did not happen; modes {self.modes}, gains {self.gains}"
            received = self.link.receive(0.1)
            if received is None:
                continue
            try:
                message = self.codec.decode(received.frame)
            except FrameError:
                continue
            if isinstance(message, HostMessage):
                if message.command is not None:
                    self.gains[message.motor] = message.command.kp, message.command.kd
            elif isinstance(message.said, Feedback):
                self.modes[message.said.motor] = message.said.mode

    def moving(self) -> bool:
        return len(self.gains) == 12 and all(kp > 29.0 for kp, _ in self.gains.values())

    def braking(self) -> bool:
        return len(self.gains) == 12 and all(kp == 0.0 and kd > 4.99 for kp, kd in self.gains.values())

    def off(self) -> bool:
        return len(self.modes) == 12 and set(self.modes.values()) == {MotorMode.OFF}


@pytest.fixture
def listening() -> Iterator[Callable[[str], Listener]]:
    made: list[Listener] = []

    def listen(bus_url: str) -> Listener:
        made.append(Listener(bus_url))
        return made[-1]

    yield listen
    for listener in made:
        listener.link.close()


TRIES = 4
"""A supervisor rightly stops a robot on a computer that is too busy to keep time; such a rehearsal begins anew."""


@pytest.fixture
def moving_robot(emulator, listening, tmp_path) -> Callable[[], tuple[subprocess.Popen, Listener, Path]]:
    """Return a function that starts a robot moved by a policy: the process that drives it, the bus, the run folder."""

    def begin() -> tuple[subprocess.Popen, Listener, Path]:
        for number in range(TRIES):
            bus_url, run = emulator(), tmp_path / f"run{number}"
            listener = listening(bus_url)
            process = mimic(tmp_path, "--robot", bus_url, "--zeroed", "--yes", "-o", str(run))
            listener.until(lambda on=listener, it=process: on.moving() or it.poll() is not None)
            if process.poll() is None:
                return process, listener, run
            told, _ = process.communicate()
            assert process.returncode == 3, told
        pytest.skip("this computer is too busy to keep the robot's time")

    return begin


def test_ctrl_c_sits_down_and_leaves_a_whole_log(moving_robot):
    run, listener, folder = moving_robot()
    run.send_signal(signal.SIGINT)
    listener.until(listener.braking)
    listener.until(listener.off)
    told, _ = run.communicate(timeout=PATIENCE)
    assert "Traceback" not in told
    assert "all motors are off" in told.splitlines()[-1] or "all motors are off" in told.splitlines()[-2]
    assert sorted(path.name for path in folder.iterdir()) == [
        "events.jsonl",
        "health.parquet",
        "log.parquet",
        "metrics.json",
        "scene.rrd",
    ]
    log = store.load(folder / "log.parquet", RunLog)
    health = store.load(folder / "health.parquet", HealthLog)
    assert np.array_equal(log.t, health.t)
    assert PHASES[log.phase[-1]] == "damp"


def test_a_request_to_end_damps(moving_robot):
    run, listener, _ = moving_robot()
    run.terminate()
    listener.until(listener.braking)
    listener.until(listener.off)
    told, _ = run.communicate(timeout=PATIENCE)
    assert run.returncode == 3
    assert "SIGTERM" in told
    assert "Traceback" not in told


def test_a_robot_without_zeros_is_not_moved_and_scan_zero_and_check_agree_on_it(emulator, tmp_path):
    bus_url = emulator()
    run = mimic(tmp_path, "--robot", bus_url, "--yes", "-o", str(tmp_path / "run"))
    told, _ = run.communicate(timeout=PATIENCE)
    assert run.returncode == 2
    assert "nothing was moved" in told
    assert "mimic robot zero" in told
    assert not (tmp_path / "run").exists()
    for verb, *options in (("scan",), ("zero", "--yes"), ("check",)):
        run = mimic(tmp_path, "robot", verb, bus_url, *options)
        told, _ = run.communicate(timeout=PATIENCE)
        assert run.returncode == 0, told
    assert "set since the power" in told


def test_nobody_at_the_other_end_is_reported_in_a_sentence(tmp_path):
    run = mimic(tmp_path, "--robot", "socketcand://127.0.0.1:9/can0", "--zeroed", "--yes", "-o", str(tmp_path / "run"))
    told, _ = run.communicate(timeout=PATIENCE)
    assert run.returncode == 2
    assert "nobody listens" in told
    assert "Traceback" not in told

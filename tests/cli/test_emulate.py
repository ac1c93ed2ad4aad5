"""``mimic emulate`` as a process of its own, and what it refuses."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mimic.cli import main
from mimic.hardware.can.opening import open_link
from mimic.hardware.motors.cybergear.codec import Codec, HostMessage, Kind, MotorMessage
from mimic.hardware.motors.interface import Feedback

PATIENCE = 60.0
"""Limit on hanging only [s]."""


class Emulator:
    """A process, and the lines that it has printed."""

    def __init__(self, *arguments: str) -> None:
        command = [sys.executable, "-m", "mimic", "emulate", "--listen", "127.0.0.1:0", "--zeroed", *arguments]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ | {"COLUMNS": "200"}
        )
        self._lines: queue.Queue[str] = queue.Queue()
        self.said = ""
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)

    def until(self, wanted: str) -> str:
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            line = self._lines.get(timeout=PATIENCE)
            self.said += line
            if wanted in line:
                return line
        raise AssertionError(self.said)


@pytest.fixture
def emulator() -> Iterator[Callable[..., Emulator]]:
    made: list[Emulator] = []

    def start(*arguments: str) -> Emulator:
        made.append(Emulator(*arguments))
        return made[-1]

    yield start
    for one in made:
        one.process.kill()
        one.process.wait(PATIENCE)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "transport"), [(signal.SIGTERM, "socketcand"), (signal.SIGINT, "slcan")])
def test_it_serves_motors_to_another_process_until_it_is_asked_to_stop(number, transport, emulator):
    served = emulator("--slcan", "--every", "0.2", "--fault", "motor_hot:FL_knee=90@+0")
    address = served.until(transport).split()[-1]
    link, codec = open_link(address), Codec()
    link.send(0, codec.encode(HostMessage(Kind.ENABLE, 1)))
    end, answer = time.monotonic() + PATIENCE, None
    while answer is None and time.monotonic() < end:
        received = link.receive(0.1)
        if received is not None and received.frame.extended:
            message = codec.decode(received.frame)
            answer = message.said if isinstance(message, MotorMessage) and isinstance(message.said, Feedback) else None
    assert answer is not None
    assert answer.motor == 1
    served.until("first motor switched on")
    served.until("motor_hot:FL_knee=90")
    served.until("frames/s; 1 client")
    link.close()
    served.process.send_signal(number)
    assert "none driven; on: " in served.until("motors at the end")
    assert served.process.wait(PATIENCE) == 0
    assert "Traceback" not in served.said


def test_it_ends_after_its_time_with_a_summary(capsys):
    assert main(["emulate", "--listen", "127.0.0.1:0", "--buses", "2", "--seconds", "0.1"]) == 0
    said = capsys.readouterr().out
    assert said.count("ready ") == 2
    assert "bits each on average" in said
    assert "bus load" in said
    assert "none driven" in said


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--listen", "29536"], "expected HOST:PORT"),
        (["--listen", "127.0.0.1:a"], "expected HOST:PORT"),
        (["--fault", "motor_sad"], "there is no fault 'motor_sad'"),
        (["--fault", "bus_off:bus3"], "is on bus 3"),
        (["--buses", "3"], "no line for 3 buses"),
        (["--wiring", "nowhere.toml"], "there is no wiring file nowhere.toml"),
        (["--effects", "nowhere.toml"], "nowhere.toml"),
        (["--placement", "2"], "placement is 2"),
        (["--timestep", "0.003"], "timestep is 0.003"),
        (["--every", "-1"], "every is -1 s; it must be from 0"),
        (["--board", "go2", "--slcan", "--buses", "2"], "--board go2 has no --slcan, --buses; it takes --wiring, "),
        (["--board", "go2", "--zeroed"], "has no --zeroed; it takes --wiring, --fault, --seconds, --every, "),
        (["--board", "cyberdog2", "--can-timeout"], "has no --can-timeout; it takes "),
    ],
)
def test_what_it_cannot_do_it_says(arguments, says, capsys):
    assert main(["emulate", "--seconds", "0", *arguments]) == 2
    assert says in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("seconds", ["-1", "nan"])
def test_it_ends_after_no_negative_time(seconds, capsys):
    assert main(["emulate", "--listen", "127.0.0.1:0", "--seconds", seconds]) == 2
    assert f"seconds is {seconds} s; it must be from 0" in capsys.readouterr().err


def test_a_stand_is_left_out_on_the_floor_and_said_so(tmp_path: Path, capsys):
    effects = tmp_path / "effects.toml"
    effects.write_text('[[effect]]\nname = "base_tilt"\nrole = "fixed"\nroll = [0.0]\npitch = [0.1]\nsource = "test"\n')
    arguments = ["emulate", "--listen", "127.0.0.1:0", "--seconds", "0", "--effects", str(effects)]
    assert main(arguments) == 0
    assert "base_tilt" in capsys.readouterr().out
    assert main([*arguments, "--suspended"]) == 0
    assert "base_tilt" not in capsys.readouterr().out

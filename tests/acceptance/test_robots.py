"""Emulated robots behind their real protocols, in real time: they stand, box and sit, and end with no motor driven."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np
import pytest

from mimic.control.recorder import ROWS, salvage
from mimic.metrics import stand_up_time

pytestmark = pytest.mark.acceptance

NOT_DRIVEN = "none driven"

DAMPED_WITHIN = 9.0
"""A robot whose host has ended is damped, and its motors are off after this [s]: it is damped for 8 s at most."""


def box_on_can(shell, transport: str, source: Path, served: tuple[str, ...] = (), *options: str) -> None:
    def attempt(folder):
        emulator, addresses = shell.emulate("--listen", "127.0.0.1:0", "--zeroed", *served)
        address = next(one for one in addresses if one.startswith(transport))
        done = shell.mimic(source, "--robot", address, "--zeroed", "--yes", "--out", folder, *options)
        figures = shell.check_run(done, folder, toes_cm=2.5)
        assert "done" in done.last
        assert "all motors are off" in done.last
        assert shell.ask(emulator).row("motors at the end") == NOT_DRIVEN
        return done, f"{figures}, {shell.lateness(folder)}"

    shell.in_real_time(f"boxing on CAN by {transport}", attempt)


def test_the_boxing_clip_on_can_by_socketcand(shell):
    box_on_can(shell, "socketcand", shell.videos / "boxing.mp4")


def test_the_boxing_clip_on_can_by_a_serial_adapter(shell, boxing_targets):
    box_on_can(shell, "slcan", boxing_targets, ("--slcan",))


def test_the_boxing_clip_on_a_stock_robot(shell, boxing_targets):
    def attempt(folder):
        emulator, _ = shell.emulate("--board", "cyberdog2")
        done = shell.mimic(boxing_targets, "--robot", "cyberdog2", "--interface", "lo", "--yes", "--out", folder)
        figures = shell.check_run(done, folder, toes_cm=2.5)
        assert shell.ask(emulator).row("motors at the end") == NOT_DRIVEN
        return done, f"{figures}, {shell.lateness(folder)}"

    shell.in_real_time("boxing on the stock board", attempt)


def test_the_boxing_clip_on_a_go2(shell):
    pytest.importorskip("cyclonedds")

    def attempt(folder):
        emulator, _ = shell.emulate("--board", "go2")
        source = shell.videos / "boxing.mp4"
        done = shell.mimic(source, "--robot", "go2", "--interface", "lo", "--yes", "--out", folder)
        figures = shell.check_run(done, folder, robot="go2")
        ended = shell.ask(emulator)
        assert ended.row("motors at the end") == NOT_DRIVEN
        assert ended.row("silences").startswith("0 times")
        assert " 0 with a wrong checksum" in ended.row("messages")
        return done, f"{figures}, {shell.lateness(folder)}"

    shell.in_real_time("boxing on the Go2", attempt)


def test_check_and_damp(shell):
    def attempt(folder):
        emulator, (address,) = shell.emulate("--listen", "127.0.0.1:0", "--zeroed")
        checked = shell.mimic("robot", "check", address, "--zeroed")
        assert checked.status == 0, checked.said
        assert "nothing stands against moving it" in checked.last
        damped = shell.mimic("robot", "damp", address)
        assert damped.status == 0, damped.said
        assert "all motors are off" in damped.last
        assert shell.ask(emulator).row("motors at the end") == NOT_DRIVEN
        return None, damped.last

    shell.in_real_time("check and damp", attempt)


def test_a_host_that_is_killed_while_the_robot_stands(shell, description):
    def attempt(folder: Path):
        emulator, (address,) = shell.emulate("--listen", "127.0.0.1:0", "--zeroed")
        host = shell.start("--robot", address, "--zeroed", "--yes", "--out", folder)

        def stands() -> bool:
            assert host.poll() is None, shell.finish(host).said
            if not (folder / ROWS).is_file():
                return False
            log, _ = salvage(folder)
            return len(log.t) > 0 and log.t[-1] > 4.0 and np.isfinite(stand_up_time(log, description))

        shell.until(stands)
        host.send_signal(signal.SIGKILL)
        killed = time.monotonic()
        host.wait()
        saved = shell.mimic("log", "salvage", folder)
        assert saved.status == 0, saved.said
        time.sleep(max(killed + DAMPED_WITHIN - time.monotonic(), 0.0))
        ended = shell.ask(emulator)
        assert ended.row("motors at the end") == NOT_DRIVEN
        return ended, saved.last

    shell.in_real_time("host killed while standing", attempt)

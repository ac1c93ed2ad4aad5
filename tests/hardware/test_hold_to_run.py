"""Hold to run: keys of a terminal and buttons of a gamepad, and what is refused."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator

import pytest

from mimic.errors import ConfigError
from mimic.hardware.hold_to_run import FIRST_REPEAT, REPEAT, HeldButton, HeldKey, await_hold, hold_to_run


class Clock:
    t = 100.0

    def __call__(self) -> float:
        return self.t


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """Return the two ends of a terminal: the keyboard and what a program reads."""
    import tty

    keyboard, program = os.openpty()
    tty.setcbreak(program)
    yield keyboard, program
    os.close(keyboard)
    os.close(program)


def test_a_key_counts_as_held_while_it_repeats(terminal):
    (keyboard, program), clock = terminal, Clock()
    key = HeldKey(program, clock)
    assert not key.held()
    os.write(keyboard, b" ")
    assert key.held()
    clock.t += FIRST_REPEAT - 0.05  # terminals wait before they repeat
    assert key.held()
    for _ in range(20):
        os.write(keyboard, b" ")
        clock.t += 0.03
        assert key.held()
    clock.t += REPEAT + 0.01
    assert not key.held()


def test_a_key_that_is_pressed_once_is_let_go(terminal):
    (keyboard, program), clock = terminal, Clock()
    key = HeldKey(program, clock)
    os.write(keyboard, b"x")
    assert key.held()
    clock.t += FIRST_REPEAT + 0.01
    assert not key.held()


def event(value: int, kind: int, number: int) -> bytes:
    return struct.pack("<IhBB", 0, value, kind, number)


@pytest.fixture
def gamepad(tmp_path) -> Iterator[tuple[int, str]]:
    path = tmp_path / "js0"
    os.mkfifo(path)
    writer = os.open(path, os.O_RDWR)
    yield writer, str(path)
    os.close(writer)


def test_a_button_counts_as_held_until_it_is_let_go(gamepad):
    writer, path = gamepad
    with hold_to_run(path) as pad:
        assert isinstance(pad, HeldButton)
        assert not pad.held()
        os.write(
            writer, event(0, 0x81, 0) + event(0, 0x82, 1) + event(32767, 0x02, 1)
        )  # its state at the start; a stick
        assert not pad.held()
        os.write(writer, event(1, 0x01, 3))
        assert pad.held()
        assert pad.held()
        os.write(writer, event(1, 0x01, 4) + event(0, 0x01, 3))
        assert pad.held()
        os.write(writer, event(0, 0x01, 4))
        assert not pad.held()


def test_a_gamepad_that_is_gone_counts_as_let_go():
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    pad = HeldButton(reader)
    os.write(writer, event(1, 0x01, 0))
    assert pad.held()
    os.close(writer)
    assert not pad.held()
    assert not pad.held()
    os.close(reader)


def test_waiting_ends_when_it_is_held_or_after_a_while():
    class After:
        calls = 0

        def held(self) -> bool:
            self.calls += 1
            return self.calls > 5

    assert await_hold(After(), 1.0, pause=lambda seconds: None)
    assert not await_hold(After(), 0.2, pause=lambda seconds: None)


@pytest.mark.parametrize("what", ["key", "/dev/input/nothing", "space"])
def test_what_cannot_be_held_is_refused_in_one_line(what, monkeypatch):
    monkeypatch.setattr("sys.stdin", open(os.devnull))  # noqa: SIM115
    with pytest.raises(ConfigError, match="--hold"), hold_to_run(what):
        pass

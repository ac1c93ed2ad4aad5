"""The emulated Go2: checksum, services, silence, temperatures."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.config.emulator import EmulateSettings
from mimic.emulator.boards.go2 import TIMEOUT, EmulatedGo2
from mimic.emulator.faults import parse_fault
from mimic.errors import ConfigError
from mimic.hardware.go2.messages import LOWCMD, LOWSTATE, SPORT, SWITCHER, Call, blank, decode, encode
from mimic.hardware.go2.wiring import load_go2
from mimic.robot.description import load_description

D, WIRING = load_description("go2"), load_go2()


def robot(*faults: str, mode: str = "", **settings) -> EmulatedGo2:
    options = EmulateSettings(**{"suspended": True, "placement": 0.0, **settings})
    made = EmulatedGo2(D, WIRING, options, faults=[parse_fault(text) for text in faults])
    made.mode = mode
    return made


def stiff() -> bytes:
    message = blank(LOWCMD)
    motors = message["motor_cmd"][:12]
    motors["mode"], motors["kp"], motors["q"] = 1, 40.0, WIRING.wire_angles(D.poses["lie"])
    return encode(LOWCMD, message)


def run(made: EmulatedGo2, seconds: float, data: bytes | None = None):
    """Return what it says at the end of a time in which it hears the same command every 2 ms, or nothing."""
    said = []
    end = made.now + seconds
    while made.now < end - 1e-9:
        if data is not None:
            made.take(LOWCMD, data, made.now)
        made.advance(made.now + 0.002)
        said += made.published(made.now)
    return said


def ask(made: EmulatedGo2, service: str, api: int) -> Call:
    made.take(f"{service}request", Call(id=5, api=api).to_bytes(), made.now)
    (answer,) = [m for m in run(made, 0.004) if m.channel == f"{service}response"]
    return Call.from_bytes(answer.data, answer=True)


@pytest.mark.parametrize(("place", "value"), [(-1, 0x55), (4, 0x00), (30, 0x7F)])
def test_a_command_with_a_wrong_checksum_or_header_is_ignored_and_counted(place, value):
    made, wrong = robot(), bytearray(stiff())
    wrong[place] = value
    run(made, 0.02, bytes(wrong))
    assert (made.refused, made.driven()) == (10, ())
    run(made, 0.02, stiff())
    assert len(made.driven()) == 12


def test_a_checksum_that_was_not_set_is_wrong():
    made, unset = robot(), stiff()[:-4] + bytes(4)
    run(made, 0.02, unset)
    assert (made.refused, made.driven()) == (10, ())


@pytest.mark.parametrize("damps", [False, True])
def test_a_silence_is_counted_and_the_last_command_held_or_damped(damps):
    made = robot(can_timeout=damps)
    run(made, 0.02, stiff())
    run(made, TIMEOUT + 0.01)
    assert made.silences == 1
    assert len(made.driven()) == (0 if damps else 12)


def test_its_services_name_and_release_its_mode_and_refuse_what_they_do_not_know():
    made = robot(mode="ai")
    assert ask(made, SWITCHER, 1001).name() == "ai"
    run(made, 0.02, stiff())
    assert (made.fights, made.driven()) == (10, ())
    assert ask(made, SPORT, 1005).code == 0
    assert ask(made, SWITCHER, 1003).code == 0
    assert ask(made, SWITCHER, 1001).name() == ""
    assert ask(made, SPORT, 1016).code != 0


def test_it_says_angles_temperatures_and_which_motors_are_lost():
    made = robot("motor_hot:FR_knee=77@0", "motor_dead:FL_abad@0")
    said = run(made, 0.1, stiff())
    message = decode(LOWSTATE, said[-1].data)
    motors = message["motor_state"][:12]
    np.testing.assert_allclose(WIRING.angles(motors["q"]), made.body.joints(made.now)[0], atol=1e-5)
    assert motors["temperature"][2] == 77  # FR comes first on the wire
    assert (motors["mode"][3], motors["lost"][3]) == (0, 50)
    assert motors["mode"][[0, 4]].tolist() == [1, 1]
    assert [m.channel for m in said].count(LOWSTATE) == 50


def test_a_fault_that_it_does_not_have_is_refused_with_those_that_it_has():
    with pytest.raises(ConfigError, match="the Go2 has no fault 'motor_fault'; it has motor_dead"):
        robot("motor_fault:FL_knee@0")

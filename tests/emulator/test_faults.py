from __future__ import annotations

from pathlib import Path

import pytest

from mimic.emulator.boards import board, go2
from mimic.emulator.faults import BOARD_ONLY, CAN_KINDS, KINDS, EmulatedFault, parse_fault
from mimic.errors import ConfigError
from mimic.records import JOINTS


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (
            "motor_dead:FL_knee@12.5",
            EmulatedFault(kind="motor_dead", value=1.0, start=12.5, joint=JOINTS.index("FL_knee")),
        ),
        (
            "motor_hot:FR_hip=85@3-6",
            EmulatedFault(kind="motor_hot", value=85.0, start=3.0, until=6.0, joint=JOINTS.index("FR_hip")),
        ),
        ("frames_lost:bus1=0.2@2-4", EmulatedFault(kind="frames_lost", value=0.2, start=2.0, until=4.0, bus=1)),
        ("imu_frozen", EmulatedFault(kind="imu_frozen", value=1.0, start=0.0)),
        ("bus_off@+2-3", EmulatedFault(kind="bus_off", value=1.0, start=2.0, until=3.0, after_release=True)),
        ("frames_late=5e-3", EmulatedFault(kind="frames_late", value=0.005, start=0.0)),
    ],
)
def test_a_fault_is_what_its_word_says(text, fault):
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("motor_sad:FL_knee", "there is no fault 'motor_sad'"),
        ("motor_dead", "needs a joint"),
        ("motor_dead:FL_elbow", "needs a joint"),
        ("imu_frozen:FL_knee", "of the whole robot"),
        ("bus_off:can0", "of the whole bus"),
        ("imu_frozen@5-4", "ends before it begins"),
        ("imu_frozen@soon", "is not KIND"),
        ("imu_frozen@1.2.3", "a number that is none"),
        ("", "is not KIND"),
    ],
)
def test_a_word_that_is_none_is_refused(text, says):
    with pytest.raises(ConfigError, match=says):
        parse_fault(text)


def test_times_after_the_first_motor_count_from_there():
    fault = parse_fault("imu_silent@+1-2")
    assert not fault.active(1.5)
    later = fault.released(10.0)
    assert [later.active(t) for t in (1.5, 10.9, 11.0, 11.9, 12.0)] == [False, False, True, True, False]


def test_the_manual_names_every_kind():
    manual = (Path(__file__).parents[2] / "docs" / "manual" / "robot.md").read_text(encoding="utf-8")
    assert [kind for kind in CAN_KINDS if f"`{kind}`" not in manual] == []


@pytest.mark.parametrize(("page", "faults"), [("stock-robot", board.FAULTS), ("go2", go2.FAULTS)])
def test_the_manual_of_a_stock_robot_names_every_kind_that_it_has(page, faults):
    manual = (Path(__file__).parents[2] / "docs" / "manual" / f"{page}.md").read_text(encoding="utf-8")
    assert set(BOARD_ONLY) <= {*board.FAULTS, *go2.FAULTS} <= set(KINDS)
    assert [kind for kind in faults if f"`{kind}`" not in manual] == []

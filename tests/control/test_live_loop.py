"""Commands that come while the robot moves."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.config.play import RunSettings
from mimic.records import PHASES, Command

SHORT = RunSettings(stand_up=1.0, blend=0.1, hold_last=0.1)


class ScriptedCommands:
    """Answers a number of commands, then nothing."""

    def __init__(self, toes: np.ndarray, count: int) -> None:
        self.toes, self.left, self.asked = toes, count, 0

    def newest(self) -> Command | None:
        self.asked += 1
        if self.left == 0:
            return None
        self.left -= 1
        return Command(v=np.array([0.1, 0.0]), heading=0.3, p_BE=self.toes)


@pytest.fixture
def toes(contract) -> np.ndarray:
    return np.array(contract.neutral_toes).reshape(2, 3) + 0.05


def phases(log) -> list[tuple[str, int]]:
    names, counts = np.unique(log.phase, return_counts=True)
    return [(PHASES[name], int(count)) for name, count in zip(names, counts, strict=True)]


def test_they_are_asked_for_once_a_tick_after_standing_up_and_the_last_is_held(play, memory_plant, fixed_policy, toes):
    commands = ScriptedCommands(toes, 25)
    log = play(memory_plant(), fixed_policy(), commands, SHORT).log
    assert phases(log) == [("stand_up", 50), ("blend", 5), ("track", 20), ("hold", 5)]
    assert commands.asked == 25 + 6
    rows = log.phase == PHASES.index("track")
    np.testing.assert_allclose(log.p_BE_des[rows], np.broadcast_to(toes, (20, 2, 3)))
    assert (log.v_des[rows, 0] == 0.1).all()
    held = log.phase == PHASES.index("hold")
    np.testing.assert_allclose(log.p_BE_des[held], np.broadcast_to(toes, (5, 2, 3)))
    assert not log.v_des[held].any()
    assert log.heading_des[rows][0] == pytest.approx(0.3)


def test_a_source_that_ends_before_it_began_ends_the_run(play, memory_plant, fixed_policy, toes):
    log = play(memory_plant(), fixed_policy(), ScriptedCommands(toes, 0), SHORT).log
    assert phases(log) == [("stand_up", 50)]


def test_every_run_ends_sitting_down(play, memory_plant, fixed_policy, toes, contract):
    import dataclasses

    sitter = fixed_policy()
    sitter.contract = dataclasses.replace(contract, task="sit_down")
    log = play(memory_plant(), fixed_policy(), ScriptedCommands(toes, 10), SHORT, sit_down=sitter).log
    assert phases(log)[-1] == ("sit_down", round(SHORT.sit_down / 0.02))

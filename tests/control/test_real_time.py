from __future__ import annotations

import numpy as np
import pytest

from mimic.control.plant import damping_command
from mimic.control.real_time import PacedPlant


class World:
    """A clock that goes on when someone sleeps or works."""

    def __init__(self) -> None:
        self.t, self.slept = 5.0, []

    def clock(self) -> float:
        return self.t

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.t += seconds


@pytest.fixture
def world() -> World:
    return World()


def paced(plant, world: World, work: float) -> PacedPlant:
    """The plant, whose steps take so long."""
    plant.fail = lambda tick: setattr(world, "t", world.t + work)
    return PacedPlant(plant, clock=world.clock, sleep=world.sleep)


STILL = damping_command(np.zeros(12), 1.0)


def test_quick_steps_wait_for_the_clock(memory_plant, world):
    plant = paced(memory_plant(), world, 0.004)
    state = plant.start()
    for _ in range(50):
        state = plant.step(STILL).state
    assert world.t - 5.0 == pytest.approx(50 * 0.02)
    assert state.t == pytest.approx(1.0)
    assert plant.overruns == 0


def test_a_slow_step_is_made_up_for_by_the_next_ones(memory_plant, world):
    inner = memory_plant()
    plant = paced(inner, world, 0.004)
    plant.start()
    for tick in range(20):
        inner.fail = lambda _, tick=tick: setattr(world, "t", world.t + (0.07 if tick == 3 else 0.004))
        plant.step(STILL)
    assert world.t - 5.0 == pytest.approx(20 * 0.02)
    assert plant.overruns > 0


def test_who_is_far_behind_counts_anew(memory_plant, world):
    plant = paced(memory_plant(), world, 0.5)
    plant.start()
    plant.step(STILL)
    before = world.t
    plant._plant.fail = lambda tick: None
    plant.step(STILL)
    assert world.t - before == pytest.approx(0.02)


def test_it_is_closed_like_the_plant(memory_plant, world):
    inner = memory_plant()
    PacedPlant(inner, clock=world.clock, sleep=world.sleep).close()
    assert inner.closed == 1

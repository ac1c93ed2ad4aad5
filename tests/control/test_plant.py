"""What every plant does, whatever is behind it."""

from __future__ import annotations

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from lab.in_process.sender_link import robot_on_can
from mimic.config.emulator import EmulateSettings
from mimic.control.plant import Plant
from mimic.emulator.robot import EmulatedRobot
from mimic.geometry import up_cosine
from mimic.hardware.can.wiring import load_wiring
from mimic.records import JointCommand
from mimic.simulation.plant import SimulatedPlant

RESOLUTION = {"memory": 0.0, "simulation": 0.0, "CAN robot on an EmulatedLink": 8e-3}
"""How much a command may be rounded on its way; a stiffness is a word of 16 bits from 0 to 500 N m/rad."""


@pytest.fixture(params=list(RESOLUTION))
def kind(request) -> str:
    return request.param


@pytest.fixture
def plant(kind, request, description) -> Plant:
    match kind:
        case "memory":
            return request.getfixturevalue("memory_plant")()
        case "simulation":
            return SimulatedPlant(description)
        case _:
            wiring = load_wiring()
            robot = EmulatedRobot(description, wiring, EmulateSettings(zeroed=True, placement=0.02))
            link = EmulatedLink(robot)
            link.sleep(0.1)  # motors announce themselves at power-up
            return robot_on_can(link, wiring, description)


def hold(description, q: np.ndarray) -> JointCommand:
    zeros = np.zeros(12)
    gains = description.kp, description.kd
    return JointCommand(q_des=q, dq_des=zeros, kp=gains[0], kd=gains[1], tau_ff=zeros)


def test_it_starts_lying(plant, description):
    state = plant.start()
    assert abs(up_cosine(*state.quat_WB)) < 0.2
    assert np.abs(state.q - description.poses["lie"]).max() < 0.5
    assert np.linalg.norm(state.quat_WB) == pytest.approx(1.0)


def test_a_state_has_all_its_quantities(plant):
    state = plant.start()
    sizes = {"q": 12, "dq": 12, "tau": 12, "quat_WB": 4, "omega_B": 3, "p_WB": 3, "v_WB": 3}
    assert {name: getattr(state, name).shape for name in sizes} == {name: (n,) for name, n in sizes.items()}
    assert np.isfinite(state.q).all()


def test_a_step_passes_one_control_step(plant, description):
    times = [plant.start().t]
    for _ in range(10):
        times.append(plant.step(hold(description, description.poses["lie"])).state.t)
    assert np.allclose(np.diff(times), description.dt)


def test_a_tick_returns_the_command_that_went_out(plant, kind, description):
    plant.start()
    command = hold(description, description.poses["four"])
    sent = plant.step(command).sent
    for name in ("q_des", "dq_des", "kp", "kd", "tau_ff"):
        assert np.abs(getattr(sent, name) - getattr(command, name)).max() <= RESOLUTION[kind], name


def test_joints_go_where_they_are_sent(plant, description):
    plant.start()
    for _ in range(50):
        state = plant.step(hold(description, description.poses["four"])).state
    assert np.abs(state.q - description.poses["four"]).max() < 0.15


def test_a_state_keeps_its_numbers_when_time_goes_on(plant, description):
    before = plant.start()
    q = before.q.copy()
    plant.step(hold(description, description.poses["four"]))
    assert np.array_equal(before.q, q)


def test_its_time_starts_again(plant, description):
    first = plant.start()
    for _ in range(5):
        plant.step(hold(description, description.poses["lie"]))
    assert plant.start().t == pytest.approx(first.t, abs=1e-9)


@pytest.mark.parametrize("kind", ["memory", "simulation"])
def test_a_simulated_robot_starts_again_as_it_started(plant, description):
    first = plant.start()
    for _ in range(5):
        plant.step(hold(description, description.poses["four"]))
    again = plant.start()
    for name in ("t", "q", "dq", "quat_WB"):
        assert np.array_equal(getattr(first, name), getattr(again, name)), name


def test_it_may_be_closed_twice_and_before_its_start(plant):
    plant.close()
    plant.start()
    plant.close()
    plant.close()
    assert plant.description.name == "cyberdog2"

"""What training asks of a led robot against what mimic asks when a robot is led."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mimic.config.leading import LeadingSettings
from mimic.config.training import MdpSettings
from mimic.dynamics.robot_model import load_model
from mimic.evaluation.leading import HandLeading, PullEstimator
from mimic.records import RobotState, Tick
from mimic.robot.model import TOES

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
pytest.importorskip("mujoco_warp", reason="training needs the extra 'train'")
from mimic.train.contract import make_contract  # noqa: E402
from mimic.train.schedules import MoveSchedule  # noqa: E402

HEADING = 0.7
TOES_OUT = np.array([[0.16, 0.14, -0.24], [0.16, -0.14, -0.24]])


def pulled_robot(description, force: np.ndarray) -> RobotState:
    """An upright robot at rest with this heading, whose motors hold a force on the left front toe."""
    model = load_model(description)
    data = mujoco.MjData(model)
    turn, lean = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), HEADING)
    mujoco.mju_axisAngle2Quat(lean, np.array([0.0, 1.0, 0.0]), np.deg2rad(-80.0))
    mujoco.mju_mulQuat(data.qpos[3:7], turn, lean)
    data.qpos[2], data.qpos[7:] = 1.0, description.poses["upright"]
    mujoco.mj_forward(model, data)
    pulled, site = np.zeros(model.nv), model.site(TOES[0]).id
    mujoco.mj_applyFT(model, data, force, np.zeros(3), data.site_xpos[site], int(model.site_bodyid[site]), pulled)
    still = {"omega_B": np.zeros(3), "v_WB": np.zeros(3), "dq": np.zeros(12)}
    place = {"q": data.qpos[7:].copy(), "quat_WB": data.qpos[3:7].copy(), "p_WB": data.qpos[:3].copy()}
    return RobotState(t=0.0, tau=(data.qfrc_bias - pulled)[6:], **place, **still)


@pytest.mark.parametrize("pull", [(6.0, 0.0), (-7.0, 0.5), (1.0, 5.0), (2.5, -1.0), (0.5, 0.5)])
def test_a_pull_asks_in_training_for_what_it_asks_for_when_the_robot_is_led(description, pull):
    ahead = np.array([[np.cos(HEADING), -np.sin(HEADING)], [np.sin(HEADING), np.cos(HEADING)]])
    leading = HandLeading(description, TOES_OUT, LeadingSettings())
    state = pulled_robot(description, np.array([*ahead @ np.array(pull), 0.0]))
    felt = PullEstimator(description).force(state)[0, :2]  # a little off the truth
    tick = Tick(state=state, sent=None, health=None)  # type: ignore[arg-type]

    settings = MdpSettings(worlds=2)
    moves = MoveSchedule(make_contract(description, settings), settings, "cpu")
    headings = torch.full((2,), HEADING)
    moves.reset(torch.ones(2, dtype=torch.bool), headings)
    led, hand = torch.tensor([True, False]), torch.tensor([[0.0, 0.0], [0.2, 0.2]])
    for _ in range(150):
        leading.see(tick)
        command = leading.newest()
        moves.advance()
        moves.lead(led, torch.as_tensor(felt, dtype=torch.float32).expand(2, 2), hand, headings)
        assert command is not None
        assert float(moves.velocity[0, 0]) == pytest.approx(command.v[0], abs=0.005)
        assert float(moves.heading[0]) - HEADING == pytest.approx(command.heading, abs=0.015)  # a step later
    assert torch.equal(moves.wanted[1], moves.velocity[1])


def test_a_led_robot_is_judged_by_how_the_hand_goes_sideways_and_asked_for_no_such_velocity(description):
    settings = MdpSettings(worlds=1)
    moves = MoveSchedule(make_contract(description, settings), settings, "cpu")
    everyone, heading = torch.ones(1, dtype=torch.bool), torch.zeros(1)
    moves.reset(everyone, heading)
    for _ in range(200):
        moves.advance()
        moves.lead(everyone, torch.tensor([[0.0, 8.0]]), torch.tensor([[0.0, 0.2]]), heading)
    assert moves.wanted[0].numpy() == pytest.approx([0.0, 0.2], abs=1e-3)
    assert not moves.velocity.any()
    assert not moves.settled.any()
    for _ in range(300):
        moves.advance()
        moves.lead(everyone, torch.zeros(1, 2), torch.tensor([[0.0, 0.2]]), heading)
    assert moves.wanted[0].numpy() == pytest.approx([0.0, 0.0], abs=1e-6)
    assert moves.settled.all()

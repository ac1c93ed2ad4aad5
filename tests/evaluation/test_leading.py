"""A robot that is led: the pull that it feels, and the commands that follow from it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mimic.config.leading import HandSettings, LeadingSettings
from mimic.dynamics.robot_model import load_model
from mimic.errors import ConfigError
from mimic.evaluation.leading import HandLeading, PullEstimator, lead_figures, lead_robot
from mimic.policy.runtime import load_policy
from mimic.records import RobotState, Tick
from mimic.robot.model import TOES
from mimic.simulation.hand import Hand
from mimic.simulation.plant import SimulatedPlant

TOES_OUT = np.array([[0.16, 0.14, -0.24], [0.16, -0.14, -0.24]])


def held(description, force: np.ndarray, side: int, heading: float = 0.0) -> RobotState:
    """An upright robot at rest whose motors hold a force on a front toe, worked out by MuJoCo."""
    model = load_model(description)
    data = mujoco.MjData(model)
    tilt = np.deg2rad(-80.0)
    turn, lean = np.array([np.cos(heading / 2), 0, 0, np.sin(heading / 2)]), [np.cos(tilt / 2), 0, np.sin(tilt / 2), 0]
    mujoco.mju_mulQuat(data.qpos[3:7], turn, np.array(lean))
    data.qpos[2], data.qpos[7:] = 1.0, description.poses["upright"]
    mujoco.mj_forward(model, data)
    pulled = np.zeros(model.nv)
    site = model.site(TOES[side]).id
    mujoco.mj_applyFT(model, data, force, np.zeros(3), data.site_xpos[site], int(model.site_bodyid[site]), pulled)
    nothing = np.zeros(3)
    return RobotState(
        t=0.0,
        q=data.qpos[7:].copy(),
        dq=np.zeros(12),
        tau=(data.qfrc_bias - pulled)[6:],
        quat_WB=data.qpos[3:7].copy(),
        omega_B=nothing,
        p_WB=data.qpos[:3].copy(),
        v_WB=nothing,
    )


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("force", [(0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (-3.0, 2.0, 0.0), (0.0, -8.0, 4.0)])
def test_the_pull_is_found_from_the_torques(description, side, force):
    found = PullEstimator(description).force(held(description, np.array(force), side))
    assert found[side] == pytest.approx(np.array(force), abs=0.4)
    assert np.abs(found[1 - side]).max() < 0.05


def led(description, force: tuple[float, float, float], *, heading: float = 0.0, side: int = 0):
    """The commands of three seconds in which a robot is pulled and does not move."""
    leading = HandLeading(description, TOES_OUT, LeadingSettings())
    tick = Tick(state=held(description, np.array(force), side, heading), sent=None, health=None)  # type: ignore[arg-type]
    commands = []
    for _ in range(round(3.0 / description.dt)):
        leading.see(tick)
        commands.append(leading.newest())
    return commands


def test_nothing_is_asked_of_a_robot_that_nobody_pulls(description):
    for command in led(description, (0.0, 0.0, 0.0)):
        assert not command.v.any()
        assert command.heading == 0.0
        assert np.array_equal(command.p_BE, TOES_OUT)


@pytest.mark.parametrize(("pull", "way"), [(6.0, 1), (-6.0, -1)])
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_it_walks_where_it_is_pulled_and_not_at_once(description, pull, way, heading):
    ahead = (pull * np.cos(heading), pull * np.sin(heading), 0.0)
    commands = led(description, ahead, heading=heading)
    assert abs(commands[1].v[0]) < 0.1
    assert commands[-1].v[0] == pytest.approx(way * LeadingSettings().speed, rel=0.05)
    assert abs(commands[-1].heading) < 0.3  # it does not turn away from the test's pull, as a robot would


def test_a_stronger_pull_asks_for_more(description):
    speeds = [led(description, (pull, 0.0, 0.0))[-1].v[0] for pull in (1.0, 2.5, 3.5)]
    assert speeds[0] == 0.0
    assert 0.0 < speeds[1] < speeds[2] < LeadingSettings().speed


@pytest.mark.parametrize(("across", "turn"), [(5.0, 1), (-5.0, -1)])
def test_it_turns_to_a_pull_from_the_side_but_not_far_ahead_of_itself(description, across, turn):
    commands = led(description, (0.0, across, 0.0))
    headings = turn * np.array([c.heading for c in commands])
    assert headings[25] < headings[75] < headings[-1] + 1e-6
    assert 0.4 < headings[-1] < 0.65
    assert abs(commands[-1].v[0]) < 0.05


def test_it_ends_after_its_time_or_when_it_is_stopped(description):
    short = HandLeading(description, TOES_OUT, LeadingSettings(), seconds=0.05)
    assert [short.newest() is None for _ in range(4)] == [False, False, True, True]
    stopped = HandLeading(description, TOES_OUT, LeadingSettings())
    assert stopped.newest() is not None
    stopped.stop()
    assert stopped.newest() is None


@pytest.mark.parametrize(
    ("kind", "change", "text"),
    [
        (LeadingSettings, {"full": 1.0}, "full is 1 N; it must be from 1.6 to 50 N"),
        (HandSettings, {"most": 80.0}, "most is 80 N; it must be from 0.1 to 50 N"),
        (HandSettings, {"way": 0.0}, "way is 0 m; it must be from 0.1 to 100 m"),
    ],
)
def test_impossible_settings_are_refused(kind, change, text):
    with pytest.raises(ConfigError, match=text):
        kind(**change)


def lead(description, **changes):
    settings = HandSettings(way=1.0, speed=0.2, begin=3.0, **changes)
    plant = SimulatedPlant(description, samples=False)
    hand = Hand(plant.model, settings)
    seconds = settings.end + settings.after
    plant.watch(hand)
    result = lead_robot(plant, load_policy(None, description), LeadingSettings(), seconds=seconds)
    return result, hand, lead_figures(result, hand, settings), settings


def test_the_shipped_policy_follows_a_hand_and_stops(description):
    result, hand, figures, settings = lead(description)
    assert result.fell_at is None
    assert figures["followed"]
    assert figures["stopped"]
    assert figures["way_m"] == pytest.approx(1.0, abs=0.3)
    assert 0.5 < figures["pull_mean_n"] < settings.most
    assert figures["pull_max_n"] <= settings.most + 1e-9
    assert settings.begin <= hand.t[0] < hand.t[-1] < settings.end


def test_a_hand_that_hardly_pulls_moves_nobody(description):
    _, hand, figures, _ = lead(description, most=0.5)
    assert not figures["followed"]
    assert np.linalg.norm(hand.force, axis=1).max() == pytest.approx(0.5)

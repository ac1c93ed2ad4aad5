"""How calmly a policy stands, on signals whose figures are known, and on the shipped policy."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from lab.policies.studies import calm
from lab.policies.studies.calm import (
    STANDING,
    _Planted,
    evaluate_calm,
    fast_share,
    still_figures,
    summarise,
    winding_heat,
)
from lab.policies.studies.settings import CalmSettings
from mimic.dynamics.robot_model import load_model
from mimic.io.assets import shipped
from mimic.records import JOINTS, JointSamples

RATE = 400.0


def test_heat_is_resistance_times_current_squared_as_the_mjcf_has_it(description):
    tau = np.zeros(12)
    tau[3], tau[7] = 12.0, -4.0
    constant, resistance = 0.7742684776, 0.9730649129  # motorconst and resistance in cyberdog2.xml
    assert winding_heat(tau, description) == pytest.approx(resistance * (144.0 + 16.0) / constant**2, rel=1e-6)
    assert winding_heat(np.zeros((5, 12)), description).tolist() == [0.0] * 5


@pytest.mark.parametrize(("hz", "expected"), [(5.0, 0.0), (50.0, 1.0)])
def test_the_share_of_fast_torque_is_that_of_a_sine(hz, expected):
    t = np.arange(0.0, 4.0, 1.0 / RATE)
    wave = np.sin(2 * np.pi * hz * t)[:, None] + 7.0
    assert fast_share(wave, RATE) == pytest.approx(expected, abs=1e-6)
    both = np.concatenate([wave, 0.5 * np.sin(2 * np.pi * 50.0 * t)[:, None]], axis=1)
    assert fast_share(both, RATE) == pytest.approx(0.2 if hz < 20 else 1.0, abs=1e-6)
    assert fast_share(np.ones((100, 2)), RATE) == 0.0


def test_figures_of_a_known_stand(description):
    t = np.arange(0.0, 2.0, 1.0 / RATE)
    tau = np.zeros((len(t), 12))
    knees = [JOINTS.index("RL_knee"), JOINTS.index("RR_knee")]
    tau[:, knees] = [3.0, -4.0]
    tau[:80, knees[0]] = 12.0
    nothing = np.zeros((len(t), 12))
    samples = JointSamples(t=t, q=nothing, dq=nothing, tau=tau, q_des=nothing)
    q_des = np.zeros((100, 12))
    q_des[::2, JOINTS.index("RL_hip")] = 0.1
    q_des[::2, JOINTS.index("FL_hip")] = 9.0  # front legs do not count
    p_WB = np.linspace([0.0, 0.0, 0.4], [0.3, 0.4, 0.4], 100)
    planted = np.arange(len(t)) % 4 > 0
    found = still_figures(samples, planted, q_des, p_WB, description)
    assert found["planted"] == pytest.approx(0.75)
    assert found["at_limit"] == pytest.approx(0.1)
    assert found["knee_rms_nm"] == pytest.approx(np.sqrt((0.1 * 144 + 0.9 * 9 + 16) / 2))
    assert found["action_rate_rad"] == pytest.approx(0.1 / np.sqrt(6))
    assert found["drift_m"] == found["farthest_m"] == pytest.approx(0.5)


def test_who_falls_counts_against_standing_and_in_no_mean():
    still = {"kind": "standing", "what": "as described", "planted": 1.0, "heat_w": 50.0, "knee_rms_nm": 4.0}
    still |= {"at_limit": 0.0, "fast_torque": 0.0, "action_rate_rad": 0.0, "drift_m": 0.1, "farthest_m": 0.2}
    pushed = {"kind": "pushed", "what": "0.5 m/s sideways"}
    rows = [still | {"stands": True}, {"kind": "standing", "what": "as described", "stands": False}]
    found = summarise([*rows, pushed | {"stands": True}, pushed | {"stands": False}])
    assert found["standing"]["as described"]["stood"] == 0.5
    assert found["standing"]["as described"]["drift_max_m"] == 0.1
    assert found["pushed"] == {"0.5 m/s sideways": 0.5}


@pytest.fixture(scope="module")
def evaluated():
    few = CalmSettings(episodes=1, seconds=9.0, pushes=(0.3,), pulls=(3.0,), pushed_episodes=1, workers=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calm, "PUSH_WAYS", ("sideways",))
        patch.setattr(calm, "PULL_WAYS", ("backward",))
        return evaluate_calm(shipped("policies", "stand_track.onnx"), few)


def test_the_shipped_policy_stands_and_has_every_figure(evaluated):
    s = evaluated["summary"]
    assert set(s["standing"]) == set(STANDING)
    for f in s["standing"].values():
        assert f["stood"] == 1.0
        assert 0.0 < f["planted"] < 1.0
        assert 2.0 < f["knee_rms_nm"] < 8.0
        assert 20.0 < f["heat_w"] < 200.0
        assert np.isfinite([f[name] for name in ("at_limit", "fast_torque", "action_rate_rad", "drift_m")]).all()
    noisy, quiet = (s["standing"][name] for name in ("the paper's noise", "as described"))
    assert noisy["action_rate_rad"] > 1.2 * quiet["action_rate_rad"]
    assert s["pushed"] == {"0.3 m/s sideways": 1.0}
    assert set(s["pulled"]) == {"3 N backward"}


def test_a_foot_is_planted_that_bears_a_fifth_of_the_weight(description):
    model = load_model(description, visuals=False)
    data = mujoco.MjData(model)
    data.qpos[:7] = 0.0, 0.0, description.pose_height["upright"], np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0
    data.qpos[7:] = data.ctrl[:] = description.poses["upright"]
    planted = _Planted(model, description)
    for aside in (0.0, 40.0):  # a push on the trunk to the left lifts the right foot
        mujoco.mj_forward(model, data)
        data.xfrc_applied[1, 1] = aside
        for _ in range(40):
            mujoco.mj_step(model, data)
        planted(model, data)
    assert planted.rows == [True, False]

"""The robot as a Gymnasium environment, stepped by the shipped policies."""

from __future__ import annotations

import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import mimic
from mimic.records import Command

pytestmark = pytest.mark.filterwarnings("ignore:.*(Box action|Box observation).*")


@pytest.fixture(scope="module", params=["cyberdog2", "go2"])
def env(request) -> mimic.Env:
    return mimic.Env(request.param, seconds=4.0)


def played(env: mimic.Env, seed: int, steps: int, acts) -> list:
    """Return what the steps of an episode give."""
    seen, _ = env.reset(seed=seed)
    given = []
    for step in range(steps):
        given.append(env.step(acts(step, seen)))
        seen = given[-1][0]
        if given[-1][2]:
            break
    return given


def test_gymnasiums_own_checker_finds_nothing(env):
    check_env(env, skip_render_check=True)


def test_the_shipped_policy_stands_and_follows_goals_until_the_time_is_over(env):
    policy = mimic.load_policy(robot=env.description)
    given = played(env, 3, 200, lambda step, seen: policy.act(seen))
    assert [truncated for *_, truncated, _ in given] == [False] * 199 + [True]
    phases = [info["phase"] for *_, info in given]
    assert set(phases) == {"stand_up", "blend", "track"}
    errors = [info["toe_error"].mean() for *_, info in given if info["phase"] == "track"]
    assert np.mean(errors) < 0.02
    assert 2.5 < np.mean([reward for _, reward, *_ in given[-50:]]) <= 3.35


def test_the_same_seed_is_the_same_episode_and_another_seed_is_not(env):
    policy = mimic.load_policy(robot=env.description)
    one, again, other = (played(env, seed, 60, lambda step, seen: policy.act(seen)) for seed in (1, 1, 2))
    assert np.array_equal(one[-1][0], again[-1][0])
    assert not np.array_equal(one[-1][0], other[-1][0])


def test_a_fall_terminates_the_episode(env):
    policy = mimic.load_policy(robot=env.description)
    given = played(env, 1, 400, lambda step, seen: policy.act(seen) if step < 60 else np.zeros(12))
    assert given[-1][2]
    assert len(given) < 200


def test_goals_can_be_set_from_outside_while_the_robot_moves():
    class Goals:
        asked = None

        def newest(self) -> Command | None:
            return self.asked

    goals = Goals()
    env = mimic.Env(commands=goals, seconds=6.0)
    policy = mimic.load_policy()
    neutral = np.array(policy.contract.neutral_toes).reshape(2, 3)
    goals.asked = Command(v=np.array([0.3, 0.0]), heading=0.0, p_BE=neutral)
    way = []

    def act(step, seen):
        way.append(env.plant.data.qpos[0])
        return policy.act(seen)

    given = played(env, 1, 300, act)
    assert np.array_equal(given[-1][-1]["velocity"], [0.3, 0.0])
    stood = 75  # control steps until it stands, which takes it back a little
    assert way[-1] - way[stood] > 0.5


def test_several_robots_step_together():
    robots = gymnasium.vector.SyncVectorEnv([mimic.Env] * 2)
    seen, _ = robots.reset(seed=1)
    seen, reward, *_ = robots.step(np.zeros((2, 12), np.float32))
    assert seen.shape == (2, 1169)
    assert reward.shape == (2,)


@pytest.mark.parametrize("seconds", [1.0, float("nan"), float("inf")])
def test_an_episode_that_is_too_short_or_has_no_end_is_refused(seconds):
    with pytest.raises(mimic.MimicError, match=r"give at least 2\.5"):
        mimic.Env(seconds=seconds)


def test_an_action_of_another_shape_and_one_before_the_episode_are_refused():
    env = mimic.Env()
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset before step"):
        env.step(np.zeros(12))
    env.reset(seed=1)
    for action in (np.zeros(11), np.zeros((1, 12)), 0.0):
        with pytest.raises(mimic.MimicError, match=r"expected \(12,\)"):
            env.step(action)


def test_without_gymnasium_its_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "mimic.flows.environment")
    monkeypatch.delitem(mimic.__dict__, "Env", raising=False)
    with pytest.raises(mimic.MimicError, match="needs gymnasium, which is not installed: pip install 'gymnasium"):
        mimic.Env()

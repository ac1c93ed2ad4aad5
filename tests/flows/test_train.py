from __future__ import annotations

import json
from hashlib import sha256

import pytest

from mimic.config.training import LearnSettings, MdpSettings
from mimic.errors import ConfigError
from mimic.flows.train import train, training_settings
from mimic.io.assets import shipped
from mimic.policy.runtime import load_policy
from mimic.robot.description import load_description


def overridden(*words: str) -> tuple[MdpSettings, LearnSettings]:
    return training_settings(words=words)


def test_the_defaults_are_the_recipe_of_the_policy_that_stands():
    assert training_settings() == training_settings("stand_track") == (MdpSettings(), LearnSettings())


def test_words_find_their_settings():
    mdp, learn = overridden("worlds=16", "seed=7", "device=cpu")
    assert (mdp.worlds, learn.seed, learn.device) == (16, 7, "cpu")


def test_dots_go_down_into_rewards_and_ranges():
    mdp, _ = overridden("rewards.slip=-0.4", "randomisation.push=[0,0.5]")
    assert mdp.rewards.slip == -0.4
    assert mdp.randomisation.push == (0, 0.5)
    assert mdp.rewards.upright == MdpSettings().rewards.upright


def test_lists_become_tuples_and_text_needs_no_quotes():
    mdp, learn = overridden("hidden=[64,32]", "effects=out/effects.toml")
    assert learn.hidden == (64, 32)
    assert mdp.effects == "out/effects.toml"


def test_the_last_word_wins():
    assert overridden("worlds=16", "worlds=32")[0].worlds == 32


def test_a_whole_number_may_stand_for_a_real_one():
    assert overridden("rewards.slip=0")[0].rewards.slip == 0


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("worlds", "'worlds' is not a setting; expected name=value"),
        ("colour=red", "there is no setting 'colour'; there are task"),
        ("rewards.mood=1", "there is no setting 'rewards.mood'; there are alive"),
        ("worlds.more=1", "worlds is {'more': 1}; expected a whole number"),
        ("worlds=many", "worlds is 'many'; expected a whole number"),
        ("rewards.slip=[1,2]", "rewards.slip is [1, 2]; expected a number"),
        ("randomisation.push=0.5", "randomisation.push is 0.5; expected a list of 2, each a number"),
        ("task=jump", 'task is \'jump\'; expected "stand_track" or "sit_down"'),
        ("worlds=0", "worlds is 0; it must be from 1"),
        ("rewards=3", "rewards is 3; set one of its fields"),
    ],
)
def test_a_word_that_names_or_fits_no_setting_is_reported(word, told):
    with pytest.raises(ConfigError) as error:
        overridden(word)
    assert told in str(error.value)


def test_the_recipe_of_sitting_down_has_another_task_and_other_numbers():
    mdp, learn = training_settings("sit_down", ["worlds=16"])
    assert (mdp.task, mdp.history, mdp.worlds, learn.minutes) == ("sit_down", 6, 16, 9.3)
    assert mdp.randomisation.push == (0.0, 0.9)


@pytest.mark.parametrize("name", ["stand_track", "go2_stand_track", "go2_sit_down"])
def test_the_settings_beside_a_policy_are_those_that_its_file_names(name):
    stored = shipped("policies", f"{name}.settings.json").read_text(encoding="utf-8")
    task = json.loads(stored)["mdp"]["task"]
    robot = load_description("go2" if name.startswith("go2") else "cyberdog2")
    assert load_policy(None, robot, task=task).contract.training == sha256(stored.encode()).hexdigest()


def test_a_recipe_of_one_s_own_goes_down_into_tables_and_words_come_after_it(tmp_path):
    (tmp_path / "own.toml").write_text('device = "cpu"\nstd_range = [0.1, 1]\n[rewards]\nslip = -0.4\ngait = 3\n')
    mdp, learn = training_settings(str(tmp_path / "own.toml"), ["rewards.gait=7"])
    assert (learn.device, learn.std_range, mdp.rewards.slip, mdp.rewards.gait) == ("cpu", (0.1, 1), -0.4, 7)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("dance", None, "there is no recipe 'dance'; give a .toml file or one of stand_track, sit_down, go2_"),
        ("gone.toml", None, "cannot be read"),
        ("broken.toml", "rewards = [", "is not a TOML file"),
    ],
)
def test_what_is_no_recipe_is_refused(name, text, message, tmp_path):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=message):
        training_settings(str(tmp_path / name) if name.endswith(".toml") else name)


@pytest.mark.train
def test_a_training_that_is_there_is_not_overwritten(tmp_path):
    pytest.importorskip("torch", reason="training needs the extra 'train'")
    (tmp_path / "last.pt").write_text("kept")
    with pytest.raises(ConfigError, match=r"holds a training \(last\.pt\); name another folder, or go on"):
        train(tmp_path)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["kept"]

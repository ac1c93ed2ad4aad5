from __future__ import annotations

import pytest

from mimic.config.training import LearnSettings, MdpSettings
from mimic.errors import ConfigError
from mimic.train.overrides import recipe, with_overrides


def overridden(*words: str) -> tuple[MdpSettings, LearnSettings]:
    return with_overrides(MdpSettings(), LearnSettings(), list(words))


def test_no_words_change_nothing():
    assert overridden() == (MdpSettings(), LearnSettings())


def test_words_find_their_settings():
    mdp, learn = overridden("worlds=16", "seed=7", "device=cpu")
    assert (mdp.worlds, learn.seed, learn.device) == (16, 7, "cpu")


def test_dots_go_down_into_rewards_and_ranges():
    mdp, _ = overridden("rewards.slip=-0.4", "randomisation.push=[0,0.5]")
    assert mdp.rewards.slip == -0.4
    assert mdp.randomisation.push == (0, 0.5)
    assert mdp.rewards.upright == MdpSettings().rewards.upright


def test_lists_and_tuples_become_tuples():
    assert overridden("hidden=[64,32]")[1].hidden == (64, 32)
    assert overridden("hidden=(64,32)")[1].hidden == (64, 32)


def test_the_last_word_wins():
    assert overridden("worlds=16", "worlds=32")[0].worlds == 32


def test_a_whole_number_may_stand_for_a_real_one():
    assert overridden("rewards.slip=0")[0].rewards.slip == 0


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("worlds", "'worlds' is not a setting; expected name=value"),
        ("colour=red", "there is no setting 'colour'; there are task"),
        ("rewards.mood=1", "there is no setting 'rewards.mood'"),
        ("worlds.more=1", "there is no setting 'worlds.more'"),
        ("worlds=many", "worlds is 'many'; expected a whole number such as"),
        ("rewards.slip=[1,2]", "rewards.slip is [1, 2]; expected a number such as"),
        ("randomisation.push=0.5", "randomisation.push is 0.5; expected a list of numbers such as"),
        ("worlds=0", "worlds is 0; it must be from 1"),
        ("rewards=3", "rewards is 3; set one of its fields"),
    ],
)
def test_a_word_that_names_or_fits_no_setting_is_reported(word, told):
    with pytest.raises(ConfigError) as error:
        overridden(word)
    assert told in str(error.value)


def test_a_shipped_recipe_names_settings_that_exist_and_changes_some():
    mdp, learn = overridden(*recipe("stand_track"))
    assert mdp.task == "stand_track"
    assert learn.minutes > 0
    assert (mdp, learn) != overridden()


def test_a_recipe_of_one_s_own_goes_down_into_tables(tmp_path):
    (tmp_path / "own.toml").write_text('device = "cpu"\nstd_range = [0.1, 1]\n[rewards]\nslip = -0.4\n')
    mdp, learn = overridden(*recipe(str(tmp_path / "own.toml")), "rewards.gait=7")
    assert (learn.device, learn.std_range, mdp.rewards.slip, mdp.rewards.gait) == ("cpu", (0.1, 1), -0.4, 7)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("dance", None, "there is no recipe 'dance'; give a .toml file or one of stand_track"),
        ("gone.toml", None, "cannot be read"),
        ("broken.toml", "rewards = [", "cannot be read"),
    ],
)
def test_what_is_no_recipe_is_refused(name, text, message, tmp_path):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=message):
        recipe(str(tmp_path / name) if name.endswith(".toml") else name)

from __future__ import annotations

import pytest

from mimic.config.training import LearnSettings, MdpSettings
from mimic.errors import ConfigError
from mimic.train.overrides import with_overrides


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

"""Being led by the hand, over random robots and directions."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lab.policies.studies.led_by_hand import evaluate_leading
from lab.policies.studies.settings import LeadSettings
from mimic.config.leading import HandSettings
from mimic.errors import ConfigError
from mimic.io.assets import shipped


def test_an_evaluation_repeats_and_has_every_figure():
    settings = LeadSettings(episodes=2, seconds=9.0, hand=HandSettings(way=0.8, begin=3.0), workers=1)
    policy = shipped("policies", "stand_track.onnx")
    one, other = evaluate_leading(policy, settings), evaluate_leading(policy, replace(settings, episodes=1))
    assert other["episodes"] == one["episodes"][:1]
    assert one["summary"]["episodes"] == 2
    assert 0.0 <= one["summary"]["stopped"] <= one["summary"]["followed"] <= one["summary"]["stood"] <= 1.0


def test_an_evaluation_that_is_too_short_is_refused():
    with pytest.raises(ConfigError, match="seconds is 20 s; it must be from 31 to 629 s"):
        LeadSettings(seconds=20.0)


def test_a_long_evaluation_of_leading_watches_the_rest():
    assert LeadSettings(seconds=120.0).hand.after == 120.0 - LeadSettings().hand.end
    with pytest.raises(ConfigError, match="seconds is 5000 s"):
        LeadSettings(seconds=5000.0)

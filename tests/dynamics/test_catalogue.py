from __future__ import annotations

import pytest

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.catalogue import CATALOGUE, UnknownEffect, effect, unit_of
from mimic.errors import ConfigError

PARAMETERS = [(e.name, p.name) for e in CATALOGUE.values() for p in e.parameters]


@pytest.mark.parametrize(("name", "parameter"), PARAMETERS)
def test_a_neutral_value_is_allowed_and_a_step_is_small_against_the_range(name, parameter):
    p = effect(name).parameter(parameter)
    assert p.low < p.high
    assert 0 < p.step < p.high - p.low
    assert p.neutral == "model" or p.low <= p.neutral <= p.high


@pytest.mark.parametrize("e", CATALOGUE.values(), ids=lambda e: e.name)
def test_an_effect_says_what_it_is_how_it_shows_and_where_from(e):
    for text in (e.title, e.equation, e.signature, e.experiment, e.enters, e.source):
        assert len(text) > 3
    assert e.parameters
    assert not all(p.shape for p in e.parameters)


def test_structural_effects_have_somewhere_to_start():
    """A threshold has no slope at its neutral value; where nothing is fitted, nothing starts."""
    for e in CATALOGUE.values():
        if e.structural and not all(p.fixed for p in e.parameters):
            assert any(p.starts for p in e.parameters), e.name


def test_the_declared_ones_are_those_of_the_paper():
    names = tuple(CATALOGUE)[:4]
    assert names == CalibrateSettings().baseline == ("coulomb", "viscous", "link_mass", "delay")


def test_an_unknown_effect_is_reported_with_all_that_there_are():
    with pytest.raises(UnknownEffect, match=r"'strib' is not in the catalogue; it has coulomb, .*lost_commands"):
        effect("strib")


def test_an_unknown_parameter_is_reported_with_those_of_the_effect():
    with pytest.raises(ConfigError, match="has no parameter 'height'; it has level, speed"):
        effect("stribeck").parameter("height")


def test_units_follow_the_kind_of_joint():
    assert unit_of("coulomb", "level") == "N m"
    assert unit_of("coulomb", "level", "m") == "N"
    assert unit_of("kt_gain", "factor") == ""
    assert unit_of("supply_sag", "drop", "m") == "1/W"

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mimic.dynamics.effect_set import EffectSet, EffectValues, read_effects, write_effects
from mimic.dynamics.machine import hung_robot
from mimic.dynamics.servo import parameters_of
from mimic.errors import ConfigError
from mimic.records import JOINTS
from mimic.robot.description import load_description

KNEES = ("FL_knee", "FR_knee")


def stribeck(**changes) -> EffectValues:
    options = {"name": "stribeck", "joints": KNEES, "values": {"level": [0.21, 0.19], "speed": 0.1}}
    return EffectValues(**(options | changes))


def test_what_is_written_is_read_again(tmp_path: Path):
    interval = {"level": [[0.19, 0.23], [0.17, 0.21]]}
    written = EffectSet(
        (
            stribeck(intervals=interval, role="fitted", source='log "a\\b", 30 s'),
            EffectValues(name="delay", values={"time": 0.0123456789012345}, role="off"),
        )
    )
    read = read_effects(write_effects(written, tmp_path / "effects.toml", ("one line", "another")))
    assert len(read) == 2
    for a, b in zip(written, read, strict=True):
        assert (a.name, a.joints, a.role, a.source) == (b.name, b.joints, b.role, b.source)
        for mine, yours in ((a.values, b.values), (a.intervals, b.intervals)):
            assert mine.keys() == yours.keys()
            assert all(np.array_equal(mine[k], yours[k]) for k in mine)


def test_one_number_counts_for_all_joints():
    assert stribeck().values["speed"].tolist() == [0.1, 0.1]


@pytest.mark.parametrize("role", ["fixed", "fitted"])
def test_fixed_effects_are_applied_as_fitted_ones(role):
    """That "frozen" meant "silently not applied" is a bug that others have had."""
    effects = EffectSet((stribeck(role=role), EffectValues(name="delay", values={"time": 0.01}, role="off")))
    assert [e.name for e in effects.applied] == ["stribeck"]
    found = parameters_of(effects, hung_robot(load_description("cyberdog2")))
    assert ("delay", "time") not in found
    level = found["stribeck", "level"]
    assert level.shape == (1, 12)
    assert {JOINTS[i]: level[0, i] for i in np.flatnonzero(level[0])} == {"FL_knee": 0.21, "FR_knee": 0.19}


def test_joints_without_an_effect_keep_the_numbers_of_the_model():
    machine = hung_robot(load_description("cyberdog2"))
    found = parameters_of(EffectSet((EffectValues(name="coulomb", joints=KNEES, values={"level": 0.5}),)), machine)
    level = found["coulomb", "level"][0]
    assert level[[JOINTS.index(j) for j in KNEES]].tolist() == [0.5, 0.5]
    assert level[0] == machine.drives.friction[0]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"name": "stribek"}, "'stribek' is not in the catalogue"),
        ({"values": {"height": 1.0}}, "has no parameter 'height'"),
        ({"values": {"level": -0.1}}, "stribeck.level is -0.1 N m; it must be from 0 to 50 N m"),
        ({"values": {"level": float("nan")}}, "stribeck.level is nan"),
        ({"values": {"level": [1.0, 2.0, 3.0]}}, "has 3 values for 2 joints"),
        ({"joints": ()}, "belongs to joints; name them"),
        ({"joints": ("FL_knee", "FL_knee")}, "has a joint twice"),
        ({"intervals": {"level": [[0.1, 0.2]]}}, r"shape \(1, 2\), expected \(2, 2\)"),
        ({"name": "delay", "values": {"time": 0.01}}, "belongs to the whole machine"),
    ],
)
def test_what_does_not_fit_the_catalogue_is_reported(changes, told):
    with pytest.raises(ConfigError, match=told):
        stribeck(**changes)


def test_an_effect_twice_is_refused():
    with pytest.raises(ConfigError, match="'stribeck' is given twice"):
        EffectSet((stribeck(), stribeck()))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("level =", "is not a TOML file"),
        ("[effect]\nname = 'delay'", "is not an effects file"),
        ("", "is not an effects file"),
        ("[[effect]]\nlevel = 1", "has no name"),
        ("[[effect]]\nname = 'delay'\ntime = 'late'", "effect 'delay'"),
        ("[[effect]]\nname = 'delay'\ntime = true", "time is True; expected a number"),
        ("[[effect]]\nname = 'coulomb'\njoints = 'FL_knee'\nlevel = 0.1", "joints is 'FL_knee'; expected a list"),
        ("[[effect]]\nname = 'delay'\nrole = 'frozen'", 'role is \'frozen\'; expected "off" or "fixed" or "fitted"'),
        ("[[effect]]\nname = 'delay'\ntime = 0.01\ninterval = 3", "effect 'delay': 'int' object is not iterable"),
        (f"[[effect]]\nname = 'delay'\ntime = {10**400}", "effect 'delay': int too large"),
        ("[[effect]]\nname = 'delay'\ntime = 3.0", "effects.toml: effect 'delay': delay.time is 3 s"),
    ],
)
def test_a_file_that_is_no_set_of_effects_is_reported(tmp_path: Path, text, told):
    path = tmp_path / "effects.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=told):
        read_effects(str(path))


def test_a_joint_that_the_robot_lacks_is_reported():
    with pytest.raises(ConfigError, match="names joint 'tail'; the model has FL_abad"):
        parameters_of(EffectSet((stribeck(joints=("tail", "FR_knee")),)), hung_robot(load_description("cyberdog2")))


def test_joints_without_an_effect_are_as_the_model_has_them() -> None:
    machine = hung_robot(load_description("cyberdog2"))
    line = EffectValues(name="torque_speed", joints=("FL_knee",), values={"torque": 8.0, "speed": 9.0, "flat": 0.0})
    found, at = parameters_of(EffectSet((line,)), machine), machine.joints.index("FL_knee")
    for name, own in (
        ("torque", machine.drives.torque),
        ("speed", machine.drives.speed),
        ("flat", machine.drives.flat),
    ):
        row = found["torque_speed", name][0]
        assert row[at] == {"torque": 8.0, "speed": 9.0, "flat": 0.0}[name]
        assert np.array_equal(np.delete(row, at), np.delete(own, at))

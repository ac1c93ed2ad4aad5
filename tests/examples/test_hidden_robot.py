from pathlib import Path

from mimic.dynamics.effect_set import read_effects
from mimic.records import JOINTS

HIDDEN = Path(__file__).resolve().parents[2] / "examples" / "hidden.toml"


def test_the_hidden_robot_of_the_walk_through_can_be_read() -> None:
    hidden = {e.name: e for e in read_effects(HIDDEN)}
    assert set(hidden) == {"coulomb", "viscous", "delay", "stribeck"}
    assert hidden["coulomb"].joints == JOINTS
    assert hidden["stribeck"].joints == tuple(j for j in JOINTS if j.endswith("knee"))

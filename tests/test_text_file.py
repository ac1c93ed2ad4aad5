"""One reader of JSON and TOML: what is nested too deeply is one line, wherever it comes from."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from mimic.config.text_file import DEEPEST, from_json, from_toml
from mimic.config.values import read_toml
from mimic.control.row_file import read_rows
from mimic.dynamics.effect_set import read_effects
from mimic.errors import MimicError
from mimic.flows.train import training_settings
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.go2.messages import Call
from mimic.hardware.go2.wiring import load_go2
from mimic.hardware.stock.wiring import load_board
from mimic.io.joint_log import read_log
from mimic.io.store import load_json
from mimic.policy.contract import PolicyContract
from mimic.robot.description import load_description

DEPTHS = (60, 900, 100_000)


def brackets(depth: int) -> str:
    return "[" * depth + "]" * depth


def refused(read: Callable[[], object]) -> str:
    with pytest.raises(MimicError) as raised:
        read()
    assert "\n" not in str(raised.value)
    return str(raised.value)


@pytest.mark.parametrize("depth", DEPTHS)
@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("bus.toml", load_wiring),
        ("board.toml", load_go2),
        ("board.toml", load_board),
        ("effects.toml", read_effects),
        ("recipe.toml", read_toml),
        ("robot.toml", lambda path: load_description(str(path.parent))),
    ],
)
def test_a_file_of_toml_that_is_nested_too_deeply_is_one_line(name, read, depth, tmp_path):
    path = tmp_path / name
    path.write_text(f"a = {brackets(depth)}\n")
    assert "nested too deeply" in refused(lambda: read(path))


@pytest.mark.parametrize("depth", DEPTHS)
def test_other_texts_that_are_nested_too_deeply_are_one_line(depth, tmp_path):
    deep = brackets(depth)
    (tmp_path / "a.json").write_text(deep)
    (tmp_path / "log.rows").write_text(f'{{"form": {deep}}}\n')
    assert "nested too deeply" in refused(lambda: load_json(tmp_path / "a.json"))
    assert "does not hold rows" in refused(lambda: read_rows(tmp_path / "log.rows"))
    assert refused(lambda: training_settings(words=[f"rewards.slip={deep}"]))
    assert "contract" in refused(lambda: PolicyContract.from_json(deep))
    assert Call(id=1, api=1001, text=f'{{"name": {deep}}}', code=0).name() is None


@pytest.mark.parametrize("depth", DEPTHS)
def test_notes_of_a_log_that_are_nested_too_deeply_are_one_line(depth, tmp_path):
    (tmp_path / "log.csv").write_text("t,q\n0.0,0.0\n0.01,0.1\n")
    (tmp_path / "log.json").write_text(f'{{"kp": {brackets(depth)}}}')
    assert "nested too deeply" in refused(lambda: read_log(tmp_path / "log.csv"))


def test_what_is_nested_as_deep_as_it_may_be_is_read():
    assert from_json(brackets(DEEPEST)) is not None
    assert from_toml(f"a = {brackets(DEEPEST - 1)}")["a"] is not None

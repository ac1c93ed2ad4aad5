from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mimic.control.safety.safety_limits import limits_for
from mimic.control.safety.safety_rules import FAILURE, FAILURE_OUTCOMES, FAILURES, RULES
from mimic.control.start import START, START_FINDS
from mimic.robot.description import load_description

PAGE = (Path(__file__).parents[3] / "docs" / "manual" / "robot.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_the_page_has_every_rule_as_the_code_has_it(rule, description):
    assert f"| `{rule.name}` | {rule.limit(limits_for(description))} | {rule.within} | {rule.outcome} |" in PAGE


def test_the_page_has_the_rule_of_the_loop():
    assert f"| `{FAILURE}` | {FAILURES} | 1 tick | {FAILURE_OUTCOMES} |" in PAGE
    assert f"| `{START}` | {START_FINDS} | 2.5 s; 6 s | damp |" in PAGE


@pytest.mark.parametrize(("robot", "joints"), [("cyberdog2", 7), ("go2", 8)])
def test_the_page_has_the_limits_of_the_start(robot, joints):
    start = load_description(robot).start
    assert (round(np.rad2deg(start.joints)), round(np.rad2deg(start.tilt))) == (joints, 6)

from __future__ import annotations

from pathlib import Path

import pytest

from mimic.control.safety_limits import limits_for
from mimic.control.safety_rules import FAILURE, FAILURE_OUTCOMES, FAILURES, RULES

PAGE = (Path(__file__).parents[2] / "docs" / "manual" / "robot.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_the_page_has_every_rule_as_the_code_has_it(rule, description):
    assert f"| `{rule.name}` | {rule.limit(limits_for(description))} | {rule.within} | {rule.outcome} |" in PAGE


def test_the_page_has_the_rule_of_the_loop():
    assert f"| `{FAILURE}` | {FAILURES} | 1 tick | {FAILURE_OUTCOMES} |" in PAGE

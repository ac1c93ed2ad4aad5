"""Plugin of pytest: writes which tests passed and which did not to the file that MUTANTS_OUTCOMES names."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

_passed: list[str] = []
_failed: list[str] = []


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note a test's outcome."""
    if report.failed:
        _failed.append(report.nodeid)
    elif report.passed and report.when == "call":
        _passed.append(report.nodeid)


def pytest_collectreport(report: pytest.CollectReport) -> None:
    """Note a file that cannot be imported."""
    if report.failed:
        _failed.append(report.nodeid)


def pytest_sessionfinish() -> None:
    """Write the outcomes."""
    outcomes = {"passed": _passed, "failed": list(dict.fromkeys(_failed))}
    Path(os.environ["MUTANTS_OUTCOMES"]).write_text(json.dumps(outcomes), encoding="utf-8")

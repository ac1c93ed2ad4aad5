"""The emulated stock board against the maker's firmware, where that is built."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from benchmarks.stock_firmware.firmware import ROOT, NotHere, require_built

pytestmark = pytest.mark.slow


def test_same_commands_and_readings_give_the_same_error_flags_and_torques():
    try:
        require_built()
    except NotHere as reason:
        pytest.skip(str(reason))
    command = [sys.executable, "-m", "benchmarks.stock_firmware", "compare"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=True)
    found = json.loads(done.stdout)
    assert found["cycles compared"] > 5000
    assert found["error flags that differ (bits: cycles)"] == {}
    assert set(found["cycles that differ by more than 0.001"].values()) == {0}
    assert {"0x00", "0x01", "0x04", "0x08", "0x10", "0x1b", "0x1e"} <= set(found["cycles by error flag"])

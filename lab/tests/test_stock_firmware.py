"""The emulated stock board against the maker's firmware, where that is built."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from lab.stock_firmware.firmware import ROOT, NotHere, require_built
from lab.stock_firmware.series import ended, nominal, table
from mimic.dynamics.lying import sunk_pose
from mimic.robot.description import load_description


def test_a_robot_on_the_bench_begins_as_it_sank_without_power(tmp_path):
    model = mujoco.MjModel.from_binary_path(str(nominal(tmp_path)))
    q = model.key_qpos[model.key("lie").id]
    assert q[2] < 0.07
    np.testing.assert_allclose(q[-12:], sunk_pose(load_description("cyberdog2")), atol=0.05)


def test_a_robot_that_was_refused_is_counted_apart_from_one_that_fell():
    played = {"case": "plain", "toe_error_cm": 1.6, "toe_error_simulated_cm": 1.8, "ticks_with_0x01": 1, "ticks": 900}
    good = played | {"status": 0, "stood": True, "lies": True, "line": "done", "rule": ""}
    fell = played | {"status": 3, "stood": False, "lies": False, "line": "stopped", "rule": "falling"}
    late = played | {"status": 3, "stood": True, "lies": True, "line": "stopped", "rule": "step_late"}
    tilted = {"case": "plain", "status": 2, "stood": False, "lies": True, "line": "nothing was moved. IMU and legs"}
    broken = {"case": "plain", "status": 2, "stood": False, "lies": False, "line": "it said nothing"}
    rows = [good, good, fell, late, tilted, broken]
    assert [ended(row) for row in rows] == ["passed", "passed", "fell", "failed", "refused", "failed"]
    cells = [cell.strip() for cell in table(rows).splitlines()[-1].split("|")[1:-1]]
    assert cells[:3] == ["plain", "6", "2"]
    assert cells[3] == "1: 1 nothing was moved. IMU and legs"
    assert cells[4] == "1: 1 falling"
    assert cells[5] == "2: 1 step_late, 1 it said nothing"


@pytest.mark.slow
def test_same_commands_and_readings_give_the_same_error_flags_and_torques():
    try:
        require_built()
    except NotHere as reason:
        pytest.skip(str(reason))
    command = [sys.executable, "-m", "lab.stock_firmware", "compare"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=True)
    found = json.loads(done.stdout)
    assert found["cycles compared"] > 5000
    assert found["error flags that differ (bits: cycles)"] == {}
    assert set(found["cycles that differ by more than 0.001"].values()) == {0}
    assert {"0x00", "0x01", "0x04", "0x08", "0x10", "0x1b", "0x1e"} <= set(found["cycles by error flag"])

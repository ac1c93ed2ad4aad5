"""The player that needs no mimic does what mimic does."""

from __future__ import annotations

import ast
import dataclasses
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mimic.config.play import RunSettings
from mimic.control.loop import run_policy
from mimic.control.safety.supervisor import Supervisor
from mimic.control.tick import Safety
from mimic.io.assets import shipped
from mimic.policy.runtime import load_policy
from mimic.records import CommandTrack
from mimic.simulation.plant import SimulatedPlant

SCRIPT = Path(__file__).parents[2] / "examples" / "standalone_player.py"


@pytest.fixture(scope="module")
def player():
    spec = importlib.util.spec_from_file_location("standalone_player", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_it_is_short_and_needs_four_libraries():
    text = SCRIPT.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 110
    nodes = list(ast.walk(ast.parse(text)))
    imported = {name.name.split(".")[0] for node in nodes if isinstance(node, ast.Import) for name in node.names}
    assert not [node for node in nodes if isinstance(node, ast.ImportFrom)]
    assert imported - set(sys.stdlib_module_names) == {
        "mujoco",
        "numpy",
        "onnxruntime",
        "scipy",
    }


@pytest.fixture(params=["as shipped", pytest.param("held, with a clock that never fades", marks=pytest.mark.train)])
def policy(request, description, tmp_path) -> Path:
    """The shipped policy, and one with the same weights that is played in another way."""
    path = shipped("policies", "stand_track.onnx")
    if request.param == "as shipped":
        return path
    contract = dataclasses.replace(load_policy(None, description).contract, interpolate=False, clock_fade=0.0)
    onnx, onnx_file = pytest.importorskip("onnx"), pytest.importorskip("mimic.train.learning.onnx_file")
    onnx_file.write_policy(onnx.load(str(path)), contract, description, tmp_path / "other.onnx")
    return tmp_path / "other.onnx"


def test_it_plays_as_mimic_does(player, policy, description):
    held = not load_policy(policy, description).contract.interpolate
    seconds = 0.5 if held else 1.5  # the last bit of a float32 grows, with held actions faster
    toes = player.boxing(description.dt, seconds=seconds)
    scene = shipped("assets", "cyberdog2") / "scene.xml"
    _, q, quat, q_des = (np.array(column) for column in zip(*player.play(str(policy), str(scene), toes), strict=True))
    n = len(toes)
    track = CommandTrack(t=description.dt * np.arange(n), v=np.zeros((n, 2)), heading=np.zeros(n), p_BE=toes)
    plant = SimulatedPlant(description, samples=False)
    lying = np.r_[0.0, 0.0, description.pose_height["lie"] + 0.005, 1.0, 0.0, 0.0, 0.0, description.poses["lie"]]
    plant.start = lambda: plant.start_at(lying, np.zeros(18))  # the player begins in the crouch
    safety = Safety(supervisor=Supervisor(description, sits=False), ramp=0.0, damp_at_end=False)
    settings = RunSettings(hold_last=0.0, hold_position=False, lean_against_pulls=False)
    log = run_policy(plant, load_policy(policy, description), track, settings, safety=safety).log
    assert len(q) == len(log.t)
    for ours, theirs in ((log.q, q), (log.quat_WB, quat), (log.q_des, q_des)):
        assert np.abs(ours - theirs).max() < 1e-5
    assert np.ptp(log.p_BE_des[:, :, 0]) > 0.2


@pytest.mark.slow
def test_it_is_started_from_the_shell():
    scene = shipped("assets", "cyberdog2") / "scene.xml"
    command = [sys.executable, str(SCRIPT), str(shipped("policies", "stand_track.onnx")), str(scene)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    angles = [float(angle) for angle in re.findall(r"points +(-?\d+)° upward", done.stdout)]
    assert abs(angles[0]) < 10  # it lies
    assert min(angles[100:]) > 75  # it stands
    without = subprocess.run(command[:2], capture_output=True, text=True, timeout=60, check=False)
    assert without.returncode == 1
    assert without.stderr.startswith("Play a policy without mimic")

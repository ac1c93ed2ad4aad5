"""The whole loop with a robot that is hidden: log it, calibrate, and see whether the corrected model predicts it.

    python benchmarks/close_the_loop.py OUT [--seconds 40] [--episodes 10] [--look-for load_friction,stribeck]

A robot whose effects only this script knows hangs and is logged; ``mimic calibrate`` explains the log; then the shipped
policy is judged on the model as described, on the hidden robot, and on the corrected model. The corrected model is
worth something where its figures are those of the hidden robot. OUT/loop.json holds everything.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.evaluation import EvaluateSettings
from mimic.config.play import EffectsSettings
from mimic.config.sysid import CalibrateSettings, LogSettings
from mimic.dynamics.effect_set import EffectSet, EffectValues, write_effects
from mimic.dynamics.excitation import hung_ranges, probe_targets
from mimic.dynamics.machine import hung_robot
from mimic.evaluation.policy import evaluate
from mimic.io.assets import shipped
from mimic.io.joint_log import write_log
from mimic.records import JOINTS
from mimic.robot.description import load_description
from mimic.sysid.calibrate import calibrate
from mimic.sysid.log.checks import check_log
from mimic.sysid.predict import simulate_log

HIDDEN = EffectSet(
    (
        EffectValues(name="load_friction", joints=JOINTS, values={"ratio": 0.15}, source="made up"),
        EffectValues(name="delay", values={"time": 0.02}, source="made up"),
    )
)
"""Gears that lose a seventh of the torque, and later commands than described."""

FIGURES = (
    "stood_up_and_kept",
    "stand_up_median_s",
    "nominal_toe_error_cm",
    "nominal_drift_m",
    "nominal_knee_torque_rms_nm",
    "nominal_falls",
)


def main() -> None:
    """Run the loop and write OUT/loop.json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, default=40.0, help="length of the log")
    parser.add_argument("--episodes", type=int, default=10, help="randomised episodes of an evaluation")
    parser.add_argument("--look-for", default="", help="effects that may be named; by default the whole catalogue")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    hidden = write_effects(HIDDEN, options.out / "hidden.toml")

    machine, description = hung_robot(load_description()), load_description()
    moved = probe_targets(*hung_ranges(description), seconds=options.seconds, seed=0)
    log = simulate_log(machine, moved.t, moved.q_des, HIDDEN, LogSettings())
    write_log(log, options.out / "probe.parquet")
    begin = time.monotonic()
    facts = check_log(log, np.stack([machine.low, machine.high], -1), torque=np.asarray(machine.drives.torque))
    settings = CalibrateSettings(effects=tuple(filter(None, options.look_for.split(","))))
    found = calibrate(facts.log, machine, settings, lambda text, count: None)
    seconds = time.monotonic() - begin
    corrected = write_effects(found.effects, options.out / "effects.toml", (found.sentence,))
    sys.stderr.write(f"{found.sentence}\n{found.replays} replays, {seconds:.0f} s\n")

    policy = shipped("policies", "stand_track.onnx")
    described = EffectSet((EffectValues(name="delay", values={"time": description.delay}),))
    steps = write_effects(described, options.out / "described.toml")
    robots = {"described": None, "described, in steps of 2.5 ms": steps, "hidden": hidden, "corrected": corrected}
    result: dict[str, Any] = {"sentence": found.sentence, "replays": found.replays, "calibration_s": seconds}
    for name, effects in robots.items():
        robot = EffectsSettings(effects=None if effects is None else str(effects))
        judged = evaluate(policy, EvaluateSettings(episodes=options.episodes, seconds=10.0, robot=robot))
        result[name] = judged["summary"]
        figures = ", ".join(f"{key} {judged['summary'][key]:.3g}" for key in FIGURES)
        sys.stderr.write(f"{name}: {figures}\n")
    (options.out / "loop.json").write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()

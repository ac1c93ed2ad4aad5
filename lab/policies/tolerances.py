"""How long a robot stands without readings or commands: what the tolerances of the safety rules rest on.

python -m lab.policies.tolerances OUT.json [robots for each case]

Each run is an emulated robot that stands, follows random commands and meets one fault, with no rule to end the run.
Its true orientation a second and a half after the fault says whether it still stands.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from mimic.config.emulator import EmulateSettings
from mimic.config.play import RunSettings
from mimic.control.loop import run_policy
from mimic.control.recorder import RunRecorder
from mimic.control.supervisor import Supervisor
from mimic.control.tick import Safety
from mimic.emulator.faults import parse_fault
from mimic.emulator.link import EmulatedLink
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import MimicError
from mimic.evaluation.policy import command_script
from mimic.hardware.plant import CanRobot
from mimic.hardware.wiring import load_wiring
from mimic.io import store
from mimic.metrics import uprightness
from mimic.policy.runtime import load_policy
from mimic.robot.description import load_description

TIMING = RunSettings(stand_up=1.0, blend=0.5, hold_last=0.1)

AFTER = 1.5
"""How long it goes on after the fault has passed [s]."""

CASES = {
    "no orientation": ("imu_silent", (0.06, 0.1, 0.15, 0.2, 0.3)),
    "bus broken": ("unplugged", (0.04, 0.06, 0.1, 0.15, 0.2)),
    "bus held back": ("stalled", (0.06, 0.1, 0.15, 0.2)),
    "one motor mute": ("motor_mute:RL_knee", (0.06, 0.1, 0.2)),
    "all frames late": ("frames_late", (0.005, 0.01, 0.02, 0.03, 0.04)),
}
"""Name -> fault, and how long it lasts [s]; for frames that are late, by how much, without an end."""


def stands(fault: str, seed: int, folder: Path) -> bool:
    """Return whether a robot still stands after a fault, {begin} in it being its begin and {end} its end."""
    description, rng = load_description(), np.random.default_rng([seed, 43])
    begin = 2.5 + float(rng.uniform(0.0, 0.8))
    kind, _, seconds = fault.partition("~")
    late = kind.startswith("frames_late")
    text = f"{kind}={seconds}@+{begin}" if late else f"{kind}@+{begin}-{begin + float(seconds)}"
    settings = EmulateSettings(zeroed=True, placement=0.03, seed=seed)
    robot = EmulatedRobot(description, load_wiring(), settings, faults=[parse_fault(text)])
    link = EmulatedLink(robot)
    link.sleep(0.3)
    plant = CanRobot(link, load_wiring(), description, outage=10.0)
    policy = load_policy(None, description)
    supervisor = Supervisor(description, rules=())
    recorder = RunRecorder(folder, policy.contract.observation_size, {})
    safety = Safety(supervisor=supervisor, recorder=recorder, ramp=0.5, damp_at_end=False)
    seen: list[float] = []
    track = command_script(description, begin - 2.0 + AFTER, rng)
    sink = lambda tick: seen.append(float(uprightness(robot.body.base()[0], description)))  # noqa: E731
    try:
        run_policy(plant, policy, track, TIMING, sink=sink, safety=safety)
    except MimicError:
        return False
    finally:
        recorder.close()
    return bool(seen) and seen[-1] > description.safety.upright


def main() -> None:
    out, robots = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 10
    found: dict[str, dict[str, str]] = {}
    with tempfile.TemporaryDirectory() as name:
        for case, (kind, lengths) in CASES.items():
            for seconds in lengths:
                stood = sum(stands(f"{kind}~{seconds}", seed, Path(name)) for seed in range(1, robots + 1))
                found.setdefault(case, {})[f"{1e3 * seconds:g} ms"] = f"{stood} of {robots}"
                print(f"{case:18s} {1e3 * seconds:5.0f} ms: {stood} of {robots} stood", flush=True)
                store.save_json(found, out)


if __name__ == "__main__":
    main()

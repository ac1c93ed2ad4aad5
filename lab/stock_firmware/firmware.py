"""Runs the maker's firmware, built elsewhere, and its bench beside whatever speaks to them."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType

import mujoco
import numpy as np

ROOT = Path(__file__).parents[2]

PLACE = "MIMIC_FIRMWARE"
"""Environment variable: folder of the built firmware: `run.sh`, which runs a command in a network namespace,
`build/firmware/control/user/cyberdog_control`, and the bench, `build/bench.mimic`, which plays the simulator's part
with a MuJoCo model (.xml, .mjb) and takes --gains, --delay, --imu-lag, --seed, --push and --noise."""

INSIDE = "MIMIC_FIRMWARE_NETWORK"
"""Set inside the network of the bench, which reaches nothing else."""

REAL_TIME = ("chrt", "-f", "5") if os.geteuid() == 0 else ("nice", "-n", "0")
"""Bench and firmware run before other work where that is allowed: a robot's board does nothing else either."""


class NotHere(Exception):
    """The firmware is not here or cannot run here; says why."""


def require_built() -> Path:
    """Return the folder of the built firmware and bench.

    Raises:
        NotHere: If it is not built.
    """
    folder = Path(os.environ.get(PLACE, ""))
    if not os.environ.get(PLACE) or not (folder / "build" / "bench.mimic").is_file():
        given = f"{folder} has no build/bench.mimic" if os.environ.get(PLACE) else "it is not set"
        raise NotHere(f"{PLACE} must name the folder of the built firmware and bench; {given}")
    if subprocess.run([folder / "run.sh", "true"], capture_output=True, check=False).returncode:
        raise NotHere("this computer gives no network namespace to its user (unshare), which keeps messages here")
    return folder


def inside_network(arguments: list[str]) -> int | None:
    """Run this command again inside a network of its own; return its exit status, or None if it is there already."""
    if os.environ.get(INSIDE):
        return None
    return subprocess.run(through_network(arguments), cwd=ROOT, check=False).returncode


def through_network(arguments: list[str]) -> list[str]:
    """Return the command that runs this benchmark with other arguments inside a network of its own."""
    return [
        "env",
        f"{INSIDE}=1",
        str(require_built() / "run.sh"),
        sys.executable,
        "-m",
        "lab.stock_firmware",
        *arguments,
    ]


class Bench:
    """The firmware in lockstep with a model, in real time; for a with statement."""

    def __init__(self, folder: Path, work: Path, model: Path, *options: str) -> None:
        work.mkdir(parents=True, exist_ok=True)
        self.csv, self._log = work / "bench.csv", work / "bench.log"
        program = folder / "build" / "firmware" / "control" / "user" / "cyberdog_control"
        command = [*REAL_TIME, folder / "build" / "bench.mimic", "--model", model, "--firmware", program]
        command += ["--log", self.csv, "--firmware-log", work / "firmware.log", *options]
        self._command = [str(word) for word in command]

    def __enter__(self) -> Bench:
        with self._log.open("w") as log:
            self._process = subprocess.Popen(self._command, stdout=log, stderr=subprocess.STDOUT)
        end = time.monotonic() + 30.0
        while "\nt " not in self.text():
            if self._process.poll() is not None or time.monotonic() > end:
                raise NotHere(f"the bench does not run: {self.text().strip()[-300:]}")
            time.sleep(0.1)
        return self

    def __exit__(self, kind: type[BaseException] | None, value: object, trace: TracebackType | None) -> None:
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def text(self) -> str:
        """Return what the bench has printed."""
        return self._log.read_text(errors="replace") if self._log.is_file() else ""

    def height(self) -> float:
        """Return the height of the trunk as printed last [m]."""
        whole = self.text().rpartition("\n")[0]  # the last line may be half written
        lines = [line for line in whole.splitlines() if line.startswith("t ")]
        return float(lines[-1].split(" z ")[1].split()[0])

    def count(self) -> int:
        """Return how many rows the record has; quick, unlike reading them."""
        return self.csv.read_bytes().count(b"\n") - 1

    def rows(self) -> dict[str, np.ndarray]:
        """Return the columns of the bench's own record of the model, 100 rows a second."""
        with self.csv.open() as file:
            rows = [row for row in csv.DictReader(file) if None not in row.values()]
        return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def upright(rows: dict[str, np.ndarray]) -> np.ndarray:
    """Return the up component of the base's x axis."""
    return 2.0 * (rows["qx"] * rows["qz"] - rows["qw"] * rows["qy"])


def save_model(model: mujoco.MjModel, path: Path) -> Path:
    """Write a compiled model."""
    mujoco.mj_saveModel(model, str(path), None)
    return path

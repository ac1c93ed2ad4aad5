"""Builds the maker's firmware and its bench, and runs them beside whatever speaks to them."""

from __future__ import annotations

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType

import mujoco
import numpy as np

ROOT = Path(__file__).parents[2]

SOURCE = ROOT.parent / "shared" / "firmware"
"""Tarball of the firmware, bench and scripts."""

PLACE = "MIMIC_FIRMWARE"
"""Environment variable: folder of a copy of SOURCE to build in, or that is built."""

INSIDE = "MIMIC_FIRMWARE_NETWORK"
"""Set inside the network of the bench, which reaches nothing else."""

EXTENSIONS = (
    (
        "mjModel* m             = mj_loadXML( o.model.c_str(), nullptr, error, sizeof error );",
        'bool     compiled      = o.model.size() > 4 && o.model.substr( o.model.size() - 4 ) == ".mjb";\n'
        "    mjModel* m             = compiled ? mj_loadModel( o.model.c_str(), nullptr )"
        " : mj_loadXML( o.model.c_str(), nullptr, error, sizeof error );",
    ),
    (
        "bool        hang = false, attach = false;",
        "bool        hang = false, attach = false;\n    std::string gains;\n"
        "    int         delay = 0, imu_lag = 0, seed = 0;\n"
        "    double      push = 0, noise[ 4 ] = { 0, 0, 0, 0 };",
    ),
    (
        'else if ( a == "--spi" ) o.spi = v;',
        'else if ( a == "--gains" ) o.gains = v;\n        else if ( a == "--delay" ) o.delay = atoi( v.c_str() );\n'
        '        else if ( a == "--imu-lag" ) o.imu_lag = atoi( v.c_str() );\n'
        '        else if ( a == "--seed" ) o.seed = atoi( v.c_str() );\n'
        '        else if ( a == "--push" ) o.push = atof( v.c_str() );\n'
        '        else if ( a == "--noise" )\n'
        '            sscanf( v.c_str(), "%lf,%lf,%lf,%lf", o.noise, o.noise + 1, o.noise + 2, o.noise + 3 );\n'
        '        else if ( a == "--spi" ) o.spi = v;',
    ),
    (
        "const SpiCommand c = out.spiCommand;",
        "static std::deque< SpiCommand > waiting;\n        waiting.push_back( out.spiCommand );\n"
        "        const SpiCommand c = waiting.front();\n"
        "        if ( ( int )waiting.size() > o.delay ) waiting.pop_front();",
    ),
    (
        "double want = cp[ k ][ l ] * ( cq[ k ][ l ] - qq ) + cd[ k ][ l ] * ( cv[ k ][ l ] - vv ) + ct[ k ][ l ];",
        "double want = factor[ 0 ][ i ] * cp[ k ][ l ] * ( cq[ k ][ l ] - qq )"
        " + factor[ 1 ][ i ] * cd[ k ][ l ] * ( cv[ k ][ l ] - vv ) + ct[ k ][ l ];",
    ),
    (
        "long   tick = 0, late = 0;",
        "double factor[ 2 ][ 12 ];\n"
        "    for ( int i = 0; i < 24; i++ ) factor[ i / 12 ][ i % 12 ] = 1;\n"
        "    for ( size_t i = 0, at = 0; i < 24 && !o.gains.empty() && at != std::string::npos; i++ ) {\n"
        "        factor[ i / 12 ][ i % 12 ] = atof( o.gains.c_str() + at );\n"
        "        at = o.gains.find( ',', at );\n"
        "        if ( at != std::string::npos ) at++;\n"
        "    }\n"
        "    long   tick = 0, late = 0;",
    ),
    ("#include <cstdlib>", "#include <cstdlib>\n#include <deque>\n#include <random>"),
    (
        "        in.cheater_state.orientation << q[ 0 ], q[ 1 ], q[ 2 ], q[ 3 ];\n",
        "        in.cheater_state.orientation << q[ 0 ], q[ 1 ], q[ 2 ], q[ 3 ];\n"
        "        static std::mt19937 draw( o.seed );\n"
        "        auto around = [ & ]( double half ) {\n"
        "            return half > 0 ? std::uniform_real_distribution<>( -half, half )( draw ) : 0.0;\n"
        "        };\n"
        "        mjtNum turn[ 4 ] = { 1, around( o.noise[ 2 ] ) / 2, around( o.noise[ 2 ] ) / 2,"
        " around( o.noise[ 2 ] ) / 2 }, seen[ 4 ];\n"
        "        mju_normalize4( turn );\n"
        "        mju_mulQuat( seen, q, turn );\n"
        "        in.vectorNav.quat << seen[ 1 ], seen[ 2 ], seen[ 3 ], seen[ 0 ];\n"
        "        for ( int k = 0; k < 3; k++ ) in.vectorNav.gyro[ k ] += around( o.noise[ 3 ] );\n"
        "        static std::deque< std::decay_t< decltype( in.vectorNav ) > > felt;\n"
        "        felt.push_back( in.vectorNav );\n"
        "        if ( ( int )felt.size() > o.imu_lag + 1 ) felt.pop_front();\n"
        "        in.vectorNav = felt.front();\n"
        "        static double next_push = 5.0;\n"
        "        if ( o.push > 0 && tick * TICK >= next_push ) {\n"
        "            double way = around( M_PI ), speed = o.push * ( 1 + around( 1 ) ) / 2;\n"
        "            d->qvel[ 0 ] += speed * cos( way ), d->qvel[ 1 ] += speed * sin( way );\n"
        "            next_push += 5.0 + ( 1 + around( 1 ) ) / 8;\n"
        "        }\n",
    ),
    (
        "qs[ k ][ l ]      = SIGN[ k ] * d->qpos[ qadr[ i ] ];",
        "qs[ k ][ l ]      = SIGN[ k ] * d->qpos[ qadr[ i ] ] + around( o.noise[ 0 ] );",
    ),
    (
        "vs[ k ][ l ]      = SIGN[ k ] * d->qvel[ vadr[ i ] ];",
        "vs[ k ][ l ]      = SIGN[ k ] * d->qvel[ vadr[ i ] ] + around( o.noise[ 1 ] );",
    ),
)
"""Additions to the bench: compiled models (.mjb), factors on the gains of each motor, a delay of commands in ticks; a
push of the trunk up to so many m/s every 5 s; half widths of the noise of joint positions [rad], velocities [rad/s],
orientation about each axis [rad] and rate of turn [rad/s], drawn each tick; a lag of the IMU in ticks."""


REAL_TIME = ("chrt", "-f", "5") if os.geteuid() == 0 else ("nice", "-n", "0")
"""Bench and firmware run before other work where that is allowed: a robot's board does nothing else either."""


class NotHere(Exception):
    """The firmware cannot be built or run here; says why."""


def place() -> Path:
    """Return the folder in which the firmware is built."""
    given = os.environ.get(PLACE)
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(given) if given else base / "mimic" / "stock_firmware"


def require_built() -> Path:
    """Return the folder of the built firmware with the extended bench.

    Raises:
        NotHere: If it is not built.
    """
    folder = place()
    if not (folder / "build" / "bench.mimic").is_file():
        raise NotHere(f"the maker's firmware is not built in {folder}; run: python -m lab.stock_firmware build")
    if subprocess.run([folder / "run.sh", "true"], capture_output=True, check=False).returncode:
        raise NotHere("this computer gives no network namespace to its user (unshare), which keeps messages here")
    return folder


def build() -> Path:
    """Build firmware and bench, if that is not done, and return the folder.

    Raises:
        NotHere: If the sources are absent or it cannot be built.
    """
    folder = place()
    if not (folder / "build" / "bench").is_file():
        if not (folder / "build.sh").is_file():
            if not SOURCE.is_dir():
                raise NotHere(f"there is no {SOURCE} with the maker's firmware")
            shutil.copytree(SOURCE, folder, dirs_exist_ok=True)
        print(f"building in {folder}, some 7 minutes", flush=True)
        own = str(Path(sys.executable).parent)  # whose lcm-gen, of the package from PyPI, writes another C++
        path = os.pathsep.join(p for p in os.environ.get("PATH", "").split(os.pathsep) if p != own)
        if subprocess.run(
            ["nice", "-n", "15", "./build.sh"], cwd=folder, env=os.environ | {"PATH": path}, check=False
        ).returncode:
            raise NotHere(f"building in {folder} failed; see build/*.log there")
    original = (folder / "bench.cpp").read_text(encoding="utf-8")
    extended = original
    for before, after in EXTENSIONS:
        if extended.count(before) != 1:
            raise NotHere(f"the bench in {folder} is another one: it lacks {before!r}")
        extended = extended.replace(before, after)
    script = (folder / "build.sh").read_text(encoding="utf-8")
    compile_bench = script[script.index("mj=$(") : script.index('echo "built')]
    compile_bench = compile_bench.replace("bench.cpp -o build/bench", "build/bench.mimic.cpp -o build/bench.mimic")
    (folder / "build" / "bench.mimic.cpp").write_text(extended, encoding="utf-8")
    subprocess.run(["nice", "-n", "15", "sh", "-ec", compile_bench], cwd=folder, check=True)
    return require_built()


def inside_network(arguments: list[str]) -> int | None:
    """Run this command again inside a network of its own; return its exit status, or None if it is there already."""
    if os.environ.get(INSIDE):
        return None
    return subprocess.run(through_network(arguments), cwd=ROOT, check=False).returncode


def through_network(arguments: list[str]) -> list[str]:
    """Return the command that runs this benchmark with other arguments inside a network of its own."""
    inside = ["env", f"{INSIDE}=1", f"PYTHONPATH={ROOT}"]
    return [*inside, str(require_built() / "run.sh"), sys.executable, "-m", "lab.stock_firmware", *arguments]


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
        lines = [line for line in self.text().splitlines() if line.startswith("t ")]
        return float(lines[-1].split(" z ")[1].split()[0])

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

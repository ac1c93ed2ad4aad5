"""What this computer has for mimic: libraries, graphics, camera, CAN, multicast and the pose model; nothing moves."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mimic.errors import MimicError, install_line
from mimic.version import __version__

EXTRAS = {
    "train": ("torch", "mujoco_warp", "rsl_rl"),
    "language": ("openai",),
    "stock": ("lcm",),
    "go2": ("cyclonedds",),
    "env": ("gymnasium",),
    "mcap": ("mcap_ros2",),
    "ray": ("ray",),
    "c3d": ("ezc3d",),
}
"""Extra -> the modules that it adds."""

LIBRARIES = (
    "apt-get install libgl1 libglib2.0-0 libgomp1; pip install --force-reinstall --no-deps opencv-python-headless does "
    "without libGL"
)
"""What brings the libraries of the system that OpenCV and Pinocchio need."""
NETWORKS = Path("/sys/class/net")
"""Where Linux lists network interfaces; those of CAN have type 280."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """One thing that was looked at."""

    name: str
    ok: bool
    text: str
    """What there is."""
    fix: str = ""
    """The line that fixes it; empty where nothing is missing."""
    needed: bool = False
    """Whether playing a video in simulation needs it."""


def examine() -> Iterator[Finding]:
    """Yield one finding after the other; none of them raises."""
    yield Finding(name="mimic", ok=True, text=f"{__version__}, Python {sys.version.split()[0]}, {sys.platform}")
    for look in (_libraries, _opencv, _pose_model, _pictures, _gpu, _camera, _can, _multicast):
        try:
            yield look()
        except Exception as error:  # a diagnosis goes on
            name = look.__name__.strip("_").replace("_", " ")
            yield Finding(name=name, ok=False, text=f"{type(error).__name__}: {error}")
    for extra, modules in EXTRAS.items():
        missing = [module for module in modules if importlib.util.find_spec(module) is None]
        text = f"without {', '.join(missing)}" if missing else "installed"
        yield Finding(name=f"extra {extra}", ok=not missing, text=text, fix=install_line(extra) * bool(missing))


def _libraries() -> Finding:
    names = ("mujoco", "onnxruntime", "mediapipe", "rerun-sdk")
    text = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names)
    return Finding(name="libraries", ok=True, text=text, needed=True)


def _opencv() -> Finding:
    """OpenCV ships in variants that overwrite each other; those with windows need libGL."""
    try:
        cv2 = importlib.import_module("cv2")
    except ImportError as error:
        return Finding(name="opencv", ok=False, text=str(error), fix=LIBRARIES, needed=True)
    return Finding(name="opencv", ok=True, text=cv2.__version__, needed=True)


def _pose_model() -> Finding:
    from mimic.sources.video.pose_models.pose_model import is_here

    if is_here():
        return Finding(name="pose model", ok=True, text="on this computer")
    fix = "downloaded at the first video (36 MB); without a network: --pose-model FILE"
    return Finding(name="pose model", ok=False, text="not on this computer", fix=fix)


def _run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python code in a process of its own: a graphics driver may end it."""
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )


def _pictures() -> Finding:
    """Which way of MuJoCo to draw films works here."""
    code = (
        "import mujoco; c = mujoco.GLContext(64, 64); c.make_current(); from OpenGL import GL; "
        "print(GL.glGetString(GL.GL_RENDERER).decode())"
    )
    given = os.environ.get("MUJOCO_GL", "")
    for way in [given] if given else ["egl", "osmesa"]:
        done = _run(code, MUJOCO_GL=way, PYOPENGL_PLATFORM=way if way in ("egl", "osmesa") else "")
        if done.returncode == 0:
            return Finding(name="graphics", ok=True, text=f"MUJOCO_GL={way}: {done.stdout.strip()}")
    fix = "apt-get install libegl1 libgl1-mesa-dri libosmesa6 (films only; everything else works)"
    return Finding(name="graphics", ok=False, text=f"MuJoCo cannot draw (MUJOCO_GL={given or 'unset'})", fix=fix)


def _gpu() -> Finding:
    """Return the graphics cards that the driver lists."""
    try:
        done = subprocess.run(
            ["nvidia-smi", "--query-gpu=name,memory.total", "--format=csv,noheader"],
            capture_output=True,
            text=True,
            timeout=20.0,
            check=False,
        )
    except FileNotFoundError:
        return Finding(name="gpu", ok=False, text="none", fix="mimic train needs an NVIDIA card and its driver")
    cards = "; ".join(done.stdout.strip().splitlines())
    return Finding(name="gpu", ok=done.returncode == 0, text=cards or done.stderr.strip() or "none")


def _camera() -> Finding:
    found = sorted(str(path) for path in Path("/dev").glob("video[0-9]*"))
    if not found and sys.platform != "linux":
        return Finding(name="camera", ok=True, text="try: mimic --camera 0 --sim")
    barred = [name for name in found if not os.access(name, os.R_OK | os.W_OK)]
    if barred:
        return Finding(name="camera", ok=False, text=f"no right to {barred[0]}", fix="usermod -aG video $USER")
    fix = "" if found else "plug one in; a video file can stand in: mimic --camera clip.mp4 --sim"
    return Finding(name="camera", ok=bool(found), text=", ".join(found) or "none", fix=fix)


def _can() -> Finding:
    """CAN interfaces of the kernel and serial adapters."""
    can = [path for path in NETWORKS.glob("*") if _text(path / "type") == "280"] if NETWORKS.is_dir() else []
    down = [path.name for path in can if _text(path / "operstate") == "down"]
    serial = sorted(str(path) for path in Path("/dev").glob("ttyACM*"))
    found = [path.name for path in can] + [f"slcan:{name}" for name in serial]
    if down:
        fix = f"ip link set {down[0]} up type can bitrate 1000000"
        return Finding(name="CAN adapter", ok=False, text=f"{down[0]} is down", fix=fix)
    fix = "" if found else "plug an adapter in; to rehearse without a robot: mimic emulate"
    return Finding(name="CAN adapter", ok=bool(found), text=", ".join(found) or "none", fix=fix)


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8").strip() if path.is_file() else ""


def _multicast() -> Finding:
    """Where messages to a stock robot would leave this computer."""
    from mimic.hardware.stock.lcm_bus import check_network
    from mimic.hardware.stock.wiring import load_board

    try:
        return Finding(name="multicast route", ok=True, text=check_network(load_board(), None)[0])
    except MimicError as reason:
        text, _, fix = str(reason).partition("; ")
        return Finding(name="multicast route", ok=False, text=text, fix=fix)

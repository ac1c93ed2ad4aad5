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


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at."""

    name: str
    ok: bool
    text: str
    """What there is."""
    fix: str = ""
    """The line that fixes it; empty where nothing is missing."""

    @property
    def needed(self) -> bool:
        """Whether playing a video in simulation needs it."""
        return self.name in NEEDED


NEEDED = ("libraries", "opencv")
"""What playing a video in simulation needs."""

Found = tuple[bool, str, str]
"""Whether something is there, what there is, and the line that fixes it."""


def examine() -> Iterator[Finding]:
    """Yield one finding after the other; none of them raises."""
    yield Finding("mimic", True, f"{__version__}, Python {sys.version.split()[0]}, {sys.platform}")
    for name, look in LOOKS.items():
        try:
            yield Finding(name, *look())
        except Exception as error:  # a diagnosis goes on
            yield Finding(name, False, f"{type(error).__name__}: {error}")
    for extra, modules in EXTRAS.items():
        missing = [module for module in modules if importlib.util.find_spec(module) is None]
        text = f"without {', '.join(missing)}" if missing else "installed"
        yield Finding(f"extra {extra}", not missing, text, install_line(extra) * bool(missing))


def _libraries() -> Found:
    names = ("mujoco", "onnxruntime", "mediapipe", "rerun-sdk")
    return True, ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names), ""


def _opencv() -> Found:
    """OpenCV ships in variants that overwrite each other; those with windows need libGL."""
    try:
        return True, importlib.import_module("cv2").__version__, ""
    except ImportError as error:
        return False, str(error), LIBRARIES


def _pose_model() -> Found:
    from mimic.sources.video.pose_models.pose_model import is_here

    if is_here():
        return True, "on this computer", ""
    fix = "downloaded at the first video (36 MB); without a network: --pose-model FILE"
    return False, "not on this computer", fix


def _run(*command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a program: a graphics driver may end its process."""
    own = {**os.environ, **environment}
    return subprocess.run(command, env=own, capture_output=True, text=True, timeout=60.0, check=False)


def _pictures() -> Found:
    """Which way of MuJoCo to draw films works here."""
    code = (
        "import mujoco; c = mujoco.GLContext(64, 64); c.make_current(); from OpenGL import GL; "
        "print(GL.glGetString(GL.GL_RENDERER).decode())"
    )
    given = os.environ.get("MUJOCO_GL", "")
    for way in [given] if given else ["egl", "osmesa"]:
        platform = way if way in ("egl", "osmesa") else ""
        done = _run(sys.executable, "-c", code, MUJOCO_GL=way, PYOPENGL_PLATFORM=platform)
        if done.returncode == 0:
            return True, f"MUJOCO_GL={way}: {done.stdout.strip()}", ""
    fix = "apt-get install libegl1 libgl1-mesa-dri libosmesa6 (films only; everything else works)"
    return False, f"MuJoCo cannot draw (MUJOCO_GL={given or 'unset'})", fix


def _gpu() -> Found:
    """Return the graphics cards that the driver lists."""
    try:
        done = _run("nvidia-smi", "--query-gpu=name,memory.total", "--format=csv,noheader")
    except FileNotFoundError:
        return False, "none", "mimic train needs an NVIDIA card and its driver"
    cards = "; ".join(done.stdout.strip().splitlines())
    return done.returncode == 0, cards or done.stderr.strip() or "none", ""


def _camera() -> Found:
    found = sorted(str(path) for path in Path("/dev").glob("video[0-9]*"))
    if not found and sys.platform != "linux":
        return True, "try: mimic --camera 0 --sim", ""
    barred = [name for name in found if not os.access(name, os.R_OK | os.W_OK)]
    if barred:
        return False, f"no right to {barred[0]}", "usermod -aG video $USER"
    fix = "plug one in; a video file can stand in: mimic --camera clip.mp4 --sim"
    return bool(found), ", ".join(found) or "none", "" if found else fix


def _can() -> Found:
    """CAN interfaces of the kernel and serial adapters."""
    can = [path for path in NETWORKS.glob("*") if _text(path / "type") == "280"]
    down = [path.name for path in can if _text(path / "operstate") == "down"]
    if down:
        return False, f"{down[0]} is down", f"ip link set {down[0]} up type can bitrate 1000000"
    serial = sorted(str(path) for path in Path("/dev").glob("ttyACM*"))
    found = [path.name for path in can] + [f"slcan:{name}" for name in serial]
    fix = "plug an adapter in; to rehearse without a robot: mimic emulate"
    return bool(found), ", ".join(found) or "none", "" if found else fix


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8").strip() if path.is_file() else ""


def _multicast() -> Found:
    """Where messages to a stock robot would leave this computer."""
    from mimic.hardware.stock.lcm_bus import check_network
    from mimic.hardware.stock.wiring import load_board

    try:
        return True, check_network(load_board(), None)[0], ""
    except MimicError as reason:
        text, _, fix = str(reason).partition("; ")
        return False, text, fix


LOOKS = {
    "libraries": _libraries,
    "opencv": _opencv,
    "pose model": _pose_model,
    "graphics": _pictures,
    "gpu": _gpu,
    "camera": _camera,
    "CAN adapter": _can,
    "multicast route": _multicast,
}
"""What is looked at, in this order."""

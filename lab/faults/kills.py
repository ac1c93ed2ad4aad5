"""One process of a run, or what is between, is killed or stopped at a random moment: when is the last motor damped?

The emulated robot runs in this process, `mimic --robot` and the process that sends are others; before the robot stands
a server or network that may be gone for 1 or 5 s (killed) or keep everything back for as long (stopped).
Needed: damped within 0.15 s of a process that ends and 0.35 s of one that hangs, or of a server that is back.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from lab.faults.processes import HELPER, Process, helper_of, incomplete, lines_in, send_signals, traceback_in
from lab.faults.proxies import LcmProxy, TcpProxy, wiring_through
from mimic.config.emulator import EmulateSettings
from mimic.control.priority import EMULATOR, real_time
from mimic.emulator.boards.board import EmulatedBoard
from mimic.emulator.boards.board_server import BoardServer
from mimic.emulator.boards.go2 import EmulatedGo2
from mimic.emulator.robot import EmulatedRobot
from mimic.emulator.server import EmulatorServer
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.go2.dds_bus import DdsBus
from mimic.hardware.go2.wiring import load_go2
from mimic.hardware.stock.lcm_bus import LcmBus
from mimic.hardware.stock.wiring import load_board
from mimic.robot.description import load_description

WITHIN = {"killed": 0.15, "stopped": 0.35}
"""A robot is damped this long after a process ends or hangs [s]."""

WATCHED = 4.0
"""For how long motors are watched afterwards [s]."""

RUNS = 14.0
"""A run lasts about so long from the first driven motor on [s]: joints are tested, it stands up, and sits down."""

HANG = 60.0
"""[s]"""

CUT_BY = {
    ("can", "killed"): "refuses",
    ("can", "stopped"): "stalls",
    ("stock", "killed"): "cuts",
    ("stock", "stopped"): "cuts",
}
"""What the proxy does, by the robot and what becomes of the server."""


class Scene:
    """An emulated robot in a thread, and what is between it and `mimic`."""

    def __init__(self, robot: str, seed: int, work: Path, stack: ExitStack) -> None:
        settings = EmulateSettings(zeroed=True, placement=0.02, seed=seed)
        description = load_description("go2" if robot == "go2" else "cyberdog2")
        self.server: Any
        self.proxy: TcpProxy | LcmProxy | None = None
        if robot == "can":
            self.robot: Any = EmulatedRobot(description, load_wiring(), settings)
            self.server = EmulatorServer(self.robot)
            port = int(self.server.addresses[0].split(":")[2].split("/")[0])
            self.proxy = stack.enter_context(TcpProxy(port, seed))
            self.words = [f"socketcand://127.0.0.1:{self.proxy.port}/can0", "--zeroed"]
        elif robot == "stock":
            self.robot = EmulatedBoard(description, load_board(), settings)
            self.server = BoardServer(self.robot, LcmBus(load_board(), 0))
            self.proxy = stack.enter_context(LcmProxy(seed))
            self.words = ["cyberdog2", "--interface", "lo", "--wiring", str(wiring_through(work / "board.toml"))]
        else:
            self.robot = EmulatedGo2(description, load_go2(), settings)
            with real_time(EMULATOR, inherited=True):  # also for the threads in which its network receives
                self.server = BoardServer(self.robot, DdsBus(load_go2(), "lo", robot=True))
            self.words = ["go2", "--interface", "lo"]
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        with real_time(EMULATOR):
            self.server.run(self._over.is_set)
        self.server.close()

    def driven(self) -> bool:
        """Return whether a motor has stiffness or torque."""
        return bool(self.robot.driven())

    def last_driven(self, begin: float, end: float) -> float:
        """Watch the motors until a time [s], and return when one was last driven; ``begin`` where none was."""
        last = begin
        while time.monotonic() < end:
            if self.driven():
                last = time.monotonic()
            time.sleep(0.001)
        return last

    def close(self) -> None:
        self._over.set()
        self._thread.join(10.0)


def play(robot: str, seed: int, motion: Path, work: Path) -> dict[str, Any]:
    """Play a run, and return what was done to which process, when the motors were damped, and how the run ended."""
    rng = np.random.default_rng([seed, 83, len(robot)])
    who = str(rng.choice(["loop", "sender"] if robot == "go2" else ["loop", "sender", "server"]))
    how, after = str(rng.choice(["killed", "stopped"])), float(rng.uniform(0.1, RUNS))
    lasts = float(rng.choice([1.0, 5.0])) if who == "server" else 0.0
    row: dict[str, Any] = {"robot": robot, "seed": seed, "who": who, "how": how, "at": round(after, 2), "lasts": lasts}
    with ExitStack() as stack:
        scene = Scene(robot, seed, work, stack)
        stack.callback(scene.close)
        words = [str(motion), "--robot", *scene.words, "--yes", "--no-view", "-o", str(work / "run")]
        host = stack.enter_context(Process(work / "said.txt", *words))
        pid = host.process.pid
        _await_driven(scene, host)
        time.sleep(after)
        row["driven_before"] = scene.driven()
        target = pid if who == "loop" else helper_of(pid, HELPER)
        began = time.monotonic()
        if who == "server" and scene.proxy is not None:
            scene.proxy.disturb(CUT_BY[robot, how], lasts=lasts)
        else:
            send_signals([target], signal.SIGKILL if how == "killed" else signal.SIGSTOP)
        back = began + lasts
        last = scene.last_driven(back, back + WATCHED)
        send_signals([pid, target], signal.SIGCONT)
        row["hung"] = not host.end(HANG)
        row["status"] = host.process.returncode
        row["driven_after"] = scene.driven()
    stopped = back + WATCHED - began if who == "loop" and how == "stopped" else 0.0
    row["damped_after"] = round(last - back, 3)
    row["undamped"] = bool(row["driven_before"] and row["damped_after"] > WITHIN[how]) or row["driven_after"]
    row["traceback"] = traceback_in(host.said)
    gone = began if (who, how) == ("loop", "killed") else None
    row["lost"] = "" if (work / "run").exists() else "there is no run folder"
    if not row["lost"] and row["driven_before"]:
        row["lost"] = incomplete(work / "run", gone, stopped)
    last_lines = lines_in(host.said)[-3:]
    row["false"] = any("cut the power" in line for line in last_lines) and not row["driven_after"]
    row["last"] = last_lines[-2:]
    return row


def _await_driven(scene: Scene, host: Process) -> None:
    """Return once a motor is driven, the program has ended, or nothing happens for too long."""
    end = time.monotonic() + HANG
    while not scene.driven() and host.process.poll() is None and time.monotonic() < end:
        time.sleep(0.01)


def report(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print how many were damped in time, and what else was wrong."""
    for who, how in sorted({(row["who"], row["how"]) for row in rows}):
        some = [row for row in rows if (row["who"], row["how"]) == (who, how) and row["driven_before"]]
        if some:
            longest = max(row["damped_after"] for row in some)
            fine = sum(not row["undamped"] for row in some)
            print(f"{who} {how}: {fine} of {len(some)} damped within {WITHIN[how]} s, {longest:.3f} s at most")
    for name in ("undamped", "hung", "traceback", "lost", "false"):
        bad = [(row["robot"], row["seed"], row[name]) for row in rows if row[name]]
        print(f"{name:10s} {len(bad)} of {len(rows)}", bad[:10])

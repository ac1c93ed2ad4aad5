"""One run of either emulated robot in its own time, with a fault that a seed draws."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from lab.faults.can_scene import CanScene
from lab.faults.drawn import random_fault
from lab.faults.stock_scene import Go2Scene, StockScene
from lab.faults.trouble import CASES, cases, stood
from mimic.config.play import RunSettings
from mimic.control.loop import run_policy
from mimic.control.recorder import RunRecorder, salvage
from mimic.control.safety.supervisor import SafetyMode, Supervisor
from mimic.control.signals import Signals
from mimic.control.tick import Safety
from mimic.emulator.faults import MISWIRED, EmulatedFault
from mimic.errors import MimicError
from mimic.evaluation.policy import command_script
from mimic.policy.runtime import load_policy
from mimic.records import RunLog
from mimic.robot.description import load_description

TIMING = RunSettings(stand_up=1.0, blend=0.5, hold_last=0.5)

RAMP, TRACK = 1.0, 3.0
"""[s]"""

WITHIN = (0.1, 13.0)
"""When a fault begins, after the robot is ready [s]: from the ramp into the sitting down."""

ROUNDING = 1e-6
"""Times that differ by less are the same [s]."""

DAMPED_WITHIN = 0.35
"""Motors are damped this long after the decision, or after somebody can act again [s]."""

HANG = 60.0
"""A run that takes longer than this in the robot's time hangs [s]."""

SCENES: dict[str, Any] = {"can": CanScene, "stock": StockScene, "go2": Go2Scene}


class Killed(BaseException):
    """This program is gone."""


class FullDisk(RunRecorder):
    """A recorder whose disk may be full."""

    full = False

    def row(self, values: Any, health: Any) -> None:
        self._write()
        super().row(values, health)

    def event(self, event: Any) -> None:
        self._write()
        super().event(event)

    def _write(self) -> None:
        if self.full:
            raise OSError(28, "No space left on device")


class _Run:
    """What the seed's fault does to the program that drives the robot, tick by tick."""

    def __init__(self, kind: str, start: float, lasts: float, scene: Any, recorder: FullDisk) -> None:
        self.kind, self.start, self.lasts, self.scene, self.recorder = kind, start, lasts, scene, recorder
        self.signals, self.steps, self._begin, self._paused = Signals(), 0, np.inf, False
        self._rng = scene.trouble.rng

    def passed(self, more: float = 0.0) -> bool:
        """Return whether the fault has begun, some time ago [s]."""
        return self.scene.now() >= self._begin + self.start + more

    def damped_from(self, supervisor: Supervisor, *, killed: bool) -> float:
        """Return when it was decided to damp the robot, or the program was gone [s]; infinite where neither was."""
        if killed:
            return self._begin + self.start
        found = [event.t for event in supervisor.events if event.mode >= SafetyMode.DAMP]
        return self._begin + found[0] if found else np.inf

    def sink(self, tick: object) -> None:
        now = self.scene.now()
        if self._begin == np.inf:
            self._begin = now
            self.scene.trouble.start(self.kind, self.start, self.lasts)
        if now - self._begin > HANG:
            raise TimeoutError
        self.steps += 1
        if not self.passed():
            return
        match self.kind:
            case "host_killed":
                raise Killed
            case "sink_raises":
                raise RuntimeError("a bug in the viewer")
            case "host_stopped" if not self._paused:
                self._paused = True
                self.scene.stands_still(float(self._rng.choice([0.03, 0.08, 0.3, 2.0])))
            case "disk_full":
                self.recorder.full = True
            case "terminal_closed":
                self.signals.interrupts, self.signals.hung_up = 1, True
            case "many_ctrl_c":
                self.signals.interrupts += 1
            case "ctrl_c" | "ctrl_c_twice":
                self.signals.interrupts = 2 if self.kind == "ctrl_c_twice" and self.passed(0.5) else 1
            case "sigterm":
                self.signals.terminated = True

    def act(self, policy: Any, seen: np.ndarray) -> np.ndarray:
        if self.passed():
            match self.kind:
                case "policy_nan":
                    return np.full(12, np.nan)
                case "policy_wild":
                    return self._rng.normal(0.0, 50.0, 12)
                case "policy_raises":
                    raise RuntimeError("a bug in the policy")
                case "policy_slow":
                    self.scene.wait(float(self._rng.choice([0.005, 0.025, 0.04, 0.15])))
        return policy.act(seen)


def play(
    robot: str,
    seed: int,
    folder: Path,
    kind: str | None = None,
    at: float | None = None,
    seconds: float = TRACK,
    *,
    tested: bool = True,
) -> dict[str, Any]:
    """Play a run with the fault of a seed and return how it ended.

    Args:
        robot: `can`, `stock` or `go2`.
        seed: Draws fault, robot and commands.
        folder: Run folder.
        kind: One of CASES; by default drawn too.
        at: When it begins, after the robot is ready [s], to stay; by default drawn too.
        seconds: For how long it follows commands [s].
        tested: Test its joints before it stands up.
    """
    rng = np.random.default_rng([seed, 47, len(robot)])
    kind = str(rng.choice(cases(robot, "own_time"))) if kind is None else kind
    start = float(rng.uniform(*WITHIN)) if at is None else at
    lasts = np.inf if at is not None else float(rng.choice([0.05, 0.2, 1.0, np.inf]))
    fault = _fault_of_robot(kind, seed, start, rng) if CASES[kind].place == "robot" else None
    if fault is not None and at is not None:
        fault = replace(fault, until=np.inf)
    if kind == "adapter_out":
        lasts = float(rng.choice([1.0, 5.0]))
    elif kind == "clock_stands":
        lasts = min(lasts, 2.0)
    description = load_description("go2" if robot == "go2" else "cyberdog2")
    scene = SCENES[robot](description, rng, seed, fault)
    policies = [load_policy(None, description), load_policy(None, description, task="sit_down")]
    recorder = FullDisk(folder, policies[0].contract.observation_size, {"dt": description.dt})
    run = _Run(kind, start, lasts, scene, recorder)
    supervisor = Supervisor(description)
    safety = Safety(supervisor=supervisor, signals=run.signals, recorder=recorder, ramp=RAMP, tested=tested)
    track = command_script(description, seconds, rng)
    if kind == "target_nan":
        toes = track.p_BE.copy()
        toes[int(rng.integers(len(toes))), 0, 0] = np.nan
        track = replace(track, p_BE=toes)
    first, last = (
        SimpleNamespace(contract=p.contract, path=p.path, act=lambda seen, p=p: run.act(p, seen)) for p in policies
    )
    scene.plant.close = _unless_killed(scene.plant.close)
    driver: Any = run_policy  # the wrapped policies are no Policy
    began = time.monotonic()
    end = _end_of(lambda: driver(scene.plant, first, track, TIMING, sit_down=last, sink=run.sink, safety=safety), run)
    if end.killed:
        scene.is_alone()
    recorder.close()
    scene.wait(1.0)
    on_disk = None
    with suppress(MimicError):
        on_disk, _ = salvage(folder)
    kept = on_disk if end.log is None or kind != "disk_full" else end.log
    rows = 0 if kept is None else len(kept.t)
    begun = 0 if kept is None else int(np.searchsorted(kept.t - kept.t[:1], start - ROUNDING)) - 1
    steps = max(run.steps, 0 if end.killed else getattr(scene.plant, "steps", 0) - 1)
    driven = scene.driven()
    decided = run.damped_from(supervisor, killed=end.killed)
    late = scene.last_driven - scene.actable(decided)
    return {
        "robot": robot,
        "seed": seed,
        "kind": kind,
        "fault": kind if fault is None else str(fault),
        "begin": start,
        "lasts": lasts,
        "stood": stood(kept, begun),
        **_decision(supervisor, start),
        "driven": driven,
        "undamped": bool((driven and scene.reachable()) or DAMPED_WITHIN < late < np.inf),
        "late": round(float(late), 3) if np.isfinite(late) else None,
        "hung": end.hung,
        "traceback": end.escaped,
        "lost": rows < steps,
        "silent": bool(scene.on()) and not end.killed and not scene.told(),
        "false": bool(scene.false_line()),
        "rows": rows,
        "ending": scene.plant.ending,
        "seconds": time.monotonic() - began,
    }


def _fault_of_robot(kind: str, seed: int, start: float, rng: np.random.Generator) -> EmulatedFault:
    if kind in MISWIRED:
        return EmulatedFault(kind=kind, value=1.0, start=0.0, joint=int(rng.integers(12)))
    return random_fault(seed, start=(start, start), after_release=True, kinds=(kind,))


@dataclass(frozen=True, kw_only=True)
class _End:
    """How the program ended."""

    log: RunLog | None = None
    escaped: str = ""
    """An exception that should not have come out, with its message."""
    hung: bool = False
    killed: bool = False


def _end_of(drive: Callable[[], Any], run: _Run) -> _End:
    """Play a run and return how the program ended."""
    try:
        result = drive()
    except MimicError as reason:  # before the first tick it is a sentence
        return _End(escaped="" if run.steps == 0 else f"{type(reason).__name__}: {reason}")
    except Killed:
        return _End(killed=True)
    except Exception as reason:
        return _End(escaped=f"{type(reason).__name__}: {reason}")
    error = result.error
    expected = isinstance(error, MimicError | TimeoutError) or (
        isinstance(error, RuntimeError) and run.kind in ("sink_raises", "policy_raises")
    )
    escaped = "" if error is None or expected else f"{type(error).__name__}: {error}"
    return _End(log=result.log, escaped=escaped, hung=isinstance(error, TimeoutError))


def _decision(supervisor: Supervisor, start: float) -> dict[str, Any]:
    """Return what ended the run, and how long after the fault began [s]."""
    ended = supervisor.decisive
    if ended is None:
        return {"rule": "", "text": "", "after": float("nan")}
    return {"rule": f"{ended.rule} {ended.mode.name.lower()}", "text": ended.text, "after": ended.t - start}


def _unless_killed(close: Any) -> Any:
    """Return a close that a killed program never reaches."""

    def closing() -> None:
        if not isinstance(sys.exc_info()[1], Killed):
            close()

    return closing

"""One run on the emulated robot in its own time, with a fault drawn by a seed: of robot, bus or program.

Used by lab/faults/fault_campaign.py and by the tests.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from mimic.config.emulator import EmulateSettings
from mimic.config.play import RunSettings
from mimic.control.loop import run_policy
from mimic.control.recorder import RunRecorder, salvage
from mimic.control.signals import Signals
from mimic.control.supervisor import Supervisor
from mimic.control.tick import Safety
from mimic.emulator.faults import CAN_KINDS, EmulatedFault, random_fault
from mimic.emulator.link import EmulatedLink
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import MimicError
from mimic.evaluation.policy import command_script
from mimic.hardware.cybergear.messages import Mode
from mimic.hardware.plant import CanRobot
from mimic.hardware.wiring import load_wiring
from mimic.policy.runtime import load_policy
from mimic.records import JOINTS
from mimic.robot.description import load_description

PROGRAM = (
    "ctrl_c",
    "ctrl_c_twice",
    "sigterm",
    "policy_nan",
    "policy_wild",
    "policy_raises",
    "policy_slow",
    "target_nan",
    "sink_raises",
    "watchdog_gone",
)
"""What can go wrong in the program that drives the robot."""

KINDS_OF_FAULT = (*CAN_KINDS, *PROGRAM)

TIMING = RunSettings(stand_up=1.0, blend=0.5, hold_last=0.5)

RAMP, TRACK = 1.0, 3.0
"""[s]"""

WITHIN = (0.1, 8.4)
"""When a fault begins, after the motors were switched on [s]: from the ramp into the sitting down."""

CUTS = ("bus_off", "unplugged", "motor_deaf", "stalled", "frames_lost", "frames_late")
"""Faults that can keep a motor from hearing anybody; without a timeout of its own it then goes on."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a run with a fault ended."""

    seed: int
    fault: str
    own_timeout: bool
    """Whether the motors stop by themselves when they hear nobody."""
    rule: str
    """What first ended the run; empty where it raised before its first tick."""
    text: str
    mode: str
    """What that asked for: sit_down or damp."""
    after: float
    """How long after the fault had begun [s]."""
    driven: tuple[str, ...]
    """Joints whose motors still have stiffness at the end."""
    running: tuple[str, ...]
    """Joints whose motors are still switched on."""
    reachable: bool
    """Whether the motors could have been told at the end."""
    told: bool
    """Whether the last line says what is left running."""
    escaped: str
    """An exception that got out, other than one that says what to do."""
    rows: int
    steps: int
    """Control steps that were asked of the robot; each must have a row."""

    @property
    def undamped(self) -> bool:
        """Whether a motor that could be told, or that stops by itself, was left driven."""
        return bool(self.driven) and (self.reachable or self.own_timeout)

    @property
    def silent(self) -> bool:
        """Whether motors were left on without a word."""
        return bool(self.running) and not self.told

    @property
    def incomplete(self) -> bool:
        """Whether the log lacks a control step."""
        return self.rows != self.steps


class _Counted(CanRobot):
    """Counts the steps that the loop asks for."""

    steps = 0

    def step(self, command: Any) -> Any:
        self.steps += 1
        return super().step(command)


class _Gone:
    """A watchdog that ends at some time."""

    def __init__(self, ends: float, link: EmulatedLink) -> None:
        self._ends, self._link = ends, link

    def alive(self) -> bool:
        return self._link.now() < self._ends

    def arm(self) -> None: ...

    def beat(self) -> None: ...

    def disarm(self) -> None: ...

    def take_over(self) -> str:
        return ""


def drawn(seed: int, kind: str | None, at: float | None) -> tuple[str, float, EmulatedFault | None]:
    """Return kind, begin after the motors were switched on [s], and the fault of the robot where it is one."""
    rng = np.random.default_rng([seed, 31])
    kind = str(rng.choice(KINDS_OF_FAULT)) if kind is None else kind
    within = WITHIN if at is None else (at, at)
    start = float(rng.uniform(*within))
    if kind in PROGRAM:
        return kind, start, None
    fault = random_fault(seed, start=within, after_release=True, kinds=(kind,))
    if at is not None:
        fault = replace(fault, until=np.inf)
    return kind, fault.start, fault


def play(seed: int, folder: Path, kind: str | None = None, at: float | None = None, seconds: float = TRACK) -> Outcome:
    """Play a run with the fault of a seed and return how it ended.

    Args:
        seed: Draws fault, robot and commands.
        folder: Run folder.
        kind: Kind of the fault; by default drawn too.
        at: When it begins, after the motors were switched on [s], to stay; by default drawn too.
        seconds: For how long it follows commands [s].
    """
    description = load_description()
    kind, start, fault = drawn(seed, kind, at)
    rng = np.random.default_rng([seed, 37])
    own_timeout, buses = bool(rng.random() < 0.5), int(rng.choice([1, 2]))
    wiring = load_wiring(buses=buses)
    settings = EmulateSettings(zeroed=True, placement=0.03, seed=seed, can_timeout=own_timeout)
    robot = EmulatedRobot(description, wiring, settings, faults=[] if fault is None else [fault])
    link = EmulatedLink(robot)
    link.sleep(0.3)
    begin = link.now()
    watchdog = _Gone(begin + start, link) if kind == "watchdog_gone" else None
    plant = _Counted(link, wiring, description, watchdog=watchdog)
    signals, supervisor = Signals(), Supervisor(description)
    real, sitter = load_policy(None, description), load_policy(None, description, task="sit_down")

    def passed() -> bool:
        return link.now() - begin >= start

    def act(observation: np.ndarray, policy: Any) -> np.ndarray:
        if not passed():
            return policy.act(observation)
        if kind == "policy_nan":
            return np.full(12, np.nan)
        if kind == "policy_wild":
            return rng.normal(0.0, 50.0, 12)
        if kind == "policy_raises":
            raise RuntimeError("a bug in the policy")
        if kind == "policy_slow":
            link.sleep(float(rng.choice([0.005, 0.025, 0.04, 0.15])))
        return policy.act(observation)

    def sink(tick: object) -> None:
        if not passed():
            return
        if kind == "sink_raises":
            raise RuntimeError("a bug in the viewer")
        signals.terminated |= kind == "sigterm"
        if kind.startswith("ctrl_c"):
            more = kind == "ctrl_c_twice" and link.now() - begin >= start + 0.5
            signals.interrupts = 2 if more else 1

    track = command_script(description, seconds, rng)
    if kind == "target_nan":
        toes = track.p_BE.copy()
        toes[int(rng.integers(len(toes))), 0, 0] = np.nan
        track = replace(track, p_BE=toes)
    width = real.contract.observation_size
    recorder = RunRecorder(folder, width, {"dt": description.dt})
    safety = Safety(supervisor=supervisor, signals=signals, recorder=recorder, ramp=RAMP)
    wrapped = [
        SimpleNamespace(contract=p.contract, path=p.path, act=lambda seen, p=p: act(seen, p)) for p in (real, sitter)
    ]
    escaped = ""
    try:
        driver: Any = run_policy  # the wrapped policies are no Policy
        policy, last = wrapped
        result = driver(plant, policy, track, TIMING, sit_down=last, sink=sink, safety=safety)
        if result.error is not None and not isinstance(result.error, MimicError | RuntimeError):
            escaped = f"{type(result.error).__name__}: {result.error}"
    except MimicError:
        escaped = ""  # it ended before its first tick, with a sentence
    except Exception as reason:
        escaped = f"{type(reason).__name__}: {reason}"
    recorder.close()
    link.sleep(1.0)
    log, _ = salvage(folder)
    ended = supervisor.decisive
    running = tuple(name for name, motor in zip(JOINTS, robot.motors, strict=True) if motor.mode is Mode.RUN)
    return Outcome(
        seed=seed,
        fault=kind if fault is None else str(fault),
        own_timeout=own_timeout,
        rule="" if ended is None else ended.rule,
        text="" if ended is None else ended.text,
        mode="" if ended is None else ended.mode.name.lower(),
        after=float("nan") if ended is None else ended.t - start,
        driven=tuple(n for n, m in zip(JOINTS, robot.motors, strict=True) if m.mode is Mode.RUN and m.drive.kp > 0.0),
        running=running,
        reachable=not (kind in CUTS and fault is not None and np.isinf(fault.until)),
        told=all(name in plant.ending for name in running) or "all motors" in plant.ending or "stopped" in plant.ending,
        escaped=escaped,
        rows=len(log.t),
        steps=max(plant.steps - 1, 0),
    )

"""What goes wrong in a run: the table of cases, what a network does to messages, and the count of how runs ended."""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mimic.control.recorder import salvage
from mimic.emulator.boards.board import FAULTS as BOARD_FAULTS
from mimic.emulator.boards.go2 import FAULTS as GO2_FAULTS
from mimic.emulator.faults import CAN_KINDS
from mimic.errors import MimicError
from mimic.io import store
from mimic.metrics import standing
from mimic.records import RunLog
from mimic.robot.description import load_description


class Case(NamedTuple):
    """One thing that can go wrong: in the emulator's own time, between processes in real time, or in both."""

    place: str
    """What it is done to: messages, a second program, the policy, this program, a process, the emulated robot."""
    own_time: str
    """Robots on which it is played in the emulator's own time."""
    processes: str
    """Robots on which it is played with real processes and sockets."""
    text: str


BOTH, BOARDS, ALL = "can stock", "stock go2", "can stock go2"

CASES: dict[str, Case] = {
    "jitter": Case("messages", "", "stock", "each waits a while, in order"),
    "delays": Case("messages", ALL, BOTH, "some wait, and are overtaken"),
    "drops": Case("messages", ALL, BOTH, "some are lost"),
    "corrupts": Case("messages", ALL, BOTH, "some have other bytes"),
    "repeats": Case("messages", ALL, BOTH, "old ones come again"),
    "forges": Case("messages", ALL, BOTH, "readings have other numbers"),
    "cuts": Case("messages", BOARDS, "stock", "nothing gets through"),
    "hears_nothing": Case("messages", ALL, "", "answers are lost"),
    "sends_nothing": Case("messages", ALL, "", "commands are lost"),
    "refuses_frames": Case("messages", "can", "", "the adapter takes no frames"),
    "fails": Case("messages", "can", "", "the adapter fails both ways"),
    "adapter_out": Case("messages", "can", "", "the adapter fails, and works again after 1 or 5 s"),
    "flaps": Case("messages", ALL, "", "nothing gets through every other tenth of a second"),
    "truncates": Case("messages", ALL, "", "some are cut short"),
    "swaps": Case("messages", ALL, "", "two in a row change places"),
    "clock_stands": Case("this program", "can", "", "this computer's clock stands still"),
    "garbage": Case("messages", "", "can", "bytes that are no message come between"),
    "stalls": Case("messages", "", "can", "nothing gets through, and comes later"),
    "half_closes": Case("messages", "", "can", "the connection is closed one way"),
    "resets": Case("messages", "", "can", "the connection breaks"),
    "refuses": Case("messages", "", "can", "it breaks, and cannot be made again"),
    "master_commands": Case("second program", ALL, BOTH, "commands the motors"),
    "master_once": Case("second program", BOARDS, "", "commands them once"),
    "master_stops": Case("second program", "can", "can", "switches motors off"),
    "master_zeroes": Case("second program", "can", "", "sets zeros"),
    "master_enables": Case("second program", "can", "", "switches motors on"),
    "master_sets_torque": Case("second program", "can", "", "sets torque limits"),
    "master_asks": Case("second program", "can", "", "reads parameters"),
    "master_floods": Case("second program", "can", "", "fills the bus"),
    "second_check": Case("second program", "", BOTH, "mimic robot check"),
    "second_watch": Case("second program", "", BOTH, "mimic robot watch"),
    "second_run": Case("second program", "", BOTH, "mimic --robot"),
    "second_probe": Case("second program", "", BOTH, "mimic robot probe"),
    "second_damp": Case("second program", "", "can", "mimic robot damp"),
    "second_zero": Case("second program", "", "can", "mimic robot zero"),
    "second_scan": Case("second program", "", "can", "mimic robot scan"),
    "policy_nan": Case("policy", ALL, "", "answers NaN"),
    "policy_wild": Case("policy", ALL, "", "answers noise"),
    "policy_raises": Case("policy", ALL, "", "raises"),
    "policy_slow": Case("policy", ALL, "", "takes up to 150 ms"),
    "target_nan": Case("policy", ALL, "", "is given NaN"),
    "sink_raises": Case("this program", ALL, "", "a bug in the viewer"),
    "sender_killed": Case("this program", ALL, "", "its sending process ends"),
    "sender_stopped": Case("this program", ALL, "", "its sending process stands still"),
    "ctrl_c": Case("this program", ALL, BOTH, "Ctrl-C"),
    "ctrl_c_twice": Case("this program", ALL, "can", "Ctrl-C again soon after"),
    "ctrl_c_thrice": Case("this program", "", BOTH, "and again"),
    "many_ctrl_c": Case("this program", ALL, "", "Ctrl-C at every tick"),
    "sigterm": Case("this program", ALL, BOTH, "SIGTERM"),
    "terminal_closed": Case("this program", ALL, BOTH, "SIGHUP"),
    "disk_full": Case("this program", ALL, BOTH, "the disk fills"),
    "disk_small": Case("this program", "", BOTH, "logs fit on the disk, the scene does not"),
    "host_killed": Case("process", ALL, BOTH, "mimic is killed"),
    "host_stopped": Case("process", ALL, BOTH, "mimic stands still"),
    "helper_killed": Case("process", "", BOTH, "the process that sends is killed"),
    "helper_stopped": Case("process", "", BOTH, "it stands still"),
    "both_killed": Case("process", "", BOTH, "both are killed"),
    "both_stopped": Case("process", "", BOTH, "both stand still"),
    "emulator_stopped": Case("process", "", BOTH, "the robot's computer stands still"),
}
_OF_ROBOTS = {"can": CAN_KINDS, "stock": BOARD_FAULTS, "go2": GO2_FAULTS}
for _kind in dict.fromkeys([*CAN_KINDS, *BOARD_FAULTS, *GO2_FAULTS]):
    _own = " ".join(robot for robot, kinds in _OF_ROBOTS.items() if _kind in kinds)
    CASES[_kind] = Case("robot", _own, "can" if _kind in CAN_KINDS else "", "as the manual of the robot says")


def cases(robot: str, setting: str) -> tuple[str, ...]:
    """Return the cases of a robot in a setting, `own_time` or `processes`."""
    return tuple(name for name, case in CASES.items() if robot in getattr(case, setting).split())


FLAP = 0.1
"""[s]"""


class Trouble:
    """What goes wrong, when it is there, and what it does to messages."""

    def __init__(self, rng: np.random.Generator, now: Callable[[], float]) -> None:
        """Draw how much of it there will be.

        Args:
            rng: Draws.
            now: The clock of the run [s].
        """
        self.rng, self.now = rng, now
        self.kind = ""
        self.begin = self.end = np.inf
        self.share, self.lag = float(rng.uniform(0.05, 0.6)), float(rng.uniform(0.002, 0.08))
        """Share of the messages that are hit; longest delay of one [s]."""
        self._held: list[tuple[float, int, Any, Any]] = []
        self._last: dict[Any, float] = {}
        self._kept: dict[Any, Any] = {}
        self._old: defaultdict[Any, deque[Any]] = defaultdict(lambda: deque(maxlen=400))
        self._count = 0

    def start(self, kind: str, after: float = 0.0, lasts: float = np.inf) -> None:
        """Let it begin in some time, for some time [s]."""
        self.kind, self.begin = kind, self.now() + after
        self.end = self.begin + lasts

    def doing(self, *kinds: str) -> bool:
        """Return whether one of these is there now; without a name, whether anything is."""
        return (not kinds or self.kind in kinds) and self.begin <= self.now() < self.end

    def cuts(self) -> bool:
        """Return whether nothing gets through now."""
        return self.doing("cuts") or (self.doing("flaps") and int(self.now() / FLAP) % 2 == 0)

    def shorter(self, data: bytes) -> bytes:
        """Return the begin of a message."""
        return data[: int(self.rng.integers(len(data)))]

    def hit(self) -> bool:
        """Return whether the next message is hit."""
        return bool(self.rng.random() < self.share)

    def damaged(self, data: bytes, first: int = 0) -> bytes:
        """Return a message with one to three other bytes from a place on."""
        changed = bytearray(data)
        for _ in range(int(self.rng.integers(1, 4))):
            changed[int(self.rng.integers(first, len(changed)))] = int(self.rng.integers(256))
        return bytes(changed)

    def through(
        self,
        way: Any,
        message: Any,
        damage: Callable[[Any], Any] | None = None,
        forge: Callable[[Any], Any] | None = None,
        cut: Callable[[Any], Any] | None = None,
    ) -> list[Any]:
        """Return what comes out where a message goes in; `due` returns what is held back until later.

        Args:
            way: Whose messages are mixed with each other; told by `due`.
            message: What goes in.
            damage: Changes it as noise would; by default such messages are not damaged.
            forge: Changes it as somebody who knows the protocol would; by default such messages are not forged.
            cut: Leaves out its end; by default such messages are whole.
        """
        self._old[way].append(message)
        if not self.doing():
            return [message]
        if self.cuts():
            return []
        if self.kind == "jitter":
            self._last[way] = max(self.now() + self.lag * float(self.rng.random()), self._last.get(way, 0.0))
            return self._hold(self._last[way], way, message)
        if not self.hit():
            return [message]
        match self.kind:
            case "drops":
                return []
            case "delays":
                return self._hold(self.now() + self.lag * float(self.rng.random()), way, message)
            case "repeats":
                return [self._old[way][int(self.rng.integers(len(self._old[way])))], message]
            case "swaps" if way not in self._kept:
                self._kept[way] = message
                return []
            case "swaps":
                return [message, self._kept.pop(way)]
            case "truncates" if cut is not None:
                return [cut(message)]
            case "corrupts" if damage is not None:
                return [damage(message)]
            case "forges" if forge is not None:
                return [forge(message)]
        return [message]

    def _hold(self, until: float, way: Any, message: Any) -> list[Any]:
        self._count += 1
        heapq.heappush(self._held, (until, self._count, way, message))
        return []

    def due(self) -> list[tuple[Any, Any]]:
        """Return way and message of each that was held back until now."""
        out = []
        while self._held and self._held[0][0] <= self.now():
            out.append(heapq.heappop(self._held)[2:])
        return out

    def next_due(self) -> float | None:
        """Return when the next message is due [s]."""
        return self._held[0][0] if self._held else None


def halt(link: Any, trouble: Trouble) -> None:
    """Let the sender of an `EmulatedSenderLink` stand still, or be gone for good."""
    link.halted = trouble.doing("sender_stopped") or (link.halted and trouble.kind == "sender_killed")
    link.halted |= trouble.doing("sender_killed")


def logged(run: Path) -> RunLog | None:
    """Return the log of a run, or its rows where it did not end; None where there is none."""
    if (run / "log.parquet").is_file():
        return store.load(run / "log.parquet", RunLog)
    try:
        return salvage(run)[0]
    except MimicError:
        return None


def stood(log: RunLog | None, row: int) -> bool:
    """Return whether the robot stood at a row, the last before its fault."""
    if log is None or not len(log.t):
        return False
    return bool(standing(log, load_description("cyberdog2"))[min(max(row, 0), len(log.t) - 1)])


def report(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print how runs ended, and how many of the robots stood when their fault began."""
    for robot in sorted({row["robot"] for row in rows}):
        mine = [row for row in rows if row["robot"] == robot]
        print(f"{robot}: {len(mine)} runs; {sum(row['stood'] for row in mine)} stood when the fault began")
        for name in ("undamped", "hung", "traceback", "lost", "silent", "false"):
            bad = [(row["seed"], row["fault"], row[name]) for row in mine if row.get(name)]
            print(f"  {name:10s} {len(bad)}", bad[:10])
        print("  driven, beyond reach:", [(r["seed"], r["fault"]) for r in mine if r["driven"] and not r["undamped"]])
        for kind in sorted({row["kind"] for row in mine}):
            of_kind = [row for row in mine if row["kind"] == kind]
            up = sum(row["stood"] for row in of_kind)
            print(f"  {kind:18s} {len(of_kind)}, {up} stood:", dict(Counter(row["rule"] or "–" for row in of_kind)))

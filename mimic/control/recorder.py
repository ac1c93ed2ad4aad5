"""The log of a run while it grows: control ticks as rows, events as lines of JSON, on disk at once.

A thread of its own writes, so that a slow disk never holds the control loop; what waits for it is kept.
"""

from __future__ import annotations

import errno
import json
import os
import queue
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from mimic.control.priority import RECORDER, real_time
from mimic.control.row_file import RowFile, read_rows
from mimic.control.safety.supervisor import Event
from mimic.io.store import plain
from mimic.records import AXES, FloatArray, Health, HealthLog, JointSamples, Record, RobotState, RunLog, Tick

ROWS = "log.rows"
"""File of rows in a run folder, removed once log.parquet exists."""
EVENTS = "events.jsonl"
"""File of events in a run folder."""

MOST_WAITING = 3000
"""Rows and events that wait for the disk at most: a minute of them, 6 MB."""

CLOSE_WITHIN = 60.0
"""What waits is written within this when a log is closed [s]."""

_HEALTH = "health_"


class _Disk:
    """Writes in a thread of its own, in order; what waits for one file goes there at once."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[tuple[Callable[[bytes], Any], bytes] | None] = queue.Queue(MOST_WAITING)
        self._failure: OSError | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def write(self, how: Callable[[bytes], Any], data: bytes) -> None:
        """Have something written, without waiting for it.

        Raises:
            OSError: If something before could not be written, or too much waits.
        """
        if self._failure is not None:
            raise self._failure
        try:
            self._waiting.put_nowait((how, data))
        except queue.Full:
            raise OSError(errno.ETIMEDOUT, f"the disk is too slow: {MOST_WAITING} rows wait for it") from None

    def close(self) -> None:
        """Wait until all is written; safe to call twice."""
        if self._thread.is_alive():
            with suppress(queue.Full):
                self._waiting.put(None, timeout=CLOSE_WITHIN)
            self._thread.join(CLOSE_WITHIN)

    def _run(self) -> None:
        with real_time(RECORDER):  # while it holds the interpreter, nothing should hold it up
            goes_on = True
            while goes_on:
                waiting = [self._waiting.get()]
                while not self._waiting.empty():
                    waiting.append(self._waiting.get())
                goes_on = None not in waiting
                items = (item for item in waiting if item is not None)
                for how, same in groupby(items, key=itemgetter(0)):
                    self._write(how, b"".join(data for _, data in same))

    def _write(self, how: Callable[[bytes], Any], data: bytes) -> None:
        try:
            how(data)
        except OSError as reason:
            self._failure = self._failure or reason


def _shapes(kind: type[Record], observation: int) -> dict[str, tuple[int, ...]]:
    """Return the shape of a row of each array field."""
    lengths = {name: len(labels) for name, labels in AXES.items()} | {"observation": observation}
    arrays = [f for f in fields(kind) if "axes" in f.metadata]  # type: ignore[arg-type]
    return {f.name: tuple(map(lengths.__getitem__, f.metadata["axes"])) for f in arrays}


def _health_row(health: Health | None, t: float, clamped: int, mode: int) -> dict[str, Any]:
    """Return the columns of a HealthLog for one tick; NaN where the plant does not measure."""
    nothing = np.full(len(AXES["joint"]), np.nan)
    row: dict[str, Any] = {"t": t, "clamped": float(clamped), "mode": float(mode)}
    for f in fields(HealthLog):
        if f.name in row or "axes" not in f.metadata:
            continue
        missing = nothing if f.metadata["axes"] else np.nan
        row[f.name] = missing if health is None else np.asarray(getattr(health, f.name), dtype=np.float64)
    return row


class RunRecorder:
    """Writes rows and events into a run folder at once."""

    def __init__(self, folder: Path, observation: int, metadata: Mapping[str, Any]) -> None:
        """Begin a log.

        Args:
            folder: Run folder.
            observation: Width of the policies' observation.
            metadata: Of the RunLog that `salvage` returns.
        """
        health = {_HEALTH + name: shape for name, shape in _shapes(HealthLog, observation).items()}
        self._folder = folder
        self._has_rows = False
        self._rows = RowFile(folder / ROWS, _shapes(RunLog, observation) | health, metadata)
        self._disk = _Disk()
        self._events = os.open(folder / EVENTS, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o644)

    def row(self, values: Mapping[str, Any], health: Mapping[str, Any]) -> None:
        """Append a tick."""
        self._has_rows = True
        row = self._rows.packed({**values, **{_HEALTH + name: value for name, value in health.items()}})
        self._disk.write(self._rows.write, row)

    def event(self, event: Event) -> None:
        """Append an event."""
        self._disk.write(self._write_event, _line(event))

    def _write_event(self, lines: bytes) -> None:
        os.write(self._events, lines)

    def close(self) -> None:
        """Write what waits, and close the files; safe to call twice."""
        self._disk.close()
        self._rows.close()
        if self._events >= 0:
            os.close(self._events)
            self._events = -1

    def restore_events(self, events: Sequence[Event]) -> bool:
        """Write the events again where their file was removed meanwhile; return whether it was."""
        if (self._folder / EVENTS).exists():
            return False
        self._folder.mkdir(parents=True, exist_ok=True)
        (self._folder / EVENTS).write_bytes(b"".join(map(_line, events)))
        return True

    def discard(self) -> None:
        """Close the files and remove the rows, once they are stored in another format."""
        self.close()
        self._rows.path.unlink(missing_ok=True)

    def abandon(self) -> None:
        """Close the files; remove them if the run never began."""
        self.close()
        if not self._has_rows:
            self.discard()
            (self._folder / EVENTS).unlink(missing_ok=True)
            if not any(self._folder.iterdir()):
                self._folder.rmdir()


class Journal:
    """The log of a run in memory, and on disk as long as that works."""

    def __init__(self, disk: RunRecorder | None, observation: int) -> None:
        """Begin a log; policies observe so many numbers."""
        self._disk = disk
        self._rows: dict[str, list[Any]] = {}
        self._health: dict[str, list[Any]] = {}
        self._samples: list[JointSamples] = []
        self._noted = 0
        unknown = ("v_des", "heading_des", "p_BE_des", "trunk_des", "observation", "action", "q_sent", "kp", "kd")
        shapes = _shapes(RunLog, observation)
        self._unknown = {name: np.full(shapes[name], np.nan) for name in unknown} | {"v_des": np.zeros(2)}

    def add(self, state: RobotState, done: Tick | None, *, clamped: int, mode: int, **known: Any) -> None:
        """Append a tick.

        Args:
            state: Before it.
            done: What came of it; None where it failed.
            clamped: Numbers that were beyond their limits.
            mode: Of the supervisor.
            known: Columns of the RunLog: what was asked for, and what a policy saw and answered.

        Raises:
            OSError: If the disk fails; from then on all is in memory only.
        """
        row = {name: getattr(state, name) for name in ("t", "q", "dq", "tau", "quat_WB", "omega_B", "p_WB", "v_WB")}
        row |= self._unknown | known
        if done is not None:
            row |= {"q_sent": done.sent.position_target(), "kp": done.sent.kp, "kd": done.sent.kd}
        if done is not None and done.samples is not None:
            self._samples.append(done.samples)
        health = _health_row(None if done is None else done.health, state.t, clamped, mode)
        for columns, values in ((self._rows, row), (self._health, health)):
            for name, value in values.items():
                columns.setdefault(name, []).append(value)
        if self._disk is not None:
            with self._left_where_it_fails():
                self._disk.row(row, health)

    def note(self, events: Sequence[Event]) -> None:
        """Append those of all events that are new.

        Raises:
            OSError: As for `add`.
        """
        new = events[self._noted :]
        self._noted = len(events)
        if self._disk is not None:
            with self._left_where_it_fails():
                for event in new:
                    self._disk.event(event)

    @contextmanager
    def _left_where_it_fails(self) -> Iterator[None]:
        try:
            yield
        except OSError:
            self._disk = None
            raise

    def columns(self) -> dict[str, Any]:
        """Return the columns of the RunLog."""
        return {name: np.array(values) for name, values in self._rows.items()}

    def samples(self) -> JointSamples | None:
        """Return the joints faster than the control rate, where the plant records them."""
        columns = {}
        for f in fields(JointSamples) if self._samples else ():
            columns[f.name] = np.concatenate([getattr(part, f.name) for part in self._samples])
        return JointSamples(**columns) if columns else None

    def health_columns(self) -> dict[str, Any]:
        """Return the columns of the HealthLog."""
        return {name: np.array(values) for name, values in self._health.items()}

    def health_so_far(self, name: str) -> FloatArray:
        """Return a column of the HealthLog up to now, (T, ...); NaN where the plant does not say."""
        return np.array(self._health.get(name, []), dtype=np.float64)


def _line(event: Event) -> bytes:
    line = {"t": event.t, "rule": event.rule, "mode": event.mode.name.lower(), "text": event.text}
    return json.dumps(plain(line)).encode() + b"\n"


def salvage(folder: Path) -> tuple[RunLog, HealthLog]:
    """Return the logs of a run whose process was killed, up to the last complete tick.

    Raises:
        AssetError: If the folder holds no rows.
    """
    columns, metadata = read_rows(folder / ROWS)
    split: dict[bool, dict[str, Any]] = {True: {}, False: {}}
    for name, value in columns.items():
        split[name.startswith(_HEALTH)][name.removeprefix(_HEALTH)] = value
    return RunLog(**split[False], metadata=metadata), HealthLog(**split[True])

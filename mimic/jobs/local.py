"""Jobs in other processes, each result as soon as it is ready; a job that kills its process is a result, too."""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

Job = TypeVar("Job")
Row = TypeVar("Row")

Progress = Callable[[int, int], None]
"""Called with the number of jobs done, and of all jobs."""


@dataclass(frozen=True, slots=True)
class Died:
    """Result of a job that killed its process."""

    reason: str


@dataclass(frozen=True, slots=True)
class _Raised:
    """An exception of a job, on its way to the caller."""

    error: Exception


@dataclass(slots=True, eq=False)
class _Worker:
    process: BaseProcess
    pipe: Connection
    job: int | None = None


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def results_here(play: Callable[[Any], Any], jobs: Sequence[Any], *, workers: int = 0) -> Generator[tuple[int, Any]]:
    """Yield index and result of each job as it ends, in processes of this computer.

    A job whose process dies (a crash inside a library, no memory) yields `Died`, and a new process goes on with
    the rest. When the iterator is closed or an exception passes, the processes are ended at once; Ctrl-C reaches the
    caller only.

    Args:
        play: A function that other processes can import.
        jobs: Its arguments, one a call.
        workers: Processes; 0 takes one for each core.

    Raises:
        Exception: What a job raised.
    """
    waiting = deque(range(len(jobs)))
    count = min(workers or cores(), len(jobs))
    crew = [_start(play) for _ in range(count)]
    try:
        for worker in crew:
            _give(worker, waiting, jobs)
        while busy := [worker for worker in crew if worker.job is not None]:
            ready = wait([worker.pipe for worker in busy])
            for at, worker in enumerate(crew):
                if worker.pipe not in ready or worker.job is None:
                    continue
                done = worker.job
                try:
                    result = worker.pipe.recv()
                except (EOFError, OSError):
                    worker.process.join()
                    result = Died(f"its process ended with exit code {worker.process.exitcode}")
                    worker.pipe.close()
                    worker = crew[at] = _start(play)
                _give(worker, waiting, jobs)
                if isinstance(result, _Raised):
                    raise result.error
                yield done, result
    finally:
        for worker in crew:
            worker.process.terminate()
        for worker in crew:
            worker.process.join()
            worker.pipe.close()


def run_all(
    play: Callable[[Job], Row], jobs: Sequence[Job], *, workers: int = 0, progress: Progress | None = None
) -> list[Row]:
    """Return what ``play`` makes of each job, in the order of the jobs.

    Args:
        play: A function that other processes can import.
        jobs: One for each call.
        workers: Processes; 0 takes one for each core, 1 none besides this one.
        progress: Called after each job.

    Raises:
        RuntimeError: If the process of a job died.
        Exception: What a job raised.
    """
    rows: dict[int, Row] = {}
    here = ((index, play(job)) for index, job in enumerate(jobs))
    with closing(here if workers == 1 else results_here(play, jobs, workers=workers)) as results:
        for index, row in results:
            if isinstance(row, Died):
                raise RuntimeError(f"job {index} of {len(jobs)} failed: {row.reason}")
            rows[index] = row
            if progress is not None:
                progress(len(rows), len(jobs))
    return [rows[i] for i in range(len(jobs))]


def _start(play: Callable[[Any], Any]) -> _Worker:
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(play, theirs), daemon=True)
    process.start()
    theirs.close()
    return _Worker(process, ours)


def _give(worker: _Worker, waiting: deque[int], jobs: Sequence[Any]) -> None:
    worker.job = waiting.popleft() if waiting else None
    if worker.job is not None:
        worker.pipe.send(jobs[worker.job])


def _work(play: Callable[[Any], Any], pipe: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process decides
    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        try:
            result = play(job)
        except Exception as error:
            result = _Raised(error)
        pipe.send(result)

"""Jobs on other processes, each result as soon as it is there; one that takes its process down is a result too."""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any


@dataclass(frozen=True, slots=True)
class Died:
    """What a job left that took its process down."""

    reason: str


@dataclass(slots=True, eq=False)
class _Worker:
    process: BaseProcess
    pipe: Connection
    job: int | None = None


def results_here(play: Callable[[Any], Any], jobs: Sequence[Any], *, workers: int = 0) -> Generator[tuple[int, Any]]:
    """Yield index and result of each job as it ends, in processes of this computer.

    A job whose process dies (a crash inside a library, no memory) yields :class:`Died`, and a new process goes on with
    the rest. When the iterator is closed or an exception passes, the processes are ended at once; Ctrl-C reaches the
    caller only.

    Args:
        play: A function that other processes can import; it should not raise.
        jobs: What it is given, one at a time.
        workers: Processes; 0 takes one for each core.
    """
    waiting = deque(range(len(jobs)))
    count = min(workers or len(os.sched_getaffinity(0)), len(jobs))
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
                yield done, result
    finally:
        for worker in crew:
            worker.process.terminate()
        for worker in crew:
            worker.process.join()
            worker.pipe.close()


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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one who waits decides
    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        pipe.send(play(job))

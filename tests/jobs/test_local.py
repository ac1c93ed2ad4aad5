from __future__ import annotations

import os
import time
from contextlib import closing
from pathlib import Path

import pytest

from mimic.jobs.local import Died, results_here, run_all


def doubled(job: int) -> int:
    return 2 * job


def may_die(job: int) -> int:
    if job == 2:
        os._exit(7)
    return job


def refuses_six(job: int) -> int:
    if job == 6:
        raise ValueError("six")
    return job


def writes_and_waits(folder: str) -> None:
    Path(folder, str(os.getpid())).touch()
    while True:
        time.sleep(0.05)


@pytest.mark.parametrize("workers", [1, 3])
@pytest.mark.slow
def test_every_job_gives_its_own_result(workers):
    assert dict(results_here(doubled, [5, 6, 7, 8], workers=workers)) == {0: 10, 1: 12, 2: 14, 3: 16}


def test_nothing_to_do_gives_nothing():
    assert list(results_here(doubled, [])) == []


@pytest.mark.slow
def test_a_job_that_takes_its_process_down_is_named_and_the_rest_goes_on():
    results = dict(results_here(may_die, [0, 1, 2, 3, 4], workers=1))
    assert results.pop(2) == Died("its process ended with exit code 7")
    assert results == {0: 0, 1: 1, 3: 3, 4: 4}


@pytest.mark.slow
def test_processes_end_with_who_asked_for_them(tmp_path):
    def give_up() -> None:
        with closing(results_here(one_waits, [str(tmp_path), ""], workers=2)) as results:
            next(results)  # the other job's
            while not list(tmp_path.iterdir()):
                time.sleep(0.02)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        give_up()
    (pid,) = (int(path.name) for path in tmp_path.iterdir())
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def one_waits(folder: str) -> None:
    if folder:
        writes_and_waits(folder)


def test_run_all_keeps_the_order_and_counts():
    counted = []
    assert run_all(doubled, [5, 6, 7], workers=2, progress=lambda done, of: counted.append((done, of))) == [10, 12, 14]
    assert counted == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.slow
def test_run_all_raises_what_a_job_raised():
    with pytest.raises(ValueError, match="six"):
        run_all(refuses_six, [5, 6, 7], workers=2)


def test_one_worker_is_this_process():
    assert run_all(lambda job: (job, os.getpid()), [5, 6], workers=1) == [(5, os.getpid()), (6, os.getpid())]


@pytest.mark.slow
def test_run_all_does_not_hide_a_dead_process():
    with pytest.raises(RuntimeError, match="exit code 7"):
        run_all(may_die, [0, 1, 2], workers=2)

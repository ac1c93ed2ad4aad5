from __future__ import annotations

import os
import threading

from mimic.control.priority import LOOP, real_time


def policy() -> int:
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK


def test_it_lasts_for_the_block_and_a_refusal_is_reported():
    before = policy()
    with real_time(LOOP) as allowed:
        assert policy() == (os.SCHED_FIFO if allowed else before)
    assert policy() == before


def test_only_the_thread_that_asked_has_it():
    seen = []
    with real_time(LOOP):
        thread = threading.Thread(target=lambda: seen.append(policy()))
        thread.start()
        thread.join()
    assert seen == [os.SCHED_OTHER]


def test_it_is_given_back_when_something_fails():
    before = policy()
    try:
        with real_time(LOOP):
            raise ValueError
    except ValueError:
        assert policy() == before

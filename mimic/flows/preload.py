"""Imports what a run needs next while the pose detector, which is not Python, keeps the computer busy."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from mimic.flows.reporter import Progress, Reporter

NEEDED = (
    "mimic.sources.video.smoothing",
    "mimic.retargeting.targets",
    "mimic.retargeting.wrists",
    "mimic.view.scene.scene",
)
"""Modules that import SciPy, Pinocchio and Rerun: about a second together."""


class PreloadingReporter:
    """Passes everything on to another reporter; the first step of any progress begins to import NEEDED in a thread.

    The detector reports its first step when its own imports are done, and the thread is joined when its progress ends.
    So two threads never import the same package at the same time.
    """

    def __init__(self, reporter: Reporter) -> None:
        self._reporter = reporter
        self.note, self.warn, self.activity = reporter.note, reporter.warn, reporter.activity

    @contextmanager
    def progress(self, what: str) -> Iterator[Progress]:
        """Pass it on, and import beside it."""
        thread = threading.Thread(target=_import, name="imports beside the pose")
        with self._reporter.progress(what) as progress:

            def step(done: int, total: int | None = None) -> None:
                if thread.ident is None:
                    thread.start()
                progress(done, total)

            try:
                yield step
            finally:
                if thread.ident is not None:
                    thread.join()


def _import() -> None:
    for name in NEEDED:
        importlib.import_module(name)

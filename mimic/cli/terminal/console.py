"""What the commands print: progress, notes, warnings and tables."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from mimic.flows.reporter import Activity
from mimic.flows.reporter import Progress as Steps

console = Console(highlight=False)

LINE_INTERVAL = 5.0
"""Without a terminal, long work prints a line this often, also while it reports nothing new [s]."""


class ConsoleReporter:
    """Shows notes, warnings and progress on the terminal; without a terminal, progress is a line now and then."""

    def note(self, text: str) -> None:
        """Print it."""
        note(text)

    def warn(self, text: str) -> None:
        """Print it."""
        warn(text)

    @contextmanager
    def progress(self, what: str) -> Iterator[Steps]:
        """Yield a function that shows the steps done and their total as a bar."""
        if not console.is_terminal:
            with _lines(what) as put:
                yield lambda done, total=None: put(f"{what}: {done} of {total}" if total else f"{what}: {done}")
            return
        columns = (
            TextColumn("{task.description:<12}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console) as progress:
            task = progress.add_task(what, total=None)
            yield lambda done, total=None: progress.update(task, completed=done, total=total)

    @contextmanager
    def activity(self, unit: str) -> Iterator[Activity]:
        """Yield a function that shows what is being done, and a count."""

        def line(text: str, count: int) -> str:
            return f"{text}, {count} {unit} so far" if count else text

        if not console.is_terminal:
            with _lines("working") as put:
                yield lambda text, count: put(line(text, count))
            return
        columns = (SpinnerColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
        with Progress(*columns, console=console, transient=True) as progress:
            task = progress.add_task("", total=None)
            yield lambda text, count: progress.update(task, description=escape(line(text, count)))


@contextmanager
def _lines(begun: str) -> Iterator[Callable[[str], None]]:
    """Yield a function that takes many lines; the newest, at first what is begun, is printed now and then."""
    newest = [begun]
    began = time.monotonic()
    over = threading.Event()

    def show() -> None:
        while not over.wait(LINE_INTERVAL):
            note(f"{time.monotonic() - began:6.0f} s  {newest[-1]}")

    def put(text: str) -> None:
        newest[:] = [text]

    thread = threading.Thread(target=show, daemon=True, name="progress")
    thread.start()
    try:
        yield put
    finally:
        over.set()
        thread.join()


def note(text: str) -> None:
    """Print a line that the user should read."""
    console.print(text, soft_wrap=True, markup=False)


def warn(text: str) -> None:
    """Print a warning."""
    console.print("note: " + text, style="yellow", soft_wrap=True, markup=False)


def table(title: str, rows: Mapping[str, str]) -> None:
    """Print figures, one a row."""
    grid = Table(title=escape(title), show_header=False, title_justify="left", title_style="bold")
    grid.add_column(style="cyan")
    grid.add_column()
    for name, value in rows.items():
        grid.add_row(escape(name), escape(value))
    console.print(grid)


def matrix(title: str, rows: Mapping[str, Mapping[str, str]], *, as_is: bool = False) -> None:
    """Print rows of figures under common headings: the keys of the first row, without underscores unless ``as_is``."""
    grid = Table(title=escape(title), title_justify="left", title_style="bold")
    grid.add_column(style="cyan")
    headings = tuple(next(iter(rows.values())))
    for heading in headings:
        grid.add_column(escape(heading if as_is else heading.replace("_", " ")), justify="right", overflow="fold")
    for name, values in rows.items():
        grid.add_row(escape(name), *(escape(values[heading]) for heading in headings))
    console.print(grid)

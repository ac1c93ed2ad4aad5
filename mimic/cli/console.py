"""What the commands print: progress bars, notes and tables."""

from __future__ import annotations

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

console = Console(highlight=False)


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int | None], None]]:
    """Yield a function that takes the steps done and in all, and shows them on a line of their own."""
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
def working(unit: str) -> Iterator[Callable[[str, int], None]]:
    """Yield a function that takes what is being done and a count, for work whose end is not known."""
    columns = (SpinnerColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=None)

        def tell(text: str, count: int) -> None:
            progress.update(task, description=escape(f"{text}, {count} {unit} so far" if count else text))

        yield tell


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

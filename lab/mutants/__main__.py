"""Do the tests notice when one token of mimic/ is changed?

    python -m lab.mutants OUT.jsonl [--runs 200] [--seed 0] [--jobs 2] [--tree .]

Places are drawn from all of mimic/'s code, each as likely as any other: operators, comparisons, `and`, `or`, `not`,
numbers, True, False and the names of constants; none in docstrings and other texts, annotations, comments and imports.
An operator becomes its opposite, a comparison stricter, looser or reversed, an integer one more or less, another number
twice or half, a constant another constant of its file. Each mutant runs the fast tests of the folder that mirrors
its file, its own file of tests first, until one fails. A mutant that takes more than three times the folder's time
and 30 s hangs, and is caught.

Each job has a copy of the tree, so nothing else is touched. First each folder runs as it is: tests that fail here,
for want of a library or of a network, are deselected; places whose folder has no test left are passed over, counted,
and replaced by further ones. OUT.jsonl gets a line for each folder and each mutant; what it has is not run again.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

from lab.mutants.places import Mutant, drawn
from lab.mutants.runs import Copy, Folder, folder_of, test_files

Row = dict[str, Any]
Item = TypeVar("Item")


class Pool:
    """Copies of the tree, made when first needed, each in use by one job at a time."""

    def __init__(self, tree: Path, place: Path, jobs: int) -> None:
        self.jobs = jobs
        self._tree = tree
        self._place = place
        self._made = 0
        self._lock = threading.Lock()
        self._free: SimpleQueue[Copy] = SimpleQueue()

    def each(self, items: Sequence[Item], run: Callable[[Copy, Item], Row], done: Callable[[Row], None]) -> None:
        """Run every item in a copy, and hand over the rows as they come."""
        with ThreadPoolExecutor(self.jobs) as threads:
            waiting = [threads.submit(self._one, run, item) for item in items]
            try:
                for future in as_completed(waiting):
                    done(future.result())
            except BaseException:
                threads.shutdown(cancel_futures=True)
                raise

    def _one(self, run: Callable[[Copy, Item], Row], item: Item) -> Row:
        copy = self._take()
        try:
            return run(copy, item)
        finally:
            self._free.put(copy)

    def _take(self) -> Copy:
        with self._lock:
            if not self._free.empty():
                return self._free.get()
            self._made += 1
            place = self._place / str(self._made)
        return Copy(self._tree, place)


def key(row: Row) -> tuple[Any, ...]:
    """Return what tells a mutant from the others."""
    return row["file"], row["line"], row["column"], row["before"], row["after"]


def choose(tree: Path, seed: int, runs: int, folders: dict[str, Folder]) -> tuple[list[Mutant], list[Mutant]]:
    """Return the mutants that are run, and those passed over on the way as no test can judge them."""
    chosen: list[Mutant] = []
    passed_over: list[Mutant] = []
    for mutant in drawn(tree, seed):
        if len(chosen) == runs:
            break
        files = folders[folder_of(tree, mutant.file)].files
        (chosen if files else passed_over).append(mutant)
    return chosen, passed_over


def table(rows: list[Row]) -> str:
    """Return the table by folder and the survivors, as Markdown."""
    lines = ["| folder of tests | mutants | caught | of these hung | share |", "|---|---|---|---|---|"]
    for folder in [*sorted({row["folder"] for row in rows}), "all"]:
        mine = [row for row in rows if folder in (row["folder"], "all")]
        hung = sum(row["result"] == "hung" for row in mine)
        caught = sum(row["result"] != "survived" for row in mine)
        share = f"{caught / len(mine):.0%}" if mine else ""
        lines.append(f"| {folder} | {len(mine)} | {caught} | {hung} | {share} |")
    lines += ["", "Survivors:", ""]
    for row in sorted(rows, key=key):
        if row["result"] == "survived":
            after = row["after"] or "(nothing)"
            lines.append(f"    {row['file']}:{row['line']}:{row['column'] + 1}  {row['before']} -> {after}")
    return "\n".join(lines)


def main() -> int:
    """Run the folders, then the mutants, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="a JSON line for each folder and each mutant")
    parser.add_argument("--runs", type=int, default=200, help="mutants")
    parser.add_argument("--seed", type=int, default=0, help="draws the places")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="runs at the same time")
    parser.add_argument("--tree", type=Path, default=Path.cwd(), help="the source tree, with mimic/ and tests/")
    asked = parser.parse_args()
    tree = asked.tree.resolve()
    for part in ("mimic", "tests"):
        if not (tree / part).is_dir():
            print(f"{tree} has no {part}/: give the root of the source tree with --tree", file=sys.stderr)
            return 2
    rows = []
    if asked.out.exists():
        rows = [json.loads(line) for line in asked.out.read_text(encoding="utf-8").splitlines()]

    def note(row: Row) -> None:
        rows.append(row)
        with asked.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        if "result" in row:
            what = f"{row['file']}:{row['line']}  {row['before']} -> {row['after']}"
            print(f"{row['result']:8s} {row['seconds']:6.1f} s  {what}", flush=True)
        else:
            print(f"as it is {row['seconds']:6.1f} s  {row['folder']}: {row['passed']} passed", flush=True)

    with tempfile.TemporaryDirectory(prefix="mutants-") as place:
        pool = Pool(tree, Path(place), asked.jobs)
        known = {row["folder"] for row in rows if "result" not in row}
        every = sorted({folder_of(tree, str(path.relative_to(tree))) for path in (tree / "mimic").rglob("*.py")})
        largest_first = sorted(every, key=lambda folder: -len(test_files(tree, folder)))
        unknown = [folder for folder in largest_first if folder not in known]
        pool.each(unknown, lambda copy, folder: asdict(copy.as_it_is(folder)), note)
        folders = {row["folder"]: Folder(**row) for row in rows if "result" not in row}
        chosen, passed_over = choose(tree, asked.seed, asked.runs, folders)
        done = {key(row) for row in rows if "result" in row}
        left = [mutant for mutant in chosen if key(asdict(mutant)) not in done]
        pool.each(left, lambda copy, one: copy.judge(one, folders[folder_of(tree, one.file)]), note)
    for folder in folders.values():
        for test in folder.deselected:
            print(f"deselected: {test}")
    print()
    for folder, count in Counter(folder_of(tree, mutant.file) for mutant in passed_over).items():
        print(f"passed over, as no test of the folder can run here: {count} places of {folder}")
    print()
    wanted = {key(asdict(mutant)) for mutant in chosen}
    print(table([row for row in rows if "result" in row and key(row) in wanted]))
    return 0


if __name__ == "__main__":
    sys.exit(main())

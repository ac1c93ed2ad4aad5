"""Other ways to fit a model, on the same logs: what each names, how well it predicts another log, what it costs.

    python -m lab.rivals ../shared/data/logs [--only leg EMPS] [--methods mujoco.sysid] [--results OUT.jsonl]

Every method gets the same logs and the same model. What it found is replayed, by one and the same replay, over another
log of the same machine that no method saw. Prints a table in Markdown; with ``--results`` finished rows are kept and
not run again.
"""

# ruff: noqa: E402
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lab.rivals.cases import Case, arm_case, emps_case, go2_case, leg_case, servo_case, xl330_case
from lab.rivals.methods import METHODS, Found
from mimic.dynamics.machine import as_logged
from mimic.errors import MimicError
from mimic.sysid.log.noise import noise_floor
from mimic.sysid.predict import predict

LEGS = (
    "single/stribeck/medium/probe/0/20s/grid/leg",
    "pair/load_friction+cogging/medium/probe/0/20s/grid/leg",
    "clean/nothing/none/probe/1/20s/grid/leg",
)


def cases(folder: Path) -> dict[str, Callable[[], Case]]:
    """Return the cases by a short name."""
    return {
        "STS3250": partial(servo_case, folder),
        "EMPS": partial(emps_case, folder),
        "Go2": partial(go2_case, folder),
        **{f"XL330 {f.stem}": partial(xl330_case, folder, f.stem) for f in sorted(folder.glob("xl330/*.parquet"))},
        **{f"arm {f.stem}": partial(arm_case, folder, f.stem) for f in sorted(folder.glob("arm/*.parquet"))},
        **{f"leg {key.split('/')[1]}": partial(leg_case, key) for key in LEGS},
    }


def error_of(case: Case, found: Found) -> float:
    """Return the error of the log that was not seen, root mean square over all joints."""
    machine = as_logged(case.machine, case.test.metadata)
    residual = predict(case.test, machine, found.effects)[case.test.t - case.test.t[0] >= case.judged_from]
    return float(np.sqrt(np.nanmean(residual**2)))


def run(case: Case, name: str) -> dict[str, Any]:
    """Return one row."""
    row: dict[str, Any] = {"case": case.title, "method": name, "unit": case.unit[0]}
    row["floor"] = case.unit[1] * float(np.sqrt(np.mean(noise_floor(case.test.q, case.test.rate) ** 2)))
    used, start = time.process_time(), time.perf_counter()
    try:
        found = METHODS[name](case)
    except MimicError as why:
        return {**row, "why_not": str(why)}
    row |= {"cpu_seconds": time.process_time() - used, "seconds": time.perf_counter() - start}
    row |= {"names": found.names, "hidden": case.hidden, "replays": found.replays}
    row["error"] = case.unit[1] * error_of(case, found)
    return row


def named(row: dict[str, Any]) -> str:
    """Return what a method named, and whether it is what is hidden or documented."""
    if row["names"] is None:
        return "names nothing by design"
    said = ", ".join(n.replace("_", " ") for n in row["names"]) or "nothing"
    hidden, names = set(row["hidden"] or ()), set(row["names"])
    if names == hidden:
        return f"{said} (right)"
    if hidden and hidden <= names:
        return f"{said} (right, with {len(names - hidden)} more)"
    return f"{said} (wrong)" if names else f"{said} (missed)"


def table(rows: list[dict[str, Any]]) -> str:
    """Return the rows as Markdown, a table for each case."""
    lines = []
    for title in dict.fromkeys(r["case"] for r in rows):
        mine = [r for r in rows if r["case"] == title]
        unit = mine[0]["unit"]
        lines += [f"**{title[0].upper() + title[1:]}**; noise floor {mine[0]['floor']:.2f} {unit}:", ""]
        lines += [f"| method | names | error of the unseen log [{unit}] | processor time | replays |"]
        lines += ["|---|---|---|---|---|"]
        for r in mine:
            if "why_not" in r:
                lines.append(f"| {r['method']} | not run: {r['why_not']} | | | |")
                continue
            cost = f"{r['cpu_seconds']:.1f} s" if r["cpu_seconds"] > 0.05 else ""
            lines.append(f"| {r['method']} | {named(r)} | {r['error']:.2f} | {cost} | {r['replays'] or ''} |")
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, help="folder of the public logs")
    parser.add_argument("--only", nargs="+", default=[""], help="cases whose short names contain one of these")
    parser.add_argument("--methods", nargs="+", default=[""], help="methods whose names contain one of these")
    parser.add_argument("--results", type=Path, help="one JSON line for each finished row")
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if args.results and args.results.exists():
        rows = [json.loads(line) for line in args.results.read_text(encoding="utf-8").splitlines()]
    for short, make in cases(args.logs).items():
        if not any(part in short for part in args.only):
            continue
        case = make()
        for name in METHODS:
            done = any((r["case"], r["method"]) == (case.title, name) for r in rows)
            if done or not any(part in name for part in args.methods):
                continue
            rows.append(run(case, name))
            if args.results:
                with args.results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    order = list(METHODS)
    print(table(sorted(rows, key=lambda r: order.index(r["method"]))))


if __name__ == "__main__":
    main()

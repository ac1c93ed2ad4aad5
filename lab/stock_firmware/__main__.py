"""mimic --robot cyberdog2 on the maker's firmware.

python -m lab.stock_firmware series OUT.jsonl [JOBS] [CASE=N ...]
                                                     robots of Table II lie, stand up, box, sit down;
                                                     JOBS side by side; goes on where it was stopped
python -m lab.stock_firmware one CASE SEED TARGETS         one of them
python -m lab.stock_firmware cut [ROUNDS]                  processes killed, cable cut: what drives the robot
python -m lab.stock_firmware compare                       the emulated board given the same commands

MIMIC_FIRMWARE names the folder of the built firmware. Needs real time: two cores that do little else, or root, to whom
the system gives real-time priority.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from lab.stock_firmware.compare import compare
from lab.stock_firmware.firmware import Bench, NotHere, inside_network, require_built
from lab.stock_firmware.firmware import upright as uprightness
from lab.stock_firmware.series import CASES, PLAN, children, command, nominal, play_one, series, table, targets

STANDING = 0.35
"""Height of the trunk above which the robot stands [m]."""


def cut_one(folder: Path, work: Path, source: Path, what: str, after: float) -> dict[str, object]:
    """Cut something while the robot boxes, and return what still drove it, from the bench's own record."""
    out = work / "run"
    words = command(source, out)
    work.mkdir(parents=True, exist_ok=True)
    with Bench(folder, work, nominal(work)) as bench:
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        end = time.monotonic() + 40.0
        while bench.height() < STANDING and time.monotonic() < end:
            time.sleep(0.1)
        time.sleep(after)
        sender = children(process.pid)
        before = bench.count()
        began = time.time()
        if what in ("host", "both"):
            os.kill(process.pid, signal.SIGKILL)
        if what in ("sender", "both"):
            for pid in sender:
                os.kill(pid, signal.SIGKILL)
        if what == "host stopped":
            os.kill(process.pid, signal.SIGSTOP)
        if what == "cable":
            subprocess.run(["ip", "link", "set", "lo", "down"], check=True)
        time.sleep(12.0)
        if what == "host stopped":
            os.kill(process.pid, signal.SIGCONT)
        try:
            text, _ = process.communicate(timeout=25.0)
            hung = False
        except subprocess.TimeoutExpired:
            process.kill()
            text, _ = process.communicate()
            hung = True
        if what == "cable":
            subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
            subprocess.run(["ip", "route", "add", "224.0.0.0/4", "dev", "lo"], check=False)
    rows = bench.rows()
    t, kp = rows["t"][before:] - rows["t"][before - 1], rows["kp_max"][before:]
    driven = t[kp > 0.0]
    lines = [line for line in text.splitlines() if line.strip()]
    return {
        "what": what,
        "senders": len(sender),
        "driven_for_s": round(float(driven[-1]), 2) if len(driven) else 0.0,
        "lies": bool(abs(uprightness(rows)[-1]) < 0.3 and rows["z"][-1] < 0.12),
        "z": round(float(rows["z"][-1]), 3),
        "status": process.returncode,
        "hung": hung,
        "traceback": "Traceback" in text,
        "line": re.sub(r"\s+", " ", lines[-1]) if lines else "",
        "seconds": round(time.time() - began, 1),
    }


CUT = ("host", "sender", "both", "host stopped", "cable")


def main(arguments: list[str]) -> int:
    what, *more = arguments or [""]
    try:
        if what == "series" and more:
            jobs = int(more[1]) if len(more) > 1 else 1
            plan = {name: int(count) for name, count in (word.split("=") for word in more[2:])} or PLAN
            print(table(series(Path(more[0]), jobs, plan)))
            return 0
        if what not in ("one", "cut", "compare") or (what == "one" and (len(more) != 3 or more[0] not in CASES)):
            print(__doc__)
            return 2
        status = inside_network(arguments)
        if status is not None:
            return status
        folder = require_built()
    except NotHere as reason:
        print(reason)
        return 2
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        if what == "compare":
            print(json.dumps(compare(folder, work), indent=1))
        elif what == "one":
            print(json.dumps(play_one(folder, work, Path(more[2]), int(more[1]), more[0])), flush=True)
        else:
            source = targets(work)
            for number in range(int(more[0]) if more else 1):
                for cut in CUT:
                    found = cut_one(folder, work / f"{number}-{cut}", source, cut, 2.0 + 1.7 * number)
                    print(json.dumps(found), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""How good a policy is after each minute of its training: the paper's table, not the reward, against time.

    mimic train out --minutes 9.3 --set snapshots=[2,3,4,5,6,7,8]
    python benchmarks/training_curve.py out [more folders] [--episodes 10] [--write docs/images/training_curve.png]

Every ``policy_<minutes>min.onnx`` of the folder, and policy.onnx at its end, is judged under all of the paper's rules;
a point is the mean over three evaluation seeds, and over the folders where there are several: training seeds of the
same settings, in the picture with the lowest and the highest of them. The time is that of the training from its first step on, with the
compilation of kernels. The picture shows each column as a share of what is aimed at, slip the other way round.
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mimic.run.paper_evaluation import evaluate_table
from mimic.settings import TableSettings

AIMS = {"velocity": 0.42, "heading": 0.22, "toes": 0.88, "height": 0.47, "slip": -0.06, "steps": 985.0}
RULES = "all of the paper's"
COLOURS = {
    "velocity": (180, 119, 31),
    "heading": (14, 127, 255),
    "toes": (44, 160, 44),
    "height": (40, 39, 214),
    "slip": (189, 103, 148),
    "steps": (75, 86, 140),
}
WIDTH, HEIGHT, LEFT, TOP, RIGHT, BOTTOM = 900, 520, 70, 30, 150, 60
MOST = 1.2
"""Largest share that the picture shows."""


def snapshots(folder: Path) -> list[tuple[float, Path]]:
    """Return minutes and files, in order."""
    found = [
        (float(m[1]), p) for p in folder.glob("policy_*min.onnx") if (m := re.match(r"policy_([\d.]+)min", p.name))
    ]
    minutes = json.loads((folder / "settings.json").read_text())["learn"]["minutes"]
    if minutes and (folder / "policy.onnx").is_file():
        found.append((float(minutes), folder / "policy.onnx"))
    return sorted(found)


def share(name: str, value: float) -> float:
    """Return how much of what is aimed at is reached."""
    return min(AIMS[name] / min(value, -1e-6), MOST) if name == "slip" else value / AIMS[name]


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    picture = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    last = max(row["minutes"] for row in rows)

    def at(minutes: float, part: float) -> tuple[int, int]:
        x = LEFT + (WIDTH - LEFT - RIGHT) * minutes / last
        y = HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * np.clip(part, 0, MOST) / MOST
        return round(x), round(float(y))

    def text(words: str, x: int, y: int, colour: tuple[int, int, int] = (40, 36, 32)) -> None:
        cv2.putText(picture, words, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)

    for part in np.arange(0.0, MOST + 0.01, 0.2):
        cv2.line(picture, at(0, part), at(last, part), (90, 90, 90) if part == 1 else (225, 225, 225), 1)
        text(f"{100 * part:.0f} %", 14, at(0, part)[1] + 5)
    for minute in range(int(last) + 1):
        x, y = at(minute, 0)
        cv2.line(picture, (x, y), (x, y + 5), (90, 90, 90), 1)
        text(str(minute), x - 5, y + 22)
    text("minutes of training, kernels' compilation included; 100 % is what is aimed at", LEFT, HEIGHT - 12)
    ends = []
    for name, colour in COLOURS.items():
        points = [at(row["minutes"], share(name, row[name])) for row in rows]
        for row in rows:
            low, high = (at(row["minutes"], share(name, value)) for value in row["spread"][name])
            cv2.line(picture, low, high, colour, 1, cv2.LINE_AA)
        cv2.polylines(picture, [np.array(points)], False, colour, 2, cv2.LINE_AA)
        for point in points:
            cv2.circle(picture, point, 4, colour, -1, cv2.LINE_AA)
        ends.append((points[-1][1], name, colour))
    y = TOP - 20
    for wanted, name, colour in sorted(ends):
        y = max(wanted, y + 18)
        text(name, WIDTH - RIGHT + 14, y + 5, colour)
    if not cv2.imwrite(str(path), picture):
        raise SystemExit(f"{path} cannot be written")


def judged(path: Path, episodes: int) -> dict[str, float]:
    """Return the columns of a policy, and its toe error [cm]."""
    table = evaluate_table(path, TableSettings(episodes=episodes))["table"][RULES]
    columns = {name: table["columns"][name]["mean"] for name in AIMS}
    return columns | {"toe_error_cm": table["unweighted"]["toe_error_cm"]["mean"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="+")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--write", type=Path, default=None)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print("| minutes | " + " | ".join(AIMS) + " | toe error [cm] |\n" + "|---" * (len(AIMS) + 2) + "|")
    moments = [dict(snapshots(folder)) for folder in options.folder]
    for minutes in sorted(set.intersection(*(set(m) for m in moments))):
        found = [judged(m[minutes], options.episodes) for m in moments]
        mean = {name: float(np.mean([f[name] for f in found])) for name in found[0]}
        spread = {name: (min(f[name] for f in found), max(f[name] for f in found)) for name in AIMS}
        rows.append({"minutes": minutes, **mean, "spread": spread})
        cells = [f"{mean[n]:.0f}" if n == "steps" else f"{mean[n]:.3f}" for n in AIMS]
        print(f"| {minutes:g} | " + " | ".join(cells) + f" | {mean['toe_error_cm']:.1f} |", flush=True)
    if options.write:
        draw(rows, options.write)


if __name__ == "__main__":
    main()

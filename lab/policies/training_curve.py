"""How good a policy is after each minute of its training: the paper's table, not the reward, against time.

    python -m mimic.train out minutes=9.3 snapshots=[2,3,4,5,6,7,8]
    python -m lab.policies.training_curve out [more folders] [--episodes 10] [--write docs/images/training_curve.png]
    python -m lab.policies.training_curve "defaults=one,two,three" "no gait=four" --write docs/images/ablations.png

Every ``policy_<minutes>min.onnx`` of the folder, and policy.onnx at its end, is judged under all of the paper's rules;
a point is the mean over three evaluation seeds, and over the folders where there are several: training seeds of the
same settings, in the picture with the lowest and the highest of them. The time is that of the training from its first
step on, with the compilation of kernels where that was not kept. The picture shows each column as a share of what is
aimed at, slip the other way round; with names before the folders it compares trainings, one panel a column, and the
paper's figure as a line.
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mimic.config.evaluation import TableSettings
from mimic.evaluation.paper_columns import PAPER
from mimic.evaluation.paper_table import evaluate_table

AIMS = {"velocity": 0.42, "heading": 0.22, "toes": 0.88, "height": 0.47, "slip": -0.06, "steps": 985.0}
RULES = "all of the paper's"
NOISE = "the paper's noise"
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
    text("minutes of training; 100 % is what is aimed at", LEFT, HEIGHT - 12)
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


def compare(variants: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Draw a panel for each column: the variants against time, what is aimed at, and the paper's figure."""
    wide, high, left, top, between = 470, 300, 64, 34, 40
    picture = np.full((2 * high + 60 + 20 * len(variants), 3 * wide, 3), 255, np.uint8)
    last = max(row["minutes"] for rows in variants.values() for row in rows)

    def text(words: str, x: int, y: int, colour: tuple[int, int, int] = (40, 36, 32)) -> None:
        cv2.putText(picture, words, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, 1, cv2.LINE_AA)

    for number, name in enumerate(AIMS):
        x0, y0 = number % 3 * wide + left, number // 3 * high + top
        width, height = wide - left - 20, high - top - between
        paper = PAPER[name][0]
        values = [row[name] for rows in variants.values() for row in rows] + [AIMS[name], paper, 0.0]
        low, top_value = min(values), max(values) * 1.05

        def at(
            minutes: float,
            value: float,
            x0: int = x0,
            y0: int = y0,
            width: int = width,
            height: int = height,
            low: float = low,
            top_value: float = top_value,
        ) -> tuple[int, int]:
            y = y0 + height * (1.0 - (value - low) / (top_value - low))
            return round(x0 + width * minutes / last), round(y)

        text(name, x0, y0 - 10)
        cv2.rectangle(picture, (x0, y0), (x0 + width, y0 + height), (225, 225, 225), 1)
        for value, colour, label in ((AIMS[name], (90, 90, 90), "aim"), (paper, (190, 190, 190), "paper")):
            cv2.line(picture, at(0.0, value), at(last, value), colour, 1)
            text(f"{value:g}", x0 - left + 4, at(0.0, value)[1] + 5, colour)
            text(label, x0 + width - 40, at(last, value)[1] - 4, colour)
        for minute in range(0, int(last) + 1, 2):
            text(str(minute), at(minute, low)[0] - 4, y0 + height + 18)
        for rows, colour in zip(variants.values(), COLOURS.values(), strict=False):
            points = [at(row["minutes"], row[name]) for row in rows]
            for row in rows:
                cv2.line(picture, *(at(row["minutes"], v) for v in row["spread"][name]), colour, 1, cv2.LINE_AA)
            cv2.polylines(picture, [np.array(points)], False, colour, 2, cv2.LINE_AA)
            for point in points:
                cv2.circle(picture, point, 3, colour, -1, cv2.LINE_AA)
    text("minutes of training", left, 2 * high + 12)
    for line, (name, colour) in enumerate(zip(variants, COLOURS.values(), strict=False)):
        y = 2 * high + 34 + 20 * line
        cv2.line(picture, (left, y - 4), (left + 30, y - 4), colour, 2, cv2.LINE_AA)
        text(name, left + 40, y)
    if not cv2.imwrite(str(path), picture):
        raise SystemExit(f"{path} cannot be written")


def judged(path: Path, episodes: int) -> dict[str, float]:
    """Return the columns of a policy, and its toe error [cm]."""
    table = evaluate_table(path, TableSettings(episodes=episodes, senses=(NOISE,)))["table"][NOISE][RULES]
    columns = {name: table["columns"][name]["mean"] for name in AIMS}
    return columns | {"toe_error_cm": table["unweighted"]["toe_error_cm"]["mean"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="+", help="folder of a training, or NAME=FOLDER,FOLDER,...")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--write", type=Path, default=None)
    options = parser.parse_args()
    variants: dict[str, list[Path]] = {}
    for word in options.folder:
        name, named, folders = word.rpartition("=")
        variants.setdefault(name, []).extend(Path(folder) for folder in (folders.split(",") if named else [word]))
    curves = {name: course(name, folders, options.episodes) for name, folders in variants.items()}
    if options.write and set(curves) == {""}:
        draw(curves[""], options.write)
    elif options.write:
        compare(curves, options.write)


def course(name: str, folders: list[Path], episodes: int) -> list[dict[str, Any]]:
    """Judge trainings that differ by their seed, print a table, and return its rows."""
    rows: list[dict[str, Any]] = []
    print(f"{name}\n\n" * bool(name) + "| minutes | " + " | ".join(AIMS) + " | toe error [cm] |")
    print("|---" * (len(AIMS) + 2) + "|")
    moments = [dict(snapshots(folder)) for folder in folders]
    for minutes in sorted(set.intersection(*(set(m) for m in moments))):
        found = [judged(m[minutes], episodes) for m in moments]
        mean = {name: float(np.mean([f[name] for f in found])) for name in found[0]}
        spread = {name: (min(f[name] for f in found), max(f[name] for f in found)) for name in AIMS}
        rows.append({"minutes": minutes, **mean, "spread": spread})
        cells = [f"{mean[n]:.0f}" if n == "steps" else f"{mean[n]:.3f}" for n in AIMS]
        print(f"| {minutes:g} | " + " | ".join(cells) + f" | {mean['toe_error_cm']:.1f} |", flush=True)
    return rows


if __name__ == "__main__":
    main()

"""The tables of lab/results/policy.md and robustness.md for a policy, as Markdown.

Measure and print, an hour on 2 quiet cores; with --write into both pages, with the heat map; or from stored results:

    python -m lab.policies.policy_report [POLICY]
    python -m lab.policies.policy_report [POLICY] --write lab/results
    python -m lab.policies.policy_report [POLICY] --table a.json --stand-up b.json --calm c.json --robustness d.json
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from lab.policies.studies.calm import evaluate_calm
from lab.policies.studies.heat_map import draw_heat_map
from lab.policies.studies.paper_table import evaluate_table
from lab.policies.studies.robustness import evaluate_robustness
from lab.policies.studies.settings import CalmSettings, RobustnessSettings, StandUpSettings, TableSettings
from lab.policies.studies.stand_up import evaluate_stand_up
from lab.policies.studies.walking import ARMS
from mimic.io.store import sha256_of
from mimic.policy.runtime import cached_policy
from mimic.robot.description import load_description

HERE = Path(__file__).resolve().parent
BEGIN, END = "<!-- measured: lab/policies/policy_report.py -->", "<!-- end of measured -->"


def row(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


def rows(head: tuple[str, ...], body: list[tuple[str, ...]]) -> str:
    return "\n".join([row(*head), "|---" * len(head) + "|", *(row(*cells) for cells in body)])


def paper_table(result: dict[str, Any]) -> str:
    def cells(columns: dict[str, Any]) -> list[str]:
        digits = {name: 1 if name in ("episode_reward", "steps") else 3 for name in columns}
        return [f"{v['mean']:.{digits[n]}f} ± {v['std']:.{digits[n]}f}" for n, v in columns.items()]

    head = ("", *(name.replace("_", " ") for name in result["paper"]))
    body = [("paper", *cells(result["paper"]))]
    rules = list(next(iter(result["table"].values())))
    first = next(iter(result["table"].values()))
    body += [(name, *cells(found[rules[-1]]["columns"])) for name, found in result["table"].items()]
    ends = [
        (name, ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in found["ended_by"].items()))
        for name, found in first.items()
    ]
    error = first["contacts"]["unweighted"]
    spread = {name: f"{value['mean']:.3f} ± {value['std']:.3f}" for name, value in error.items()}
    return "\n\n".join(
        [
            rows(head, body),
            f"How the episodes of the row *{next(iter(result['table']))}* end:",
            rows(("rules", "ended by"), ends),
            f"Unweighted, after the 50th step, ended by contacts: toes {spread['toe_error_cm']} cm, velocity "
            f"{spread['velocity_error_m_s']} m/s, heading {spread['heading_error_rad']} rad.",
        ]
    )


def walking_table(found: list[dict[str, Any]], unit: str) -> str:
    by_asked: dict[float, list[str]] = {}
    for row in found:
        value, height = row[f"reached_{unit}"], row["step_height_m"]
        fell = f", {row['fell']:.0%} fell" if row["fell"] else ""
        cells = by_asked.setdefault(row[f"asked_{unit}"], [])
        cells += [("–" if value is None else f"{value:+.2f}") + fell]
        cells += ["–" if height is None else f"{100 * height:.1f}"]
    heads = [name for arms in ARMS for name in (f"reached, arms {arms}", "steps [cm]")]
    return rows(
        (f"asked [{unit.replace('_', '/')}]", *heads),
        [(f"{asked:+.2f}", *cells) for asked, cells in by_asked.items()],
    )


def calm_table(result: dict[str, Any]) -> str:
    summary = result["summary"]
    cells = {
        "still standing": lambda s: f"{100 * s['stood']:.0f} %",
        "both feet planted": lambda s: f"{100 * s['planted']:.0f} %",
        "heat of the windings": lambda s: f"{s['heat_w']:.0f} W",
        "hind knees, rms": lambda s: f"{s['knee_rms_nm']:.1f} N·m",
        "a motor at its torque limit": lambda s: f"{100 * s['at_limit']:.1f} %",
        "torque variance above 20 Hz": lambda s: f"{100 * s['fast_torque']:.0f} %",
        "action rate, hind legs, rms": lambda s: f"{s['action_rate_rad']:.2f} rad",
        "drift, mean and most": lambda s: f"{s['drift_m']:.2f}, {s['drift_max_m']:.2f} m",
    }
    standing = summary["standing"]
    body = [(name, *(cell(s) for s in standing.values())) for name, cell in cells.items()]
    shares = {f"pushed by {name}": v for name, v in summary["pushed"].items()}
    shares |= {f"pulled by {name}": v for name, v in summary["pulled"].items()}
    return "\n\n".join(
        [
            rows(("standing for 60 s", *standing), body),
            rows(("while standing", "stand after it"), [(name, f"{100 * v:.0f} %") for name, v in shares.items()]),
        ]
    )


def robustness_table(result: dict[str, Any]) -> str:
    def span(pair: tuple[float, float] | None, none: str) -> str:
        return none if pair is None else f"{pair[0]:g} … {pair[1]:g}"

    body = []
    for name, axis in result["axes"].items():
        unit = f" [{axis['unit']}]" if axis["unit"] else ""
        shares = ", ".join(f"{p['value']:g}: {100 * p['survived']:.0f}" for p in axis["points"])
        title = name.replace("_", " ") + unit
        body.append(
            (title, span(axis["trained"], "–"), span(axis["asked"], "–"), span(axis["holds"], "nowhere"), shares)
        )
    head = ("axis", "trained", "asked", "95 % hold", "survived [%] at each value")
    whole = [(f"all at once, {100 * float(s):.0f} % of the asked ranges", v) for s, v in result["together"].items()]
    whole += [(f"drawn from {name}", value) for name, value in result["randomised"].items()]
    solvers = list(result["solvers"].items())
    return "\n\n".join(
        [
            rows(head, body),
            rows(("everything drawn at once", "survived"), [(n, f"{100 * v:.1f} %") for n, v in whole]),
            rows(("solver, on the paper's random robots", "survived"), [(n, f"{100 * v:.1f} %") for n, v in solvers]),
        ]
    )


def paper_and_walking(result: dict[str, Any]) -> str:
    return "\n\n".join(
        [paper_table(result), walking_table(result["walking"], "m_s"), walking_table(result["turning"], "rad_s")]
    )


def trunk_table(result: dict[str, Any]) -> str:
    return rows(
        ("height of the hips and lean that are asked", "stand", "height off", "lean off", "toes off"),
        [
            (
                what,
                f"{100 * s['stood']:.0f} %",
                f"{s['height_cm']:.1f} cm",
                f"{s['pitch_deg']:.1f}°",
                f"{s['toe_cm']:.2f} cm",
            )
            for what, s in result["summary"].items()
        ],
    )


def lead_table(result: dict[str, Any]) -> str:
    s = result["summary"]
    return rows(
        (f"{s['episodes']} randomised robots led by a front toe", "measured"),
        [
            ("still standing", f"{100 * s['stood']:.1f} %"),
            ("followed the hand", f"{100 * s['followed']:.1f} %"),
            ("… and stopped when let go", f"{100 * s['stopped']:.1f} %"),
            ("distance in the hand's direction", f"{s['way_m']:.1f} m"),
            ("pull", f"{s['pull_mean_n']:.1f} N mean, {s['pull_max_n']:.1f} N most"),
            ("speed 1 s after it is let go", f"{s['speed_after_m_s']:.2f} m/s"),
        ],
    )


def stand_up_table(result: dict[str, Any]) -> str:
    s = result["summary"]
    return rows(
        ("standing up and standing still", "measured"),
        [
            ("upright within 1.5 s", f"{100 * s['upright_in_time']:.1f} %"),
            ("… and still standing at 3 s", f"{100 * s['upright_in_time_and_kept']:.1f} %"),
            (
                "time to stand up",
                f"{s['stand_up_median_s']:.2f} s median, {s['stand_up_p95_s']:.2f} s at the 95th percentile",
            ),
            ("fastest joint", f"{s['joint_speed_max_rad_s']:.1f} of {s['joint_speed_limit_rad_s']:.1f} rad/s"),
            ("largest torque", f"{s['torque_max_nm']:.1f} of {s['torque_limit_nm']:.1f} N·m"),
            (
                "drift in 20 s of standing still",
                f"{s['still_drift_mean_m']:.2f} m mean, {s['still_drift_max_m']:.2f} m at most",
            ),
            ("turned meanwhile", f"{s['still_turned_max_rad']:.2f} rad at most"),
        ],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", nargs="?", type=Path, default=Path("policies/stand_track.onnx"))
    parser.add_argument("--table", type=Path, help="JSON of python -m lab.policies table POLICY")
    parser.add_argument("--stand-up", type=Path, help="JSON of python -m lab.policies stand-up POLICY")
    parser.add_argument("--calm", type=Path, help="JSON of python -m lab.policies calm POLICY")
    parser.add_argument("--robustness", type=Path, help="JSON of python -m lab.policies robustness POLICY")
    parser.add_argument("--write", type=Path, help="folder of both pages; their measured parts are replaced")
    given = parser.parse_args()
    cached_policy(str(given.policy), "cyberdog2")
    report(given, load_description("cyberdog2").name)


def report(given: argparse.Namespace, robot: str) -> None:
    digest = sha256_of(given.policy)

    def stored(path: Path, key: str) -> dict[str, Any]:
        result = json.loads(path.read_text())
        if key not in result:
            sys.exit(f"{path} has no {key!r}; expected what python -m lab.policies wrote for that study")
        if digest not in json.dumps(result["provenance"]):
            sys.exit(f"{path} was not measured on {given.policy} ({digest[:12]})")
        return result

    table = stored(given.table, "episodes") if given.table else evaluate_table(given.policy, TableSettings())
    robust = (
        stored(given.robustness, "episodes_per_point")
        if given.robustness
        else evaluate_robustness(given.policy, RobustnessSettings())
    )
    rise = stored(given.stand_up, "summary") if given.stand_up else evaluate_stand_up(given.policy, StandUpSettings())
    calm = stored(given.calm, "summary") if given.calm else evaluate_calm(given.policy, CalmSettings())
    fastest = cached_policy(str(given.policy), "cyberdog2").contract.velocity_max[0]
    robots = next(iter(calm["summary"]["standing"].values()))["episodes"]
    episodes, points = len(next(iter(table["episodes"].values()))["contacts"]), robust["episodes_per_point"]
    text = "\n\n".join(
        [
            f"Policy `{given.policy.name}`, SHA-256 `{digest[:12]}…`, on {robot}.",
            "## The paper's Table III",
            f"`python -m lab.policies table {given.policy}`, {episodes} episodes a row, "
            "all of the paper's terminations.",
            paper_table(table),
            "## Walking",
            "The robot as described, three walks each, 3 to 12 s after the start. Faster than "
            f"{fastest:g} m/s was not trained.",
            walking_table(table["walking"], "m_s"),
            "On the spot, the same for turns:",
            walking_table(table["turning"], "rad_s"),
            "## Calm",
            f"`python -m lab.policies calm {given.policy}`, {robots} randomised robots (Table II), and "
            f"{CalmSettings().pushed_episodes} for each push and pull.",
            calm_table(calm),
            "## Standing up and standing still",
            f"`python -m lab.policies stand-up {given.policy}`, {rise['summary']['starts']} starts, "
            f"{rise['summary']['still_episodes']} nominal robots that stand still.",
            stand_up_table(rise),
        ]
    )
    asked = f"`python -m lab.policies robustness {given.policy}`, {points} episodes at each point."
    pages = {"policy.md": text, "robustness.md": f"{asked}\n\n{robustness_table(robust)}"}
    for name, measured in pages.items():
        if given.write is None:
            print(measured)
        else:
            write(given.write / name, measured)
    if given.write is not None:
        draw_heat_map({**robust, "policy": given.policy.name}, HERE.parents[1] / "docs" / "images" / "robustness.png")


def write(path: Path, measured: str) -> None:
    page = path.read_text()
    if BEGIN not in page or END not in page:
        sys.exit(f"{path} lacks the lines {BEGIN} and {END}")
    path.write_text(f"{page.split(BEGIN)[0]}{BEGIN}\n\n{measured}\n\n{END}{page.split(END)[1]}")


if __name__ == "__main__":
    main()

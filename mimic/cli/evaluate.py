"""``mimic evaluate``: a policy over many episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from mimic.cli import options as o
from mimic.cli.console import ConsoleReporter, console, matrix, table
from mimic.cli.exit_status import DONE
from mimic.config.evaluation import (
    CalmSettings,
    EpisodeSettings,
    LeadSettings,
    RobustnessSettings,
    SitDownEvaluateSettings,
    StandUpSettings,
    TableSettings,
)

WIDE = 120
"""Columns of a terminal in which the paper's table fits with its standard deviations."""


def evaluate(
    policy: str = "stand_track",
    kind: Literal["table", "stand-up", "calm", "lead", "robustness"] | None = None,
    /,
    *,
    out: o.Out = None,
    episodes: int | None = None,
    seconds: float | None = None,
    seed: int | None = None,
    workers: int = 0,
    robot: o.Effects = None,
) -> int:
    """Evaluate a policy in plain MuJoCo from the lying start: standing up, reaching, walking, turning.

    A policy that sits down is evaluated by switching to it from the shipped tracking policy.

    Parameters
    ----------
    policy
        ONNX file with its contract inside, or a shipped policy of the robot: stand_track, sit_down.
    kind
        Another evaluation. table: the columns of the paper's Table III, next to the paper's. stand-up: 500 lying
        starts, and standing still for 20 s. calm: standing for 60 s, with and without noise; pushes, pulls. lead: led
        by a front toe, 5 m at 0.2 m/s in any direction. robustness: survived share along each disturbance, with a heat
        map.
    out
        JSON file for all figures; default: KIND-NAME.json or evaluation-NAME.json in the current folder. The heat
        map is written next to it.
    episodes
        Randomised episodes: 200; table 50 for each of three seeds; stand-up 500 starts; calm 20; lead 40; robustness
        40 at each point; 500 switches to a policy that sits down.
    seconds
        Length of a randomised episode: 20 s; stand-up 3 s; calm 60 s; lead 32 s; robustness 10 s; latest policy
        switch: 10 s.
    seed
        Seed of the first episode: 1; table, calm and lead use seeds that no policy was selected on.
    workers
        Processes; 0: one per core.
    """
    from mimic.flows.evaluate import KINDS
    from mimic.flows.evaluate import evaluate as run
    from mimic.flows.play import load_policy, load_robot
    from mimic.policy.runtime import find_policy

    given = {"episodes": episodes, "seconds": seconds, "seed": seed, "workers": workers, "robot": robot}
    options: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    what = kind or "stand_track"
    settings: Any = KINDS[what][0](**options)
    model = load_robot(settings.robot.robot_model)
    path = find_policy(policy, model.name)
    if kind is None and load_policy(path, model).contract.task == "sit_down":
        what, settings = "sit_down", KINDS["sit_down"][0](**options)
    file = out or Path(f"{kind or 'evaluation'}-{path.stem}.json")
    result = run(path, settings, out=file, reporter=ConsoleReporter())
    SHOW[what](path, result, settings, file)
    return DONE


def _show_tracking(policy: Path, result: dict[str, Any], settings: EpisodeSettings, out: Path) -> None:
    s = result["summary"]
    walk = ", ".join(f"{v:+.2f} at {k}" for k, v in s["walk_m_s"].items())
    turn = ", ".join(f"{v:.2f} at {k} deg" for k, v in s["turn_error_rad"].items())
    table(
        f"{policy.name}: {s['episodes']} randomised episodes of {settings.seconds:g} s, and nominal ones",
        {
            "stood up in 1.5 s and kept standing": f"{s['stood_up_and_kept']:.1%}",
            "time to stand up": f"{s['stand_up_median_s']:.2f} s median, {s['stand_up_p95_s']:.2f} s 95th percentile",
            "toe error, randomised": f"{s['randomised_toe_error_cm']:.1f} cm",
            "toe error, nominal": f"{s['nominal_toe_error_cm']:.1f} cm",
            "walking speed [m/s]": walk,
            "heading error after 10 s [rad]": turn,
            "drift while standing": f"{s['nominal_drift_m']:.2f} m in {settings.seconds:g} s",
            "falls on the nominal robot": f"{s['nominal_falls']}",
            "heat": f"{s['nominal_knee_torque_rms_nm']:.1f} N m rms in the hind knees, "
            f"{s['nominal_minutes_to_limit']:.0f} min to the hottest motor's limit",
            "written": str(out),
        },
    )


def _show_sit_down(policy: Path, result: dict[str, Any], settings: SitDownEvaluateSettings, out: Path) -> None:
    s = result["summary"]

    def spread(name: str, unit: str) -> str:
        v = s[name]
        return f"{v['median']:.2f} median, {v['p95']:.2f} 95th percentile, {v['max']:.2f} {unit} at most"

    table(
        f"{policy.name}: {s['hand_overs']} policy switches from {result['tracker']}",
        {
            "came down gently and lies": f"{s['success']:.1%}",
            "came down gently": f"{s['gentle']:.1%}",
            "lies at the end": f"{s['lies']:.1%}",
            "head on the ground": f"{s['head_contacts']}",
            "trunk on the ground": f"{s['trunk_contacts']}",
            "base speed when the trunk touches": spread("impact_speed", "m/s"),
            "lies after": spread("lying_after_s", "s"),
            "downward base speed": spread("sinking_speed", "m/s"),
            "front toes meet the ground": spread("toe_speed", "m/s"),
            "hind knees meet the ground": spread("knee_speed", "m/s"),
            "acceleration of the base": spread("acceleration", "m/s^2"),
            "joints off the lying pose": spread("pose_error_rad", "rad"),
            "about to fall before": f"{s['falling_before']} more, not counted",
            "written": str(out),
        },
    )


def _show_table(policy: Path, result: dict[str, Any], settings: TableSettings, out: Path) -> None:
    spread = console.width >= WIDE
    rules = list(next(iter(result["table"].values())))
    rows = {"paper": _figures(result["paper"], spread)}
    rows |= {name: _figures(row[rules[-1]]["columns"], spread) for name, row in result["table"].items()}
    count = f"{settings.episodes} episodes x {settings.seeds} seeds of {settings.seconds:g} s"
    if not spread:
        count += " (spread over seeds: in the file)"
    matrix(f"{policy.name}: the paper's Table III, {count}, with all of its terminations", rows)
    first = result["table"][settings.senses[0]]
    rows = {name: _figures(row["columns"], spread) for name, row in first.items()}
    matrix(f"With {settings.senses[0]}, by what ends an episode", rows)
    for kind, unit, what in (("walking", "m_s", "Speed [m/s]"), ("turning", "rad_s", "Turning rate [rad/s]")):
        reached = _reached(result[kind], unit)
        if reached:
            matrix(f"{what} reached by what was asked, and height of the steps, without noise", reached)
    last = first["contacts"]["unweighted"]
    table(
        f"With {settings.senses[0]}, unweighted means after the 50th step, ended by contacts",
        {
            "toe error": f"{last['toe_error_cm']['mean']:.2f} cm",
            "velocity error": f"{last['velocity_error_m_s']['mean']:.3f} m/s",
            "heading error": f"{last['heading_error_rad']['mean']:.3f} rad",
        }
        | {
            f"how they ended, {name}": ", ".join(f"{n} {kind}" for kind, n in row["ended_by"].items())
            for name, row in first.items()
        }
        | {"written": str(out)},
    )


def _reached(rows: list[dict[str, Any]], unit: str) -> dict[str, dict[str, str]]:
    """Return the cells of what was reached, by what was asked and by what the arms did."""
    cells: dict[str, dict[str, str]] = {}
    for row in rows:
        value, height = row[f"reached_{unit}"], row["step_height_m"]
        text = "-" if value is None else f"{value:+.2f}"
        text += f", {100 * height:.1f} cm" if height is not None else ""
        text += f", {row['fell']:.0%} fell" if row["fell"] else ""
        cells.setdefault(f"{row[f'asked_{unit}']:+.2f}", {})[f"arms {row['arms']}"] = text
    return cells


def _show_stand_up(policy: Path, result: dict[str, Any], settings: StandUpSettings, out: Path) -> None:
    s = result["summary"]
    table(
        f"{policy.name}: {s['starts']} lying starts, and {s['still_episodes']} nominal robots that stand still",
        {
            "upright in 1.5 s": f"{s['upright_in_time']:.1%}",
            f"… and still at {settings.seconds:g} s": f"{s['upright_in_time_and_kept']:.1%}",
            "time to stand up": f"{s['stand_up_median_s']:.2f} s median, {s['stand_up_p95_s']:.2f} s 95th percentile",
            "fastest joint": f"{s['joint_speed_max_rad_s']:.1f} of {s['joint_speed_limit_rad_s']:.1f} rad/s",
            "largest torque": f"{s['torque_max_nm']:.1f} of {s['torque_limit_nm']:.1f} N m",
            "drift while standing still": f"{s['still_drift_mean_m']:.2f} m mean, {s['still_drift_max_m']:.2f} m most "
            f"in {settings.still_seconds:g} s",
            "written": str(out),
        },
    )


def _show_calm(policy: Path, result: dict[str, Any], settings: CalmSettings, out: Path) -> None:
    s = result["summary"]
    rows = {
        what: {
            "still standing": f"{f['stood']:.0%}",
            "both feet planted": f"{f['planted']:.0%}",
            "heat": f"{f['heat_w']:.0f} W",
            "knees, rms": f"{f['knee_rms_nm']:.1f} N m",
            "at the limit": f"{f['at_limit']:.1%}",
            "above 20 Hz": f"{f['fast_torque']:.0%}",
            "action rate": f"{f['action_rate_rad']:.3f} rad",
            "drift, most": f"{f['drift_m']:.2f}, {f['drift_max_m']:.2f} m",
        }
        for what, f in s["standing"].items()
    }
    matrix(f"{policy.name}: {settings.episodes} randomised robots that stand for {settings.seconds:g} s", rows)
    shares = {f"pushed by {what}": f"{v:.0%}" for what, v in s["pushed"].items()}
    shares |= {f"pulled by {what}": f"{v:.0%}" for what, v in s["pulled"].items()}
    table(f"Share of {settings.pushed_episodes} that stand after it", shares | {"written": str(out)})


def _show_lead(policy: Path, result: dict[str, Any], settings: LeadSettings, out: Path) -> None:
    s, hand = result["summary"], settings.hand
    table(
        f"{policy.name}: {s['episodes']} randomised robots led {hand.way:g} m at {hand.speed:g} m/s by a front toe",
        {
            "still standing": f"{s['stood']:.1%}",
            "followed the hand": f"{s['followed']:.1%}",
            "… and stopped when let go": f"{s['stopped']:.1%}",
            "way": f"{s['way_m']:.1f} m of {hand.way:g} m in the hand's direction",
            "pull": f"{s['pull_mean_n']:.1f} N mean, {s['pull_max_n']:.1f} N most (the hand slips at {hand.most:g} N)",
            "speed 1 s after it is let go": f"{s['speed_after_m_s']:.2f} m/s",
            "written": str(out),
        },
    )


def _show_robustness(policy: Path, result: dict[str, Any], settings: RobustnessSettings, out: Path) -> None:
    from mimic.view.report.robustness import draw_heat_map

    picture = out.with_suffix(".png")
    draw_heat_map(result, picture)
    rows = {}
    for name, axis in result["axes"].items():
        low, high = axis["asked"]
        inside = [p["survived"] for p in axis["points"] if low <= p["value"] <= high]
        trained = "-" if axis["trained"] is None else f"{axis['trained'][0]:g} … {axis['trained'][1]:g}"
        rows[f"{name.replace('_', ' ')} [{axis['unit']}]" if axis["unit"] else name.replace("_", " ")] = {
            "trained": trained,
            "asked": f"{low:g} … {high:g}",
            "survived, worst in it": f"{min(inside):.0%}",
            "95 % hold": "nowhere" if axis["holds"] is None else f"{axis['holds'][0]:g} … {axis['holds'][1]:g}",
        }
    matrix(f"{policy.name}: {settings.episodes} episodes of {settings.seconds:g} s at each point", rows)
    shares = {f"all at once, {float(s):.0%} of the ranges": f"{v:.0%}" for s, v in result["together"].items()}
    shares |= {name: f"{v:.0%}" for name, v in result["randomised"].items()}
    shares |= {f"solver: {name}": f"{v:.0%}" for name, v in result["solvers"].items()}
    table("Survived", shares | {"written": f"{out}, {picture}"})


def _figures(columns: dict[str, dict[str, float]], spread: bool) -> dict[str, str]:
    """Return mean±standard deviation of each column as text, or the mean; the episode's sums with one decimal."""
    cells: dict[str, str] = {}
    for name, value in columns.items():
        digits = 1 if name in ("episode_reward", "steps") else 3
        cells[name] = f"{value['mean']:.{digits}f}" + (f"±{value['std']:.{digits}f}" if spread else "")
    return cells


SHOW = {
    "stand_track": _show_tracking,
    "sit_down": _show_sit_down,
    "table": _show_table,
    "stand-up": _show_stand_up,
    "calm": _show_calm,
    "lead": _show_lead,
    "robustness": _show_robustness,
}
"""What prints the figures of each kind."""

"""Training and judging policies from the command line."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mimic import store
from mimic.cli import COMMAND
from mimic.cli.app import DONE
from mimic.cli.console import console, matrix, note, progress_bar, table, warn
from mimic.errors import AssetError, MissingExtra
from mimic.settings import (
    ENDLESS,
    EffectsSettings,
    EvaluateSettings,
    LearnSettings,
    MdpSettings,
    RobustnessSettings,
    SitDownEvaluateSettings,
    StandUpSettings,
    TableSettings,
)


def tell_of_stand(robot: EffectsSettings) -> None:
    """Say which effects of a hung robot its simulation on its feet does without."""
    if robot.effects is None:
        return
    from mimic.robot.effect_set import read_effects
    from mimic.robot.servo import of_stand

    for name in of_stand(read_effects(Path(robot.effects))):
        warn(f"effect {name!r} is of the stand that the robot hung in; on its feet it is left out")


def _judged(judge: Callable[..., dict[str, Any]], policy: Path, out: Path, settings: Any) -> dict[str, Any]:
    """Return what a way of judging finds, shown as it goes and written with its provenance."""
    from mimic.run.pool import simulated

    if not policy.is_file():
        raise AssetError(f"there is no policy {policy}; the shipped one is policies/stand_track.onnx")
    tell_of_stand(settings.robot)
    simulated(settings.robot)  # refused before there is a bar
    with progress_bar("episodes") as progress:
        result = judge(policy, settings, progress=progress)
    inputs = {"policy": policy} | ({} if settings.robot.effects is None else {"effects": Path(settings.robot.effects)})
    made_by = store.provenance(command=COMMAND.get(), settings=settings, inputs=inputs)
    store.save_json({**result, "provenance": made_by}, out)
    return result


def evaluate_policy(policy: Path, out: Path, settings: EvaluateSettings) -> int:
    """Judge a policy, print the figures that decide, and write all of them."""
    from mimic.run.evaluation import evaluate

    result = _judged(evaluate, policy, out, settings)
    s = result["summary"]
    walk = ", ".join(f"{v:+.2f} at {k}" for k, v in s["walk_m_s"].items())
    turn = ", ".join(f"{v:.2f} at {k} deg" for k, v in s["turn_error_rad"].items())
    table(
        f"{policy.name}: {s['episodes']} randomised episodes of {settings.seconds:g} s, and nominal ones",
        {
            "stood up in 1.5 s and kept standing": f"{s['stood_up_and_kept']:.1%}",
            "time to stand up": f"{s['stand_up_median_s']:.2f} s median, {s['stand_up_p95_s']:.2f} s at the 95th percentile",
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
    return DONE


def task_of(policy: Path) -> str:
    """Return what a policy was trained to do.

    Raises:
        AssetError, ContractError: If it cannot be run on this robot.
    """
    from mimic.policy.runtime import Policy
    from mimic.robot.description import load_description

    return Policy(policy, load_description()).contract.task


def evaluate_sit_down(policy: Path, out: Path, settings: SitDownEvaluateSettings) -> int:
    """Judge a policy that sits down, print the figures that decide, and write all of them."""
    from mimic.run import sit_down_evaluation

    result = _judged(sit_down_evaluation.evaluate_sit_down, policy, out, settings)
    s = result["summary"]

    def told(name: str, unit: str) -> str:
        return f"{s[name]['median']:.2f} median, {s[name]['p95']:.2f} at the 95th percentile, {s[name]['max']:.2f} {unit} at most"

    table(
        f"{policy.name}: {s['hand_overs']} hand-overs from {result['tracker']}",
        {
            "came down gently and lies": f"{s['success']:.1%}",
            "came down gently": f"{s['gentle']:.1%}",
            "lies at the end": f"{s['lies']:.1%}",
            "head on the ground": f"{s['head_contacts']}",
            "trunk on the ground": f"{s['trunk_contacts']}",
            "base speed when the trunk touches": told("impact_speed", "m/s"),
            "downward base speed": told("sinking_speed", "m/s"),
            "front toes meet the ground": told("toe_speed", "m/s"),
            "hind knees meet the ground": told("knee_speed", "m/s"),
            "acceleration of the base": told("acceleration", "m/s^2"),
            "joints off the lying pose": told("pose_error_rad", "rad"),
            "about to fall before": f"{s['falling_before']} more, not counted",
            "written": str(out),
        },
    )
    return DONE


def evaluate_table(policy: Path, out: Path, settings: TableSettings) -> int:
    """Judge a policy in the paper's figures, print them beside the paper's, and write all of them."""
    from mimic.run import paper_evaluation

    result = _judged(paper_evaluation.evaluate_table, policy, out, settings)
    found = {"paper": figures(result["paper"])}
    found |= {name: figures(row["columns"]) for name, row in result["table"].items()}
    rows = {name.replace("_", " "): {way: found[way][name] for way in found} for name in result["paper"]}
    count = f"{settings.episodes} episodes x {settings.seeds} seeds"
    matrix(f"{policy.name}: the paper's Table III, {count} of {settings.seconds:g} s, by what ends them", rows)
    last = result["table"]["contacts"]["unweighted"]
    table(
        "Unweighted means after the 50th step, ended by contacts",
        {
            "toe error": f"{last['toe_error_cm']['mean']:.2f} cm",
            "velocity error": f"{last['velocity_error_m_s']['mean']:.3f} m/s",
            "heading error": f"{last['heading_error_rad']['mean']:.3f} rad",
        }
        | {
            f"how they ended, {name}": ", ".join(f"{n} {kind}" for kind, n in row["ended_by"].items())
            for name, row in result["table"].items()
        }
        | {"written": str(out)},
    )
    return DONE


def evaluate_stand_up(policy: Path, out: Path, settings: StandUpSettings) -> int:
    """Judge standing up and standing still, print the figures, and write all of them."""
    from mimic.run import stand_up

    result = _judged(stand_up.evaluate_stand_up, policy, out, settings)
    s = result["summary"]
    table(
        f"{policy.name}: {s['starts']} lying starts, and {s['still_episodes']} nominal robots that stand still",
        {
            "upright in 1.5 s": f"{s['upright_in_time']:.1%}",
            f"… and still at {settings.seconds:g} s": f"{s['upright_in_time_and_kept']:.1%}",
            "time to stand up": f"{s['stand_up_median_s']:.2f} s median, {s['stand_up_p95_s']:.2f} s at the 95th percentile",
            "fastest joint": f"{s['joint_speed_max_rad_s']:.1f} of {s['joint_speed_limit_rad_s']:.1f} rad/s",
            "largest torque": f"{s['torque_max_nm']:.1f} of {s['torque_limit_nm']:.1f} N m",
            "drift while standing still": f"{s['still_drift_mean_m']:.2f} m mean, {s['still_drift_max_m']:.2f} m at most in "
            f"{settings.still_seconds:g} s",
            "written": str(out),
        },
    )
    return DONE


def evaluate_robustness(policy: Path, out: Path, settings: RobustnessSettings) -> int:
    """Disturb a policy along each axis, print where it breaks, write all shares and draw them."""
    from mimic.run import robustness
    from mimic.view.heat_map import draw_heat_map

    result = _judged(robustness.evaluate_robustness, policy, out, settings)
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
    return DONE


def figures(columns: dict[str, dict[str, float]]) -> dict[str, str]:
    """Return mean±standard deviation of each column as text; the episode's sums with one decimal."""
    digits = {name: 1 if name in ("episode_reward", "steps") else 3 for name in columns}
    return {name: f"{v['mean']:.{digits[name]}f}±{v['std']:.{digits[name]}f}" for name, v in columns.items()}


def train_policy(out: Path, resume: Path | None, mdp: MdpSettings, learn: LearnSettings, overrides: list[str]) -> int:
    """Train a policy and print its figures on the way."""
    try:
        from mimic.train.learn import train
        from mimic.train.overrides import with_overrides
    except ModuleNotFoundError as missing:
        raise MissingExtra(str(missing.name), "train") from None
    mdp, learn = with_overrides(mdp, learn, overrides)
    tell_of_stand(EffectsSettings(effects=mdp.effects or None))

    figure, unit = ("track/toe_error_cm", "cm toes") if mdp.task == "stand_track" else ("sit_down/lying", "lying")

    def report(update: int, row: dict[str, float]) -> None:
        if update % 10 == 0 or update == learn.updates - 1:
            console.print(
                f"update {update:5d}  {row['steps'] / 1e6:7.1f} M steps  {row['elapsed_s']:6.0f} s  "
                f"reward {row['reward']:7.1f}  episode {row['episode']:5.0f}  {row.get(figure, math.nan):5.2f} {unit}"
            )

    if resume is not None and not resume.is_file():
        raise AssetError(f"there is no checkpoint {resume}")
    length = f"{learn.minutes:g} minutes" if learn.updates == ENDLESS else f"at most {learn.updates} updates"
    note(f"{mdp.worlds} worlds, {length}; TensorBoard: tensorboard --logdir {out}")
    path = train(out, mdp, learn, resume=resume, report=report)
    note(f"wrote {path}; judge it with: mimic evaluate {path}")
    return DONE

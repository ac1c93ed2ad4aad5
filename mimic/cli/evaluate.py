"""``mimic evaluate``: a policy over many episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mimic.cli import options as o
from mimic.cli.terminal.console import ConsoleReporter, table
from mimic.cli.terminal.exit_status import DONE
from mimic.config.evaluation import EvaluateSettings, SitDownEvaluateSettings


def evaluate(
    policy: str = "stand_track",
    /,
    *,
    out: o.Out = None,
    episodes: int | None = None,
    seconds: float | None = None,
    seed: int | None = None,
    workers: int = 0,
    robot: o.Effects = None,
) -> int:
    """Evaluate a policy in plain MuJoCo from the lying start: standing up, reaching, walking, turning, pushes.

    A policy that sits down is evaluated by switching to it from the shipped tracking policy.

    Parameters
    ----------
    policy
        ONNX file with its contract inside, or a shipped policy of the robot: stand_track, sit_down.
    out
        JSON file for all figures; default: evaluation-NAME.json in the current folder.
    episodes
        Randomised episodes: 200; 500 switches to a policy that sits down.
    seconds
        Length of a randomised episode: 20 s; latest policy switch: 10 s.
    seed
        Seed of the first episode: 1.
    workers
        Processes; 0: one per core.
    """
    from mimic.flows.evaluate import SETTINGS
    from mimic.flows.evaluate import evaluate as run
    from mimic.flows.play import load_policy, load_robot
    from mimic.policy.runtime import find_policy

    given = {"episodes": episodes, "seconds": seconds, "seed": seed, "workers": workers, "robot": robot}
    options: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    settings = EvaluateSettings(**options)
    model = load_robot(settings.robot.robot_model)
    path = find_policy(policy, model.name)
    task = load_policy(path, model).contract.task
    settings = SETTINGS[task](**options)
    file = out or Path(f"evaluation-{path.stem}.json")
    result = run(path, settings, out=file, reporter=ConsoleReporter())
    if isinstance(settings, SitDownEvaluateSettings):
        _show_sit_down(path, result, file)
    else:
        _show_tracking(path, result, settings.seconds, file)
    return DONE


def _show_tracking(policy: Path, result: dict[str, Any], seconds: float, out: Path) -> None:
    s = result["summary"]
    walk = ", ".join(f"{v:+.2f} at {k}" for k, v in s["walk_m_s"].items())
    turn = ", ".join(f"{v:.2f} at {k} deg" for k, v in s["turn_error_rad"].items())
    table(
        f"{policy.name}: {s['episodes']} randomised episodes of {seconds:g} s, and nominal ones",
        {
            "stood up in 1.5 s and kept standing": f"{s['stood_up_and_kept']:.1%}",
            "time to stand up": f"{s['stand_up_median_s']:.2f} s median, {s['stand_up_p95_s']:.2f} s 95th percentile",
            "toe error, randomised": f"{s['randomised_toe_error_cm']:.1f} cm",
            "toe error, nominal": f"{s['nominal_toe_error_cm']:.1f} cm",
            "walking speed [m/s]": walk,
            "heading error after 10 s [rad]": turn,
            "drift while standing": f"{s['nominal_drift_m']:.2f} m in {seconds:g} s",
            "falls on the nominal robot": f"{s['nominal_falls']}",
            "heat": f"{s['nominal_knee_torque_rms_nm']:.1f} N m rms in the hind knees, "
            f"{s['nominal_minutes_to_limit']:.0f} min to the hottest motor's limit",
            "written": str(out),
        },
    )


def _show_sit_down(policy: Path, result: dict[str, Any], out: Path) -> None:
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
            "acceleration of the base": spread("acceleration", "m/s^2"),
            "joints off the lying pose": spread("pose_error_rad", "rad"),
            "about to fall before": f"{s['falling_before']} more, not counted",
            "written": str(out),
        },
    )

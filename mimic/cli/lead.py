"""``mimic lead``: lead a simulated robot by the hand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from mimic.cli import options as o
from mimic.cli.terminal.console import ConsoleReporter, note, table
from mimic.cli.terminal.exit_status import DONE, STOPPED
from mimic.config.leading import HandSettings, LeadingSettings


def lead(
    *,
    video: Annotated[Path | None, Parameter(group=o.OUTPUT)] = None,
    policy: str | None = None,
    seed: int = 0,
    hand: Annotated[HandSettings | None, Parameter(name="*", group="Hand")] = None,
    answer: Annotated[LeadingSettings | None, Parameter(group="Answer to a pull")] = None,
    robot: o.Effects = None,
) -> int:
    """Stand a simulated robot up and lead it by a front toe: it follows, and stops when it is let go.

    Parameters
    ----------
    video
        Also write a video that shows the pull (.mp4).
    policy
        ONNX file of a policy that stands and walks; default: the shipped one.
    seed
        Seed of the initial state.
    """
    from mimic.config.play import AS_DESCRIBED
    from mimic.flows.robot.lead import lead as run

    hand = hand or HandSettings()
    led = run(
        hand,
        answer,
        policy=policy,
        robot=robot or AS_DESCRIBED,
        seed=seed,
        film=video,
        reporter=ConsoleReporter(),
    )
    if led.fell_at is not None:
        note(f"the robot fell {led.fell_at:.1f} s after the start")
    f = led.figures
    rows = {
        "way": f"{f['way_m']:.1f} m of {hand.way:g} m in the hand's direction" if "way_m" in f else "-",
        "followed the hand": "yes" if f["followed"] else "no",
        "stopped when let go": "yes" if f["stopped"] else "no",
        "pull": f"{f['pull_mean_n']:.1f} N mean, {f['pull_max_n']:.1f} N most",
    }
    table(f"Led by the {hand.toe} front toe, {hand.direction:g} deg, at {hand.speed:g} m/s", rows)
    if video is not None:
        note(f"wrote {video}")
    return DONE if led.fell_at is None else STOPPED

"""Shares and limits of one camera's depth and heading, chosen on all people but one and judged on that one.

    python -m lab.people.left_out MAN=VIEWS WOMAN=VIDEO@left,VIDEO [...]

A person has a name and clips with truth, as `lab.people.depth` takes them; behind @ is who it is in the picture. In the
order of STEPS the numbers take the values with which the people that are not left out come nearest to the truth, each
person counting once. Last, all people together choose: what mimic uses should be that.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from types import ModuleType

import numpy as np

from lab.people.depth import depth_errors, estimated, rms_of_fifths, targets_apart, true_track
from mimic.config.pose import PoseSettings
from mimic.flows.motions.motion import track_video
from mimic.records import PoseTrack
from mimic.retargeting.wrists import torso_heading
from mimic.robot.description import load_description
from mimic.robot.reach import Reach
from mimic.sources.video import depth, heading

REACH = Reach(load_description("cyberdog2"))
Clip = tuple[PoseTrack, PoseTrack]
"""What was detected, and the truth."""


def heading_off(seen: PoseTrack, true: PoseTrack) -> float:
    """Return by how much the median heading is off [deg]."""
    off = np.subtract(*(np.degrees(np.median(torso_heading(track))) for track in (seen, true)))
    return float((off + 180) % 360 - 180)


def _heading(clips: list[Clip]) -> float:
    return float(np.sqrt(np.mean([heading_off(estimated(seen), true) ** 2 for seen, true in clips])))


def _alone(clips: list[Clip]) -> float:
    return float(np.mean([targets_apart(seen, true, REACH) for seen, true in clips]))


def _targets(clips: list[Clip]) -> float:
    return _alone([(estimated(seen), true) for seen, true in clips])


def _left(clips: list[Clip]) -> float:
    """Return the share of the detector's error that is left, so that whoever moves much counts no more than others."""
    return _targets(clips) / _alone(clips)


def _declared(clips: list[Clip]) -> float:
    """Return minus twice the mean logarithm of the likelihood of the errors, but for a constant."""
    declared, error = np.concatenate([depth_errors(estimated(seen), true) for seen, true in clips], axis=1)
    return float((2 * np.log(declared) + (error / declared) ** 2).mean())


@dataclass(frozen=True, slots=True)
class Step:
    """Numbers of a module that are chosen together."""

    where: ModuleType
    names: tuple[str, ...]
    values: tuple[tuple[float, ...], ...]
    """Of each number."""
    judge: Callable[[list[Clip]], float]
    """What should be small, of one person's clips."""

    def use(self, values: tuple[float, ...]) -> None:
        """Put the numbers into force."""
        for name, value in zip(self.names, values, strict=True):
            setattr(self.where, name, value)


WIDTHS = (0.60, 0.65, 0.70, 0.75, 0.80)
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
STEPS = (
    Step(heading, ("WIDTH", "SHARE"), (WIDTHS, SHARES), _heading),
    Step(depth, ("UPPER_LENGTH", "FORE_LENGTH"), ((0.94, 1.02, 1.10), (1.02, 1.10, 1.18)), _left),
    Step(depth, ("MEAN_SHARE",), (tuple(np.linspace(0.0, 1.0, 11).round(1)),), _left),
    Step(
        depth,
        ("SURE_SHARE", "UNKNOWN", "TURNED"),
        ((0.0, 0.25, 0.5), (0.03, 0.04, 0.05, 0.06, 0.08), (0.0, 0.06, 0.09, 0.12)),
        _declared,
    ),
)
_known: dict[tuple[object, ...], float] = {}


def choose(people: dict[str, list[Clip]]) -> list[float]:
    """Set each number to the value that suits these people best, and return all of them."""
    chosen: list[float] = []
    for step in STEPS:
        costs = {}
        for values in product(*step.values):
            step.use(values)
            for name, clips in people.items():
                key = name, *chosen, *values
                if key not in _known:
                    _known[key] = step.judge(clips)
            costs[values] = np.mean([_known[name, *chosen, *values] for name in people])
        best = min(costs, key=lambda values: costs[values])
        step.use(best)
        chosen += best
    return chosen


def declared_and_true(clips: list[Clip]) -> np.ndarray:
    """Return root mean squares (2, 5) of declared and true depth errors in fifths of a person's frames [cm]."""
    return rms_of_fifths([depth_errors(estimated(seen), true) for seen, true in clips])


def report(name: str, chosen: list[float], clips: list[Clip]) -> np.ndarray:
    """Print how a person fares with the numbers in force; return `declared_and_true`."""
    off = " ".join(f"{heading_off(estimated(seen), true):.0f}" for seen, true in clips)
    both = declared_and_true(clips)
    fifths = " ".join(f"{ratio:.2f}" for ratio in both[0] / both[1])
    numbers = ", ".join(f"{value:g}" for value in chosen)
    print(f"| {name} | {numbers} | {_alone(clips):.2f} | {_targets(clips):.2f} | {off}° | {fifths} |", flush=True)
    return both


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("people", nargs="+", metavar="NAME=CLIP[,CLIP]")
    people: dict[str, list[Clip]] = {}
    for given in parser.parse_args().people:
        name, _, places = given.partition("=")
        people[name] = []
        for place in places.split(","):
            folder, _, who = place.partition("@")
            for path in sorted(Path(folder).glob("*.mp4")) or [Path(folder)]:
                seen = track_video(path, PoseSettings(depth=False, person=who or None))
                people[name].append((seen, true_track(path, seen)))
    names = ", ".join(name for step in STEPS for name in step.names)
    print(f"| left out | {names} | detector | targets [cm] | heading off | fifths |")
    print("|---|---|---|---|---|---|")
    apart = []
    for left_out, clips in people.items():
        chosen = choose({name: own for name, own in people.items() if name != left_out})
        apart.append(report(left_out, chosen, clips))
    declared, error = np.sqrt((np.array(apart) ** 2).mean(axis=0))
    print("| all, each left out | | | | |", *(f"{a:.1f}, {b:.1f}" for a, b in zip(declared, error, strict=True)), "|")
    chosen = choose(people)
    for name, clips in people.items():
        report(f"nobody: {name}", chosen, clips)


if __name__ == "__main__":
    main()

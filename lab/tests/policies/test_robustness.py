from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from lab.policies.disturbed import NO_DISTURBANCE, Disturbance, Solver
from lab.policies.studies import robustness
from lab.policies.studies.disturbance_axes import AXES, START, all_at_once
from lab.policies.studies.robustness import SOLVERS, evaluate_robustness, holds
from lab.policies.studies.settings import RobustnessSettings
from mimic.config.play import Randomisation
from mimic.errors import AssetError
from mimic.io.assets import shipped


def changed(one: Any, other: Any) -> set[str]:
    return {f.name for f in dataclasses.fields(one) if getattr(one, f.name) != getattr(other, f.name)}


@pytest.mark.parametrize("name", AXES)
def test_an_axis_is_tried_at_its_ends_and_without_it(name):
    axis = AXES[name]
    assert list(axis.points) == sorted(set(axis.points))
    assert {axis.nominal, *axis.asked} <= set(axis.points)
    assert axis.asked[0] <= axis.nominal <= axis.asked[1]
    assert axis.points[0] <= axis.asked[0]
    assert axis.points[-1] >= axis.asked[1]


@pytest.mark.parametrize("name", AXES)
def test_an_axis_changes_nothing_but_itself(name):
    axis = AXES[name]
    undisturbed = axis.apply((START, NO_DISTURBANCE), axis.nominal)
    harsh = axis.apply((START, NO_DISTURBANCE), axis.asked[1] if axis.asked[1] != axis.nominal else axis.asked[0])
    different = changed(undisturbed[0], harsh[0]) | changed(undisturbed[1], harsh[1])
    assert 1 <= len(different) <= (4 if name == "noise" else 2)  # each sensor has its own noise
    assert changed(START, undisturbed[0]) <= {"push_interval"}
    assert not changed(NO_DISTURBANCE, undisturbed[1])


def test_all_at_once_is_nominal_at_nothing_and_inside_the_ranges_at_one():
    ranges, disturbance = all_at_once(0.0, 1)
    assert changed(START, ranges) <= {"push_interval"}
    assert not changed(NO_DISTURBANCE, disturbance)
    worlds = [all_at_once(1.0, seed) for seed in range(50)]
    friction = [ranges.ground_friction[0] for ranges, _ in worlds]
    assert AXES["ground_friction"].asked[0] <= min(friction) < 0.8 < 2.5 < max(friction) <= 3.0
    assert max(disturbance.drag for _, disturbance in worlds) <= 15.0
    assert {(disturbance.drag_way, disturbance.imu_axis) for _, disturbance in worlds} == {("any", "any")}
    assert worlds[3] == all_at_once(1.0, 3)


@pytest.mark.parametrize(
    ("shares", "nominal", "expected"),
    [
        ({0.0: 1.0, 1.0: 1.0, 2.0: 0.94}, 0.0, (0.0, 1.0)),
        ({0.0: 0.9, 1.0: 0.95, 2.0: 1.0, 3.0: 0.0, 4.0: 1.0}, 2.0, (1.0, 2.0)),
        ({0.0: 0.5, 1.0: 1.0}, 0.0, None),
        ({0.0: 1.0, 0.12: 1.0}, 0.05, (0.0, 0.12)),
    ],
)
def test_a_range_holds_up_to_where_it_breaks(shares, nominal, expected):
    assert holds(shares, nominal) == expected


def test_the_first_solver_is_the_usual_one():
    assert next(iter(SOLVERS.values())) == (Solver(), Randomisation())


FEW = RobustnessSettings(episodes=1, seconds=3.0, workers=1)


@pytest.fixture
def small(monkeypatch) -> None:
    """Two axes of two points, one solver."""
    drag = dataclasses.replace(AXES["toe_drag"], points=(0.0, 100.0), asked=(0.0, 100.0))
    early = dataclasses.replace(drag, apply=lambda world, value: (world[0], Disturbance(drag=value, drag_from=1.5)))
    delay = dataclasses.replace(AXES["delay"], points=(15.0, 400.0), asked=(15.0, 400.0))
    monkeypatch.setattr(robustness, "AXES", {"toe_drag": early, "delay": delay})
    monkeypatch.setattr(robustness, "TOGETHER", (0.25,))
    monkeypatch.setattr(robustness, "SOLVERS", {"usual": (Solver(), START), "fine": (Solver(timestep=0.0025), START)})


@pytest.mark.usefixtures("small")
def test_shares_fall_where_a_robot_is_dragged_off_or_commanded_with_delay():
    seen: list[tuple[int, int]] = []
    path = shipped("policies", "stand_track.onnx")
    result = evaluate_robustness(path, FEW, progress=lambda done, total: seen.append((done, total)))
    for axis in result["axes"].values():
        assert [point["survived"] for point in axis["points"]] == [1.0, 0.0]
        assert axis["holds"] == (axis["nominal"], axis["nominal"])
    assert set(result["together"]) == {"0.25"}
    assert set(result["solvers"]) == {"usual", "fine"}
    assert result["solvers"]["usual"] == 1.0
    assert seen[-1] == (9, 9)


def test_a_policy_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(AssetError, match="there is no policy"):
        evaluate_robustness(tmp_path / "nowhere.onnx", FEW)


def test_points_are_distinguished_by_their_names():
    for axis in AXES.values():
        assert len({f"{value:g}" for value in axis.points}) == len(axis.points)
        assert np.isfinite(axis.points).all()

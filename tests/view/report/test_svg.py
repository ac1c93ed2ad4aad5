from __future__ import annotations

import re

import numpy as np
import pytest

from mimic.view.report.svg import Plot, round_ticks

LABELS = {"title": "", "x_label": "", "y_label": ""}


@pytest.mark.parametrize("low", [0.0, 0.13, 0.51, 7.9, -3.3])
@pytest.mark.parametrize("span", [1e-3, 0.37, 0.87, 1.69, 4.2, 950.0])
def test_an_axis_has_at_least_two_round_marks_and_not_many(low, span):
    ticks = round_ticks(low, low + span, 3)
    assert 2 <= len(ticks) <= 7
    assert low - 1e-9 <= ticks[0] < ticks[-1] <= low + span + 1e-9


@pytest.mark.parametrize("limits", [(1.6, 4.0), (1.1, 1.9), (0.5, 40.0), (1e-4, 1e3)])
def test_a_logarithmic_axis_has_at_least_two_marks_too(limits):
    drawn = Plot(x=(0.0, 1.0), y=limits, log=(False, True), **LABELS).svg("")
    assert drawn.count("class='tick end'") >= 2


@pytest.mark.parametrize("axis", [0, 1])
def test_on_a_logarithmic_axis_equal_factors_are_equal_distances(axis):
    factors, steps = np.array([1.0, 10.0, 100.0]), np.array([0.0, 1.0, 2.0])
    of_axis = [steps, steps]
    of_axis[axis] = factors
    plot = Plot(
        x=(of_axis[0][0], of_axis[0][-1]), y=(of_axis[1][0], of_axis[1][-1]), log=(axis == 0, axis == 1), **LABELS
    )
    plot.curve(*of_axis, "seen")
    drawn = re.search(r"class='line seen' d='M([^']+)'", plot.svg(""))
    assert drawn
    points = np.array([pair.split(",") for pair in drawn[1].split()], dtype=float)
    one, other = np.diff(points[:, axis])
    assert abs(one) > 20.0
    assert one == pytest.approx(other, abs=0.11)  # drawn to a tenth

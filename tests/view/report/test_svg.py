from __future__ import annotations

import pytest

from mimic.view.report.svg import round_ticks


@pytest.mark.parametrize("low", [0.0, 0.13, 0.51, 7.9, -3.3])
@pytest.mark.parametrize("span", [1e-3, 0.37, 0.87, 1.69, 4.2, 950.0])
def test_an_axis_has_at_least_two_round_marks_and_not_many(low, span):
    ticks = round_ticks(low, low + span, 3)
    assert 2 <= len(ticks) <= 7
    assert low - 1e-9 <= ticks[0] < ticks[-1] <= low + span + 1e-9

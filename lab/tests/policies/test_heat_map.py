from __future__ import annotations

import cv2
import numpy as np
import pytest

from lab.policies.studies.heat_map import CELL, draw_heat_map, shade
from mimic.errors import AssetError


def result(*shares: float) -> dict:
    points = [{"value": 0.5 * i, "survived": share} for i, share in enumerate(shares)]
    axis = {"unit": "kg", "nominal": 0.0, "asked": (0.0, 1.0), "trained": (0.0, 0.5), "points": points}
    return {
        "policy": "a.onnx",
        "episodes_per_point": 7,
        "axes": {"base_mass": axis, "push": axis | {"trained": None, "unit": ""}},
        "together": {"0.5": shares[-1]},
    }


def test_a_heat_map_is_a_picture_whose_colours_show_the_shares(tmp_path):
    draw_heat_map(result(1.0, 0.6, 0.0), tmp_path / "a.png")
    picture = cv2.imread(str(tmp_path / "a.png"))
    areas = [(picture == np.array(shade(share))).all(-1).sum() for share in (1.0, 0.6, 0.0)]
    cell = CELL[0] * CELL[1]
    assert areas[0] == pytest.approx(2 * cell, rel=0.25)
    assert areas[1] == pytest.approx(2 * cell, rel=0.25)
    assert areas[2] == pytest.approx(3 * cell, rel=0.25)  # and that of all at once


def test_colours_go_from_red_to_green():
    blue, green, red = zip(*(shade(share) for share in (0.0, 0.75, 1.0)), strict=True)
    assert red[0] > green[0]
    assert green[2] > red[2]
    assert len(set(blue)) > 1


def test_a_picture_that_cannot_be_written_is_one_line(tmp_path):
    with pytest.raises(AssetError, match="cannot write"):
        draw_heat_map(result(1.0), tmp_path / "nowhere" / "a.png")

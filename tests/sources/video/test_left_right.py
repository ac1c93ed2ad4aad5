import numpy as np
import pytest

from mimic.records import LANDMARKS
from mimic.sources.video.left_right import LiveSides, decide_sides, other_side, side_costs, swap_sides

NO_CUTS = np.array([], dtype=np.int64)
PLACES = {"shoulder": (0.18, -0.5), "elbow": (0.3, -0.25), "wrist": (0.35, 0.0), "hip": (0.1, 0.0), "knee": (0.1, 0.45)}


def person(t: np.ndarray, *, speed: float = 3.0, heading: float = 0.3) -> np.ndarray:
    """A person with a waving left arm, turned a little; (T, 33, 3) [m]."""
    rows = np.zeros((len(t), 33, 3))
    for i, name in enumerate(LANDMARKS):
        x, y = PLACES.get(name.split("_")[-1], (0.05, 0.8 if "left" in name or "right" in name else -0.7))
        x = -x if "right" in name else x
        rows[:, i] = np.array([x * np.cos(heading), y, x * np.sin(heading)])
    rows[:, LANDMARKS.index("left_wrist"), 1] -= 0.4 * (1 + np.sin(speed * t))
    return rows + np.random.default_rng(0).normal(0, 0.01, rows.shape)


def test_other_side_is_its_own_inverse_and_keeps_the_nose():
    assert (other_side()[other_side()] == np.arange(33)).all()
    assert other_side()[LANDMARKS.index("nose")] == LANDMARKS.index("nose")
    assert other_side()[LANDMARKS.index("mouth_left")] == LANDMARKS.index("mouth_right")
    assert other_side()[LANDMARKS.index("left_wrist")] == LANDMARKS.index("right_wrist")


@pytest.mark.parametrize(
    "stretches",
    [[], [(40, 55)], [(10, 11), (20, 21), (22, 25)], [(60, 180)], [(250, 300)]],
    ids=["never", "once", "flickering", "for four seconds", "until the end"],
)
def test_swapped_intervals_are_found_exactly(stretches):
    t = np.arange(300) / 30
    truth = np.zeros(300, dtype=bool)
    for start, end in stretches:
        truth[start:end] = True
    seen = swap_sides(person(t), truth)
    np.testing.assert_array_equal(decide_sides(t, seen, NO_CUTS), truth)
    np.testing.assert_array_equal(swap_sides(seen, truth), person(t))


def test_a_first_frame_that_is_wrong_does_not_decide_the_clip():
    t = np.arange(90) / 30
    truth = np.arange(90) < 8
    np.testing.assert_array_equal(decide_sides(t, swap_sides(person(t), truth), NO_CUTS), truth)


def test_a_frame_between_both_sides_does_not_exchange_the_rest_of_the_clip():
    """While the detector changes sides, a frame may be a mixture that is as far from one side as from the other."""
    t = np.arange(90) / 30
    truth = (np.arange(90) >= 40) & (np.arange(90) < 62)
    seen = swap_sides(person(t), truth)
    seen[62] = 0.42 * person(t)[62] + 0.58 * swap_sides(person(t), np.ones(90, dtype=bool))[62]
    decided = decide_sides(t, seen, NO_CUTS)
    assert (decided != truth)[np.arange(90) != 62].sum() == 0
    live = LiveSides()
    assert [live.decide(*row) for row in zip(t, seen, strict=True)][70:] == [False] * 20


def test_gaps_are_bridged_and_rows_without_a_person_stay_unmarked():
    t = np.arange(120) / 30
    truth = (np.arange(120) >= 50) & (np.arange(120) < 70)
    seen = swap_sides(person(t), truth)
    seen[58:62] = np.nan
    expected = truth.copy()
    expected[58:62] = False
    np.testing.assert_array_equal(decide_sides(t, seen, NO_CUTS), expected)


def test_sides_are_not_carried_over_a_cut():
    """The next person may face the other way; the detector is believed again."""
    t = np.arange(120) / 30
    seen = np.concatenate([person(t[:60], heading=0.3), person(t[60:], heading=0.3 + np.pi)])
    assert decide_sides(t, seen, np.array([60])).sum() == 0
    assert decide_sides(t, seen, NO_CUTS).sum() > 0


def test_a_clip_with_nobody_has_no_sides():
    assert not decide_sides(np.arange(5) / 30, np.full((5, 33, 3), np.nan), NO_CUTS).any()


def test_costs_of_one_row_need_only_the_row_before():
    before, now = person(np.arange(2) / 30)
    same, other = side_costs(before, now)
    assert same < 0.05
    assert other > 0.2
    same_all, _ = side_costs(np.stack([before, before]), np.stack([now, before]))
    np.testing.assert_allclose(same_all, np.array([float(same), 0.0]))


def test_row_by_row_a_lasting_exchange_is_put_right_and_its_end_is_seen():
    """After five seconds that were right, the detector exchanges sides for two."""
    t = np.arange(300) / 30
    truth = (t >= 5) & (t < 7)
    sides = LiveSides()
    seen = swap_sides(person(t), truth)
    decided = np.array([sides.decide(time, row) for time, row in zip(t, seen, strict=True)])
    np.testing.assert_array_equal(decided, truth)


def test_row_by_row_nothing_is_swapped_after_a_long_gap():
    rows, both = person(np.arange(2) / 30), np.ones(1, dtype=bool)
    sides = LiveSides()
    assert not sides.decide(0.0, rows[0])
    assert not sides.decide(5.0, swap_sides(rows[1:], both)[0])

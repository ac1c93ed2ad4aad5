from dataclasses import replace

import numpy as np

from mimic.records import LANDMARKS, PoseTrack
from mimic.sources.video.screening import is_invented, jump_share, person_rows, posture, shot_starts

SIZE = (640, 480)


def standing(rows: int = 100) -> PoseTrack:
    """A person of 300 px to the metre who stands still."""
    landmarks = np.zeros((rows, 33, 3))
    places = {"shoulder": (0.18, -0.5, 0), "wrist": (0.3, 0, 0), "hip": (0.1, 0, 0), "knee": (0.1, 0.4, 0)}
    places |= {"ear": (0.08, -0.7, 0), "eye": (0.03, -0.72, 0)}
    landmarks[:, [LANDMARKS.index("mouth_left"), LANDMARKS.index("mouth_right")]] = (0, -0.63, 0)
    for name, place in places.items():
        landmarks[:, LANDMARKS.index(f"left_{name}")] = place
        landmarks[:, LANDMARKS.index(f"right_{name}")] = np.array(place) * (-1, 1, 1)
    seen = np.ones((rows, 33), dtype=bool)
    return PoseTrack(
        t=np.arange(rows) / 30,
        landmarks=landmarks,
        image=(landmarks[..., :2] * 300 + np.array([320.0, 300.0])) / SIZE,
        score=seen.astype(float),
        valid=seen,
        swapped=np.zeros(rows, dtype=bool),
        size=SIZE,
    )


def test_a_person_has_both_shoulders_and_a_wrist():
    score = np.zeros((4, 33))
    columns = [LANDMARKS.index(n) for n in ("left_shoulder", "right_shoulder", "right_wrist")]
    score[0, columns] = 0.9
    score[1, columns[:2]] = 0.9
    score[2, columns[1:]] = 0.9
    score[3, columns] = 0.49
    assert person_rows(score, 0.5).tolist() == [True, False, False, False]


def test_a_single_large_change_is_a_cut_and_steady_motion_is_not():
    calm = np.full(60, 1.0)
    cut = calm.copy()
    cut[25] = 22.0
    assert shot_starts(cut).tolist() == [25]
    assert shot_starts(calm).tolist() == []
    assert shot_starts(np.full(60, 25.0)).tolist() == []


def test_standing_still_has_no_jumps():
    assert jump_share(standing()) == 0.0


def test_walking_across_the_picture_is_no_jump_and_hopping_about_is():
    track = standing()
    right = np.array([1.0, 0.0])
    walking = track.image + np.linspace(0, 0.5, 100)[:, None, None] * right
    assert jump_share(replace(track, image=walking)) == 0.0
    hops = np.where(np.arange(100) // 10 % 2, 0.3, 0.0)
    hopping = track.image + hops[:, None, None] * right
    assert jump_share(replace(track, image=hopping)) == 9 / 99


def test_a_wrist_elsewhere_counts_only_where_it_is_seen():
    track = standing()
    wrist = LANDMARKS.index("left_wrist")
    landmarks, valid = track.landmarks.copy(), track.valid.copy()
    landmarks[50, wrist] += 0.5
    assert jump_share(replace(track, landmarks=landmarks)) == 2 / 99
    valid[50, wrist] = False
    assert jump_share(replace(track, landmarks=landmarks, valid=valid)) == 0.0


def test_frames_far_apart_may_move_further():
    landmarks = standing().landmarks.copy()
    landmarks[::2, LANDMARKS.index("left_wrist")] += (0.4, 0, 0)
    track = replace(standing(), landmarks=landmarks)
    assert jump_share(track) == 1.0
    assert jump_share(replace(track, t=track.t * 3)) == 0.0


def test_a_person_on_their_head_lying_or_squeezed_is_noticed():
    track = standing()
    assert posture(track) == ""
    overturned = replace(track, image=1 - track.image)
    assert "upside down" in posture(overturned)
    assert posture(replace(overturned, valid=~track.valid)) == ""
    assert "turned by 90°" in posture(replace(track, image=track.image[..., ::-1]))
    assert "narrower" in posture(replace(track, size=(SIZE[0] // 2, SIZE[1])))
    assert "wider" in posture(replace(track, size=(SIZE[0] * 2, SIZE[1])))


def test_a_narrow_face_that_is_turned_is_no_squeezed_picture():
    track = standing()
    ears = [LANDMARKS.index(f"{side}_ear") for side in ("left", "right")]
    turned = track.image.copy()
    turned[:, ears, 0] = 0.5 - 85 / SIZE[0] * 0.3
    assert posture(replace(track, image=turned)) == ""
    assert "narrower" in posture(replace(track, image=turned, size=(SIZE[0] // 2, SIZE[1])))


def test_a_face_tells_nothing_from_behind():
    track = standing()
    behind = replace(track, image=track.image * (-1, 1) + (1, 0), landmarks=track.landmarks * (-1, 1, 1))
    for wide in (2, 0.5):
        assert posture(replace(behind, size=(round(SIZE[0] * wide), SIZE[1]))) == ""


def test_who_sits_or_leans_is_told_that_the_robot_does_not():
    track = standing()
    knees = [LANDMARKS.index(f"{side}_knee") for side in ("left", "right")]
    seated = track.landmarks.copy()
    seated[:, knees] = seated[:, knees] * (1, 0, 1) + (0, 0.05, -0.4)
    assert "sits" in posture(replace(track, landmarks=seated))
    from_the_side = track.valid.copy()
    from_the_side[:, knees[1]] = False
    assert "sits" in posture(replace(track, landmarks=seated, valid=from_the_side))
    seated[:, knees[0]] = track.landmarks[:, knees[0]]  # one leg is lifted
    assert posture(replace(track, landmarks=seated)) == ""
    shear = np.array([[1.0, 0.0], [-0.9, 1.0]])
    leaning = (track.image * SIZE - (320, 300)) @ shear / SIZE + np.array([320, 300]) / SIZE
    assert "leans" in posture(replace(track, image=leaning))


def test_a_body_whose_limbs_and_size_change_all_the_time_is_invented():
    track = standing()
    rows = track.valid[:, 11]
    assert not is_invented(track, rows)
    rng = np.random.default_rng(1)
    limbs = track.landmarks * rng.uniform(0.7, 1.3, (len(rows), 33, 1))
    size = replace(track, image=0.5 + (track.image - 0.5) * rng.uniform(0.7, 1.3, (len(rows), 1, 1)))
    assert is_invented(replace(size, landmarks=limbs), rows)
    assert not is_invented(size, rows)

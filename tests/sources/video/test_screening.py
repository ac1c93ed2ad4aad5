import numpy as np

from mimic.records import LANDMARKS
from mimic.sources.video.screening import is_invented, jump_share, person_rows, posture, shot_starts

SIZE = (640, 480)


def standing(rows: int = 100) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """t, landmarks, image and valid of a person of 300 px to the metre who stands still."""
    landmarks = np.zeros((rows, 33, 3))
    places = {"shoulder": (0.18, -0.5, 0), "wrist": (0.3, 0, 0), "hip": (0.1, 0, 0), "knee": (0.1, 0.4, 0)}
    for name, place in places.items():
        landmarks[:, LANDMARKS.index(f"left_{name}")] = place
        landmarks[:, LANDMARKS.index(f"right_{name}")] = np.array(place) * (-1, 1, 1)
    image = (landmarks[..., :2] * 300 + np.array([320.0, 300.0])) / np.array([640.0, 480.0])
    return np.arange(rows) / 30, landmarks, image, np.ones((rows, 33), dtype=bool)


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
    assert jump_share(*standing(), SIZE, 0.25) == 0.0


def test_walking_across_the_picture_is_no_jump_and_hopping_about_is():
    t, landmarks, image, valid = standing()
    right = np.array([1.0, 0.0])
    walking = image + np.linspace(0, 0.5, 100)[:, None, None] * right
    assert jump_share(t, landmarks, walking, valid, SIZE, 0.25) == 0.0
    hops = np.where(np.arange(100) // 10 % 2, 0.3, 0.0)
    hopping = image + hops[:, None, None] * right
    assert jump_share(t, landmarks, hopping, valid, SIZE, 0.25) == 9 / 99


def test_a_wrist_elsewhere_counts_only_where_it_is_seen():
    t, landmarks, image, valid = standing()
    wrist = LANDMARKS.index("left_wrist")
    landmarks[50, wrist] += 0.5
    assert jump_share(t, landmarks, image, valid, SIZE, 0.25) == 2 / 99
    valid[50, wrist] = False
    assert jump_share(t, landmarks, image, valid, SIZE, 0.25) == 0.0


def test_frames_far_apart_may_move_further():
    t, landmarks, image, valid = standing()
    landmarks[::2, LANDMARKS.index("left_wrist")] += (0.4, 0, 0)
    assert jump_share(t, landmarks, image, valid, SIZE, 0.25) == 1.0
    assert jump_share(t * 3, landmarks, image, valid, SIZE, 0.25) == 0.0


def test_a_person_on_their_head_lying_or_squeezed_is_noticed():
    _, landmarks, image, valid = standing()
    assert posture(landmarks, image, valid, SIZE) == ""
    assert "upside down" in posture(landmarks, 1 - image, valid, SIZE)
    assert posture(landmarks, 1 - image, np.zeros_like(valid), SIZE) == ""
    assert "turned by 90°" in posture(landmarks, image[..., ::-1], valid, SIZE)
    assert "narrower" in posture(landmarks, image, valid, (SIZE[0] // 2, SIZE[1]))
    assert "wider" in posture(landmarks, image, valid, (SIZE[0] * 2, SIZE[1]))


def test_who_sits_or_leans_is_told_that_the_robot_does_not():
    _, landmarks, image, valid = standing()
    knees = [LANDMARKS.index(f"{side}_knee") for side in ("left", "right")]
    seated = landmarks.copy()
    seated[:, knees] = seated[:, knees] * (1, 0, 1) + (0, 0.05, -0.4)
    assert "sits" in posture(seated, image, valid, SIZE)
    seated[:, knees[0]] = landmarks[:, knees[0]]  # one leg is lifted
    assert posture(seated, image, valid, SIZE) == ""
    shear = np.array([[1.0, 0.0], [-0.9, 1.0]])
    leaning = (image * SIZE - (320, 300)) @ shear / SIZE + np.array([320, 300]) / SIZE
    assert "leans" in posture(landmarks, leaning, valid, SIZE)


def test_a_body_whose_limbs_and_size_change_all_the_time_is_invented():
    _, landmarks, image, valid = standing()
    rows = valid[:, 11]
    assert not is_invented(landmarks, image, rows, SIZE)
    rng = np.random.default_rng(1)
    limbs = landmarks * rng.uniform(0.7, 1.3, (len(rows), 33, 1))
    size = 0.5 + (image - 0.5) * rng.uniform(0.7, 1.3, (len(rows), 1, 1))
    assert is_invented(limbs, size, rows, SIZE)
    assert not is_invented(landmarks, size, rows, SIZE)

import numpy as np

from mimic.records import LANDMARKS, PoseTrack
from mimic.sources.video.depth import UNKNOWN, LiveDepth, placed, with_depth
from mimic.sources.video.left_right import other_side

SIZE = (640, 480)
NO_SHOTS = np.zeros(0, dtype=np.int64)


def estimated(t: np.ndarray, landmarks: np.ndarray, image: np.ndarray, shots: np.ndarray = NO_SHOTS):
    """Landmarks with depth, and spread, of someone who is seen well."""
    return estimated_as_seen(t, landmarks, image, np.ones((len(t), 33)), shots)


def estimated_as_seen(t: np.ndarray, landmarks: np.ndarray, image: np.ndarray, score: np.ndarray, shots: np.ndarray):
    """The same of someone with some visibility."""
    track = PoseTrack(
        t=t, landmarks=landmarks, image=image, score=score, valid=score > 0.5, swapped=np.zeros(len(t), dtype=bool),
        size=SIZE, shot=np.searchsorted(shots, np.arange(len(t)), "right").astype(float),
    )  # fmt: skip
    found = with_depth(track)
    return found.landmarks, found.depth_spread


def estimated_live(live: LiveDepth, t: float, landmarks: np.ndarray, image: np.ndarray):
    """The same of the next frame of a camera."""
    return live.see(t, landmarks, image, np.ones(33), SIZE)


def someone(seconds: float = 3.0, *, behind: bool = False, rate: float = 30.0, seed: int = 1):
    """Times and a row per frame of someone who faces the camera and moves both arms; the detector sees all of it."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    points = {
        "nose": (0, -0.7, -0.1), "left_ear": (0.07, -0.7, 0), "right_ear": (-0.07, -0.7, 0),
        "left_shoulder": (0.18, -0.5, 0), "right_shoulder": (-0.18, -0.5, 0),
        "left_hip": (0.1, 0, 0), "right_hip": (-0.1, 0, 0),
    }  # fmt: skip
    landmarks = np.zeros((len(t), 33, 3))
    for name, place in points.items():
        landmarks[:, LANDMARKS.index(name)] = place
    for side, sign in (("left", 1), ("right", -1)):
        a, b = rng.uniform(0, 2 * np.pi, 2)
        swing, lift = 0.5 * np.sin(3 * t + a), -0.6 + 0.8 * np.sin(2 * t + b)
        way = np.stack(
            [sign * np.cos(lift) * np.sin(swing + 0.5), -np.sin(lift), -np.cos(lift) * np.cos(swing)], axis=1
        )
        shoulder = landmarks[:, LANDMARKS.index(f"{side}_shoulder")]
        landmarks[:, LANDMARKS.index(f"{side}_elbow")] = shoulder + 0.28 * way
        for part, reach in (("wrist", 0.53), ("index", 0.62), ("pinky", 0.61), ("thumb", 0.58)):
            landmarks[:, LANDMARKS.index(f"{side}_{part}")] = shoulder + reach * way
    if behind:
        landmarks = landmarks * (-1.0, 1.0, -1.0)
    return t, landmarks, seen_from(landmarks, 1.0)


def seen_from(landmarks: np.ndarray, lens: float) -> np.ndarray:
    """Where a camera with a focal length of `lens` times the longer side sees the points, 4 m away."""
    pixels = lens * max(SIZE) * landmarks[..., :2] / (4.0 + landmarks[..., 2:])
    return 0.5 + pixels / SIZE


def arms(landmarks: np.ndarray) -> np.ndarray:
    """Shoulder -> elbow, wrist of both sides."""
    ids = [[LANDMARKS.index(f"{s}_{p}") for p in ("shoulder", "elbow", "wrist")] for s in ("left", "right")]
    return np.stack([landmarks[:, i[1:]] - landmarks[:, i[:1]] for i in ids], axis=1)


def test_the_right_depth_puts_the_arms_where_they_are_in_a_picture_with_perspective():
    _, landmarks, image = someone()
    flat = landmarks.copy()
    moving = [i for i, name in enumerate(LANDMARKS) if name.split("_")[-1] in ("elbow", "wrist")]
    flat[:, moving, 2] = 0.0
    scale = np.full(len(image), 4.0 / max(SIZE))
    found = placed(flat, image, SIZE, scale, arms(landmarks)[..., 2])
    np.testing.assert_allclose(arms(found), arms(landmarks), atol=1e-9)


def flattened(landmarks: np.ndarray) -> np.ndarray:
    """Landmarks as of a detector that sees nothing of how deep the arms are: always a little before the body."""
    said = landmarks.copy()
    for side in ("left", "right"):
        shoulder, elbow, wrist = (LANDMARKS.index(f"{side}_{p}") for p in ("shoulder", "elbow", "wrist"))
        said[:, elbow, 2], said[:, wrist, 2] = said[:, shoulder, 2] - 0.10, said[:, shoulder, 2] - 0.25
    return said


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_depth_is_found_from_the_picture_and_the_spread_is_of_the_size_of_the_error():
    t, landmarks, image = someone(8.0)
    said = flattened(landmarks)
    found, spread = estimated(t, said, image)
    before, after = (arms(v)[:, :, 1] - arms(landmarks)[:, :, 1] for v in (said, found))
    assert rms(after[..., 2]) < 0.9 * rms(before[..., 2])
    for side in range(2):
        assert np.corrcoef(arms(found)[:, side, 1, 2], arms(landmarks)[:, side, 1, 2])[0, 1] > 0.6
    assert 0.5 * rms(after[..., 2]) < rms(spread) < 2 * rms(after[..., 2])


def test_an_arm_that_is_hidden_is_less_sure():
    t, landmarks, image = someone(8.0)
    score = np.ones((len(t), 33))
    _, seen = estimated_as_seen(t, landmarks, image, score, NO_SHOTS)
    score[:, [LANDMARKS.index(f"left_{part}") for part in ("elbow", "wrist")]] = 0.1
    _, hidden = estimated_as_seen(t, landmarks, image, score, NO_SHOTS)
    assert hidden[:, 0].mean() > 1.05 * seen[:, 0].mean()


def test_hands_move_with_their_wrist():
    t, landmarks, image = someone()
    found, _ = estimated(t, landmarks, image)
    for side in ("left", "right"):
        wrist, index = LANDMARKS.index(f"{side}_wrist"), LANDMARKS.index(f"{side}_index")
        np.testing.assert_allclose(found[:, index] - found[:, wrist], landmarks[:, index] - landmarks[:, wrist])


def test_a_person_in_a_mirror_gets_the_mirrored_arms():
    t, landmarks, image = someone()
    found, spread = estimated(t, landmarks, image)
    swap = other_side()
    mirrored, other = estimated(t, landmarks[:, swap] * (-1, 1, 1), (image * (-1, 1) + (1, 0))[:, swap])
    np.testing.assert_allclose(mirrored[:, swap] * (-1, 1, 1), found, atol=1e-6)
    np.testing.assert_allclose(other[:, ::-1], spread, atol=1e-6)


def test_the_head_stays_and_so_do_rows_without_a_person():
    t, landmarks, image = someone()
    landmarks[40:60], image[40:60] = np.nan, np.nan
    found, spread = estimated(t, landmarks, image)
    assert np.isnan(found[40:60]).all()
    assert np.isnan(spread[40:60]).all()
    rest = [i for i, name in enumerate(LANDMARKS) if name.split("_")[-1] in ("nose", "ear", "eye")]
    np.testing.assert_array_equal(found[:, rest], landmarks[:, rest])
    assert (spread[:40] > 0).all()


def test_the_trunk_stays():
    t, landmarks, image = someone()
    found, _ = estimated(t, landmarks, image)
    trunk = [LANDMARKS.index(f"{side}_{part}") for side in ("left", "right") for part in ("shoulder", "hip")]
    np.testing.assert_array_equal(found[:, trunk], landmarks[:, trunk])


def test_the_average_depth_follows_the_detector_in_part():
    t, landmarks, image = someone(8.0)
    said = flattened(landmarks)
    deeper = said.copy()
    deeper[:, LANDMARKS.index("left_wrist"), 2] += 0.2
    one, other = (arms(estimated(t, points, image)[0])[:, 0, 1, 2].mean() for points in (said, deeper))
    assert 0.04 < other - one < 0.25


def test_what_no_picture_tells_is_part_of_every_spread():
    t, points, image = someone(4.0)
    _, spread = estimated(t, points, image)
    assert (spread > UNKNOWN).all()


def test_a_shot_does_not_know_of_the_next():
    t, landmarks, image = someone()
    cut = len(t) // 2
    both, _ = estimated(t, landmarks, image, np.array([cut]))
    first, _ = estimated(t[:cut], landmarks[:cut], image[:cut])
    np.testing.assert_allclose(both[:cut], first)


def test_a_camera_gets_about_the_same_arms_as_a_clip():
    t, landmarks, image = someone(6.0)
    clip, _ = estimated(t, landmarks, image)
    live = LiveDepth()
    rows = [estimated_live(live, *row) for row in zip(t, landmarks, image, strict=True)]
    found, spread = (np.array(column) for column in zip(*rows, strict=True))
    apart = arms(found)[60:, :, 1] - arms(clip)[60:, :, 1]
    assert np.sqrt((apart**2).sum(axis=-1).mean()) < 0.12
    assert np.isfinite(spread).all()


def test_a_camera_forgets_who_was_there_before_a_pause():
    t, landmarks, image = someone(2.0)
    fresh, used = LiveDepth(), LiveDepth()
    _, other, other_image = someone(2.0, seed=5)
    for row in zip(t, other, other_image, strict=True):
        estimated_live(used, *row)
    one = estimated_live(used, 60.0, landmarks[0], image[0])[0]
    np.testing.assert_allclose(estimated_live(fresh, 0.0, landmarks[0], image[0])[0], one, atol=0.05)


def test_two_frames_of_a_camera_at_the_same_time_do_no_harm():
    t, landmarks, image = someone(1.0)
    live = LiveDepth()
    rows = [estimated_live(live, t[k // 2], landmarks[k], image[k]) for k in range(30)]
    assert all(np.isfinite(arms).all() and np.isfinite(spread).all() for arms, spread in rows)


def test_the_arms_of_who_is_turned_away_are_less_sure():
    spreads = []
    for behind in (False, True):
        t, landmarks, image = someone(behind=behind)
        spreads.append(estimated(t, landmarks, image)[1])
    assert spreads[1].mean() > 1.5 * spreads[0].mean()

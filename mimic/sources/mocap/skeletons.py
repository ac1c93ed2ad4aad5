"""What other people's files call a shoulder or a wrist, and how their rows are numbered.

A scheme maps our landmark (see `mimic.records.LANDMARKS`) to a name of the file, or to several whose mean it is.
``--names left_wrist=LWRA+LWRB`` adds to the tables or overrules them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mimic.errors import ConfigError, SourceError
from mimic.records import LANDMARKS

Scheme = Mapping[str, tuple[str, ...]]
"""Landmark -> names in the file; the landmark is their mean."""

NEEDED = ("left_shoulder", "right_shoulder", "left_wrist", "right_wrist")
"""Without these there is no arm to follow."""

_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot_index")


def _sides(left: str, right: str, *patterns: str) -> dict[str, tuple[str, ...]]:
    """Return a scheme from one pattern per limb, in the order of _LIMBS.

    ``{}`` is the side, ``a+b`` a mean, "" nothing.
    """
    scheme = {}
    for limb, pattern in zip(_LIMBS, patterns, strict=False):
        for side, own in (("left", left), ("right", right)):
            if pattern:
                scheme[f"{side}_{limb}"] = tuple(name.format(own) for name in pattern.split("+"))
    return scheme


SCHEMES: Mapping[str, Scheme] = {
    "blazepose": {name: (name,) for name in LANDMARKS},
    # Joints of the arm: Arm at the shoulder, ForeArm at the elbow, Hand at the wrist. LeftShoulder is the collar bone.
    "mixamo": _sides(
        "Left", "Right", "{}Arm", "{}ForeArm", "{}Hand", "{}UpLeg", "{}Leg", "{}Foot", "{}ToeBase"
    ),  # also Motion Builder, CMU as converted for it, Perception Neuron, Rokoko
    "lafan1": _sides("Left", "Right", "{}Arm", "{}ForeArm", "{}Hand", "{}UpLeg", "{}Leg", "{}Foot", "{}Toe"),
    "xsens": _sides("Left", "Right", "{}Shoulder", "{}Elbow", "{}Wrist", "{}Hip", "{}Knee", "{}Ankle", "{}Toe"),
    "cmu": _sides("l", "r", "{}humerus", "{}radius", "{}wrist", "{}femur", "{}tibia", "{}foot", "{}toes"),
    "daz": _sides("l", "r", "{}Shldr", "{}ForeArm", "{}Hand", "{}Thigh", "{}Shin", "{}Foot"),
    "unreal": _sides("l", "r", "upperarm_{}", "lowerarm_{}", "hand_{}", "thigh_{}", "calf_{}", "foot_{}", "ball_{}"),
    "smpl": _sides("L", "R", "{}_Shoulder", "{}_Elbow", "{}_Wrist", "{}_Hip", "{}_Knee", "{}_Ankle", "{}_Toe"),
    "openpose": _sides("L", "R", "{}Shoulder", "{}Elbow", "{}Wrist", "{}Hip", "{}Knee", "{}Ankle", "{}BigToe")
    | {"nose": ("Nose",), "left_ear": ("LEar",), "right_ear": ("REar",)},
    # The positions beside the example clips (examples/videos/*.npz).
    "mimic": _sides("L", "R", "shoulder{}", "elbow{}", "wrist{}", "hip{}", "knee{}", "ankle{}") | {"nose": ("nose",)},
    "opensim": _sides("L", "R", "{}.Shoulder", "{}.Elbow", "{}.Wrist", "{}.Hip", "{}.Knee", "{}.Ankle"),
    # Markers on the skin, each beside its joint; hips are the middle of the two markers of the pelvis on that side.
    "plug-in gait": _sides("L", "R", "{}SHO", "{}ELB", "{}WRA+{}WRB", "{}ASI+{}PSI", "{}KNE", "{}ANK", "{}TOE"),
    # Markers that OpenCap's and Pose2Sim's marker augmentation adds (Uhlrich et al., PLOS Computational Biology, 2023).
    "opencap": _sides(
        "L",
        "r",
        "{}_shoulder_study",
        "{}_lelbow_study+{}_melbow_study",
        "{}_lwrist_study+{}_mwrist_study",
        "{}HJC_study",
        "{}_knee_study+{}_mknee_study",
        "{}_ankle_study+{}_mankle_study",
        "{}_toe_study",
    ),
    "qualisys": _sides("L", "R", "{}Shoulder", "{}Elbow", "{}WristIn+{}WristOut", "", "{}KneeOut", "{}AnkleOut"),
}
"""Naming schemes that are recognised by themselves; the one that knows most of the file's landmarks wins."""

_H36M = (
    "mid_hip right_hip right_knee right_ankle left_hip left_knee left_ankle spine thorax neck head left_shoulder "
    "left_elbow left_wrist right_shoulder right_elbow right_wrist"
)
_SMPL = (
    "mid_hip left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot_index "
    "right_foot_index neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow "
    "left_wrist right_wrist left_hand right_hand"
)
_COCO = (
    "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow left_wrist "
    "right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle"
)
LAYOUTS: Mapping[str, tuple[str, ...]] = {
    "blazepose33": LANDMARKS,
    "coco17": tuple(_COCO.split()),
    "halpe26": tuple(
        f"{_COCO} head neck mid_hip left_foot_index right_foot_index "
        "left_small_toe right_small_toe left_heel right_heel".split()
    ),
    "coco133": (
        *f"{_COCO} left_foot_index left_small_toe left_heel right_foot_index right_small_toe right_heel".split(),
        *(f"face_{i}" for i in range(68)),
        *(f"left_hand_{i}" for i in range(21)),
        *(f"right_hand_{i}" for i in range(21)),
    ),
    "h36m17": tuple(_H36M.split()),
    "smpl24": tuple(_SMPL.split()),
}
"""Names of points that come as rows without names."""


def layout_of(points: int, asked: str | None) -> tuple[str, ...]:
    """Return the names of that many points, by the layout asked for or by their number.

    Raises:
        SourceError: If no layout fits, or two do.
    """
    known = ", ".join(f"{name} ({len(names)} points)" for name, names in LAYOUTS.items())
    if asked is not None:
        if asked not in LAYOUTS:
            raise ConfigError(f"there is no layout {asked!r}; known are {known}")
        if len(LAYOUTS[asked]) != points:
            raise SourceError(f"the layout {asked} has {len(LAYOUTS[asked])} points, the file {points}")
        return LAYOUTS[asked]
    fitting = [name for name, names in LAYOUTS.items() if len(names) == points]
    if len(fitting) != 1:
        what = f"could be {' or '.join(fitting)}" if fitting else "fit no layout that is known"
        raise SourceError(
            f"the file has {points} points without names, which {what}; store an array 'names' or 'layout' with them, "
            f"or give --layout; known are {known}"
        )
    return LAYOUTS[fitting[0]]


def read_names(words: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the mapping that ``left_wrist=LWRA+LWRB`` and the like ask for.

    Raises:
        ConfigError: If a word is none, or names no landmark of ours.
    """
    asked = {}
    for word in words:
        ours, separator, theirs = word.partition("=")
        if not separator or not theirs or ours not in LANDMARKS:
            raise ConfigError(
                f"--names {word} cannot be read; expected OURS=THEIRS or OURS=THEIRS+THEIRS, OURS being one of "
                f"{', '.join(name for name in LANDMARKS if name.split('_')[-1] in (*_LIMBS, 'index'))}"
            )
        asked[ours] = tuple(theirs.split("+"))
    return asked


def recognise(names: Sequence[str], asked: Scheme) -> tuple[str, Scheme]:
    """Return the scheme that fits a file's names: its name, and landmark -> names as the file writes them.

    A prefix before a colon (``mixamorig:LeftArm``) and upper or lower case make no difference.

    Args:
        names: Names in the file.
        asked: What the user mapped; it wins over the tables.

    Raises:
        SourceError: If shoulders and wrists cannot be found.
    """
    written = {name.split(":")[-1].lower(): name for name in reversed(names)}
    written |= {name: name for name in names}

    def found(scheme: Scheme) -> dict[str, tuple[str, ...]]:
        here = {}
        for ours, theirs in scheme.items():
            own = [written.get(name, written.get(name.lower())) for name in theirs]
            if all(name is not None for name in own):
                here[ours] = tuple(str(name) for name in own)
        return here

    missing = [name for theirs in asked.values() for name in theirs if not found({"": (name,)})]
    if missing:
        raise SourceError(f"--names asks for {', '.join(missing)}; the file has {_some(names)}")
    fits = {name: found({**scheme, **asked}) for name, scheme in SCHEMES.items()}
    best = max(fits, key=lambda name: (set(NEEDED) <= fits[name].keys(), len(fits[name])))
    if not set(NEEDED) <= fits[best].keys():
        lacking = [name for name in NEEDED if name not in fits[best]]
        raise SourceError(
            f"no {', '.join(lacking)} among the names of the file ({_some(names)}); the schemes {', '.join(SCHEMES)} "
            "are known; map others with --names left_shoulder=… right_shoulder=… left_wrist=… right_wrist=…"
        )
    return best, fits[best]


def _some(names: Sequence[str]) -> str:
    shown = [name or "''" for name in names[:24]]
    return ", ".join(shown) + ", …" * (len(names) > 24)

"""What other people's files call a shoulder or a wrist, and how their rows are numbered.

A scheme maps our landmark (see `mimic.records.LANDMARKS`) to a name of the file, or to several whose mean it is.
``names = ["left_wrist=LWRA+LWRB"]`` under [mocap] adds to the tables or overrules them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from mimic.errors import ConfigError, SourceError
from mimic.records import LANDMARKS

Scheme = Mapping[str, tuple[str, ...]]
"""Landmark -> names in the file; the landmark is their mean."""

NEEDED = ("left_shoulder", "right_shoulder", "left_wrist", "right_wrist")
"""Without these there is no arm to follow."""

_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot_index")


_NAMES = """
mixamo       Left Right {}Arm {}ForeArm {}Hand {}UpLeg {}Leg {}Foot {}ToeBase
lafan1       Left Right {}Arm {}ForeArm {}Hand {}UpLeg {}Leg {}Foot {}Toe
xsens        Left Right {}Shoulder {}Elbow {}Wrist {}Hip {}Knee {}Ankle {}Toe
unity        Left Right {}UpperArm {}LowerArm {}Hand {}UpperLeg {}LowerLeg {}Foot {}Toes
mvn          Left Right {}UpperArm {}ForeArm {}Hand {}UpperLeg {}LowerLeg {}Foot {}Toe
biovision    Left Right {}UpArm {}LowArm {}Hand {}UpLeg {}LowLeg {}Foot
cmu          l r        {}humerus {}radius {}wrist {}femur {}tibia {}foot {}toes
daz          l r        {}Shldr {}ForeArm {}Hand {}Thigh {}Shin {}Foot
biped        L R        {}UpperArm {}Forearm {}Hand {}Thigh {}Calf {}Foot {}Toe0
vroid        L R        {}UpperArm {}LowerArm {}Hand {}UpperLeg {}LowerLeg {}Foot {}ToeBase
optitrack    L R        {}UArm {}FArm {}Hand {}Thigh {}Shin {}Foot {}Toe
unreal       l r        upperarm_{} lowerarm_{} hand_{} thigh_{} calf_{} foot_{} ball_{}
rigify       L R        upper_arm{} forearm{} hand{} thigh{} shin{} foot{} toe{}
rigify_fk    L R        upper_arm_fk{} forearm_fk{} hand_fk{} thigh_fk{} shin_fk{} foot_fk{} toe_fk{}
auto-rig_pro l r        arm_stretch{} forearm_stretch{} hand{} thigh_stretch{} leg_stretch{} foot{} toes_01{}
suffixes     L R        Arm{} ForeArm{} Hand{} UpLeg{} Leg{} Foot{} ToeBase{}
suffixed     Left Right Arm{} ForeArm{} Hand{} UpLeg{} Leg{} Foot{} ToeBase{}
smpl         L R        {}_Shoulder {}_Elbow {}_Wrist {}_Hip {}_Knee {}_Ankle {}_Toe
openpose     L R        {}Shoulder {}Elbow {}Wrist {}Hip {}Knee {}Ankle {}BigToe
kinect       Left Right Shoulder{} Elbow{} Wrist{} Hip{} Knee{} Ankle{} Foot{}
mimic        L R        shoulder{} elbow{} wrist{} hip{} knee{} ankle{}
plug-in_gait L R        {}SHO {}ELB {}WRA+{}WRB {}ASI+{}PSI {}KNE {}ANK {}TOE
qualisys     L R        {}Shoulder {}Elbow {}WristIn+{}WristOut - {}KneeOut {}AnkleOut
opencap      L r        {}_shoulder_study {}_lelbow_study+{}_melbow_study {}_lwrist_study+{}_mwrist_study {}HJC_study \
 {}_knee_study+{}_mknee_study {}_ankle_study+{}_mankle_study {}_toe_study
"""
"""Scheme, its left and right, and its names in the order of _LIMBS: ``{}`` is the side, ``a+b`` a mean, ``-`` nothing.

The arm begins at the joint whose child is the elbow: mixamo's LeftShoulder is a collar bone. Mixamo's names are also
those of Motion Builder, Perception Neuron and Rokoko, Unity's those of VRM, and mimic's are beside its example clips.
Markers on the skin lie beside their joint. OpenCap: Uhlrich et al., PLOS Computational Biology, 2023.
"""


def _scheme(left: str, right: str, *patterns: str) -> dict[str, tuple[str, ...]]:
    return {
        f"{side}_{limb}": tuple(pattern.replace("{}", own).split("+"))
        for limb, pattern in zip(_LIMBS, patterns, strict=False)
        for side, own in (("left", left), ("right", right))
        if pattern != "-"
    } | {"nose": ("Nose",), "left_ear": (f"{left}Ear",), "right_ear": (f"{right}Ear",)}


SCHEMES: Mapping[str, Scheme] = {
    "blazepose": {name: (name,) for name in LANDMARKS},
    **{name.replace("_", " "): _scheme(*words) for name, *words in map(str.split, _NAMES.strip().splitlines())},
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
_HAND = [
    f"{finger}_{joint}" for finger in ("thumb", "index_finger", "middle", "ring", "pinky_finger") for joint in range(4)
]
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
    "mhr70": (
        *_COCO.split()[:9],
        *_COCO.split()[11:],
        *["left_foot_index", "left_small_toe", "left_heel", "right_foot_index", "right_small_toe", "right_heel"],
        *(f"right_{joint}" for joint in (*_HAND, "wrist")),
        *(f"left_{joint}" for joint in (*_HAND, "wrist")),
        *(f"{side}_{part}" for part in ("olecranon", "cubital_fossa", "acromion") for side in ("left", "right")),
        "neck",
    ),
    "h36m17": tuple(_H36M.split()),
    "smpl24": tuple(_SMPL.split()),
}
"""Names of points that come as rows without names. mhr70: SAM 3D Body, sam_3d_body/metadata/mhr70.py."""


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
            f"or give [mocap] layout in --config; known are {known}"
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
                f"[mocap] names: {word} cannot be read; expected OURS=THEIRS or OURS=THEIRS+THEIRS, OURS being one of "
                f"{', '.join(name for name in LANDMARKS if name.split('_')[-1] in (*_LIMBS, 'index'))}"
            )
        asked[ours] = tuple(theirs.split("+"))
    return asked


Columns = Mapping[str, tuple[int, ...]]
"""Landmark -> columns of the file's points; the landmark is their mean."""


def recognise(names: Sequence[str], asked: Scheme) -> tuple[str, list[Columns]]:
    """Return the scheme that fits a file's names, and the columns of each skeleton in it, in the order of the file.

    Case, separators, and what all names of a skeleton have before or after ours (``mixamorig:LeftArm``,
    ``DEF-upper_arm.L.001``) make no difference; several skeletons differ in that, or repeat each other's names.

    Args:
        names: Names in the file.
        asked: What the user mapped; it wins over the tables.

    Raises:
        SourceError: If shoulders and wrists cannot be found.
    """
    column = _columns(names)
    unknown = [name for theirs in asked.values() for name in theirs if _plain(name) not in "\n".join(column)]
    if unknown:
        raise SourceError(f"[mocap] names asks for {', '.join(unknown)}; the file has {_some(names)}")
    fits = {name: _skeletons({**scheme, **asked}, asked, column) for name, scheme in SCHEMES.items()}
    best = max(fits, key=lambda name: (set(NEEDED) <= fits[name][0].keys(), len(fits[name][0])))
    lacking = [name for name in NEEDED if name not in fits[best][0]]
    if lacking:
        raise SourceError(
            f"no {', '.join(lacking)} among the names of the file ({_some(names)}); the schemes {', '.join(SCHEMES)} "
            'are known; map others with [mocap] names = ["left_wrist=…", …] in --config'
        )
    return best, fits[best]


def _columns(names: Sequence[str]) -> dict[str, int]:
    """Return the column of each name, without separators; repeated names differ by ``#`` behind them."""
    column: dict[str, int] = {}
    for i, name in enumerate(names):
        key = _plain(name)
        while key in column:
            key += "#"
        column[key] = i
    return column


def _skeletons(scheme: Scheme, asked: Scheme, column: Mapping[str, int]) -> list[Columns]:
    """Return the columns of each skeleton that a scheme finds, of the fullest one where none is whole."""
    arms = [_plain(scheme[part][0]) for part in NEEDED]
    around = {tuple(key.split(own, 1)) for key in column for own in arms if own in key}
    here = [_found(scheme, asked, column, *ends) for ends in sorted(around)] or [_found(scheme, asked, column)]
    whole = [one for one in here if set(NEEDED) <= one.keys()]
    return sorted(whole or [max(here, key=len)], key=lambda one: min(map(min, one.values()), default=0))


def _found(scheme: Scheme, asked: Scheme, column: Mapping[str, int], before: str = "", after: str = "") -> Columns:
    """Return the columns of the landmarks that a scheme finds whole among names with this before and after them."""
    found = {}
    for ours, theirs in scheme.items():
        plain = [_plain(name) for name in theirs]
        at = [column.get(before + name + after, column.get(name) if ours in asked else None) for name in plain]
        if None not in at:
            found[ours] = tuple(index for index in at if index is not None)
    return found


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name.lower())


def _some(names: Sequence[str]) -> str:
    """Return the names that look like parts of arms; all, where less than four do."""
    arms = [name for name in names if re.search("sho|shld|sh_|acr|arm|elb|hum|rad|uln|wr|hand", name.lower())]
    some = arms if len(arms) >= len(NEEDED) else [name or "''" for name in names]
    return ", ".join(some) + f", and {len(names) - len(some)} others" * (len(some) < len(names))

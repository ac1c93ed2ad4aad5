"""The person in the pictures: body, face, hair, hands and clothes as skins over the skeleton's bones."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lab.people.skeleton import SIDES, SIGN, Build, rest_frames
from lab.people.surface import Array, Field, Mesh, below, blend, both, carve, cone, ellipsoid, grown, mesh_of

Colour = tuple[float, float, float]
Weights = dict[str, Array]


@dataclass(frozen=True, kw_only=True, slots=True)
class Look:
    """How one person differs from another."""

    skin: Colour
    hair: Colour
    lips: Colour
    iris: Colour
    top: Colour
    bottom: Colour
    trim: Colour
    shoes: Colour
    soles: Colour
    bun: bool = False
    top_style: str = "tee"
    """`tee`, `long` (sleeves), `tank` or `leotard`."""
    bottom_style: str = "trousers"
    """`trousers`, `shorts` or `tights` (with a skirt)."""
    hands: str = "open"
    """`open`, `soft` (ballet) or `gloves`."""
    slender: float = 0.0
    """0: broad chest and shoulders; 1: slight."""


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """One coloured mesh that follows bones."""

    name: str
    mesh: Mesh
    weights: Weights
    colour: Colour
    shine: float = 0.1


def skins(look: Look, build: Build) -> list[Skin]:
    """Return all skins of a person, in the pose of `rest_frames`."""
    body = _body(look, build)
    low, high = [-0.26, -0.74, 0.03], [0.26, 0.74, 1.66]
    made = [_worn("body", body, low, high, 0.010, look.skin, build)]
    made += _clothes(look, build, body)
    head = np.array([build.head_x, 0.0, build.head_z])
    lo, hi = head + [-0.2, -0.14, -0.09], head + [0.18, 0.14, 0.27]
    made.append(_rigid("head", "head", mesh_of(_moved(_head(look), head), lo, hi, 0.0036), look.skin))
    made.append(_rigid("hair", "head", mesh_of(_moved(_hair(look), head), lo, hi, 0.0045), look.hair, 0.25))
    made += _hands_and_feet(look, build)
    return made


def face_geoms(look: Look) -> list[str]:
    """Return MJCF geoms of eyes, brows and mouth, in the head bone's axes."""
    geoms = []
    for s in (1.0, -1.0):
        geoms.append(_geom("ellipsoid", (0.0765, s * 0.0315, 0.083), (0.0175, 0.0185, 0.0120), (0.93, 0.91, 0.89)))
        geoms.append(_geom("ellipsoid", (0.0922, s * 0.0305, 0.083), (0.0035, 0.0084, 0.0088), look.iris))
        geoms.append(_geom("ellipsoid", (0.0950, s * 0.0303, 0.083), (0.0020, 0.0044, 0.0046), (0.03, 0.03, 0.03)))
        lash = tuple(0.5 * c for c in look.hair)
        geoms.append(_capsule((0.0920, s * 0.0160, 0.0900), (0.0935, s * 0.0310, 0.0935), 0.0030, lash))
        geoms.append(_capsule((0.0935, s * 0.0310, 0.0935), (0.0810, s * 0.0490, 0.0885), 0.0030, lash))
        brow = 0.0028 if look.bun else 0.0038
        tint = tuple(0.8 * c for c in look.hair)
        geoms.append(_capsule((0.1020, s * 0.0140, 0.1145), (0.0970, s * 0.0340, 0.1185), brow, tint))
        geoms.append(_capsule((0.0970, s * 0.0340, 0.1180), (0.0790, s * 0.0530, 0.1110), 0.8 * brow, tint))
    head = _head(look)
    wide = 0.029 - 0.003 * look.slender
    dark = tuple(0.35 * c for c in look.lips)
    for drop, radius, rise, sunk, tint in (
        (0.0055, 0.0052, 0.006, 0.0030, look.lips),
        (-0.0055, 0.0056, 0.010, 0.0028, look.lips),
        (0.0, 0.0022, 0.008, -0.0018, dark),
    ):
        y = wide * np.linspace(-1, 1, 9) * (0.80 if drop < 0 else 1.0)
        z = 0.010 + drop * (1 - 0.8 * (y / wide) ** 2) + rise * (y / wide) ** 2
        line = [(_surface_x(head, a, b) - sunk, a, b) for a, b in zip(y, z, strict=True)]
        geoms += [_capsule(a, b, radius, tint) for a, b in itertools.pairwise(line)]
    return geoms


def _surface_x(solid: Field, y: float, z: float) -> float:
    """How far forward the face reaches at a height and side [m]."""
    x = np.linspace(0.03, 0.15, 481)
    return float(x[np.flatnonzero(solid(np.stack([x, np.full(481, y), np.full(481, z)], axis=1)) < 0)[-1]])


def skin_file(skin: Skin, build: Build) -> bytes:
    """Return a skin in MuJoCo's binary format.

    Source: MuJoCo documentation, XML reference, asset/skin, "file".
    """
    rest = rest_frames(build)
    bones = {name: w for name, w in skin.weights.items() if (w > 1e-4).any()}
    vertices, faces = skin.mesh.vertices, skin.mesh.faces
    out = [struct.pack("4i", len(vertices), 0, len(faces), len(bones))]
    out += [vertices.astype("<f4").tobytes(), faces.astype("<i4").tobytes()]
    for name, weight in bones.items():
        index = np.flatnonzero(weight > 1e-4)
        x, y, z, w = Rotation.from_matrix(rest[name].R[0]).as_quat()
        out.append(struct.pack("40s", name.encode()))
        out.append(np.array([*rest[name].p[0], w, x, y, z], "<f4").tobytes())
        out.append(struct.pack("i", len(index)))
        out += [index.astype("<i4").tobytes(), weight[index].astype("<f4").tobytes()]
    return b"".join(out)


def _body(look: Look, build: Build) -> Field:
    """Torso, neck, arms and legs without head, hands and feet."""
    slight = look.slender
    w = 1.0 - 0.13 * slight
    torso = [
        ellipsoid((0.0, 0.0, 0.955), (0.108, 0.160 + 0.004 * slight, 0.115)),
        ellipsoid((-0.045, 0.065, 0.905), (0.085, 0.085, 0.095)),
        ellipsoid((-0.045, -0.065, 0.905), (0.085, 0.085, 0.095)),
        ellipsoid((0.005, 0.0, 1.08), (0.098 * w, 0.142 * w, 0.16)),
        ellipsoid((-0.008, 0.0, 1.27), (0.112 * w, 0.163 * w, 0.185)),
        ellipsoid((0.055, 0.068, 1.315), (0.060, 0.080 * w, 0.060)),
        ellipsoid((0.055, -0.068, 1.315), (0.060, 0.080 * w, 0.060)),
        cone((-0.02, 0.0, 1.40), (0.0, 0.0, 1.58), 0.066 - 0.012 * slight, 0.053 - 0.009 * slight),
    ]
    limbs: list[Field] = []
    arms: list[Field] = []
    for side in SIDES:
        s = SIGN[side]
        shoulder, along = build.shoulder(side), build.arm_direction(side)
        torso.append(cone((-0.02, 0.0, 1.475), shoulder + [-0.005, 0.0, 0.012], 0.050 - 0.006 * slight, 0.048))

        def at(distance: float, origin: Array = shoulder, axis: Array = along) -> Array:
            return origin + distance * axis

        elbow = build.upper_arm
        thin = 1.0 - 0.27 * slight
        arms.append(
            blend(
                [
                    ellipsoid(at(0.012), (0.064 * thin, 0.064 * thin, 0.066 * thin)),
                    cone(at(0.0), at(elbow), 0.056 * thin, 0.040 * thin),
                    ellipsoid(at(0.15) + [0.012, 0, 0], (0.042 * thin, 0.070 * thin, 0.046 * thin)),
                    ellipsoid(at(0.15) + [-0.014, 0, 0], (0.040 * thin, 0.080 * thin, 0.044 * thin)),
                    cone(at(elbow), at(elbow + 0.08), 0.039 * thin, 0.044 * thin),
                    cone(at(elbow + 0.08), at(build.arm), 0.044 * thin, 0.027 * thin),
                ],
                0.03,
            )
        )
        hip = np.array([0.0, s * build.hip_half, build.hip_z])
        knee, ankle = hip - [0, 0, build.thigh], hip - [0, 0, build.thigh + build.shin]
        limbs.append(
            blend(
                [
                    cone(hip, knee, 0.086 - 0.006 * slight, 0.055 - 0.011 * slight),
                    ellipsoid(hip + [0.012, 0.0, -0.17], (0.078, 0.072, 0.20)),
                    cone(knee, ankle, 0.053 - 0.010 * slight, 0.037 - 0.004 * slight),
                    ellipsoid(knee + [-0.022, 0.0, -0.12], (0.052, 0.053 - 0.004 * slight, 0.13)),
                    ellipsoid(knee + [0.022 - 0.010 * slight, 0.0, 0.0], (0.036, 0.038, 0.05)),
                ],
                0.03,
            )
        )
    legs = blend(limbs, 0.012)
    return blend([blend([blend(torso, 0.06), legs], 0.035), *arms], 0.05)


def _clothes(look: Look, build: Build, body: Field) -> list[Skin]:
    made: list[Skin] = []
    box = ([-0.3, -0.78, 0.0], [0.3, 0.78, 1.66])

    def add(name: str, solid: Field, colour: Colour, shine: float = 0.05, step: float = 0.010) -> None:
        made.append(_worn(name, solid, *box, step, colour, build))

    def sleeve_end(length: float) -> list[Field]:
        """Everything but the arm beyond a length from the shoulder."""
        cuts = [below(_along(build, s, length), build.arm_direction(s)) for s in SIDES]
        trunks = [below((0, SIGN[s] * 0.25, 1.1), (0, SIGN[s], 0)) for s in SIDES]
        return [_either(cut, trunk) for cut, trunk in zip(cuts, trunks, strict=True)]

    def leg_part(z_low: float, z_high: float) -> list[Field]:
        return [below((0, 0, z_low), (0, 0, -1)), below((0, 0, z_high), (0, 0, 1))]

    not_arms = [below(np.array([0, SIGN[s] * (build.shoulder_half + 0.02), 1.1]), (0, SIGN[s], 0)) for s in SIDES]
    neckline = both([_outside(ellipsoid((0.03, 0, 1.535), (0.10, 0.088, 0.075))), below((0, 0, 1.52), (0, 0, 1))])
    if look.top_style in ("tee", "long"):
        loose = [body]
        for side in SIDES:
            a, along = build.shoulder(side), build.arm_direction(side)
            if look.top_style == "tee":
                loose.append(cone(a, a + 0.19 * along, 0.060, 0.060))
            else:
                loose.append(cone(a, a + build.upper_arm * along, 0.066, 0.046))
                loose.append(cone(a + build.upper_arm * along, a + (build.arm - 0.01) * along, 0.047, 0.036))
        loose.append(ellipsoid((0.0, 0.0, 1.06), (0.112, 0.156, 0.24)))
        shell = grown(blend(loose, 0.05), _wrinkles(0.010, 0.0028))
        ends = sleeve_end(0.185 if look.top_style == "tee" else build.arm - 0.012)
        hem = below((0, 0, 0.915), (0.0, 0, -1))
        add("top", both([shell, *ends, hem, neckline]), look.top)
        throat = ellipsoid((0.03, 0, 1.535), (0.10, 0.088, 0.075))
        near = [grown(throat, 0.014), below((0, 0, 1.42), (0, 0, -1))]
        add("collar", both([grown(body, 0.016), neckline, *near]), look.trim, step=0.007)
        if look.top_style == "tee":
            for side in SIDES:
                outer = below((0, SIGN[side] * 0.24, 0), (0, -SIGN[side], 0))
                ring = [
                    below(_along(build, side, d), n * build.arm_direction(side)) for d, n in ((0.17, -1), (0.19, 1))
                ]
                add(f"cuff{side}", both([grown(shell, 0.004), outer, *ring]), look.trim)
    elif look.top_style == "tank":
        shell = grown(blend([body, ellipsoid((0.0, 0.0, 1.06), (0.110, 0.152, 0.24))], 0.04), _wrinkles(0.008, 0.0022))
        holes = [ellipsoid(build.shoulder(s) + [0, SIGN[s] * 0.052, -0.045], (0.16, 0.100, 0.155)) for s in SIDES]
        throat = ellipsoid((0.05, 0, 1.52), (0.12, 0.092, 0.105))
        holes.append(throat)
        ends = [below((0, 0, 0.915), (0, 0, -1)), below((0, 0, 1.53), (0, 0, 1)), *not_arms]
        add("top", both([shell, *ends, *map(_outside, holes)]), look.top, step=0.008)
        near = [blend([grown(hole, 0.012) for hole in holes], 1e-4), below((0, 0, 1.2), (0, 0, -1))]
        add("piping", both([grown(shell, 0.003), *ends, *near, *map(_outside, holes)]), look.trim, step=0.007)
    else:
        scoop = _outside(ellipsoid((0.10, 0, 1.50), (0.13, 0.100, 0.125)))
        back = _outside(ellipsoid((-0.12, 0, 1.48), (0.10, 0.095, 0.125)))
        armholes = [
            _outside(ellipsoid(build.shoulder(s) + [0, SIGN[s] * 0.055, -0.03], (0.15, 0.108, 0.135))) for s in SIDES
        ]
        ends = [below((0, 0, 0.90), (0, 0, -1)), below((0, 0, 1.50), (0, 0, 1))]
        add("top", both([grown(body, 0.007), scoop, back, *armholes, *not_arms, *ends]), look.top, 0.2, 0.008)
    if look.bottom_style == "trousers":
        loose = [body]
        for side in SIDES:
            hip = np.array([0, SIGN[side] * build.hip_half, build.hip_z])
            knee, ankle = hip - [0, 0, build.thigh], hip - [0, 0, build.thigh + build.shin]
            loose.append(cone(hip, knee, 0.092, 0.068))
            loose.append(cone(knee, ankle, 0.068, 0.056))
        shell = grown(blend(loose, 0.012), _wrinkles(0.008, 0.0030))
        add("bottom", both([shell, *not_arms, *leg_part(0.095, 1.0)]), look.bottom)
    elif look.bottom_style == "shorts":
        legs = []
        for side in SIDES:
            hip = np.array([0, SIGN[side] * build.hip_half, build.hip_z])
            leg = blend([body, cone(hip, hip + [0.008, SIGN[side] * 0.026, -0.36], 0.097, 0.094)], 0.012)
            own = below((0, SIGN[side] * 0.004, 0.80), (0, -SIGN[side], 0.03))
            legs.append(both([grown(leg, _wrinkles(0.006, 0.0035)), _either(own, below((0, 0, 0.80), (0, 0, -1)))]))
        shell = _either(*legs)
        add("bottom", both([shell, *not_arms, *leg_part(0.575, 1.01)]), look.bottom, 0.3)
        add("hem", both([grown(shell, 0.003), *not_arms, *leg_part(0.568, 0.592)]), look.trim, 0.3)
        socks = both([grown(body, 0.006), *not_arms, *leg_part(0.06, 0.235)])
        add("socks", socks, (0.93, 0.93, 0.92))
    else:
        add("bottom", both([grown(body, 0.004), *not_arms, *leg_part(0.05, 0.99)]), look.bottom, 0.2)

        def skirt(p: Array) -> Array:
            angle = np.arctan2(p[:, 1], p[:, 0])
            drop = 1.04 - p[:, 2]
            radius = 1.0 + 1.75 * drop + 0.05 * drop * np.sin(11 * angle) / 0.35
            rho = np.hypot(p[:, 0] / 0.118, p[:, 1] / 0.156)
            return np.abs(rho - radius) * 0.112 - 0.006

        add("skirt", both([skirt, *leg_part(0.70, 1.04)]), look.trim, 0.15, 0.008)
    return made


def _wrinkles(mean: float, height: float) -> Field:
    """Thickness of cloth with soft folds [m]."""

    def field(p: Array) -> Array:
        x, y, z = p.T
        folds = np.sin(52 * z + 17 * y + 9 * np.sin(14 * x + 5 * z)) * np.sin(19 * y - 23 * x + 11 * z)
        return mean + height * folds

    return field


def _outside(solid: Field) -> Field:
    return lambda p: -solid(p)


def _either(a: Field, b: Field) -> Field:
    return lambda p: np.minimum(a(p), b(p))


def _along(build: Build, side: str, distance: float) -> Array:
    return build.shoulder(side) + distance * build.arm_direction(side)


def _head(look: Look) -> Field:
    solid = blend(
        [
            ellipsoid((-0.002, 0.0, 0.112), (0.096, 0.075, 0.088)),
            ellipsoid((0.040, 0.0, 0.040), (0.056, 0.055 - 0.004 * look.slender, 0.066)),
            ellipsoid((0.074, 0.0, -0.018), (0.026, 0.026 - 0.005 * look.slender, 0.020)),
            ellipsoid((0.055, 0.038, 0.052), (0.034, 0.024, 0.030)),
            ellipsoid((0.055, -0.038, 0.052), (0.034, 0.024, 0.030)),
            ellipsoid((0.078, 0.0, 0.012), (0.022, 0.030, 0.024)),
        ],
        0.03,
    )
    brow = blend([cone((0.086, -s * 0.006, 0.110), (0.070, s * 0.050, 0.110), 0.011, 0.010) for s in (1, -1)], 0.01)
    solid = blend([solid, brow], 0.02)
    for s in (1, -1):
        solid = carve(solid, ellipsoid((0.102, s * 0.033, 0.083), (0.020, 0.021, 0.014)), 0.012)
    nose = [
        cone((0.092, 0.0, 0.100), (0.114, 0.0, 0.058), 0.007, 0.0115),
        ellipsoid((0.104, 0.011, 0.052), (0.011, 0.0085, 0.0075)),
        ellipsoid((0.104, -0.011, 0.052), (0.011, 0.0085, 0.0075)),
    ]
    ears = [
        carve(
            ellipsoid((-0.004, s * 0.078, 0.075), (0.019, 0.0095, 0.032)),
            ellipsoid((0.004, s * 0.090, 0.078), (0.011, 0.008, 0.019)),
            0.006,
        )
        for s in (1, -1)
    ]
    neck = cone((-0.018, 0.0, -0.07), (-0.012, 0.0, 0.05), 0.053 - 0.009 * look.slender, 0.050 - 0.006 * look.slender)
    solid = blend([solid, blend(nose, 0.008), *ears], 0.010)
    return blend([solid, both([neck, below((0, 0, -0.06), (0, 0, -1))])], 0.02)


def _hair(look: Look) -> Field:
    skull = ellipsoid((-0.004, 0.0, 0.114), (0.096, 0.075, 0.088))

    def thickness(p: Array) -> Array:
        strands = np.sin(210 * p[:, 1] + 30 * p[:, 0]) * 0.0012
        if look.bun:
            return 0.008 + strands
        crown = np.clip((p[:, 2] - 0.10) / 0.10, 0.0, 1.0)
        quiff = np.clip((p[:, 0] - 0.0) / 0.09, 0.0, 1.0)
        return 0.008 + 0.012 * crown + 0.008 * crown * quiff + strands

    hairline = below((0.070, 0.0, 0.158), (1.0, 0.0, -0.62))
    sideburn = below((0.012, 0.0, 0.06), (1.0, 0.0, -0.55))
    line = blend([hairline, sideburn], 0.004) if not look.bun else hairline
    bottom = below((-0.03, 0.0, 0.035), (0.35, 0.0, -1.0))
    around_ears = [ellipsoid((-0.002, s * 0.080, 0.068), (0.026, 0.03, 0.040)) for s in (1, -1)]
    cap = both([grown(skull, thickness), line, bottom])
    for ear in around_ears:
        cap = carve(cap, ear, 0.004)
    if look.bun:
        bun = grown(ellipsoid((-0.088, 0.0, 0.190), (0.040, 0.043, 0.038)), lambda p: 0.002 * np.sin(260 * p[:, 2]))
        return blend([cap, bun], 0.012)
    return cap


def _hand(look: Look, side: str) -> Field:
    """Hand in its own axes: x along the fingers, z out of its back; the thumb of a left hand is at -y."""
    thumb = -SIGN[side]
    parts: list[Field] = [
        cone((-0.01, 0.0, 0.0), (0.03, 0.0, 0.0), 0.024, 0.024),
        ellipsoid((0.050, 0.0, 0.0), (0.050, 0.040, 0.0175)),
        ellipsoid((0.030, thumb * 0.026, -0.008), (0.034, 0.018, 0.017)),
    ]
    curl = np.deg2rad([9.0, 12.0, 14.0] if look.hands == "soft" else [4.0, 5.0, 5.0])
    size = 1.0 - 0.08 * look.slender
    spread = 0.03 if look.hands == "soft" else 0.17
    for i, (y, length) in enumerate(((0.030, 0.074), (0.0105, 0.083), (-0.0105, 0.079), (-0.030, 0.062))):
        y, angle = thumb * y, (0.5 + 0.25 * i if look.hands == "soft" else 1.0)
        p = np.array([0.088 - 0.004 * abs(i - 1.2), y, 0.0])
        aside = spread * y / 0.030
        bend = 0.0
        for joint, share in enumerate((0.45, 0.32, 0.25)):
            bend += curl[joint] * angle
            step = share * length * np.array([np.cos(bend), np.cos(bend) * aside, -np.sin(bend)])
            r = 0.0092 - 0.0007 * joint
            parts.append(cone(p, p + step, r, r - 0.0007))
            p = p + step
    if look.hands == "soft":
        path = [(0.018, thumb * 0.030, -0.012), (0.052, thumb * 0.036, -0.026), (0.080, thumb * 0.026, -0.034)]
    else:
        path = [(0.018, thumb * 0.030, -0.006), (0.048, thumb * 0.055, -0.012), (0.074, thumb * 0.070, -0.014)]
    parts += [cone(a, b, 0.0125, 0.0105) for a, b in itertools.pairwise(path)]
    hand = blend(parts, 0.010)
    return lambda p: hand(p / size) * size


def _glove(side: str) -> Field:
    thumb = -SIGN[side]
    return blend(
        [
            ellipsoid((0.088, 0.0, -0.012), (0.078, 0.058, 0.056)),
            ellipsoid((0.060, 0.0, 0.004), (0.060, 0.052, 0.046)),
            cone((0.030, thumb * 0.042, -0.020), (0.100, thumb * 0.052, -0.034), 0.022, 0.023),
        ],
        0.018,
    )


def _hands_and_feet(look: Look, build: Build) -> list[Skin]:
    made = []
    rest = rest_frames(build)

    def add(bone: str, part: str, solid: Field, step: float, colour: Colour, shine: float) -> None:
        local = mesh_of(solid, [-0.14, -0.10, -0.10], [0.24, 0.10, 0.12], step)
        mesh = Mesh(local.vertices @ rest[bone].R[0].T + rest[bone].p[0], local.faces)
        made.append(_rigid(f"{part}_{bone}", bone, mesh, colour, shine))

    for side in SIDES:
        hand, foot = f"hand{side}", f"foot{side}"
        if look.hands == "gloves":
            add(hand, "glove", _glove(side), 0.005, (0.78, 0.07, 0.07), 0.6)
            cuff = cone((-0.052, 0.0, 0.0), (0.018, 0.0, 0.0), 0.041, 0.044)
            slab = [below((-0.055, 0, 0), (-1, 0, 0)), below((0.024, 0, 0), (1, 0, 0))]
            add(hand, "cuff", both([cuff, *slab]), 0.005, (0.93, 0.92, 0.90), 0.4)
        else:
            add(hand, "skin", _hand(look, side), 0.0032, look.skin, 0.1)
        upper, sole = _shoe(look, SIGN[side])
        add(foot, "shoe", upper, 0.005, look.shoes, 0.3)
        if sole is not None:
            add(foot, "sole", sole, 0.005, look.soles, 0.1)
    return made


def _shoe(look: Look, s: float) -> tuple[Field, Field | None]:
    """Shoe and its sole in the foot's axes: x to the toes, origin at the ankle, floor at z = -0.085."""
    floor = -0.085
    if look.bottom_style == "tights":
        slipper = blend(
            [
                cone((-0.045, 0, floor + 0.030), (0.10, -s * 0.006, floor + 0.024), 0.030, 0.030),
                cone((0.10, -s * 0.006, floor + 0.020), (0.155, -s * 0.010, floor + 0.014), 0.032, 0.014),
                cone((0.0, 0, 0.0), (0.05, 0, floor + 0.040), 0.038, 0.030),
                cone((-0.02, 0, 0.0), (-0.04, 0, floor + 0.03), 0.032, 0.030),
            ],
            0.03,
        )
        return both([slipper, below((0, 0, floor + 0.002), (0, 0, -1))]), None
    outline = [
        cone((-0.048, 0.0, floor + 0.034), (0.10, -s * 0.004, floor + 0.030), 0.036, 0.042),
        ellipsoid((0.125, -s * 0.006, floor + 0.026), (0.060, 0.047, 0.038)),
    ]
    if look.bottom_style == "shorts":
        ankle = cone((-0.006, 0, 0.085), (-0.012, 0, floor + 0.05), 0.047, 0.042)
        top = below((0, 0, 0.10), (0, 0, 1))
    else:
        ankle = cone((-0.006, 0, 0.0), (-0.012, 0, floor + 0.05), 0.044, 0.042)
        top = below((0, 0, 0.005), (-0.25, 0, 1))
    instep = cone((0.02, 0, -0.005), (0.10, -s * 0.004, floor + 0.045), 0.036, 0.034)
    solid = blend([*outline, ankle, instep], 0.03)
    upper = both([solid, top, below((0, 0, floor + 0.016), (0, 0, -1))])
    sole = [grown(solid, 0.005), below((0, 0, floor + 0.024), (0, 0, 1)), below((0, 0, floor + 0.001), (0, 0, -1))]
    return upper, both(sole)


def _moved(solid: Field, by: Array) -> Field:
    return lambda p: solid(p - by)


def _rigid(name: str, bone: str, mesh: Mesh, colour: Colour, shine: float = 0.1) -> Skin:
    return Skin(name, mesh, {bone: np.ones(len(mesh.vertices))}, colour, shine)


def _worn(
    name: str, solid: Field, low: Sequence[float], high: Sequence[float], step: float, colour: Colour, build: Build
) -> Skin:
    mesh = mesh_of(solid, low, high, step)
    rounds = round(12 * (0.010 / step) ** 2)
    return Skin(name, mesh, _smoothed(_weights(mesh.vertices, build), mesh, rounds), colour)


def _ramp(value: Array, start: float, end: float) -> Array:
    x = np.clip((value - start) / (end - start), 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def _chain(value: Array, steps: Sequence[tuple[str, float, float]], first: str) -> Weights:
    """Weights along a chain of bones; each step names the bone that takes over and between which values."""
    weights = {first: np.ones(len(value))}
    last = first
    for name, start, end in steps:
        share = _ramp(value, start, end)
        weights[name] = weights[last] * share
        weights[last] = weights[last] * (1.0 - share)
        last = name
    return weights


def _weights(p: Array, build: Build) -> Weights:
    """Share of each bone in the motion of each point, by where the point is in the rest pose."""
    _, y, z = p.T
    total: Weights = {}
    left = np.ones(len(p))

    def add(part: Weights, share: Array) -> None:
        for name, weight in part.items():
            total[name] = total.get(name, 0.0) + weight * share

    for side in SIDES:
        origin, along = build.shoulder(side), build.arm_direction(side)
        s = (p - origin) @ along
        away = np.linalg.norm(p - origin - s[:, None] * along, axis=1)
        near = _ramp(s, -0.05, 0.07) * _ramp(-away, -0.130, -0.085) * _ramp(z, 0.85, 1.0)
        near = np.where(SIGN[side] * y > 0.06, near, 0.0)
        a, b = build.upper_arm, build.arm
        chain = [
            (f"upper1{side}", 0.03, 0.5 * a),
            (f"upper2{side}", 0.5 * a, 0.9 * a),
            (f"fore0{side}", a - 0.045, a + 0.045),
            (f"fore1{side}", a + 0.02, a + 0.14),
            (f"fore2{side}", a + 0.12, b - 0.02),
            (f"hand{side}", b - 0.015, b + 0.015),
        ]
        add(_chain(s, chain, f"upper0{side}"), near)
        left = left - near
    whole, legs = left, np.zeros(len(p))
    for side in SIDES:
        own = np.where(z < 0.80, SIGN[side] * y > 0.0, _ramp(SIGN[side] * y, -0.02, 0.02))
        leg = _ramp(-z, -(build.hip_z + 0.06), -(build.hip_z - 0.11)) * own * whole
        knee, ankle = build.hip_z - build.thigh, build.ankle_z
        shin = [(f"shin{side}", -knee - 0.06, -knee + 0.06), (f"foot{side}", -ankle - 0.02, -ankle + 0.02)]
        add(_chain(-z, shin, f"thigh{side}"), leg)
        legs = legs + leg
    left = left - legs
    spine = [("waist", 0.98, 1.08), ("chest", 1.10, 1.24), ("neck", 1.44, 1.51), ("head", 1.53, 1.60)]
    add(_chain(z, spine, "pelvis"), left)
    return total


def _smoothed(weights: Weights, mesh: Mesh, rounds: int) -> Weights:
    """Average weights with the neighbours on the mesh, several times."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    names = list(weights)
    value = np.stack([weights[name] for name in names], axis=1)
    degree = np.bincount(edges[:, 0], minlength=len(value)) + np.bincount(edges[:, 1], minlength=len(value))
    for _ in range(rounds):
        total = np.zeros_like(value)
        np.add.at(total, edges[:, 0], value[edges[:, 1]])
        np.add.at(total, edges[:, 1], value[edges[:, 0]])
        value = 0.5 * value + 0.5 * total / degree[:, None]
    return {name: value[:, i] for i, name in enumerate(names)}


def _text(values: Sequence[float]) -> str:
    return " ".join(f"{v:.5g}" for v in values)


def _geom(kind: str, at: Sequence[float], size: Sequence[float], colour: Sequence[float]) -> str:
    return f'<geom type="{kind}" pos="{_text(at)}" size="{_text(size)}" rgba="{_text(colour)} 1"/>'


def _capsule(a: Sequence[float], b: Sequence[float], radius: float, colour: Sequence[float]) -> str:
    return f'<geom type="capsule" fromto="{_text((*a, *b))}" size="{radius:.5g}" rgba="{_text(colour)} 1"/>'

"""Write a robot's MJCF and its scene.xml from robot.toml and the outer shapes of appearance.py, both in its folder.

    python assets/make_mjcf.py ROBOT [--check]

With --check nothing is written, and the exit status is 1 where a file on disk differs from what would be written.
"""

from __future__ import annotations

import importlib
import sys
import tomllib
import xml.etree.ElementTree as ET
from math import asin, cos, sin
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent / sys.argv[1]
sys.path.insert(0, str(HERE.parent))
LOOKS = importlib.import_module(f"{HERE.name}.appearance")
ROBOT: dict[str, Any] = tomllib.loads((HERE / "robot.toml").read_text(encoding="utf-8"))
LEGS = {"FL": (1, 1), "FR": (1, -1), "RL": (-1, 1), "RR": (-1, -1)}
"""Leg -> (front +1 or hind -1, left +1 or right -1)."""

SELF_CONTACTS = (
    ("FL_shank", "FR_shank"),
    ("RL_shank", "RR_shank"),
    *((f"{side}_shank", f"{hind}_shank") for side, hind in (("FL", "RL"), ("FR", "RR"))),
    *((f"{side}_shank", other) for other in ("head_0", "body") for side in ("FL", "FR")),
)
"""Pairs of the robot's own shapes that may touch."""


def text(*values: Any) -> str:
    """Return numbers as MJCF writes them: shortest form that reads back the same."""
    flat: list[float] = []
    for value in values:
        flat.extend(value if isinstance(value, list | tuple) else [value])
    return " ".join(f"{round(float(v), 10) + 0.0:.10g}" for v in flat)


def mirrored(inertia: list[float], xy: int, xz: int, yz: int) -> list[float]:
    """Return ixx iyy izz ixy ixz iyz with the signs of its products changed."""
    ixx, iyy, izz, ixy, ixz, iyz = inertia
    return [ixx, iyy, izz, ixy * xy, ixz * xz, iyz * yz]


def inertial(body: ET.Element, mass: float, com: list[float], inertia: list[float]) -> None:
    ET.SubElement(body, "inertial", mass=text(mass), pos=text(com), fullinertia=text(inertia))


def rotor(body: ET.Element, name: str, position: list[float]) -> None:
    child = ET.SubElement(body, "body", name=name, pos=text(position))
    inertial(child, ROBOT["rotor"]["mass"], [0.0, 0.0, 0.0], ROBOT["rotor"]["inertia"])


def collide(body: ET.Element, name: str, **attributes: str) -> None:
    ET.SubElement(body, "geom", {"name": name, "class": "collision", **attributes})


def dress(body: ET.Element, part: str, f: int, s: int) -> None:
    """Add the outer shapes of a part; they weigh nothing and touch nothing."""
    for shape in LOOKS.SHAPES.get(part, ()):
        ET.SubElement(body, "geom", {"class": "visual", **shape.attributes(f, s)})


def leg(parent: ET.Element, name: str) -> None:
    f, s = LEGS[name]
    end = "front" if f > 0 else "rear"
    a, h, k, toe = (ROBOT[key] for key in ("abad", "hip", "knee", "toe"))
    rotors = ROBOT.get("rotor", {})  # without, their mass is in the links

    x, y, z = a["origin"]
    abad = ET.SubElement(parent, "body", name=f"{name}_abad", pos=text(f * x, s * y, z))
    cx, cy, cz = a["com"]
    inertial(abad, a["mass"], [f * cx, s * cy, cz], mirrored(a["inertia"], s * f, f, s))
    ET.SubElement(abad, "joint", {"name": f"{name}_abad", "class": "abad"})
    shoulder = a["shoulder"]
    upright = {"quat": text(2**-0.5, 2**-0.5, 0, 0)}
    for label, c in (("abad", a.get("cylinder")), ("shoulder", shoulder)):
        if c:
            size = text(c["radius"], c["length"] / 2)
            at = text(0, s * c.get("y", 0.0), 0)
            collide(abad, f"{name}_{label}", type="cylinder", size=size, pos=at, **upright)
    dress(abad, "abad", f, s)
    if rotors:
        rx, ry, rz = rotors["abad"]
        rotor(abad, f"{name}_abad_rotor", [f * rx, ry, rz])

    x, y, z = h["origin"]
    hip = ET.SubElement(abad, "body", name=f"{name}_hip", pos=text(x, s * y, z))
    cx, cy, cz = h["com"]
    inertial(hip, h["mass"], [cx, s * cy, cz], mirrored(h["inertia"], s, 1, s))
    ET.SubElement(hip, "joint", {"name": f"{name}_hip", "class": f"hip_{end}"})
    half = [v / 2 for v in h["box"]]
    collide(hip, f"{name}_thigh", type="box", size=text(half), pos=text(0, 0, -h["length"] / 2))
    dress(hip, "hip", f, s)
    for joint in ("hip", "knee") if rotors else ():
        rx, ry, rz = rotors[joint]
        rotor(hip, f"{name}_{joint}_rotor", [rx, s * ry, rz])

    knee = ET.SubElement(hip, "body", name=f"{name}_knee", pos=text(0, 0, -h["length"]))
    side = s if k.get("mirrors") else 1
    cx, cy, cz = k["com"]
    inertial(knee, k["mass"], [cx, side * cy, cz], mirrored(k["inertia"], side, 1, side))
    ET.SubElement(knee, "joint", {"name": f"{name}_knee", "class": "knee"})
    tx, ty, tz = toe["position"]
    radius = k["shank"]["width"] / 2
    collide(knee, f"{name}_shank", type="capsule", size=text(radius), fromto=text(0, 0, 0, tx, ty, tz))
    if pad := k.get("rubber"):
        collide(knee, f"{name}_rubber", type="sphere", size=text(pad["radius"]), pos=text(pad["position"]))
    collide(knee, f"{name}_toe", type="sphere", size=text(toe["radius"]), pos=text(toe["position"]))
    dress(knee, "knee", f, s)
    ET.SubElement(knee, "site", {"name": f"{name}_toe", "class": "toe", "pos": text(toe["position"])})


def motor_class(top: ET.Element, name: str, place: int, axis: str, limit: list[float]) -> None:
    """Add the class of a joint and its motor; place is 0, 1 or 2 for abad, hip or knee."""
    motor, physics = ROBOT["motor"], ROBOT["physics"]
    number = {key: v[place] if isinstance(v, list) else v for key, v in motor.items()}
    constant = motor["voltage"] / number["speed_max"]
    slope = number["torque_max"] / (number["speed_max"] - number["speed_flat"])
    own = ET.SubElement(top, "default", {"class": name})
    ET.SubElement(
        own,
        "joint",
        axis=axis,
        range=text(limit),
        limited="true",
        armature=text(number["armature"]),
        damping=text(number["damping"]),
        frictionloss=text(number["friction"]),
        solreffriction=text(physics["solref_friction"]),
        solimpfriction=text(physics["solimp_friction"]),
    )
    ET.SubElement(
        own,
        "dcmotor",
        motorconst=text(constant),
        resistance=text(constant**2 / slope),
        input="pos",
        controller=text(number["kp"], 0, number["kd"], 0, 0, motor["voltage"]),
        saturation=text(number["torque_max"]),
        delay=text(motor["delay"]),
        nsample=text(round(motor["delay"] / physics["timestep"]) + 1),
    )


def defaults(root: ET.Element) -> None:
    contact = ROBOT["contact"]
    top = ET.SubElement(ET.SubElement(root, "default"), "default", {"class": ROBOT["name"]})
    motor_class(top, "abad", 0, "1 0 0", ROBOT["abad"]["range"])
    motor_class(top, "hip_front", 1, "0 1 0", ROBOT["hip"]["range_front"])
    motor_class(top, "hip_rear", 1, "0 1 0", ROBOT["hip"]["range_rear"])
    motor_class(top, "knee", 2, "0 1 0", ROBOT["knee"]["range"])
    collision = ET.SubElement(top, "default", {"class": "collision"})
    ET.SubElement(
        collision,
        "geom",
        group="3",
        contype="0",
        conaffinity="1",
        rgba="0.9 0.4 0.1 0.5",
        friction=text(contact["friction"]),
    )
    visual = ET.SubElement(top, "default", {"class": "visual"})
    ET.SubElement(visual, "geom", group="2", contype="0", conaffinity="0", mass="0")
    ET.SubElement(ET.SubElement(top, "default", {"class": "toe"}), "site", size=text(ROBOT["toe"]["radius"]), group="4")


def robot_xml() -> ET.Element:
    root = ET.Element("mujoco", model=ROBOT["name"])
    ET.SubElement(root, "compiler", angle="radian", autolimits="true", fusestatic="true")
    ET.SubElement(
        root,
        "option",
        timestep=text(ROBOT["physics"]["timestep"]),
        integrator="implicitfast",
        cone="elliptic",
        impratio="100",
    )
    defaults(root)
    assets = ET.SubElement(root, "asset")
    for name, attributes in LOOKS.MATERIALS.items():
        ET.SubElement(assets, "material", {"name": name, **attributes})

    world = ET.SubElement(root, "worldbody")
    body = ET.SubElement(
        world, "body", {"name": "base", "pos": text(0, 0, ROBOT["pose"]["four"]["z"]), "childclass": ROBOT["name"]}
    )
    ET.SubElement(body, "freejoint", name="base")
    inertial(body, ROBOT["body"]["mass"], ROBOT["body"]["com"], ROBOT["body"]["inertia"])
    collide(body, "body", type="box", size=text([v / 2 for v in ROBOT["body"]["box"]]))
    for index, head in enumerate(ROBOT["head"]):
        half = [v / 2 for v in head["size"]]
        collide(body, f"head_{index}", type="box", size=text(half), pos=text(head["position"]))
    dress(body, "body", 1, 1)
    ET.SubElement(body, "site", name="imu", pos=text(ROBOT["body"]["imu"]), size="0.005", group="4")
    for name in LEGS:
        leg(body, name)

    contacts = ET.SubElement(root, "contact")
    for one, other in SELF_CONTACTS:
        ET.SubElement(contacts, "pair", geom1=one, geom2=other, condim="3")

    actuators = ET.SubElement(root, "actuator")
    for name, (f, _) in LEGS.items():
        for joint, of in (("abad", "abad"), ("hip", "hip_front" if f > 0 else "hip_rear"), ("knee", "knee")):
            label = f"{name}_{joint}"
            ET.SubElement(actuators, "dcmotor", {"name": label, "joint": label, "class": of})

    frames = ET.SubElement(root, "keyframe")
    for name, pose in ROBOT["pose"].items():
        # base x rises by the angle whose sine is `up`: a turn about -y
        half = 0.5 * -asin(pose["up"])
        qpos = [0.0, 0.0, pose["z"], cos(half), 0.0, sin(half), 0.0, *pose["q"]]
        ET.SubElement(frames, "key", name=name, qpos=text(qpos), ctrl=text(pose["q"]))
    return root


def scene_xml() -> ET.Element:
    root = ET.Element("mujoco", model=f"{ROBOT['name']} on a floor")
    ET.SubElement(root, "include", file=ROBOT["model"]["file"])
    visual = ET.SubElement(root, "visual")
    ET.SubElement(visual, "headlight", diffuse="0.22 0.22 0.22", ambient="0.40 0.40 0.42", specular="0.1 0.1 0.1")
    ET.SubElement(visual, "rgba", haze="0.86 0.89 0.92 1")
    ET.SubElement(visual, "global", azimuth="150", elevation="-12", offwidth="1280", offheight="960")
    ET.SubElement(visual, "quality", shadowsize="4096", offsamples="4")
    ET.SubElement(visual, "map", znear="0.02", shadowclip="5")
    ET.SubElement(root, "statistic", center="0 0 0.3", extent="0.9")
    assets = ET.SubElement(root, "asset")
    ET.SubElement(
        assets,
        "texture",
        type="skybox",
        builtin="gradient",
        rgb1="0.93 0.95 0.97",
        rgb2="0.62 0.70 0.78",
        width="256",
        height="1536",
    )
    ET.SubElement(
        assets,
        "texture",
        name="floor",
        type="2d",
        builtin="checker",
        rgb1="0.80 0.82 0.84",
        rgb2="0.74 0.77 0.80",
        mark="edge",
        markrgb="0.68 0.71 0.75",
        width="512",
        height="512",
    )
    ET.SubElement(
        assets, "material", name="floor", texture="floor", texrepeat="2 2", texuniform="true", reflectance="0.08"
    )
    world = ET.SubElement(root, "worldbody")
    sun = {"type": "directional", "pos": "0 0 2"}
    ET.SubElement(
        world, "light", sun, dir="-0.40 0.28 -0.87", diffuse="0.50 0.49 0.46", specular="0.3 0.3 0.3", castshadow="true"
    )
    ET.SubElement(
        world, "light", sun, dir="0.5 -0.5 -0.7", diffuse="0.20 0.21 0.24", specular="0.1 0.1 0.1", castshadow="false"
    )
    ET.SubElement(
        world,
        "geom",
        name="floor",
        type="plane",
        size="0 0 0.05",
        material="floor",
        contype="1",
        conaffinity="0",
        priority="1",
        friction=text(ROBOT["contact"]["friction"]),
    )
    return root


def pretty(root: ET.Element, note: str) -> str:
    ET.indent(root)
    return f"<!-- {note} -->\n{ET.tostring(root, encoding='unicode')}\n"


def main() -> int:
    note = "Written by make_mjcf.py from robot.toml and appearance.py: change those, not this."
    if (HERE / "NOTICE").is_file():
        note += " Numbers of others are in it: see NOTICE."
    files = {HERE / ROBOT["model"]["file"]: robot_xml(), HERE / "scene.xml": scene_xml()}
    stale = 0
    for path, root in files.items():
        content = pretty(root, note)
        if "--check" in sys.argv:
            stale += not path.is_file() or path.read_text(encoding="utf-8") != content
        else:
            path.write_text(content, encoding="utf-8")
    return 1 if stale else 0


if __name__ == "__main__":
    raise SystemExit(main())

"""A robot as Pinocchio reads it: kinematics, inertias, and the distances between shapes."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import pinocchio as pin

from mimic.robot.description import RobotDescription
from mimic.robot.model import read_model


def rigid_body_model(description: RobotDescription) -> tuple[pin.Model, pin.GeometryModel]:
    """Return Pinocchio's model of a robot and its collision shapes.

    Joints are called as in JOINTS, after a free joint, and have the MJCF's armature, damping and dry friction; a frame
    of type OP_FRAME at each toe is called as in TOES.
    """
    spec = read_model(description)
    spec.compile()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "robot.xml"
        named = spec.to_xml().replace("<default>", '<default class="main">', 1)  # Pinocchio does not know its name
        path.write_text(named, encoding="utf-8")
        model = pin.buildModelFromMJCF(path)
        return model, pin.buildGeomFromMJCF(model, path, pin.GeometryType.COLLISION)

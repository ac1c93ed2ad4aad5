"""Formats of motion that are named but not read."""

from __future__ import annotations

NOT_READ = {
    **dict.fromkeys(
        (".fbx", ".glb", ".gltf", ".vrm", ".dae", ".blend"),
        "a 3-D scene, which is not read; export its motion as BVH, for example from Blender",
    ),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), "a USD scene, which is not read; export its motion as BVH"),
    **dict.fromkeys((".asf", ".amc"), "ASF/AMC motion capture, which is not read; convert it to BVH or C3D"),
    **dict.fromkeys(
        (".mot", ".sto"), "OpenSim joint angles or forces, which are not read; give the marker file (.trc)"
    ),
    **dict.fromkeys((".mvn", ".mvnx"), "an Xsens MVN recording, which is not read; export it as BVH or C3D"),
    ".vmd": "a MikuMikuDance motion, which is not read; export it as BVH",
    ".csv": "a table, which is not read; store its positions as NPZ",
    ".tsv": "a Qualisys table, which is not read; export it as C3D or TRC",
    ".json": "JSON, which is not read; store the key points as NPZ",
    ".npy": "a single array, which is not read; store it with its times by numpy.savez",
    ".mcap": "an MCAP log, which is not read; export the motion as NPZ",
    ".bag": "a ROS bag, which is not read; export the motion as NPZ",
}
"""Formats of motion that are not read, and what to do instead."""

"""Formats of motion that are named but not read."""

from __future__ import annotations

NOT_READ = {
    **dict.fromkeys(
        [".fbx", ".glb", ".gltf", ".vrm", ".dae", ".blend", ".usd", ".usda", ".usdc", ".usdz", ".vmd"], "BVH"
    ),
    **dict.fromkeys([".asf", ".amc", ".mvn", ".mvnx"], "BVH or C3D"),
    **dict.fromkeys([".mot", ".sto", ".tsv"], "C3D or TRC"),
    **dict.fromkeys([".csv", ".json", ".npy", ".mcap", ".bag"], "NPZ"),
}
"""Formats of motion that are not read, and which one to export instead."""

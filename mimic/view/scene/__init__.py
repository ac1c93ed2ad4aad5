"""The Rerun scene, recorded or live."""

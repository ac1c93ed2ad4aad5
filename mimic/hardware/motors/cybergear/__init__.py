"""Xiaomi CyberGear motors: bytes and messages."""

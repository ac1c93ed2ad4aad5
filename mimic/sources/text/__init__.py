"""Sentences and key frames."""

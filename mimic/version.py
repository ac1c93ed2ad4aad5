"""The version of mimic."""

__version__ = "0.1.0"

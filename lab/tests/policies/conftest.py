"""The fixtures of mimic's tests that those of policies need."""

from tests.conftest import constant_onnx, contract, description

__all__ = ["constant_onnx", "contract", "description"]

"""PyTorch and Warp code as captured CUDA graphs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
import warp as wp


def capture_mode() -> str:
    """Return how strictly PyTorch watches a capture of a graph.

    With several processes a thread of PyTorch's asks the device whether messages have arrived; that must not spoil it.
    """
    return "thread_local" if torch.distributed.is_initialized() else "global"


class Replayed:
    """A function of static tensors: run as written at first, then captured once and replayed; on a CPU always run."""

    def __init__(self, function: Callable[[], Any], device: str) -> None:
        self._function = function
        self._on_gpu = str(device).startswith("cuda")
        self._graph: torch.cuda.CUDAGraph | None = None
        self._warm = False
        self._result: Any = None

    def __call__(self) -> Any:
        """Return what the function returns; on a GPU the same tensors each time from the second call on."""
        if not self._on_gpu:
            return self._function()
        if self._graph is None:
            if not self._warm:  # a real call: libraries set themselves up, lazy state comes to life
                self._warm = True
                return self._on_the_side()
            graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(graph, capture_error_mode=capture_mode()):
                self._result = self._function()
            self._graph = graph
        self._graph.replay()
        return self._result

    def _on_the_side(self) -> Any:
        side = torch.cuda.Stream()
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            result = self._function()
        torch.cuda.current_stream().wait_stream(side)
        return result


class ReplayedWarp:
    """Warp launches on fixed arrays: captured at the first call on a GPU, on PyTorch's stream."""

    def __init__(self, function: Callable[[], None], device: str) -> None:
        self._function = function
        self._device = device
        self._graph: Any = None
        self._streams: dict[int, Any] = {}

    def __call__(self) -> None:
        """Run the function once."""
        if not str(self._device).startswith("cuda"):
            with wp.ScopedDevice(self._device):
                self._function()
            return
        if self._graph is None:
            self._graph = self._captured()
            return
        stream = torch.cuda.current_stream()
        if stream.cuda_stream not in self._streams:
            self._streams[stream.cuda_stream] = wp.stream_from_torch(stream)
        wp.capture_launch(self._graph, stream=self._streams[stream.cuda_stream])

    def _captured(self) -> Any:
        """Run the function once, and return its graph."""
        side = torch.cuda.Stream()  # PyTorch's default stream cannot be captured
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            stream = wp.stream_from_torch(side)
            with wp.ScopedStream(stream):
                self._function()  # compiles and loads every kernel before the capture
                with wp.ScopedCapture(stream=stream) as capture:
                    self._function()
        torch.cuda.current_stream().wait_stream(side)
        return capture.graph

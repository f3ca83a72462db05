"""Operations of torch that a GPU repeats as one CUDA graph, without the host's work for each of them."""

from __future__ import annotations

from collections.abc import Callable

import torch

# Runs in Python before the recording: libraries load, and optimisers make their state, at first use.
_WARM = 3


class RecordedFunction:
    """Function that is recorded as a CUDA graph on a GPU; on other devices each call runs it.

    The first calls run it in Python, the next one records it, and from then on the graph is launched. Every call does
    its work once. It works on tensors of the device without waiting for it, reads and writes the same memory each time,
    and draws random numbers only by generators that a graph may hold.

    Args:
        operations: function that is recorded.
        device: device of its tensors.
    """

    def __init__(self, operations: Callable[[], None], device: torch.device) -> None:
        self._operations, self._device = operations, device
        self._graph: torch.cuda.CUDAGraph | None = None
        self._calls = 0
        # The default stream cannot be recorded, and the warm runs must use the stream that is.
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None

    def __call__(self) -> None:
        if self._stream is None:
            self._operations()
            return
        if self._graph is None:
            self._calls += 1
            self._stream.wait_stream(torch.cuda.current_stream(self._device))
            if self._calls <= _WARM:
                with torch.cuda.stream(self._stream):
                    self._operations()
                torch.cuda.current_stream(self._device).wait_stream(self._stream)
                return
            graph = torch.cuda.CUDAGraph()
            # Other threads, such as a viewer's, may go on using the device meanwhile.
            with torch.cuda.graph(graph, stream=self._stream, capture_error_mode="thread_local"):
                self._operations()
            self._graph = graph
        self._graph.replay()

    def forget(self) -> None:
        """Drop the recording, whose communicators of several GPUs cannot be closed as long as it is there."""
        self._graph = None

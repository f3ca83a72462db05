"""Sequences of launches, recorded once and replayed as a graph, on a CPU and on a GPU alike.

Torch and Warp share the stream: work issued here runs after Torch's earlier work and before its later work, and the
host does not wait.
"""

# pyright: reportArgumentType=false

from __future__ import annotations

import contextlib
import gc
import sys
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
import warp as wp

# Seconds of compilation before a line is printed for the user.
_SILENT_FOR = 4.0


class Graphs:
    """The recordings of one engine, by key."""

    def __init__(self, device: torch.device, capture: bool) -> None:
        if device.type == "cuda" and device.index is None:
            device = torch.device("cuda", torch.cuda.current_device())
        self.device = wp.device_from_torch(device)
        """Warp's device of the recordings."""
        self._torch_device = device
        self._capture = capture
        # Kept by key and not by function: the launches of one key are closures that differ in each call.
        self._recorded: dict[Hashable, wp.Graph] = {}
        self._streams: dict[int, wp.Stream] = {}
        self._own = wp.Stream(self.device) if self.device.is_cuda else None
        if self._own is not None:
            self._streams[self._own.cuda_stream] = self._own
        self._pool: Any = None
        self._threads: ThreadPoolExecutor | None = None

    def run(self, key: Hashable, launches: Callable[[], None]) -> None:
        """Do what ``launches`` does: replayed if it was recorded under ``key`` before, and recorded now if not.

        In a stream that is being captured by the caller the launches become part of the caller's graph.
        """
        with self.stream() as stream:
            if not self._capture or (stream is not None and stream.is_capturing):
                launches()
                return
            if key not in self._recorded:
                with _announced(self.device):
                    self._recorded[key] = self._record(launches, stream)
            wp.capture_launch(self._recorded[key], stream=stream)

    def run_side_by_side(self, launches: Mapping[Hashable, Callable[[], None]]) -> None:
        """Run each as :meth:`run` does: on a CPU in threads of their own, for what one recording does not touch of
        another's."""
        if len(launches) == 1 or self._own is not None or not self._capture:
            for key, launch in launches.items():
                self.run(key, launch)
            return
        if missing := launches.keys() - self._recorded.keys():
            with wp.ScopedDevice(self.device), _announced(self.device):
                for key in missing:
                    self._recorded[key] = self._record(launches[key], None)
        # One thread less than launches: the caller's own takes the first.
        self._threads = self._threads or ThreadPoolExecutor(len(launches) - 1, "orbit-warp")
        first, *others = (self._recorded[key] for key in launches)
        running = [self._threads.submit(wp.capture_launch, other) for other in others]
        wp.capture_launch(first)
        for each in running:
            each.result()

    @property
    def recording(self) -> bool:
        """True if launches are being recorded into a graph."""
        if self._own is None:
            return False
        with self.stream() as stream:
            return stream is not None and stream.is_capturing

    def run_mixed(self, key: Hashable, operations: Callable[[], None]) -> None:
        """Run as :meth:`run` does, for a mixture of Torch's operations and Warp's launches on a GPU.

        Torch's temporary tensors come from the recording's pool, so that no other tensor is given their memory.
        """
        with self.stream() as stream:
            if key not in self._recorded:
                assert self._own is not None
                torch.cuda.synchronize(self._torch_device)
                self._pool = self._pool or torch.cuda.MemPool()
                own = torch.cuda.ExternalStream(self._own.cuda_stream, device=self._torch_device)
                with torch.cuda.stream(own), torch.cuda.use_mem_pool(self._pool):
                    self._recorded[key] = self._record(operations, stream)
            wp.capture_launch(self._recorded[key], stream=stream)

    def forget(self) -> None:
        """Drop all recordings: an array that they use was replaced."""
        self._recorded.clear()

    @contextlib.contextmanager
    def stream(self) -> Iterator[wp.Stream | None]:
        """Warp's launches go to Torch's current stream, which a GPU's caller may have set."""
        if not self.device.is_cuda:
            with wp.ScopedDevice(self.device):
                yield None
            return
        current = torch.cuda.current_stream(self._torch_device)
        if current.cuda_stream not in self._streams:
            self._streams[current.cuda_stream] = wp.stream_from_torch(current)
        stream = self._streams[current.cuda_stream]
        with wp.ScopedDevice(self.device), wp.ScopedStream(stream, sync_enter=False):
            yield stream

    def _record(self, launches: Callable[[], None], stream: wp.Stream | None) -> wp.Graph:
        if self._own is None:
            with wp.ScopedCapture(device=self.device) as capture:
                launches()
        else:  # the default stream cannot be captured
            self._own.wait_stream(stream)
            own = wp.ScopedStream(self._own, sync_enter=False)
            with _without_garbage_collection(), own, self._capturing(self._own) as capture:
                launches()
        assert capture.graph is not None
        return capture.graph

    @contextlib.contextmanager
    def _capturing(self, stream: wp.Stream) -> Iterator[wp.ScopedCapture]:
        """Capture a graph. Where that fails the driver drops it, and Warp must not drop one with a loop again."""
        capture, graph = wp.ScopedCapture(stream=stream), None
        try:
            with capture:
                graph = self.device.captures[stream]
                yield capture
        except BaseException:
            if graph is not None and capture.graph is None:
                graph.graph = None
            raise


@contextlib.contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Memory that another engine's remains would give back to the device cannot go while a stream is captured."""
    # Collected now, so that switching it off for the recording leaves little behind.
    gc.collect()
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@contextlib.contextmanager
def _announced(device: wp.Device) -> Iterator[None]:
    """Report when compilation takes long, and how long it took."""
    begun = time.perf_counter()
    what = f"orbit-warp: compiling kernels for {device}, kept in {wp.config.kernel_cache_dir} (about a minute, once)"
    timer = threading.Timer(_SILENT_FOR, lambda: print(what, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
    if (taken := time.perf_counter() - begun) > _SILENT_FOR:
        print(f"orbit-warp: compiled in {taken:.0f} s", file=sys.stderr, flush=True)

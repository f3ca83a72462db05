"""Faults of a step: numbers beyond the bounds of divergence, and buffers that were full.

A kernel notes it on the device. On a CPU the note is read after the step. On a GPU it travels to the host by itself and
is read when the next step begins, so that no step waits for it: an error comes one step late.
"""

# pyright: reportArgumentType=false

from __future__ import annotations

import warnings

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp import OverflowType

from orbit_core.interfaces import SimulationError, divergence_error, first_few
from orbit_warp.buffers import BufferSizes
from orbit_warp.config import WarpConfig
from orbit_warp.kernels import DIVERGED_BIT, note_faults, note_peaks

_CONTACTS = int(OverflowType.BROADPHASE | OverflowType.NARROWPHASE | OverflowType.CCD | OverflowType.HFIELD)
_ROWS = int(OverflowType.NEFC | OverflowType.NJMAX_NNZ)


class Faults:
    """Notes and reports the faults of each step."""

    def __init__(self, data: mjw.Data, sizes: BufferSizes, config: WarpConfig) -> None:
        self._data, self._sizes = data, sizes
        self._raise_overflows = config.overflow == "error"
        self._on_gpu = data.qpos.device.is_cuda
        with wp.ScopedDevice(data.qpos.device):
            self._faults = wp.zeros(data.nworld, dtype=int)
            self._summary = wp.zeros(1, dtype=int)
            self._peaks = wp.zeros(2, dtype=int)
        # Pinned memory, to which the device copies while the host goes on.
        self._seen = wp.zeros(1, dtype=int, device="cpu", pinned=True) if self._on_gpu else self._summary
        self._note = self._seen.numpy()
        self.overflows = 0
        """Steps in which a buffer was full; on a GPU the last step's is counted when the next begins."""
        self._warned = False
        self.raises_divergence = True
        """Whether environments that diverged are an error; else their caller looks for them."""

    def begin(self) -> None:
        """Forget the last step's."""
        self._summary.zero_()

    def note(self) -> None:
        """Collect the step's faults; nothing waits."""
        data = self._data
        wp.launch(
            note_faults,
            dim=data.nworld,
            inputs=[data.qpos, data.qvel, _CONTACTS | _ROWS],
            outputs=[data.overflow, self._faults, self._summary],
        )
        wp.launch(note_peaks, dim=data.nworld, inputs=[data.nefc, data.nacon, data.ncollision], outputs=[self._peaks])
        if self._on_gpu:
            wp.copy(self._seen, self._summary)

    @property
    def peaks(self) -> BufferSizes:
        """The most that any step so far needed; waits for the device."""
        contacts, rows = wp.to_torch(self._peaks).tolist()
        return BufferSizes(-(-contacts // self._data.nworld), rows)

    def report(self) -> None:
        """Raise or count what was noted, once.

        Raises:
            SimulationError: environments diverged, or a buffer was full and the settings make that an error.
        """
        fault = int(self._note[0])
        if not fault:
            return
        self._note[:] = 0
        # This waits for the device, but only where something went wrong.
        faults = wp.to_torch(self._faults).cpu().numpy()
        if not self.raises_divergence:
            fault, faults = fault & ~DIVERGED_BIT, faults & ~DIVERGED_BIT
        if not fault:
            return
        if fault & DIVERGED_BIT:
            raise divergence_error(np.flatnonzero(faults & DIVERGED_BIT).tolist())
        self.overflows += 1
        message = self._overflow_message(fault, np.flatnonzero(faults))
        if self._raise_overflows:
            raise SimulationError(message)
        if not self._warned:
            self._warned = True
            warnings.warn(f"{message}; this is said once, and counted", RuntimeWarning, stacklevel=3)

    def _overflow_message(self, fault: int, environments: np.ndarray) -> str:
        if fault & _CONTACTS:
            size = self._sizes.nconmax
            what, setting = f"{size} contacts per environment are too few: some were lost", f"nconmax={2 * size}"
        else:
            size = self._sizes.njmax
            what, setting = f"{size} constraint rows are too few: some were lost", f"njmax={2 * size}"
        return f"{what} in environments {first_few(environments)}; use WarpConfig({setting}), or settings {setting}"

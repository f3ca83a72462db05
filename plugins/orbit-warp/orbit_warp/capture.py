"""A caller's step, engine and tensors together, as one graph on a GPU."""

from __future__ import annotations

import warnings
from collections.abc import Callable

from orbit_core.interfaces import CaptureFacet
from orbit_warp.state import State
from orbit_warpkit.graphs import Graphs


class WarpCapture(CaptureFacet):
    """Records a caller's step with the engine's own launches.

    Args:
        graphs: the engine's recordings.
        state: the engine's.
        prepare: what the engine must do on the host before a step.
        enabled: whether the user wants recordings.
    """

    takes_masks = frozenset({"reset", "write_joint_state", "write_root_state", "cast_rays_past"})

    def __init__(self, graphs: Graphs, state: State, prepare: Callable[[], None], enabled: bool) -> None:
        self._graphs, self._state, self._prepare_step, self._enabled = graphs, state, prepare, enabled

    def record(self, operations: Callable[[], None]) -> Callable[[], None]:
        if not self._graphs.device.is_cuda or not self._enabled:
            return operations
        return _Recording(self._graphs, operations, self._prepare, self._state.mark_stepped)

    def _prepare(self) -> None:
        self._prepare_step()
        self._state.refresh()  # so that a recording need not
        self._state.mark_stepped()  # and so that it derives bodies itself, even if they were derived meanwhile


class _Recording:
    """Runs ``operations`` the first time, records them the second, and replays them from then on.

    Where recording fails it says why, once, and runs them each time.

    Args:
        graphs: the engine's recordings, which are dropped when its arrays are replaced.
        operations: on tensors and on the engine, without waiting.
        before: what must be done on the host before each run.
        after: what must be known on the host after each run.
    """

    def __init__(
        self, graphs: Graphs, operations: Callable[[], None], before: Callable[[], None], after: Callable[[], None]
    ) -> None:
        self._graphs, self._operations, self._before, self._after = graphs, operations, before, after
        # The first run loads modules and libraries, which a recording must not contain.
        self._warm = self._failed = False

    def __call__(self) -> None:
        self._before()
        if self._failed or not self._warm:
            self._operations()  # the first run loads what libraries load on first use
            self._warm = True
        else:
            self._replay()
        self._after()

    def _replay(self) -> None:
        try:
            self._graphs.run_mixed(self, self._operations)
        except Exception as error:  # Torch, Warp or the driver cannot record it
            self._failed = True
            warnings.warn(
                f"the step is not recorded as one graph, for {type(error).__name__}: {error}; its operations are "
                "issued one by one, and the engine's own part stays a graph",
                RuntimeWarning,
                stacklevel=4,
            )
            self._operations()

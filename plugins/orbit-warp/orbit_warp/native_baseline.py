"""MuJoCo-Warp's captured stepping without ORBIT: the model and the controls of an engine, and nothing read back.

The yardstick of the overhead benchmarks.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false

from __future__ import annotations

import mujoco_warp as mjw
import warp as wp
from torch import Tensor

from orbit_warp.engine import WarpEngine
from orbit_warp.field_contacts import plain_model
from orbit_warpkit.graphs import Graphs

Command = Tensor
"""(num_envs, actuators) what MuJoCo's position actuators are told."""
_STATE = ("qpos", "qvel", "qacc_warmstart", "mocap_pos", "mocap_quat", "xfrc_applied")


class RawStepper:
    """Separate data of an engine's model, in buffers of the same sizes."""

    def __init__(self, engine: WarpEngine) -> None:
        native, sizes = engine.native, engine.buffer_sizes
        self._model, self._source = plain_model(native.model), native.data
        self._graphs = Graphs(engine.device, capture=True)
        with self._graphs.stream():
            self._data = mjw.make_data(
                native.host_model, nworld=engine.num_envs, nconmax=sizes.nconmax, njmax=sizes.njmax
            )
        self._ctrl = wp.to_torch(self._data.ctrl)

    def synchronize(self) -> None:
        """Take over the engine's present state."""
        with self._graphs.stream():
            for name in _STATE:
                if getattr(self._source, name).size:
                    wp.copy(getattr(self._data, name), getattr(self._source, name))

    def command(self) -> Command:
        """The present commands of the engine's actuators."""
        return wp.to_torch(self._source.ctrl).clone()

    def step(self, command: Command, steps: int) -> None:
        """Write a command, then advance by physics steps."""
        self._ctrl.copy_(command)
        self._graphs.run(steps, lambda: self._take(steps))

    def _take(self, steps: int) -> None:
        for _ in range(steps):
            mjw.step(self._model, self._data)


def raw_steppers(engine: WarpEngine) -> dict[str, RawStepper]:
    """The one way of stepping, by name."""
    return {"captured graph": RawStepper(engine)}

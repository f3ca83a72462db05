"""Positions and velocities, read and written.

Writes go to joint coordinates, from which Newton derives the poses of the environments written when they are next
needed. After a step of a solver that moves bodies, joint coordinates are derived from the bodies.
"""

# pyright: reportMissingImports=false
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# pyright: reportOptionalSubscript=false
# Newton's arrays are optional to Python, for a model may lack what they hold.

from __future__ import annotations

import newton
import numpy as np
import torch
import warp as wp
from torch import Tensor

from orbit_core.plugin_kit.rows import Rows, block
from orbit_core.scene import Joint, JointType
from orbit_newton.kernels import (
    mark_articulations,
    read_links,
    reset_state,
    shift_joints,
    unwrap_joints,
    write_root,
)
from orbit_newton.plant import Plant
from orbit_warpkit.arrays import array_of
from orbit_warpkit.graphs import Graphs
from orbit_warpkit.kernels import read_joints


class State:
    """The state of all environments."""

    def __init__(self, plant: Plant, graphs: Graphs, maximal: bool) -> None:
        self._plant, self._graphs, self._maximal = plant, graphs, maximal
        built, state, envs = plant.built, plant.state, plant.num_envs
        device = plant.efforts.device
        self._joint_q, self._joint_qd = plant.rows(state.joint_q), plant.rows(state.joint_qd)
        self._q, self._qd = wp.to_torch(self._joint_q), wp.to_torch(self._joint_qd)
        self._position_columns = torch.as_tensor(built.positions, device=device)
        self._velocity_columns = torch.as_tensor(built.velocities, device=device)
        self._zeros = torch.as_tensor(built.zeros, dtype=torch.float32, device=device)
        self._joint_positions = torch.zeros(envs, len(plant.layout.joints), device=device)
        self._joint_velocities = torch.zeros_like(self._joint_positions)
        self._link_poses = torch.zeros(envs, len(plant.layout.links), 7, device=device)
        self._link_velocities = torch.zeros(envs, len(plant.layout.links), 6, device=device)
        # All environments count as written at first, so that their poses are derived before the first read.
        self._written = torch.ones(envs, dtype=torch.bool, device=device)
        with wp.ScopedDevice(plant.model.device):
            self._columns = [wp.array(columns, dtype=int) for columns in (built.positions, built.velocities)]
            self._articulations = wp.zeros(plant.model.articulation_count, dtype=bool)
            turns = np.zeros(self._q.shape[1], dtype=bool)
            turns[[p for p, joint in zip(built.positions, plant.layout.joints, strict=True) if _turns(joint)]] = True
            self._turning = wp.array(turns, dtype=bool)
            # Inverse kinematics writes here and not to the coordinates, which still hold the whole turns of the last
            # step.
            self._derived_q = wp.zeros_like(state.joint_q)
            self._no_rows = wp.zeros((1, 7), dtype=float)
            home = wp.to_torch(plant.model.joint_q).view(envs, -1)[0].clone()
            home[self._position_columns] = plant.position_targets[0] - self._zeros
            self._home_q = wp.clone(wp.from_torch(home))
            joints = plant.model.joint_count // envs
            # A fixed base is placed by its joint's frame in the world, so that a reset must bring these frames back as
            # well.
            self._home_frames = wp.clone(plant.model.joint_X_p[:joints])
        self._applied = wp.from_torch(plant.applied, dtype=wp.spatial_vector)
        self._current = False

    # Time ------------------------------------------------------------------------------------------------------------

    def settle(self) -> None:
        """Derive what writes left behind."""
        if not self._current:
            self._graphs.run("derive", self._derive)
            self._written.zero_()
            self._current = True

    def reread(self) -> None:
        """Give what a snapshot brought back."""
        self._graphs.run("read", self.read)

    def take(self) -> None:
        """Launch what brings the state up to date after a physics step of a solver that moves bodies."""
        if not self._maximal:
            return
        state = self._plant.state
        newton.eval_ik(self._plant.model, state, self._derived_q, state.joint_qd)
        wp.launch(
            unwrap_joints,
            dim=self._joint_q.shape,
            inputs=[self._turning, self._plant.rows(self._derived_q)],
            outputs=[self._joint_q],
        )

    def read(self) -> None:
        """Launch what gives the contract's tensors."""
        plant = self._plant
        if plant.layout.joints:
            wp.launch(
                read_joints,
                dim=self._joint_positions.shape,
                inputs=[*self._columns, self._joint_q, self._joint_qd],
                outputs=[wp.from_torch(self._joint_positions), wp.from_torch(self._joint_velocities)],
            )
            wp.launch(
                shift_joints,
                dim=self._joint_positions.shape,
                inputs=[wp.from_torch(self._zeros)],
                outputs=[wp.from_torch(self._joint_positions)],
            )
        wp.launch(
            read_links,
            dim=self._link_poses.shape[:2],
            inputs=[plant.state.body_q, plant.state.body_qd, plant.model.body_com],
            outputs=[wp.from_torch(self._link_poses), wp.from_torch(self._link_velocities)],
        )

    def _derive(self) -> None:
        plant = self._plant
        wp.launch(
            mark_articulations,
            dim=len(self._articulations),
            inputs=[wp.from_torch(self._written)],
            outputs=[self._articulations],
        )
        state = plant.state
        # Masked, because in a solver that moves bodies the poses of others hold more than their joint coordinates do.
        newton.eval_fk(plant.model, state.joint_q, state.joint_qd, state, mask=self._articulations)
        self.read()

    # Reading ---------------------------------------------------------------------------------------------------------

    @property
    def joint_positions(self) -> Tensor:
        self.settle()
        return self._joint_positions

    @property
    def joint_velocities(self) -> Tensor:
        self.settle()
        return self._joint_velocities

    @property
    def link_poses(self) -> Tensor:
        self.settle()
        return self._link_poses

    @property
    def link_velocities(self) -> Tensor:
        self.settle()
        return self._link_velocities

    # Writing ---------------------------------------------------------------------------------------------------------

    def mark_written(self, rows: Rows) -> None:
        """Invalidate derived quantities of these environments."""
        self._written[rows] = True
        self._current = False

    def write_joints(self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, rows: Rows) -> None:
        if positions is not None:
            self._q[block(rows, self._position_columns[joints])] = positions - self._zeros[joints]
        if velocities is not None:
            self._qd[block(rows, self._velocity_columns[joints])] = velocities
        self.mark_written(rows)

    def write_root(self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor) -> None:
        plant, built = self._plant, self._plant.built
        links, joints = len(plant.layout.links), plant.model.joint_count // plant.num_envs
        places = (
            built.root_joints[entity],
            built.root_positions[entity],
            built.root_velocities[entity],
        )
        with self._graphs.stream():
            wp.launch(
                write_root,
                dim=len(env_ids),
                inputs=[
                    wp.from_torch(env_ids.contiguous()), links, plant.layout.entities[entity].root_link, joints,
                    *map(int, places), pose is not None, velocity is not None, array_of(pose, self._no_rows),
                    array_of(velocity, self._no_rows), plant.model.body_com,
                ],
                outputs=[self._joint_q, self._joint_qd, plant.model.joint_X_p],
            )  # fmt: skip
        self.mark_written(env_ids)

    def reset(self, env_ids: Tensor) -> None:
        """Home positions, no velocities, no wrenches."""
        with self._graphs.stream():
            wp.launch(
                reset_state,
                dim=len(env_ids),
                inputs=[wp.from_torch(env_ids.contiguous()), self._home_q, self._home_frames],
                outputs=[self._joint_q, self._joint_qd, self._plant.rows(self._plant.model.joint_X_p), self._applied],
            )
        self.mark_written(env_ids)

    @property
    def saved(self) -> tuple[Tensor, ...]:
        """The arrays on which the continuation depends."""
        state = self._plant.state
        flat = (state.joint_q, state.joint_qd, state.body_q, state.body_qd, self._plant.model.joint_X_p)
        return (*(wp.to_torch(array) for array in flat if array.size), self._plant.applied)


def _turns(joint: Joint) -> bool:
    return joint.type is not JointType.PRISMATIC

"""Actuation of joints of a client's environments: drives, damping and armature through wheels, and torques."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_bullet.buffers import Buffers
from orbit_bullet.drives import Wheels, write_wheels
from orbit_bullet.stage import Stage
from orbit_core.plugin_kit.bodies import on_leaders, soft_springs

FloatArray = npt.NDArray[np.float64]


class Actuation:
    """Gains per environment (K, J), and the wheels that realise them."""

    def __init__(self, stage: Stage, buffers: Buffers) -> None:
        self._stage = stage
        self._buffers = buffers
        layout, parameters = stage.layout, stage.layout.joint_parameters
        self._dt = layout.scene.physics_dt
        shape = (stage.count, len(layout.joints))
        own = np.array([joint.mimic is None for joint in layout.joints], dtype=bool)
        self._own = own
        self.stiffness = np.tile(np.where(own, parameters.drive_stiffness, 0.0), (stage.count, 1)).reshape(shape)
        """(K, J) gains of the drives that wheels realise, N m/rad or N/m."""
        self.damping = np.tile(np.where(own, parameters.drive_damping, 0.0), (stage.count, 1)).reshape(shape)
        """(K, J) N m s/rad or N s/m."""
        self._limit = parameters.effort_limit
        # Light links of fingers, each between its gear and its wheel, would be solved slowly, and the fingers
        # be bent by what they hold: leaders bear it all.
        self._armature = on_leaders(layout, parameters.armature)
        # What leaders (J,) bear of their followers' armature; a follower's own, negative.
        self._carried_over = self._armature - parameters.armature
        soft = soft_springs(layout, self._dt)
        # Stiffness (J,) of springs that are torques, taken at the beginning of each step.
        self._pulling = np.where(soft, parameters.spring_stiffness, 0.0)
        # Stiffness (J,) of those too stiff for that, which the second wheel takes at the end of the step.
        self._sprung = np.where(soft, 0.0, parameters.spring_stiffness)
        self._rest = parameters.spring_rest
        damping = on_leaders(layout, parameters.damping)
        # Inertia of the second wheel of each joint (J,).
        self._slow = self._armature + self._dt * (damping + self._dt * self._sprung)
        # Dividing at each step would cost a call more in every world.
        self._share = np.divide(1.0, self._slow, out=np.zeros_like(self._slow), where=self._slow > 0)
        self._any_sprung = bool(self._sprung.any())
        # Joints whose two wheels are one.
        self._shared = ~np.isfinite(self._limit)
        self._driven = (parameters.drive_stiffness + parameters.drive_damping > 0) & own
        self._drives: dict[tuple[int, int], Wheels] = {}
        self._passive: dict[tuple[int, int], Wheels] = {}
        self.generation = 0
        """The number of times that the drives' wheels were built."""
        self._build_passive()
        self._build_drives()

    # Building --------------------------------------------------------------------------------------------------------

    def _wheels(self, slot: int, entity: int, columns: list[int]) -> Wheels:
        start = self._stage.layout.entities[entity].joints.start
        # A file of this worker's own: another's could be read when half of it is written.
        file = self._stage.files.folder / f"wheels{len(columns)}_{os.getpid()}.urdf"
        if not file.exists():
            write_wheels(file, len(columns))
        body, numbers = self._stage.bodies[slot][entity], self._stage.joints[entity]
        return Wheels(self._stage.client, file, [(body, numbers[column - start]) for column in columns])

    def _build_passive(self) -> None:
        # A drive without a limit takes damping and armature into its one wheel, because each wheel costs the solver a
        # row.
        alone = (self._slow > 0) & ~(self._shared & self._driven)
        self._passive_columns = self._columns(alone)
        for slot in range(self._stage.count):
            for entity, columns in self._passive_columns.items():
                wheels = self._passive[slot, entity] = self._wheels(slot, entity, columns)
                wheels.set(self._slow[columns], np.full(len(columns), np.inf))

    def _build_drives(self) -> None:
        self.generation += 1
        for wheels in self._drives.values():
            self._stage.client.removeBody(wheels.body)
        self._drive_columns = self._columns(self._driven)
        for slot in range(self._stage.count):
            for entity, columns in self._drive_columns.items():
                self._drives[slot, entity] = self._wheels(slot, entity, columns)
        self._joined = self._shared & self._driven & ~self._in(self._passive_columns)
        self._derive(range(self._stage.count))

    def _columns(self, chosen: npt.NDArray[np.bool_]) -> dict[int, list[int]]:
        """The chosen joints of each entity that has any."""
        found = {}
        for entity in self._stage.layout.entities:
            columns = [column for column in range(entity.joints.start, entity.joints.stop) if chosen[column]]
            if columns:
                found[entity.index] = columns
        return found

    def _in(self, columns: dict[int, list[int]]) -> npt.NDArray[np.bool_]:
        mask = np.zeros(len(self._own), dtype=bool)
        for numbers in columns.values():
            mask[numbers] = True
        return mask

    def _derive(self, slots: range | npt.NDArray[np.int64]) -> None:
        """Recompute everything that depends on the gains."""
        dt = self._dt
        drive = dt * (self.stiffness * dt + self.damping)
        self._inertia = np.where(self._driven, drive + np.where(self._joined, self._slow, 0.0), 0.0)
        # Joints whose effort is a torque.
        self._plain = (drive == 0) & ~(self._joined & (self._inertia > 0))
        self._inverse = np.divide(1.0, self._inertia, out=np.zeros_like(drive), where=self._inertia > 0)
        self._carried = np.where(self._joined, self._armature, 0.0)
        for slot in slots:
            for entity, columns in self._drive_columns.items():
                self._drives[slot, entity].set(self._inertia[slot, columns], self._limit[columns])

    def set_gains(self, slots: npt.NDArray[np.int64], joints: npt.NDArray[np.int64], k: Any, d: Any) -> None:
        """Set gains (n, k) of joints (k,); a mimic joint has no drive."""
        own = self._own[joints]
        joints = joints[own]
        self.stiffness[np.ix_(slots, joints)] = k[:, own]
        self.damping[np.ix_(slots, joints)] = d[:, own]
        # Wheels exist only for joints that were driven when the world was built; the first gains of another build all
        # of them again.
        undriven = joints[~self._driven[joints]]
        if len(undriven):
            self._driven[undriven] = True
            self._build_drives()
        else:
            self._derive(slots)

    def armatures(self) -> FloatArray:
        """Armature (J,) of each joint of the first environment: the inertia of its wheels beyond gains and damping."""
        turning = np.zeros(len(self._own))
        for columns, wheels in ((self._drive_columns, self._drives), (self._passive_columns, self._passive)):
            for entity, numbers in columns.items():
                turning[numbers] += wheels[0, entity].inertias()
        drive = np.where(self._driven, self._dt * (self.stiffness[0] * self._dt + self.damping[0]), 0.0)
        return turning - drive - (self._slow - self._armature) - self._carried_over

    # Stepping --------------------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Before the steps of a command."""
        buffers = self._buffers
        self._given = buffers.efforts + self.damping * buffers.velocity_targets
        # Where a wheel bounds the effort by its gear's force, clipping here would bound it twice.
        torques = np.where(self._plain, np.clip(buffers.efforts, -self._limit, self._limit), 0.0)
        self._torques = torques if torques.any() or self._pulling.any() else None

    def apply(self, positions: FloatArray, velocities: FloatArray) -> None:
        """Before each step, given the joints' state (K, J)."""
        stage = self._stage
        self._push = self._given + self.stiffness * (self._buffers.position_targets - positions)
        drawn = self._dt * self._sprung * (self._rest - positions) if self._any_sprung else 0.0
        if self._drive_columns:
            carried = self._carried * velocities
            if self._any_sprung:
                carried += np.where(self._joined, drawn, 0.0)
            # Lists of Python numbers, which Bullet reads without converting each.
            speeds = ((self._dt * self._push + carried) * self._inverse).tolist()
            for (slot, entity), wheels in self._drives.items():
                row = speeds[slot]
                wheels.spin([row[column] for column in self._drive_columns[entity]])
        if self._passive_columns:
            speeds = (self._share * (self._armature * velocities + drawn)).tolist()
            for (slot, entity), wheels in self._passive.items():
                row = speeds[slot]
                wheels.spin([row[column] for column in self._passive_columns[entity]])
        if self._torques is not None:
            client = stage.client
            given = (self._torques + self._pulling * (self._rest - positions)).tolist()
            for entity in stage.layout.entities:
                joints = stage.joints[entity.index]
                for slot, row in enumerate(given):
                    torques = row[entity.joints]
                    if any(torques):
                        body = stage.bodies[slot][entity.index]
                        client.setJointMotorControlArray(body, joints, client.TORQUE_CONTROL, forces=torques)

    def efforts(self, velocities: FloatArray) -> FloatArray:
        """Efforts (K, J) of the drives in the last step, with the velocities at its end."""
        efforts = self._push - (self.stiffness * self._dt + self.damping) * velocities
        return np.clip(efforts, -self._limit, self._limit)

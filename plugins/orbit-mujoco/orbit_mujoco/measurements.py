"""Sensors in the model that measure contact forces, and how to read them and those of joint wrenches."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from mujoco.batch import Batch

from orbit_core.interfaces import TERRAIN, ContactQuery, SceneLayout
from orbit_core.plugin_kit.rotations import cross
from orbit_core.scene import Rope
from orbit_mjmodel.addresses import Addresses, body_name, columns
from orbit_mjmodel.drives import adds_damping, implicit_bounds, spring_lead
from orbit_mjmodel.matter import MatterAddresses, matter_name
from orbit_mjmodel.wrenches import CompositeInertias, held_up_beyond
from orbit_mujoco.parameters import Parameters

# Data (bit 1: force), reduction (3: net force, world axes), slots.
_NET_FORCE = (2, 3, 1)
_Target = tuple[mujoco.mjtObj, str]


def add_contact_sensors(spec: mujoco.MjSpec, layout: SceneLayout) -> None:
    """One sensor per query and thing that the query filters by, in order; each gives the force that the link exerts."""
    for number, query in enumerate(layout.contact_queries):
        for part, target in enumerate(_targets(query, layout)):
            sensor = spec.add_sensor(
                name=f"contact{number}.{part}",
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=mujoco.mjtObj.mjOBJ_BODY,
                objname=body_name(query.link),
            )
            sensor.intprm[:3] = _NET_FORCE
            if target:
                sensor.reftype, sensor.refname = target


def add_matter_sensors(spec: mujoco.MjSpec, layout: SceneLayout) -> None:
    """Sensors of :class:`MatterMeter`: of each deformable and link in contact, and of each piece of rope."""
    for index, thing in enumerate(layout.scene.deformables):
        for link in _touchable(layout):
            _add_net_force(spec, f"matter{index}.{link}", body_name(link), matter_name(index))
        for piece in range(len(thing.rest_positions) - 1 if isinstance(thing, Rope) else 0):
            name = matter_name(index) + (f"_{piece}" if piece else "")
            _add_net_force(spec, f"piece{index}.{piece}", name)
    if layout.scene.deformables:  # forces on bodies are computed where a sensor wants them
        spec.body(matter_name(0)).add_site(name="matter")
        spec.add_sensor(
            name="matter", type=mujoco.mjtSensor.mjSENS_FORCE, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="matter"
        )


def _touchable(layout: SceneLayout) -> list[int]:
    return [number for number, link in enumerate(layout.links) if link.collisions]


def _add_net_force(spec: mujoco.MjSpec, name: str, body: str, subtree: str | None = None) -> None:
    sensor = spec.add_sensor(
        name=name, type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=mujoco.mjtObj.mjOBJ_BODY, objname=body
    )
    sensor.intprm[:3] = _NET_FORCE
    if subtree is not None:
        sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_XBODY, subtree


def contact_sensor_starts(layout: SceneLayout) -> npt.NDArray[np.int64]:
    """(K + 1,) number of the first sensor of each query, then the number of all."""
    return np.cumsum([0, *(len(_targets(query, layout)) for query in layout.contact_queries)])


def _targets(query: ContactQuery, layout: SceneLayout) -> list[_Target | None]:
    """Targets of a filter: nothing, the world, whole entities (subtrees) if all their links are asked, or links."""
    if query.others is None:
        return [None]
    targets: list[_Target | None] = []
    rest = set(query.others)
    if TERRAIN in rest:
        rest.remove(TERRAIN)
        targets.append((mujoco.mjtObj.mjOBJ_BODY, "world"))
    for entity in layout.entities:
        links = set(range(entity.links.start, entity.links.stop))
        if links <= rest:
            rest -= links
            targets.append((mujoco.mjtObj.mjOBJ_XBODY, body_name(entity.root_link)))
    targets += [(mujoco.mjtObj.mjOBJ_BODY, body_name(link)) for link in sorted(rest)]
    return targets


class ContactMeter:
    """Averages the contact sensors over the physics steps of a control step."""

    def __init__(self, layout: SceneLayout, sensordata: npt.NDArray[np.float64]) -> None:
        starts = contact_sensor_starts(layout)
        self.queries, sensors = len(layout.contact_queries), int(starts[-1])
        """Number of contact queries."""
        self._starts = starts[:-1]
        self._sensordata = sensordata[:, : 3 * sensors]
        self._sum = np.zeros((len(sensordata), sensors, 3))
        self._flat_sum = self._sum.reshape(len(sensordata), 3 * sensors)
        self.forces = torch.zeros(len(sensordata), self.queries, 3)
        """(N, K, 3) newtons on each query's link."""
        self._forces = self.forces.numpy()

    def take(self, first: bool) -> None:
        """Take one physics step's forces in; the first of a control step begins the sum."""
        if first:
            np.copyto(self._flat_sum, self._sensordata)
        else:
            np.add(self._flat_sum, self._sensordata, out=self._flat_sum)

    def average(self, steps: int) -> None:
        """End a control step; the sensors give what the link exerts, and the opposite is asked."""
        total = self._sum if len(self._starts) == self._sum.shape[1] else np.add.reduceat(self._sum, self._starts, 1)
        np.multiply(total, -1.0 / steps, out=self._forces, casting="same_kind")


class EffortMeter:
    """Efforts that drives and commands applied in the last physics step, computed when they are first read.

    MuJoCo reports a drive's force at the beginning of a step. An implicit integrator applies the drive's law at the
    velocity that the step ends with, but for drives at their limit, whose force stays as it was. A position at the
    beginning of a step is the one at its end less ``h v``, for the engine integrates it so.
    """

    def __init__(self, batch: Batch, addresses: Addresses, parameters: Parameters) -> None:
        model, self._parameters = batch.model, parameters
        self._force, self._ctrl = batch.bind("actuator_force"), batch.bind("ctrl")
        self._qpos, self._qvel = batch.bind("qpos"), batch.bind("qvel")
        self._position_columns = columns(addresses.joint_positions)
        self._velocity_columns = columns(addresses.joint_velocities)
        self._lead = spring_lead(model)
        self._bounds = implicit_bounds(model)
        self._due = False
        self.efforts = torch.zeros(self._force.shape)
        """(N, J); current after :meth:`settle`."""
        self._own = self.efforts.numpy()

    def mark_stepped(self) -> None:
        """After a step: the efforts are out of date."""
        self._due = True

    def settle(self) -> None:
        """Compute the last step's efforts, before positions, velocities or gains are written, or when they are read."""
        if not self._due:
            return
        self._due = False
        stiffness = self._parameters.stiffness
        held = stiffness * self._qpos[:, self._position_columns]
        held += (self._parameters.damping - self._lead * stiffness) * self._qvel[:, self._velocity_columns]
        law = np.subtract(self._ctrl, held, out=held)
        linear = np.abs(self._force) < self._bounds
        np.copyto(self._own, np.where(linear, law, self._force), casting="same_kind")


class WrenchMeter:
    """Holds the joint wrenches of the last physics step, without the weight of bodies that are held up.

    MuJoCo measures them with accelerations to which an implicit integrator has not yet added the damping of drives and
    joints. The change of velocity over the step has it.
    """

    def __init__(self, layout: SceneLayout, batch: Batch, addresses: Addresses, parameters: Parameters) -> None:
        self.links = links = len(layout.wrench_links)
        """Number of links whose joint wrenches are measured."""
        sensordata = batch.bind("sensordata")
        self._sensordata = sensordata[:, sensordata.shape[1] - 6 * links :]
        self._parameters = parameters
        self._bodies = addresses.bodies[list(layout.wrench_links)]
        self._beyond = held_up_beyond(batch.model, self._bodies)
        self._bears = bool(self._beyond.any())
        self.needs_rates = bool(links) and adds_damping(batch.model)
        """Whether :meth:`begin` must be called before the last physics step."""
        if self._bears:
            self._centers, self._origins, self._axes = (batch.bind(name) for name in ("xipos", "xpos", "xmat"))
        if self.needs_rates:
            self._composite = CompositeInertias(batch.model, self._bodies)
            self._step, self._qacc = batch.model.opt.timestep, batch.bind("qacc")
            self._live = [batch.bind(name) for name in ("qvel", "crb", "cdof", "subtree_com", "xpos", "xmat")]
            self._before = [values.copy() for values in self._live]
        self.wrenches = torch.zeros(len(sensordata), links, 6)
        """(N, W, 6) force and torque from the parent, in the link's axes."""
        self._flat = self.wrenches.numpy().reshape(len(sensordata), 6 * links)

    def begin(self) -> None:
        """Keep the state that the last physics step begins with."""
        for kept, values in zip(self._before, self._live, strict=True):
            np.copyto(kept, values)

    def read(self) -> None:
        """Take the last physics step's wrenches."""
        np.copyto(self._flat, self._sensordata, casting="same_kind")
        if self._bears:
            self._take_off_weights()
        if self.needs_rates:
            self._add_damping()

    def _add_damping(self) -> None:
        """Add the part of the accelerations that the integrator found."""
        velocities, inertias, motions, centers, origins, axes = self._before
        rates = (self._live[0] - velocities) / self._step - self._qacc
        spatial = self._composite.wrenches(inertias, motions, rates)
        force = spatial[..., 3:]
        arms = origins[:, self._bodies] - centers[:, self._composite.roots]
        self._add(force, spatial[..., :3] - cross(arms, force), axes)

    def _add(
        self, force: npt.NDArray[np.float64], torque: npt.NDArray[np.float64], axes: npt.NDArray[np.float64]
    ) -> None:
        """Add forces and torques (N, W, 3) about the links' origins, in world axes."""
        axes = axes.reshape(len(force), -1, 3, 3)[:, self._bodies]
        local = [np.einsum("nwij,nwi->nwj", axes, part) for part in (force, torque)]
        self._flat += np.concatenate(local, -1).reshape(self._flat.shape).astype(np.float32)

    def _take_off_weights(self) -> None:
        count = len(self.wrenches)
        weights = self._parameters.masses[..., None] * self._parameters.gravity[..., None, :]
        weights = np.broadcast_to(weights, (count, *weights.shape[-2:]))
        force = self._beyond @ weights
        torque = self._beyond @ np.cross(self._centers.reshape(count, -1, 3), weights)
        torque -= np.cross(self._origins[:, self._bodies], force)
        self._add(force, torque, self._axes)


class MatterMeter:
    """Forces of deformables on links at the last physics step: those of contacts, and of what links hold.

    MuJoCo gives a cloth's particle the force that holds it alone, for contacts of flexes are no forces on bodies to it;
    a piece of rope has that of all contacts and of the drag with it, which are taken off.
    """

    def __init__(
        self, layout: SceneLayout, batch: Batch, addresses: Addresses, matter: Sequence[MatterAddresses]
    ) -> None:
        self._matter, self._link_of_body = matter, addresses.link_of_body
        self._links = np.array(_touchable(layout), dtype=np.int64)
        shape = (batch.nsim, len(matter), len(layout.links), 3)
        self.forces = torch.zeros(shape)
        """(N, D, L, 3) newtons, world axes."""
        self._forces = self.forces.numpy()
        if matter:
            self._sensordata, self._cfrc = batch.bind("sensordata"), batch.bind("cfrc_ext")
            self._xfrc, self._active = batch.bind("xfrc_applied"), batch.bind("eq_active")
            self._start = 3 * int(contact_sensor_starts(layout)[-1])

    def read(self, holders: npt.NDArray[np.int64]) -> None:
        """Take the last physics step's forces; ``holders`` (N, E) are the bodies that constraints hold particles to."""
        column = self._start
        for index, one in enumerate(self._matter):
            stop = column + 3 * len(self._links)
            exerted = self._sensordata[:, column:stop].reshape(len(self._forces), -1, 3)
            self._forces[:, index] = 0.0
            self._forces[:, index, self._links] = -exerted
            held = self._active[:, one.anchors] > 0.0
            pull = self._cfrc[:, one.bodies, 3:]
            if isinstance(one.spec, Rope):
                column, stop = stop, stop + 3 * (one.bodies.stop - one.bodies.start)
                touched = -self._sensordata[:, column:stop].reshape(len(self._forces), -1, 3)
                pull = pull - touched - self._xfrc[:, one.bodies, :3]
            column = stop
            if held.any():
                self._add_pull(index, one, held, pull, self._link_of_body[holders[:, one.anchors]])

    def _add_pull(
        self,
        index: int,
        one: MatterAddresses,
        held: npt.NDArray[np.bool_],
        pull: npt.NDArray[np.float64],
        links: npt.NDArray[np.int64],
    ) -> None:
        if isinstance(one.spec, Rope):  # the last two particles share a piece: what holds the last counts for both
            links = np.concatenate((links[:, :-2], np.where(held[:, -1:], links[:, -1:], links[:, -2:-1])), axis=1)
            held = np.concatenate((held[:, :-2], held[:, -2:].any(1, keepdims=True)), axis=1)
        rows, particles = np.nonzero(held & (links >= 0))
        if one.grid is not None:  # vertices share nodes: each counts once
            links_of_nodes = np.full(pull.shape[:2], -1, dtype=links.dtype)
            links_of_nodes[rows, one.grid.nearest()[particles]] = links[rows, particles]
            links = links_of_nodes
            rows, particles = np.nonzero(links >= 0)
        np.add.at(self._forces[:, index], (rows, links[rows, particles]), -pull[rows, particles])

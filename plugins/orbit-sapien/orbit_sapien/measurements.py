"""Contact forces from PhysX's contact points, and joint wrenches."""

# pyright: reportAttributeAccessIssue=false

# SAPIEN's stubs ask for shapes of arrays that NumPy's types cannot express.
# pyright: reportArgumentType=false

from __future__ import annotations

from itertools import chain

import numpy as np
import numpy.typing as npt
import torch

from orbit_core.interfaces import TERRAIN, ContactQuery, SceneLayout
from orbit_sapien.model import BuiltWorld
from orbit_sapien.parameters import Parameters


class ContactMeter:
    """Sums impulses per query over the physics steps of a control step.

    Queries past the layout's own are those of :class:`WrenchMeter`: what presses on links that the world holds.
    """

    def __init__(self, layout: SceneLayout, world: BuiltWorld, held: tuple[int, ...]) -> None:
        self._queries = (*layout.contact_queries, *(ContactQuery(link) for link in held))
        self._own = len(layout.contact_queries)
        self.active = bool(self._queries)
        """False without queries: contacts are then not read."""
        self._systems, self._dt = world.systems, layout.scene.physics_dt
        self._place: dict[object, tuple[int, int]] = {}
        for row, environment in enumerate(world.environments):
            bodies = [body for entity in environment.entities for body in entity.bodies]
            self._place.update({body: (row, link) for link, body in enumerate(bodies)})
            self._place.update(dict.fromkeys(environment.terrain, (row, TERRAIN)))
        # Contacts of one pair of links recur in every step, so that the search through the queries is done once.
        self._asked: dict[tuple[int, int], tuple[tuple[int, float], ...]] = {}
        self._offsets = np.stack([environment.offset for environment in world.environments])
        self._sum = np.zeros((len(world.environments), len(self._queries), 3))
        self.held_wrenches = np.zeros((len(world.environments), len(held), 6))
        """(N, H, 6) of contacts on held links in the last physics step, about the environment's origin, world axes."""
        self.forces = torch.zeros(len(world.environments), self._own, 3)
        """(N, K, 3) newtons on each query's link."""

    def clear(self) -> None:
        """Begin a control step."""
        self._sum.fill(0.0)

    def add(self) -> None:
        """Take one physics step's impulses in."""
        rows: list[int] = []
        columns: list[int] = []
        signs: list[float] = []
        impulses: list[npt.NDArray[np.float32]] = []
        points: list[npt.NDArray[np.float32]] = []
        for contact in chain.from_iterable(system.get_contacts() for system in self._systems):
            one, other = contact.bodies
            (row, first), (other_row, second) = self._place[one], self._place[other]
            asked = self._asked_of(first, second)
            if not asked:
                continue
            row = other_row if first == TERRAIN else row  # a shared ground belongs to its world's first environment
            for point in contact.points:
                impulse, position = point.impulse, point.position
                for column, sign in asked:
                    rows.append(row)
                    columns.append(column)
                    signs.append(sign)
                    impulses.append(impulse)
                    points.append(position)
        self.held_wrenches.fill(0.0)
        if rows:
            forces = np.array(impulses, np.float64) * (np.array(signs) / self._dt)[:, None]
            # Unbuffered: several points of one contact add to the same query.
            np.add.at(self._sum, (rows, columns), forces)
            if self.held_wrenches.shape[1]:
                self._add_held(np.array(rows), np.array(columns), forces, np.array(points, np.float64))

    def average(self, steps: int) -> None:
        """End a control step."""
        np.multiply(self._sum[:, : self._own], 1.0 / steps, out=self.forces.numpy(), casting="same_kind")

    def _add_held(
        self, rows: npt.NDArray, columns: npt.NDArray, forces: npt.NDArray[np.float64], points: npt.NDArray[np.float64]
    ) -> None:
        mine = columns >= self._own
        rows, columns, forces, points = rows[mine], columns[mine] - self._own, forces[mine], points[mine]
        torques = np.cross(points - self._offsets[rows], forces)
        np.add.at(self.held_wrenches, (rows, columns), np.concatenate((forces, torques), -1))

    def _asked_of(self, first: int, second: int) -> tuple[tuple[int, float], ...]:
        """Queries that a contact of these links belongs to; PhysX gives the impulse on the first."""
        if (first, second) not in self._asked:
            self._asked[first, second] = tuple(
                (number, sign)
                for link, other, sign in ((first, second, 1.0), (second, first, -1.0))
                for number, query in enumerate(self._queries)
                if query.link == link and (query.others is None or other in query.others)
            )
        return self._asked[first, second]


def held_links(layout: SceneLayout) -> tuple[int, ...]:
    """Wrench links that the world holds: PhysX does not measure these."""
    roots = {entity.root_link for entity in layout.entities if entity.spec.fixed_base}
    return tuple(link for link in layout.wrench_links if link in roots)


class WrenchMeter:
    """Holds the joint wrenches of the last physics step."""

    def __init__(self, layout: SceneLayout, world: BuiltWorld, contacts: ContactMeter, parameters: Parameters) -> None:
        self._layout, self._world, self._contacts, self._parameters = layout, world, contacts, parameters
        self._held = held_links(layout)
        self.wrenches = torch.zeros(len(world.environments), len(layout.wrench_links), 6)
        """(N, W, 6) force and torque from the parent, in the link's axes."""
        self._incoming = {
            entity.links.start + entity.spec.articulation.link_names.index(joint.child): joint
            for entity in layout.entities
            for joint in entity.spec.articulation.joints
        }
        entities = {int(layout.entity_of_link[link]) for link in layout.wrench_links}
        self._entities = [entity for entity in layout.entities if entity.index in entities]
        self._turns, self._arms = self._frames()

    def _frames(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """(L, 3, 3) and (L, 3): each link's joint frame in the link; PhysX's has the joint's axis along x."""
        turns, arms = np.tile(np.eye(3), (len(self._layout.links), 1, 1)), np.zeros((len(self._layout.links), 3))
        for link in self._incoming:
            entity = self._layout.entities[self._layout.entity_of_link[link]]
            body = self._world.environments[0].entities[entity.index].bodies[link - entity.links.start]
            pose = body.joint.pose_in_child
            turns[link] = pose.to_transformation_matrix()[:3, :3]
            arms[link] = pose.p
        return turns, arms

    def read(self, link_poses: torch.Tensor) -> None:
        """Take the last physics step's in; ``link_poses`` (N, L, 7) are those after it."""
        for entity in self._entities:
            links = np.arange(entity.links.start, entity.links.stop)
            local = self._measured(entity.index, links)
            for column, link in enumerate(self._layout.wrench_links):
                if link in self._held and link == entity.root_link:
                    value = self._balance(entity.index, links, local, link_poses.double().numpy())
                elif entity.links.start <= link < entity.links.stop:
                    value = local[:, link - entity.links.start]
                else:
                    continue
                self.wrenches[:, column] = torch.from_numpy(value).float()

    def _measured(self, entity: int, links: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        """(N, links, 6) about each link's origin, in its axes; zero for the root."""
        natives = [environment.entities[entity] for environment in self._world.environments]
        articulations = [native.articulation for native in natives if native.articulation is not None]
        if not articulations:
            return np.zeros((len(natives), len(links), 6))
        # PhysX numbers the links of an articulation in an order of its making.
        order = [body.index for body in natives[0].bodies]
        raw = np.stack([articulation.get_link_incoming_joint_forces() for articulation in articulations])
        turned = np.einsum("lij,nlkj->nlki", self._turns[links], raw[:, order].reshape(len(natives), -1, 2, 3))
        force, torque = turned[:, :, 0], turned[:, :, 1]
        return np.concatenate((force, torque + np.cross(self._arms[links], force)), -1)

    def _balance(
        self, entity: int, links: npt.NDArray[np.int64], local: npt.NDArray[np.float64], poses: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Wrench of the world on a root at rest: what its children and contacts take, less its weight and pushes."""
        spec, root = self._layout.entities[entity].spec, links[0]
        force = np.zeros((len(poses), 3))
        torque = np.zeros((len(poses), 3))  # about the environment's origin
        for joint in spec.articulation.joints:
            if joint.parent == spec.articulation.root.name:
                child = root + spec.articulation.link_names.index(joint.child)
                matrix = _matrices(poses[:, child, 3:])
                given, turn = (np.einsum("nij,nj->ni", matrix, local[:, child - root, part]) for part in _PARTS)
                force += given
                torque += turn + np.cross(poses[:, child, :3], given)
        contacts = self._contacts.held_wrenches[:, self._held.index(root)]
        own = self._parameters.wrenches[:, root].astype(np.float64)
        matrix = _matrices(poses[:, root, 3:])
        center = poses[:, root, :3] + np.einsum("nij,nj->ni", matrix, self._parameters.centers[:, root])
        weight = self._parameters.masses[:, root, None] * self._parameters.gravity
        pushed = own[:, :3] + (0.0 if spec.gravity_compensation else weight)
        force -= pushed + contacts[:, :3]
        torque -= own[:, 3:] + np.cross(center, pushed) + contacts[:, 3:]
        # From the environment's origin to the link's, about which the contract has wrenches.
        torque -= np.cross(poses[:, root, :3], force)
        return np.concatenate([np.einsum("nji,nj->ni", matrix, part) for part in (force, torque)], -1)


_PARTS = slice(0, 3), slice(3, 6)


def _matrices(q: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    w, x, y, z = q.T
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return np.stack(rows, -1).reshape(-1, 3, 3)

"""Newton's VBD in the set-ups of the scenarios of elastic solids."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import newton
import numpy as np
import warp as wp
from deformables_figures import PHYSICS_STEP, Budget, Case, Figure, G
from newton.solvers import SolverVBD

LENGTH, SIDE, DENSITY, RATIO = 0.2, 0.02, 1000.0, 0.3
"""A beam of silicone, clamped at one end."""
MODULI = {"stiff": (5.9e6, 0.009962, 39.0), "soft": (1e6, 0.05523, 16.0)}
"""Pa, metres that its tip falls as the elastica says, and rad/s of its first mode."""
CLAMPED = 1.8751040687
RADIUS = 0.001
"""Metres of the particles that VBD's contacts are of."""


@dataclass(frozen=True)
class Setting:
    """Cells across the beam or along a block's edge, milliseconds of a substep, and sweeps in each."""

    cells: int
    substep: float
    sweeps: int

    def __str__(self) -> str:
        return f"{self.cells} cells, {self.substep:.3g} ms x {self.sweeps}"


@dataclass(frozen=True)
class Plate:
    """A fixed box, whose inner face is at a point and looks along an axis (0, 1, 2) up or down (1, -1)."""

    axis: int
    side: int
    at: float
    friction: float


# Models --------------------------------------------------------------------------------------------------------------


@wp.kernel
def _brake(velocities: wp.array[wp.vec3], kept: float) -> None:
    index = wp.tid()
    velocities[index] = velocities[index] * kept


def grid(cells: tuple[int, int, int], size: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) of a box from the origin on and its tetrahedra (T, 4), five a cell, mirrored between cells."""
    lines = [np.linspace(0.0, length, count + 1) for length, count in zip(size, cells, strict=True)]
    vertices = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape([count + 1 for count in cells])
    ways = (
        ((0, 1, 2, 5), (0, 2, 3, 7), (0, 5, 7, 4), (2, 7, 5, 6), (0, 2, 7, 5)),
        ((1, 2, 3, 6), (0, 1, 3, 4), (1, 6, 4, 5), (3, 4, 6, 7), (1, 3, 4, 6)),
    )
    corners = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
    found = []
    for cell in np.ndindex(*cells):
        at = [index[cell[0] + x, cell[1] + y, cell[2] + z] for x, y, z in corners]
        found += [[at[corner] for corner in way] for way in ways[sum(cell) % 2]]
    tetrahedra = np.array(found)
    edges = vertices[tetrahedra[:, 1:]] - vertices[tetrahedra[:, :1]]
    inverted = np.linalg.det(edges) < 0.0
    tetrahedra[inverted] = tetrahedra[inverted][:, [0, 2, 1, 3]]
    return vertices, tetrahedra


def lame(modulus: float) -> tuple[float, float]:
    """Lame's parameters (mu, lambda) in Pa."""
    return modulus / (2.0 * (1.0 + RATIO)), modulus * RATIO / ((1.0 + RATIO) * (1.0 - 2.0 * RATIO))


class Solid:
    """A solid in VBD, stepped by a recorded graph of a physics step.

    Args:
        device: Warp's name of it.
        vertices: At rest, (V, 3) in m.
        tetrahedra: (T, 4).
        density: kg/m^3.
        modulus: Pa.
        delay: Seconds: damping stress of this times the modulus at uniaxial strain rates. VBD damps the rate of
            ``F^T F``, which takes 4 k (1 + 2 nu^2) of such a rate.
        setting: Substeps and sweeps.
        gravity: m/s^2.
        held: Vertices that stay where they are.
        start: Positions that it starts at, (V, 3); at rest without.
        plates: What it touches.
        stiffness: N/m of a particle's contact.
        creep: m/s below which friction is viscous.
        brake: 1/s that velocities are slowed by, for the shape at rest alone.
    """

    def __init__(
        self, device: str, vertices: np.ndarray, tetrahedra: np.ndarray, density: float, modulus: float, delay: float,
        setting: Setting, gravity: tuple[float, float, float] = (0.0, 0.0, -G), *, held: np.ndarray | None = None,
        start: np.ndarray | None = None, plates: tuple[Plate, ...] = (), stiffness: float = 1e4, creep: float = 1e-2,
        brake: float = 0.0,
    ) -> None:  # fmt: skip
        builder = newton.ModelBuilder()
        mu, lambda_ = lame(modulus)
        builder.add_soft_mesh(
            pos=wp.vec3(0.0, 0.0, 0.0), rot=wp.quat_identity(), scale=1.0, vel=wp.vec3(0.0, 0.0, 0.0),
            vertices=[wp.vec3(*map(float, point)) for point in vertices], indices=tetrahedra.ravel().tolist(),
            density=density, k_mu=mu, k_lambda=lambda_, k_damp=modulus * delay / (4.0 * (1.0 + 2.0 * RATIO**2)),
            add_surface_mesh_edges=False, particle_radius=RADIUS,
        )  # fmt: skip
        for vertex in () if held is None else held:
            builder.particle_mass[int(vertex)] = 0.0
        if start is not None:
            builder.particle_q = [wp.vec3(*map(float, point)) for point in start]
        for plate in plates:
            half, middle = [0.5, 0.5, 0.5], [0.0, 0.0, 0.0]
            half[plate.axis], middle[plate.axis] = 0.05, plate.at - 0.05 * plate.side
            material = newton.ModelBuilder.ShapeConfig(density=0.0, mu=plate.friction, ke=stiffness, kd=0.0)
            at = wp.transform(wp.vec3(*middle), wp.quat_identity())
            builder.add_shape_box(-1, xform=at, hx=half[0], hy=half[1], hz=half[2], cfg=material)
        builder.color()
        self.model = builder.finalize(device=device)
        self.model.set_gravity(gravity)
        self.model.soft_contact_ke, self.model.soft_contact_kd = stiffness, 0.0
        self.model.soft_contact_mu = max((plate.friction for plate in plates), default=0.0)
        pipeline = newton.CollisionPipeline(self.model, soft_contact_gap=0.002) if plates else None
        self.contacts = pipeline.contacts() if pipeline else None
        solver = SolverVBD(self.model, iterations=setting.sweeps, friction_epsilon=creep)
        self._observed = solver.observables(kinds={"contact_f"}, contacts=self.contacts) if plates else None
        self._states = (self.model.state(), self.model.state())
        control = self.model.control()
        count = 2 * max(1, round(0.5e3 * PHYSICS_STEP / setting.substep))
        step = PHYSICS_STEP / count

        def physics_step() -> None:
            for substep in range(count):
                before, after = self._states if substep % 2 == 0 else self._states[::-1]
                before.clear_forces()
                if pipeline:
                    pipeline.collide(before, self.contacts)
                solver.step(before, after, control, self.contacts, step, observables=self._observed)
                if brake:
                    kept = math.exp(-brake * step)
                    wp.launch(_brake, after.particle_count, [after.particle_qd, kept], device=self.model.device)

        physics_step()
        with wp.ScopedCapture(device=self.model.device) as captured:
            physics_step()
        self._graph = captured.graph
        if start is not None or not plates:
            self._put_back()

    def _put_back(self) -> None:
        """Start again, after the first step, which compiles."""
        state = self._states[0]
        state.particle_q.assign(self.model.particle_q)
        state.particle_qd.zero_()

    def step(self, budget: Budget) -> None:
        """Take a physics step."""
        wp.capture_launch(self._graph)
        budget.step()

    @property
    def positions(self) -> np.ndarray:
        """In m, (V, 3)."""
        return self._states[0].particle_q.numpy().astype(float)

    @property
    def velocity(self) -> np.ndarray:
        """Mean over the particles in m/s, (3,)."""
        return self._states[0].particle_qd.numpy().astype(float).mean(axis=0)

    def force(self, plate: int) -> np.ndarray:
        """Force on a plate in N as VBD tells it, (3,)."""
        assert self.contacts is not None
        assert self._observed is not None
        count = int(self.contacts.soft_contact_count.numpy()[0])
        rows = self._observed.contact_f.numpy()[self.contacts.rigid_contact_max :][:count, :3]
        return rows[self.contacts.soft_contact_shape.numpy()[:count] == plate].sum(axis=0)


# Beams ---------------------------------------------------------------------------------------------------------------


def _beam(
    device: str, setting: Setting, modulus: float, delay: float, *, gravity: float, brake: float
) -> tuple[Solid, np.ndarray]:
    """A clamped beam around the axis x, and the vertices of its end."""
    vertices, tetrahedra = grid((10 * setting.cells, setting.cells, setting.cells), (LENGTH, SIDE, SIDE))
    vertices -= (0.0, 0.5 * SIDE, 0.5 * SIDE)
    start = _bent(vertices, 0.004) if gravity == 0.0 else None
    solid = Solid(
        device, vertices, tetrahedra, DENSITY, modulus, delay, setting, (0.0, 0.0, -gravity),
        held=np.flatnonzero(vertices[:, 0] < 1e-6), start=start, brake=brake,
    )  # fmt: skip
    return solid, np.flatnonzero(vertices[:, 0] > LENGTH - 1e-6)


def _droop(name: str, setting: Setting, device: str, budget: Budget) -> Iterator[Figure]:
    """The shape at rest, found by slowing velocities: damping of the material would slow VBD's convergence."""
    modulus, truth, omega = MODULI[name]
    solid, end = _beam(device, setting, modulus, 0.0, gravity=G, brake=2.0 * omega)
    budget.restart()
    seconds = 14.0 / omega
    for _ in range(round(seconds / PHYSICS_STEP)):
        solid.step(budget)
    yield Figure("droop", -solid.positions[end, 2].mean(), truth, 0.05, budget.milliseconds)


def _swing(setting: Setting, device: str, budget: Budget) -> Iterator[Figure]:
    """A beam that is let go in its first mode, with a damping of 4 ms and with none."""
    modulus = MODULI["stiff"][0]
    omega = CLAMPED**2 * math.sqrt(modulus * SIDE**4 / 12.0 / (DENSITY * SIDE**2 * LENGTH**4))
    found = {}
    for delay, seconds in ((0.004, 0.8), (0.0, 1.5)):
        solid, end = _beam(device, setting, modulus, delay, gravity=0.0, brake=0.0)
        budget.restart()
        heights = []
        for _ in range(round(seconds / PHYSICS_STEP)):
            solid.step(budget)
            heights.append(solid.positions[end, 2].mean())
        swing = np.array(heights)
        before = np.flatnonzero((swing[:-1] > 0.0) != (swing[1:] > 0.0))
        crossings = before + swing[before] / (swing[before] - swing[before + 1])
        frequency = 0.5 * (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * PHYSICS_STEP)
        peaks = [np.abs(swing[a + 1 : b + 1]).max() for a, b in pairwise(before)]
        found[delay] = frequency, 2.0 * math.log(peaks[0] / peaks[-1]) / (len(peaks) - 1)
    ratio = 0.5 * 0.004 * omega
    rest = math.sqrt(1.0 - ratio**2)
    lost = abs(found[0.0][1]) * 1.5 * omega / (2.0 * math.pi)
    yield from [
        Figure("frequency", found[0.004][0], omega * rest / (2.0 * math.pi), 0.03, budget.milliseconds),
        Figure("decay", found[0.004][1], 2.0 * math.pi * ratio / rest, 0.05, budget.milliseconds),
        Figure("lost", lost, None, 0.05, budget.milliseconds, "logarithm of its amplitude in 1.5 s, undamped"),
    ]


def _bent(points: np.ndarray, height: float) -> np.ndarray:
    """Points (V, 3) of the beam in the shape of its first mode."""
    x = CLAMPED * points[:, 0] / LENGTH
    share = (math.cosh(CLAMPED) + math.cos(CLAMPED)) / (math.sinh(CLAMPED) + math.sin(CLAMPED))
    mode = np.cosh(x) - np.cos(x) - share * (np.sinh(x) - np.sin(x))
    slope = np.sinh(x) + np.sin(x) - share * (np.cosh(x) - np.cos(x))
    moved = points.copy()
    moved[:, 2] += 0.5 * height * mode
    moved[:, 0] -= points[:, 2] * 0.5 * height * slope * CLAMPED / LENGTH
    return moved


def _mesh_limit(cells: int, device: str, budget: Budget) -> Iterator[Figure]:
    """Find the small droop of the same tetrahedra by a direct solution, which no solver of them can better."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import spsolve

    del device
    budget.restart()
    modulus, _, _ = MODULI["stiff"]
    vertices, tetrahedra = grid((10 * cells, cells, cells), (LENGTH, SIDE, SIDE))
    edges = vertices[tetrahedra[:, 1:]] - vertices[tetrahedra[:, :1]]
    inverse, volumes = np.linalg.inv(edges), np.linalg.det(edges) / 6.0
    slopes = np.concatenate((-inverse.sum(axis=2, keepdims=True), inverse), axis=2).transpose(0, 2, 1)
    strain = np.zeros((len(tetrahedra), 6, 12))
    for row, (a, b) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))):
        for node in range(4):
            strain[:, row, 3 * node + a] += slopes[:, node, b]
            if a != b:
                strain[:, row, 3 * node + b] += slopes[:, node, a]
    mu, lambda_ = lame(modulus)
    law = np.diag([2.0 * mu] * 3 + [mu] * 3)
    law[:3, :3] += lambda_
    blocks = np.einsum("tia,ij,tjb,t->tab", strain, law, strain, volumes, optimize=True)
    places = (3 * tetrahedra[:, :, None] + np.arange(3)).reshape(len(tetrahedra), 12)
    rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None, :])
    size = 3 * len(vertices)
    matrix = coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), (size, size)).tocsc()
    load = np.zeros(size)
    np.add.at(load, 3 * tetrahedra + 2, -0.25 * DENSITY * G * volumes[:, None])
    free = np.repeat(vertices[:, 0] > 1e-6, 3)
    moved = np.zeros(size)
    moved[free] = spsolve(matrix[free][:, free], load[free])
    droop = -moved[2::3][vertices[:, 0] > LENGTH - 1e-6].mean()
    truth = DENSITY * SIDE**2 * G * LENGTH**4 / (8.0 * modulus * SIDE**4 / 12.0)
    yield Figure("droop", droop, truth, 0.05, note=f"{len(tetrahedra)} tetrahedra, small bending, direct solution")


# Blocks --------------------------------------------------------------------------------------------------------------


def _compression(setting: Setting, device: str, budget: Budget) -> Iterator[Figure]:
    """A block of foam between smooth plates, 4 % shorter; its force is what VBD tells."""
    edge, modulus, strain = 0.05, 1e5, 0.04
    vertices, tetrahedra = grid((setting.cells,) * 3, (edge,) * 3)
    start = vertices * (1.0, 1.0, 1.0 - strain)
    plates = (Plate(2, 1, -RADIUS, 0.0), Plate(2, -1, edge * (1.0 - strain) + RADIUS, 0.0))
    solid = Solid(
        device, vertices, tetrahedra, 500.0, modulus, 0.002, setting, (0.0, 0.0, 0.0), start=start, plates=plates
    )
    budget.restart()
    forces = []
    for step in range(100):
        solid.step(budget)
        if step >= 80:
            forces.append(0.5 * (solid.force(1)[2] - solid.force(0)[2]))
    moved = solid.positions
    spans = [
        moved[vertices[:, axis] > edge - 1e-6, axis].mean() - moved[vertices[:, axis] < 1e-6, axis].mean()
        for axis in range(3)
    ]
    shorter, wider = 1.0 - spans[2] / edge, 0.5 * (spans[0] + spans[1]) / edge - 1.0
    felt = float(np.mean(forces)) / edge**2 / shorter
    yield from [
        Figure("modulus", felt, modulus, 0.03, budget.milliseconds, "by the force that VBD tells"),
        Figure("ratio", wider / shorter, RATIO, 0.03, budget.milliseconds),
    ]


BLOCK, BLOCK_MODULUS, BLOCK_DENSITY = 0.06, 2e5, 500.0
"""A soft block of the scenarios of contact: edge in m, Pa, kg/m^3."""
WEIGHT = BLOCK_DENSITY * BLOCK**3 * G


def _lying(setting: Setting, tangent: float, device: str, creep: float) -> Solid:
    """A block on a slope, which is gravity's: it lies in the plane z = 0, and falls along x."""
    vertices, tetrahedra = grid((setting.cells,) * 3, (BLOCK,) * 3)
    angle = math.atan(tangent)
    gravity = (G * math.sin(angle), 0.0, -G * math.cos(angle))
    return Solid(
        device, vertices, tetrahedra, BLOCK_DENSITY, BLOCK_MODULUS, 0.005, setting, gravity,
        plates=(Plate(2, 1, -RADIUS, 0.4),), creep=creep,
    )  # fmt: skip


def _weight(setting: Setting, device: str, budget: Budget) -> Iterator[Figure]:
    """A block that lies on the ground, and the force that VBD tells of it."""
    solid = _lying(setting, 0.0, device, 1e-2)
    budget.restart()
    felt = []
    for step in range(120):
        solid.step(budget)
        if step >= 60:
            felt.append(-solid.force(0)[2])
    yield from [
        Figure("weight", float(np.mean(felt)), WEIGHT, 0.02, budget.milliseconds, "mean force on the ground in N"),
        Figure("spread", float(np.std(felt)) / WEIGHT, None, None, budget.milliseconds, "of it, over the weight"),
    ]


def _slope(setting: Setting, creep: float, device: str, budget: Budget) -> Iterator[Figure]:
    """A block that holds at tan 0.34 and slides at tan 0.6, with friction 0.4."""
    for tangent in (0.34, 0.6):
        solid = _lying(setting, tangent, device, creep)
        budget.restart()
        for _ in range(60):
            solid.step(budget)
        place, speed = solid.positions.mean(axis=0), np.linalg.norm(solid.velocity)
        for _ in range(80):
            solid.step(budget)
        if tangent < 0.4:
            moved = float(np.linalg.norm(solid.positions.mean(axis=0) - place)) / 0.4
            yield Figure("creep", moved, None, 1e-3, budget.milliseconds, "m/s at tan 0.34")
        else:
            angle = math.atan(tangent)
            truth = G * (math.sin(angle) - 0.4 * math.cos(angle))
            faster = float(np.linalg.norm(solid.velocity) - speed) / 0.4
            yield Figure("acceleration", faster, truth, 0.03, budget.milliseconds, "m/s^2 at tan 0.6")


def _held(setting: Setting, creep: float, device: str, budget: Budget) -> Iterator[Figure]:
    """A block that two fixed plates press with 5 N and hold up, by a friction of 1."""
    vertices, tetrahedra = grid((setting.cells,) * 3, (BLOCK,) * 3)
    vertices -= (0.5 * BLOCK, 0.0, 0.0)
    # Each contact gives way as well.
    shorter = 5.0 / (BLOCK_MODULUS * BLOCK**2) * BLOCK + 2.0 * 5.0 / ((setting.cells + 1) ** 2 * 1e4)
    half = 0.5 * (BLOCK - shorter) + RADIUS
    solid = Solid(
        device, vertices, tetrahedra, BLOCK_DENSITY, BLOCK_MODULUS, 0.005, setting,
        start=vertices * ((BLOCK - shorter) / BLOCK, 1.0, 1.0),
        plates=(Plate(0, 1, -half, 1.0), Plate(0, -1, half, 1.0)), creep=creep,
    )  # fmt: skip
    budget.restart()
    for _ in range(60):
        solid.step(budget)
    height, felt, pressed = solid.positions[:, 2].mean(), [], []
    for _ in range(300):
        solid.step(budget)
        forces = solid.force(0), solid.force(1)
        felt.append(-forces[0][2] - forces[1][2])
        pressed.append(0.5 * (forces[1][0] - forces[0][0]))
    slip = abs(float(solid.positions[:, 2].mean() - height))
    pressure = f"pressed with {np.mean(pressed):.2f} N a side"
    yield from [
        Figure("force", float(np.mean(felt)), WEIGHT, 0.02, budget.milliseconds, f"N up on it; {pressure}"),
        Figure("slip", slip, None, 5e-4, budget.milliseconds, "m in 1.5 s"),
    ]


EXAMPLES = 5.0 / 3.0
"""Milliseconds of a substep in Newton's examples, which make 10 sweeps in each."""
CASES = (
    *(
        Case(f"beam {name} ({setting})", partial(_droop, name, setting), large)
        for name in MODULI
        for setting, large in (
            (Setting(2, EXAMPLES, 10), False),
            (Setting(2, 0.25, 20), False),
            (Setting(8, 0.05, 20), True),
            (Setting(4, 0.1, 20), False),
            (Setting(8, 0.05, 40), True),
        )
    ),
    *(Case(f"beam mesh ({cells} cells)", partial(_mesh_limit, cells)) for cells in (2, 4, 8)),
    *(
        Case(f"weight ({setting})", partial(_weight, setting))
        for setting in (Setting(4, EXAMPLES, 10), Setting(4, 0.5, 20), Setting(4, 0.5, 100))
    ),
    *(
        Case(f"compression ({setting})", partial(_compression, setting))
        for setting in (Setting(4, EXAMPLES, 10), Setting(4, 0.5, 20))
    ),
    *(
        Case(f"slope ({setting}, friction from {creep:g} m/s)", partial(_slope, setting, creep))
        for setting in (Setting(4, 0.5, 20),)
        for creep in (1e-2, 1e-4)
    ),
    *(
        Case(f"held ({setting}, friction from {creep:g} m/s)", partial(_held, setting, creep))
        for setting, creep in ((Setting(4, 0.5, 20), 1e-2), (Setting(4, 0.5, 20), 1e-4), (Setting(4, 0.5, 100), 1e-4))
    ),
    *(
        Case(f"swing ({setting})", partial(_swing, setting), large)
        for setting, large in ((Setting(2, 0.25, 40), False), (Setting(4, 0.1, 40), True))
    ),
)
"""Most telling first."""

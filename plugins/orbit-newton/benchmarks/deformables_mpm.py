"""Newton's implicit MPM in the set-ups of the scenarios of liquids, as sand and as dough."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import newton
import numpy as np
import warp as wp
from deformables_figures import PHYSICS_STEP, Budget, Case, Figure, G
from newton.solvers import SolverImplicitMPM

WATER = 1000.0
"""kg/m^3."""


@dataclass(frozen=True)
class Setting:
    """A grid: metres of a voxel, particles along its edge, its bases, substeps in 5 ms.

    Bases and integration are those of Newton's example of water where nothing else is said, which are its defaults but
    for contacts at the particles. ``modulus`` in Pa is that of the material before it flows; Newton's examples of water
    and sand leave it at 1e15. ``margin`` in distances of particles is how far walls keep their middles off.
    """

    voxel: float
    particles: int = 2
    contacts: str = "pic"
    substeps: int = 1
    velocities: str = "Q1"
    strains: str = "P0"
    integration: str = "pic"
    modulus: float = 1e15
    margin: float = 0.5

    def __str__(self) -> str:
        bases = ((self.contacts, "pic"), (self.velocities, "Q1"), (self.strains, "P0"), (self.integration, "pic"))
        more = [basis for basis, usual in bases if basis != usual]
        more += [f"margin {self.margin:g}"] if self.margin != 0.5 else []
        more += [f"E {self.modulus:g}"] if self.modulus < 1e15 else []
        return ", ".join([f"{1e3 * self.voxel:g} mm, {self.particles}^3, {5.0 / self.substeps:g} ms", *more])


@dataclass(frozen=True)
class Wall:
    """A fixed box between two corners in m."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    friction: float = 0.0


@dataclass(frozen=True)
class Material:
    """Material of the particles: Newton's water has tension and no friction, its sand friction and no tension."""

    density: float = WATER
    friction: float = 0.0
    tensile: float = 1.0
    yield_stress: float = 0.0


class Matter:
    """Particles between walls. Each wall is a kinematic body, so that the solver's impulses are told by wall.

    Args:
        device: Warp's name of it.
        low: Corner of the box that is filled, m.
        high: Its other corner.
        walls: What it touches.
        material: Of the particles.
        setting: Of the grid.
        kept: Which of the particles' places (V, 3) are filled; all without.
    """

    def __init__(
        self, device: str, low: Sequence[float], high: Sequence[float], walls: Sequence[Wall], material: Material,
        setting: Setting, kept: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        builder = newton.ModelBuilder()
        SolverImplicitMPM.register_custom_attributes(builder)
        for wall in walls:
            middle, half = np.add(wall.low, wall.high) / 2.0, np.subtract(wall.high, wall.low) / 2.0
            body = builder.add_body(is_kinematic=True)
            at = wp.transform(wp.vec3(*map(float, middle)), wp.quat_identity())
            surface = newton.ModelBuilder.ShapeConfig(density=0.0, mu=wall.friction)
            builder.add_shape_box(body, xform=at, hx=float(half[0]), hy=float(half[1]), hz=float(half[2]), cfg=surface)
        places, self.spacing = self.places(low, high, setting)
        places = places if kept is None else places[kept]
        mass = material.density * self.spacing**3
        builder.add_particles(
            pos=[wp.vec3(*map(float, place)) for place in places], vel=[wp.vec3(0.0)] * len(places),
            mass=[mass] * len(places), radius=[0.5 * self.spacing] * len(places),
            flags=[newton.ParticleFlags.ACTIVE] * len(places),
        )  # fmt: skip
        self.model = builder.finalize(device=device)
        self.model.set_gravity((0.0, 0.0, -G))
        self.model.mpm.friction.fill_(material.friction)
        self.model.mpm.tensile_yield_ratio.fill_(material.tensile)
        self.model.mpm.yield_stress.fill_(material.yield_stress)
        self.model.mpm.young_modulus.fill_(setting.modulus)
        config = SolverImplicitMPM.Config()
        config.voxel_size, config.warmstart_mode = setting.voxel, "particles"
        config.collider_basis, config.velocity_basis = setting.contacts, setting.velocities
        config.strain_basis, config.integration_scheme = setting.strains, setting.integration
        self._solver = SolverImplicitMPM(self.model, config=config)
        self._solver.setup_collider(
            collider_projection_threshold=[0.25 * setting.voxel] * len(walls),
            collider_margins=[setting.margin * self.spacing] * len(walls),
        )
        self._states = [self.model.state(), self.model.state()]
        self._states[0].mpm.particle_Jp.fill_(1.0)
        self._walls, self._substeps = len(walls), setting.substeps
        self._solver.project_outside(self._states[0], self._states[0], PHYSICS_STEP)
        self._step()

    @staticmethod
    def places(low: Sequence[float], high: Sequence[float], setting: Setting) -> tuple[np.ndarray, float]:
        """Middles (V, 3) of the cubes that fill a box, and their edge, all in m."""
        spacing = setting.voxel / setting.particles
        lines = [a + spacing * (np.arange(round((b - a) / spacing)) + 0.5) for a, b in zip(low, high, strict=True)]
        return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3), spacing

    def _step(self) -> None:
        h = PHYSICS_STEP / self._substeps
        for _ in range(self._substeps):
            before, after = self._states
            self._solver.step(before, after, None, None, h)
            self._solver.project_outside(after, after, h)
            self._states.reverse()

    def step(self, budget: Budget) -> None:
        """Take a physics step."""
        self._step()
        budget.step()

    @property
    def positions(self) -> np.ndarray:
        """In m, (V, 3)."""
        return self._states[0].particle_q.numpy().astype(float)

    def push(self, velocities: np.ndarray) -> None:
        """Add to the velocities, (V, 3) in m/s."""
        state = self._states[0]
        state.particle_qd.assign((state.particle_qd.numpy() + velocities).astype(np.float32))

    def forces(self) -> np.ndarray:
        """Forces on the walls in N as the solver's impulses of the last substep tell, (W, 3)."""
        impulses, _, walls = self._solver.collect_collider_impulses(self._states[0])
        found, of = impulses.numpy().astype(float), walls.numpy()
        h = PHYSICS_STEP / self._substeps
        return np.stack([found[of == wall].sum(axis=0) for wall in range(self._walls)]) / h


def _tank(length: float, width: float, height: float, thick: float, friction: float = 0.0) -> tuple[Wall, ...]:
    """A floor, whose friction is given, and smooth walls to the right, left, front and back."""
    x, y = 0.5 * length, 0.5 * width
    return (
        Wall((-x - thick, -y - thick, -thick), (x + thick, y + thick, 0.0), friction),
        Wall((x, -y - thick, 0.0), (x + thick, y + thick, height)),
        Wall((-x - thick, -y - thick, 0.0), (-x, y + thick, height)),
        Wall((-x, y, 0.0), (x, y + thick, height)),
        Wall((-x, -y - thick, 0.0), (x, -y, height)),
    )


# Water ---------------------------------------------------------------------------------------------------------------


def _rest(setting: Setting, thick: float, seconds: float, device: str, budget: Budget) -> Iterator[Figure]:
    """Water in a tank: volume, force on the floor and on the sides over the half second until each of two times."""
    length, width, depth = 0.12, 0.08, 0.06
    tank = _tank(length, width, 0.12, thick)
    water = Matter(
        device, (-0.5 * length, -0.5 * width, 0.0), (0.5 * length, 0.5 * width, depth), tank, Material(), setting
    )
    budget.restart()
    weight, pressed = WATER * G * length * width * depth, 0.5 * WATER * G * depth**2
    forces, heights = [], []
    steps = round(seconds / PHYSICS_STEP)
    for step in range(1, steps + 1):
        water.step(budget)
        forces.append(water.forces())
        heights.append(2.0 * water.positions[:, 2].mean())
        if step in (400, steps):
            mean = np.mean(forces[-100:], axis=0)
            after = f"after {step * PHYSICS_STEP:g} s"
            sides = np.array([
                mean[1, 0] / pressed / width, -mean[2, 0] / pressed / width,
                mean[3, 1] / pressed / length, -mean[4, 1] / pressed / length,
            ])  # fmt: skip
            worst = float(sides[np.argmax(np.abs(sides - 1.0))])
            volume = float(np.mean(heights[-100:])) / depth
            out = _outside(water.positions, 0.5 * length + 0.5 * thick, 0.5 * width + 0.5 * thick, -0.5 * thick)
            yield from [
                Figure("volume", volume, 1.0, 0.02, budget.milliseconds, f"{after}; {out:.2%} have leaked"),
                Figure("floor", -mean[0, 2] / weight, 1.0, 0.01, budget.milliseconds, after),
                Figure("sides", worst, 1.0, 0.01, budget.milliseconds, after),
            ]


def _outside(points: np.ndarray, x: float, y: float, bottom: float) -> float:
    """Part of the points that are outside of a tank."""
    return float(((np.abs(points[:, 0]) > x) | (np.abs(points[:, 1]) > y) | (points[:, 2] < bottom)).mean())


def _cup(setting: Setting, device: str, budget: Budget) -> Iterator[Figure]:
    """A cup with walls of 6 mm, which stands in the air: what is left in it, and what it weighs."""
    side, depth, thick = 0.06, 0.06, 0.006
    cup = _tank(side, side, 0.08, thick)
    half = 0.5 * side
    water = Matter(device, (-half, -half, 0.0), (half, half, depth), cup, Material(), setting)
    budget.restart()
    forces = []
    for step in range(300):
        water.step(budget)
        if step >= 200:
            forces.append(-water.forces()[:, 2].sum())
    out = _outside(water.positions, half + 0.5 * thick, half + 0.5 * thick, -0.5 * thick)
    weight = WATER * G * side**2 * depth
    yield from [
        Figure("weight", float(np.mean(forces)), weight, 0.02, budget.milliseconds, "N on the cup, of 1 to 1.5 s"),
        Figure("leaked", out, None, 0.0, budget.milliseconds, "part of the particles after 1.5 s"),
    ]


FRONT = ((1.219, 1.474), (1.997, 2.292), (2.547, 2.995))
"""Martin and Moyce, 1952: times in sqrt(a / 2 g) and places in a."""


def _dam_break(setting: Setting, device: str, budget: Budget) -> Iterator[Figure]:
    """The front of a column that is twice as high as long."""
    length, width = 0.06, 0.04
    x, y = 0.5 * length, 0.5 * width
    walls = (
        Wall((-x - 0.05, -y - 0.05, -0.05), (0.4, y + 0.05, 0.0)),
        Wall((-x - 0.05, -y - 0.05, 0.0), (-x, y + 0.05, 0.2)),
        Wall((-x, y, 0.0), (0.4, y + 0.05, 0.2)),
        Wall((-x, -y - 0.05, 0.0), (0.4, -y, 0.2)),
    )
    water = Matter(device, (-x, -y, 0.0), (x, y, 2.0 * length), walls, Material(), setting)
    # The first step, in which kernels are compiled, is a part of the fall.
    budget.restart()
    unit = math.sqrt(0.5 * length / G)
    times, places, row = [], [], round(width / water.spacing)
    for step in range(1, round((FRONT[-1][0] * unit + 0.02) / PHYSICS_STEP) + 1):
        ahead = np.sort(water.positions[:, 0])[-row:].mean() + 0.5 * water.spacing
        times.append(step * PHYSICS_STEP / unit)
        places.append((ahead + x) / length)
        water.step(budget)
    found = np.interp([time for time, _ in FRONT], times, places)
    yield from [
        Figure(f"front {time:.1f}", float(at), truth, 0.1, budget.milliseconds, "lengths at that time in sqrt(a / 2 g)")
        for at, (time, truth) in zip(found, FRONT, strict=True)
    ]


def _sloshing(setting: Setting, device: str, budget: Budget) -> Iterator[Figure]:
    """The first mode of water in a tank, set in motion by its velocities."""
    length, width, depth = 0.16, 0.06, 0.06
    low, high = (-0.5 * length, -0.5 * width, 0.0), (0.5 * length, 0.5 * width, depth)
    water = Matter(device, low, high, _tank(length, width, 0.12, 0.05), Material(), setting)
    budget.restart()
    for _ in range(60):
        water.step(budget)
    k = math.pi / length
    omega = math.sqrt(G * k * math.tanh(k * depth))
    points = water.positions
    x, z = k * (points[:, 0] + 0.5 * length), k * points[:, 2]
    speed = 0.008 * G * k / omega / math.cosh(k * depth)
    water.push(speed * np.stack((np.sin(x) * np.cosh(z), 0.0 * x, -np.cos(x) * np.sinh(z)), axis=1))
    middles = []
    for _ in range(280):
        water.step(budget)
        middles.append(water.positions[:, 0].mean())
    swing = np.array(middles)
    before = np.flatnonzero((swing[:-1] > 0.0) != (swing[1:] > 0.0))
    if len(before) < 2:
        yield Figure("frequency", 0.0, 0.5 * omega / math.pi, 0.05, budget.milliseconds, "does not swing")
        return
    crossings = before + swing[before] / (swing[before] - swing[before + 1])
    frequency = 0.5 * (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * PHYSICS_STEP)
    yield Figure("frequency", float(frequency), 0.5 * omega / math.pi, 0.05, budget.milliseconds)
    if len(before) > 2:
        swings = [np.abs(swing[a : b + 1]).max() for a, b in pairwise(before)]
        lost = 1.0 - (swings[-1] / swings[0]) ** (1.0 / (len(swings) - 1))
        yield Figure("lost", float(lost), None, 0.15, budget.milliseconds, "of its amplitude in half a period")


def _outflow(setting: Setting, device: str, budget: Budget) -> Iterator[Figure]:
    """Water that runs out of a square hole, between 85 and 45 % of its depth."""
    side, depth, hole, bottom = 0.10, 0.11, 0.04, 0.01
    x, h, far = 0.5 * side, 0.5 * hole, 0.5 * side + 0.05
    walls = (
        Wall((-far, -far, -bottom), (-h, far, 0.0)),
        Wall((h, -far, -bottom), (far, far, 0.0)),
        Wall((-h, -far, -bottom), (h, -h, 0.0)),
        Wall((-h, h, -bottom), (h, far, 0.0)),
        *_tank(side, side, 0.15, 0.05)[1:],
    )
    water = Matter(device, (-x, -x, 0.0), (x, x, depth), walls, Material(), setting)
    budget.restart()
    depths = []
    for _ in range(140):
        water.step(budget)
        depths.append(float((water.positions[:, 2] > -bottom).sum()) * water.spacing**3 / side**2)
    first = int(np.argmax(np.array(depths) < 0.85 * depth))
    last = int(np.argmax(np.array(depths) < 0.45 * depth)) or len(depths) - 1
    fallen = 2.0 * side**2 * (math.sqrt(depths[first]) - math.sqrt(depths[last]))
    coefficient = fallen / (hole**2 * math.sqrt(2.0 * G) * max(last - first, 1) * PHYSICS_STEP)
    yield Figure("coefficient", coefficient, 0.62, 0.1, budget.milliseconds)


# Sand and dough ------------------------------------------------------------------------------------------------------


def _collapse(setting: Setting, aspect: float, device: str, budget: Budget) -> Iterator[Figure]:
    """A column of sand in a channel: how far it runs and how high it stays, after Lube and others.

    In plane flow of constant volume the solver's coefficient of friction is the sine of the angle of friction: 30
    degrees. The channel's sides are smooth, its floor is rough.
    """
    length, width = 0.1, 4.0 * setting.voxel
    walls = (
        Wall((-0.05, -0.2, -0.05), (0.7, 0.2, 0.0), math.tan(math.radians(30.0))),
        Wall((-0.05, -0.2, 0.0), (0.0, 0.2, 0.6)),
        Wall((0.0, 0.5 * width, 0.0), (0.7, 0.2, 0.6)),
        Wall((0.0, -0.2, 0.0), (0.7, -0.5 * width, 0.6)),
    )
    sand = Material(1500.0, friction=0.5, tensile=0.0)
    low, high = (0.0, -0.5 * width, 0.0), (length, 0.5 * width, aspect * length)
    matter = Matter(device, low, high, walls, sand, setting)
    budget.restart()
    for _ in range(200):
        matter.step(budget)
    points = matter.positions
    # Where the heap ends, and not the few grains that left it.
    run = (np.percentile(points[:, 0], 99.5) + 0.5 * matter.spacing) / length - 1.0
    high_end = (np.percentile(points[points[:, 0] < 0.1 * length, 2], 99.0) + 0.5 * matter.spacing) / length
    lube = 1.2 * aspect if aspect < 2.3 else 1.9 * aspect ** (2.0 / 3.0)
    height = aspect if aspect < 1.15 else 0.65 * aspect**0.4
    # Heights of columns of one voxel: sand does not lose volume, and gains little as it loosens.
    columns = np.floor(points[:, 0] / setting.voxel).astype(int)
    tops = [points[columns == column, 2].max() + 0.5 * matter.spacing for column in np.unique(columns)]
    area = sum(tops) * setting.voxel / (aspect * length**2)
    note = f"lengths; {len(points)} particles"
    yield Figure("run-out", float(run), lube, 0.1, budget.milliseconds, note)
    yield Figure("height", float(high_end), height, 0.1, budget.milliseconds, note)
    yield Figure("volume", float(area), 1.0, 0.1, budget.milliseconds, "under its surface")


def _slump(setting: Setting, strength: float, device: str, budget: Budget) -> Iterator[Figure]:
    """A cylinder of dough on a smooth floor, by whose slump yield stresses are measured.

    ``strength`` is its yield stress in shear over rho g H; yield is von Mises', sqrt(3) times that in compression.
    """
    height, radius, density = 0.1, 0.05, 1200.0
    low, high = (-radius, -radius, 0.0), (radius, radius, height)
    places, _ = Matter.places(low, high, setting)
    kept = np.hypot(places[:, 0], places[:, 1]) < radius
    dough = Material(density, friction=0.0, tensile=1.0, yield_stress=strength * density * G * height)
    floor = (Wall((-0.4, -0.4, -0.05), (0.4, 0.4, 0.0)),)
    matter = Matter(device, low, high, floor, dough, setting, kept)
    budget.restart()
    for _ in range(160):
        matter.step(budget)
    points = matter.positions
    inner = points[np.hypot(points[:, 0], points[:, 1]) < 0.5 * radius, 2]
    slump = 1.0 - (np.percentile(inner, 99.0) + 0.5 * matter.spacing) / height
    s = math.sqrt(3.0) * strength
    truth = 1.0 - s * (1.0 - math.log(s)) if s < 1.0 else 0.0
    note = f"of its height; {len(points)} particles"
    rigid = truth == 0.0
    yield Figure("slump", float(slump), None if rigid else truth, 0.02 if rigid else 0.1, budget.milliseconds, note)


COARSE, FINE = Setting(0.02), Setting(0.01)
CASES = (
    Case(f"rest ({COARSE})", partial(_rest, COARSE, 0.05, 2.0)),
    Case(f"rest ({FINE})", partial(_rest, FINE, 0.05, 10.0), large=True),
    Case(f"collapse of 1 ({FINE})", partial(_collapse, FINE, 1.0)),
    Case(f"dam break ({FINE})", partial(_dam_break, FINE)),
    Case(f"cup ({FINE})", partial(_cup, FINE)),
    Case(f"slump of .15 ({Setting(0.0125)})", partial(_slump, Setting(0.0125), 0.15)),
    Case(f"slump of .65 ({Setting(0.0125)})", partial(_slump, Setting(0.0125), 0.65)),
    *(
        Case(f"rest ({setting})", partial(_rest, setting, 0.05, 2.0), setting.voxel < 0.02)
        for setting in (
            Setting(0.02, margin=0.0), Setting(0.02, contacts="S2"), Setting(0.02, substeps=4), Setting(0.02, 3),
            Setting(0.02, velocities="B2"), Setting(0.02, modulus=1e5), Setting(0.02, modulus=1e6),
            Setting(0.02, strains="P1d"), Setting(0.02, strains="Q1d"), Setting(0.02, integration="gimp"),
            Setting(0.005), Setting(0.01, modulus=1e5), Setting(0.01, strains="P1d"),
            Setting(0.01, integration="gimp"), Setting(0.01, contacts="S2"), Setting(0.01, velocities="B2"),
        )
    ),
    Case(f"rest, walls of 10 mm ({COARSE})", partial(_rest, COARSE, 0.01, 2.0)),
    Case(f"sloshing ({FINE})", partial(_sloshing, FINE)),
    Case(f"outflow ({FINE})", partial(_outflow, FINE)),
    Case(f"collapse of 3 ({FINE})", partial(_collapse, FINE, 3.0), large=True),
    Case(f"dam break ({Setting(0.005)})", partial(_dam_break, Setting(0.005)), large=True),
    Case(f"collapse of 1 ({Setting(0.005)})", partial(_collapse, Setting(0.005), 1.0), large=True),
    Case(f"cup ({Setting(0.005)})", partial(_cup, Setting(0.005)), large=True),
    Case(f"sloshing ({Setting(0.005)})", partial(_sloshing, Setting(0.005)), large=True),
)  # fmt: skip
"""Most telling first."""

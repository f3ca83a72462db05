"""Paths of joint positions around obstacles, by OMPL's planners over batched distances."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, PlanningError
from orbit_motion.compliant import PlacedRobot, PlacedWorld
from orbit_motion.obstacles import Clearance, Obstacles

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PlannerConfig:
    """Settings of path planning."""

    obstacles: tuple[str, ...] | None = None
    """Names of objects, and "terrain"; None takes the terrain and all objects whose base is fixed."""
    margin: float = 0.01
    """Distance (m) that is kept free around obstacles."""
    self_collisions: bool = True
    """True if links that no joint connects avoid each other, by their balls."""
    resolution: float = 0.02
    """rad or m that the fastest joint moves between two postures that are checked."""
    time_limit: float = 10.0
    """Seconds."""


class JointPlanner:
    """Planner for some joints of a robot in one environment at a time; other joints and all objects stay in place.

    RRT-Connect (Kuffner and LaValle, RRT-Connect: An Efficient Approach to Single-Query Path Planning, ICRA 2000), then
    OMPL's simplification (Sucan, Moll and Kavraki, The Open Motion Planning Library, IEEE Robotics and Automation
    Magazine 19(4), 2012). The robot is the balls that cover it; all postures along an edge are checked at once.

    Args:
        world: world of the robot.
        robot: robot that moves.
        joints: indices of the joints.
        config: how to search.

    Raises:
        ConfigurationError: OMPL is not installed.
        UnknownNameError: the world has no such obstacle.
    """

    def __init__(
        self, world: PlacedWorld, robot: PlacedRobot, joints: Sequence[int], config: PlannerConfig = PlannerConfig()
    ) -> None:
        self._ompl = _library()
        self.config = config
        self._robot, self._joints = robot, list(joints)
        self._tree = KinematicTree(robot.spec.articulation, world.device)
        self._clearance = Clearance(robot, joints, self._tree, Obstacles(world, config.obstacles))
        self.obstacles = self._clearance.obstacles
        """Obstacles that are avoided."""
        low, high = robot.position_limits[self._joints].double().cpu().unbind(1)
        # OMPL needs finite bounds: two turns either way hold every posture.
        self._low, self._high = low.clamp_min(-2.0 * torch.pi).numpy(), high.clamp_max(2.0 * torch.pi).numpy()
        none = torch.zeros(0, dtype=torch.int64, device=world.device)
        self._all_pairs = self._own_pairs() if config.self_collisions else (none, none)
        self._rigid = self._carried_alike(*self._all_pairs)
        # Each plan leaves out those that touch at its start and that no path could part.
        self._pairs = self._all_pairs

    def plan(self, goal: Tensor, env: int = 0, start: Tensor | None = None) -> Tensor:
        """Plan joint positions (P, k), between which straight lines keep the margin to everything.

        Args:
            goal: (k,) joint positions.
            env: index of the environment.
            start: (k,) joint positions; the measured ones if None.

        Raises:
            PlanningError: start or goal touch something or are out of limits, or no path was found in time; says which.
        """
        here = self._robot.joint_positions[env, self._joints] if start is None else start
        ends = [part.double().cpu().numpy() for part in (here, goal)]
        self._pairs = self._parted(here, env)
        for what, position in zip(("start", "goal"), ends, strict=True):
            self._check_end(what, position, env)
        path = self._search(ends[0], ends[1], env)
        return torch.as_tensor(path, dtype=torch.float32, device=goal.device)

    def clearances(self, positions: Tensor, env: int = 0) -> Tensor:
        """Compute the free distance (B,) in m at joint positions (B, k), negative where the robot overlaps."""
        links = self._links(positions, env)
        least = self._clearance.gaps(links, env).flatten(1)
        parts = [least] if least.shape[1] else []
        if len(self._pairs[0]):
            parts.append(self._own_gaps(links, self._pairs))
        if not parts:
            return torch.full((len(links),), torch.inf, device=links.device)
        return torch.cat(parts, 1).amin(1)

    def touched(self, positions: Tensor, env: int = 0) -> str:
        """Describe the thing nearest to the robot at joint positions (k,), and the free part of the margin."""
        free, near = float(self.clearances(positions[None], env)), self._nearest(positions, env)
        margin = self.config.margin
        return f"'{self._robot.name}' has {free:.3f} m of the margin of {margin:g} m free to {near}"

    def _search(self, start: _Array, goal: _Array, env: int) -> _Array:
        base, geometric = self._ompl
        count = len(self._joints)
        space = base.RealVectorStateSpace(count)
        bounds = base.RealVectorBounds(count)
        # A start slightly outside its limits is allowed: drives overshoot.
        for joint in range(count):
            bounds.setLow(joint, float(min(self._low[joint], start[joint], goal[joint])))
            bounds.setHigh(joint, float(max(self._high[joint], start[joint], goal[joint])))
        space.setBounds(bounds)
        information = base.SpaceInformation(space)
        information.setStateValidityChecker(lambda state: self._free(_values(state, count)[None], env))
        # All states of an edge are checked in one batch: ten times faster than one by one.
        validator = _edge_validator(base, information, lambda a, b: self._free(self._between(a, b), env), count)
        information.setMotionValidator(validator)
        information.setup()
        states = [space.allocState(), space.allocState()]
        for state, position in zip(states, (start, goal), strict=True):
            for joint in range(count):
                state[joint] = float(position[joint])
        problem = base.ProblemDefinition(information)
        problem.setStartAndGoalStates(*states)
        planner = geometric.RRTConnect(information)
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(self.config.time_limit)
        if not problem.hasExactSolution():
            raise PlanningError(
                f"no path for '{self._robot.name}' in {self.config.time_limit:g} s: give more time or less margin, or "
                "choose another goal"
            )
        path = problem.getSolutionPath()
        simplifier = geometric.PathSimplifier(information)
        # Only vertices are removed, so that each remaining edge is one that was checked as a straight line.
        simplifier.reduceVertices(path)
        simplifier.collapseCloseVertices(path)
        return np.array([_values(path.getState(i), count) for i in range(path.getStateCount())])

    def _free(self, positions: _Array, env: int) -> bool:
        return bool((self.clearances(torch.as_tensor(positions), env) >= self.config.margin).all())

    def _between(self, start: _Array, end: _Array) -> _Array:
        """Return postures on the straight line, the end included."""
        count = int(np.ceil(np.abs(end - start).max() / self.config.resolution)) + 1
        return start + np.linspace(0.0, 1.0, count)[1:, None] * (end - start) if count > 1 else end[None]

    def _check_end(self, what: str, position: _Array, env: int) -> None:
        names = [self._robot.joint_names[joint] for joint in self._joints]
        for name, value, low, high in zip(names, position, self._low, self._high, strict=True):
            if not low - 1e-4 <= value <= high + 1e-4:
                raise PlanningError(
                    f"the {what} has joint '{name}' at {value:.3f}, outside its limits {low:.3f} to {high:.3f}"
                )
        free = float(self.clearances(torch.as_tensor(position[None]), env))
        if free < self.config.margin:
            raise PlanningError(f"at the {what} {self.touched(torch.as_tensor(position), env)}")

    def _nearest(self, position: Tensor, env: int) -> str:
        gaps = self._clearance.gaps(self._links(position[None], env), env)[0]
        if not gaps.numel() or float(gaps.min()) >= self.config.margin:
            return "itself"
        ball, obstacle = divmod(int(gaps.argmin()), gaps.shape[1])
        link = self._robot.link_names[int(self._clearance.links[ball])]
        return f"'{self._clearance.obstacles.names[obstacle]}', from link '{link}'"

    def _own_pairs(self) -> tuple[Tensor, Tensor]:
        """Return indices of balls that may touch: links that no joint connects, and that are apart at home."""
        articulation = self._robot.spec.articulation
        names = articulation.link_names
        joined = {frozenset(pair) for pair in (*articulation.joined_links, *articulation.collision_exclusions)}
        owners = [names[int(link)] for link in self._clearance.links]
        pairs = [
            (a, b)
            for a in range(len(owners))
            for b in range(a)
            if owners[a] != owners[b] and frozenset((owners[a], owners[b])) not in joined
        ]
        first, second = torch.tensor(pairs, dtype=torch.int64).reshape(-1, 2).unbind(1)
        first, second = first.to(self._tree.device), second.to(self._tree.device)
        home = self._tree.forward(self._robot.root_pose[:1], self._robot.home_positions[None])
        # Balls are larger than links, so that neighbours further along the arm may overlap even at home.
        apart = self._own_gaps(home, (first, second))[0] > self.config.margin
        return first[apart], second[apart]

    def _parted(self, start: Tensor, env: int) -> tuple[Tensor, Tensor]:
        """Return the pairs of balls without those that touch at the start and that no planned joint moves apart.

        Fingers that hold each other touch in every posture of the arm.
        """
        first, second = self._all_pairs
        gaps = self._own_gaps(self._links(start[None], env), self._all_pairs)[0]
        kept = ~(self._rigid & (gaps < self.config.margin))
        return first[kept], second[kept]

    def _carried_alike(self, first: Tensor, second: Tensor) -> Tensor:
        """Return (pairs,) whether no planned joint moves the balls of a pair against each other."""
        names, carriers = self._robot.spec.articulation.link_names, self._carriers()
        carried = [carriers[names[int(link)]] for link in self._clearance.links]
        alike = [carried[a] == carried[b] for a, b in zip(first.tolist(), second.tolist(), strict=True)]
        return torch.tensor(alike, dtype=torch.bool, device=first.device)

    def _carriers(self) -> dict[str, str]:
        """Return the last planned joint between the root and each link, by name; links with the same one are rigid."""
        articulation = self._robot.spec.articulation
        planned = {self._robot.joint_names[joint] for joint in self._joints}
        carriers = {articulation.link_names[0]: ""}
        # Joints stand in the order of their child links, each behind its parent.
        for joint in articulation.joints:
            carriers[joint.child] = joint.name if joint.name in planned else carriers[joint.parent]
        return carriers

    def _links(self, positions: Tensor, env: int) -> Tensor:
        """Compute the poses (B, L, 7) of the robot's links at positions (B, k) of the planned joints."""
        count = positions.shape[0]
        full = self._robot.joint_positions[env].repeat(count, 1)
        full[:, self._joints] = positions.to(full)
        return self._tree.forward(self._robot.root_pose[env].expand(count, 7), full)

    def _own_gaps(self, links: Tensor, pairs: tuple[Tensor, Tensor]) -> Tensor:
        """Compute the distances (B, pairs) in m between pairs of the robot's own balls."""
        first, second = pairs
        points, radii = self._clearance.points(links), self._clearance.radii
        distance = torch.linalg.vector_norm(points[:, first] - points[:, second], dim=-1)
        return distance - radii[first] - radii[second]


def _values(state: Any, count: int) -> _Array:
    return np.array([state[joint] for joint in range(count)])


def _edge_validator(base: Any, information: Any, free: Any, count: int) -> Any:
    # Defined here, because its base class exists only where OMPL is installed.
    class Edges(base.MotionValidator):
        def checkMotion(self, first: Any, second: Any) -> bool:
            return free(_values(first, count), _values(second, count))

    return Edges(information)


@functools.cache
def _library() -> tuple[Any, Any]:
    try:
        from ompl import base, geometric, util
    except ImportError:
        raise ConfigurationError(f"plans need the package ompl: {install_extra('planning')}") from None
    util.setLogLevel(util.LogLevel.LOG_WARN)
    util.RNG.setSeed(1)  # once: the library draws all plans of a process from one stream
    return base, geometric

"""How far a robot is from obstacles, by balls that cover what its joints move."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree, joint_ancestry
from orbit_core.dynamics.transforms import quat_rotate
from orbit_motion.collision_spheres import collision_spheres
from orbit_motion.obstacles import Obstacles
from orbit_motion.still import PlacedRobot


class Clearance:
    """Balls around the links that some joints move, and the obstacles that count for each.

    What a ball touches in all environments with the robot at home, such as the table that it stands on, is no obstacle
    to it.

    Args:
        robot: that moves.
        joints: indices of the joints.
        tree: the robot's kinematics.
        obstacles: that it keeps off.
    """

    def __init__(self, robot: PlacedRobot, joints: Sequence[int], tree: KinematicTree, obstacles: Obstacles) -> None:
        articulation, device = robot.spec.articulation, robot.joint_positions.device
        balls = collision_spheres(articulation)
        ancestry = joint_ancestry(articulation)[:, list(joints)]
        moved = ancestry[balls.links].any(1)
        self.obstacles = obstacles
        self.links = torch.as_tensor(balls.links[moved], device=device)
        """(S,) of each ball."""
        self.centers = torch.as_tensor(balls.centers[moved], dtype=torch.float32, device=device)
        """(S, 3) in their links."""
        self.radii = torch.as_tensor(balls.radii[moved], dtype=torch.float32, device=device)
        """(S,) m"""
        self.moves = torch.as_tensor(ancestry[balls.links[moved]], dtype=torch.float32, device=device)
        """(S, k): which joints move each ball."""
        home = robot.home_positions.expand(robot.joint_positions.shape[0], -1)
        distances, _ = obstacles.distances(self.points(tree.forward(robot.root_pose, home)))
        # In all environments alike, for objects may stand elsewhere later.
        self.counts = torch.where(((distances - self.radii[:, None]) < 0.0).all(0), 0.0, 1.0)
        """(S, O): 1 where the obstacle counts for the ball."""

    def points(self, links: Tensor) -> Tensor:
        """(N, S, 3) centres of the balls for link poses (N, L, 7)."""
        poses = links.index_select(1, self.links)
        return poses[..., :3] + quat_rotate(poses[..., 3:], self.centers)

    def gaps(self, links: Tensor, env: int | None = None) -> Tensor:
        """(N, S, O) m from each ball to each obstacle, negative where they overlap; infinite where it does not count.

        With ``env`` the obstacles are those of that environment, and N is any number of postures.
        """
        distances, _ = self.obstacles.distances(self.points(links), env)
        return torch.where(self.counts > 0.0, distances - self.radii[:, None], torch.inf)

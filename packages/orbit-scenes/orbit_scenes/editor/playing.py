"""Physics while a scene is edited: the scene by itself, or episodes of its task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from torch import Tensor

from orbit_core.scene import Pose, Scene


class Playing(Protocol):
    """Interface of physics or episodes that run until they are stopped."""

    step_dt: float
    """Seconds that :meth:`step` advances."""
    words: str
    """State in words, for people."""

    @property
    def link_poses(self) -> Tensor:
        """Poses (1, L, 7) of all links, in the scene's order."""
        ...

    def step(self) -> None:
        """Advance by one step."""
        ...

    def states(self) -> Mapping[str, tuple[Pose, Mapping[str, float]]]:
        """Return pose and joint positions of everything that can move, by name."""
        ...

    def close(self) -> None:
        """Free what runs."""
        ...


class PhysicsPlay(Playing):
    """Physics of a scene, its robots held by their drives.

    Args:
        scene: as it starts; its sensors are left out.
        backend: name of an installed backend.

    Raises:
        OrbitError: of many kinds; the backend cannot simulate the scene.
    """

    def __init__(self, scene: Scene, backend: str) -> None:
        from orbit_core.world import simulate

        # Sensors would draw pictures in each step that nobody looks at.
        self._world = simulate(replace(scene, sensors=(), markers=()), 1, backend)
        # About fifty pictures a second: browsers show no more.
        self._steps = max(1, round(0.02 / scene.physics_dt))
        self.step_dt = self._steps * scene.physics_dt
        self._seconds = 0.0
        self.words = f"physics on {backend}"

    @property
    def link_poses(self) -> Tensor:
        return self._world.link_poses

    def step(self) -> None:
        self._world.step(self._steps)
        self._seconds += self.step_dt
        self.words = f"physics on {self._world.backend}, {self._seconds:.1f} s"

    def states(self) -> Mapping[str, tuple[Pose, Mapping[str, float]]]:
        found = {}
        for name, body in {**self._world.robots, **self._world.objects}.items():
            if body.spec.fixed_base and not body.spec.articulation.movable_joints:
                continue
            x, y, z, *orientation = body.root_pose[0].tolist()
            w, qx, qy, qz = orientation
            # Joints that mimic others have no home to set.
            leaders = {joint.name for joint in body.spec.articulation.movable_joints if joint.mimic is None}
            joints = dict(zip(body.joint_names, body.joint_positions[0].tolist(), strict=True))
            limits = {joint.name: (joint.lower_limit, joint.upper_limit) for joint in body.spec.articulation.joints}
            # Engines hold limits softly: a position a little beyond one is no home.
            kept = {
                joint: min(max(at, limits[joint][0]), limits[joint][1])
                for joint, at in joints.items()
                if joint in leaders
            }
            pose = body.spec.pose if body.spec.fixed_base else Pose((x, y, z), (w, qx, qy, qz))
            found[name] = (pose, kept)
        return found

    def close(self) -> None:
        self._world.close()


class TaskPlay(Playing):
    """Episodes of a scene file's task, in one environment.

    Args:
        path: of the scene file.
        backend: name of an installed backend.
        agent: name of a scripted actor, such as ``random``.

    Raises:
        OrbitError: of many kinds; the file has no task, or the backend cannot simulate it.
    """

    def __init__(self, path: Path, backend: str, agent: str) -> None:
        from orbit_core.envs.actors import scripted_actor
        from orbit_core.envs.making import make

        self._environment = make(str(path), 1, backend)
        self._environment.reset()
        self._actor = scripted_actor(agent, self._environment, 0)
        self.step_dt = self._environment.step_dt
        self._agent, self._episodes, self._successes, self._return = agent, 0, 0, 0.0
        self.words = f"{agent} agent on {backend}"

    @property
    def link_poses(self) -> Tensor:
        return self._environment.world.link_poses

    def step(self) -> None:
        _, reward, _, _, info = self._environment.step(self._actor.act())
        self._return += float(reward[0])
        if final := info.get("final"):
            self._episodes += len(final.success)
            self._successes += int(final.success.sum())
            # The next episode has begun within this step.
            self._return = 0.0
        self.words = (
            f"{self._agent} agent, return {self._return:.2f}, {self._successes} of {self._episodes} episodes successful"
        )

    def states(self) -> Mapping[str, tuple[Pose, Mapping[str, float]]]:
        # Episodes begin again by themselves: their poses are no state of the scene's.
        return {}

    def close(self) -> None:
        self._environment.close()

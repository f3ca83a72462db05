"""Old import paths: modules that moved into other distributions still import under their old names, with a warning.

The tables hold for one release. A module's old name gives the very same module.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
import warnings
from collections.abc import Sequence
from types import ModuleType
from typing import Any

from orbit_core.installing import install_command
from orbit_core.interfaces.errors import ConfigurationError

# Module -> modules of the same package that it took in, by the last part of their names
_MERGED = {
    "orbit_core.active.laws": ("factory", "law", "magnetic_seal"),
    "orbit_core.actuators.actuators": ("delay", "factory"),
    "orbit_core.actuators.models": ("model", "motors"),
    "orbit_core.cli.info": ("info_scene",),
    "orbit_core.cli.making": ("acting",),
    "orbit_core.cli.run": ("runner",),
    "orbit_core.cli.settings": ("checks", "parsing"),
    "orbit_core.dynamics.kinematics": ("tree",),
    "orbit_core.interfaces.capabilities": ("gaps", "requirements"),
    "orbit_core.interfaces.engine": ("rays",),
    "orbit_core.interfaces.errors": ("divergence",),
    "orbit_core.interfaces.layout": ("built",),
    "orbit_core.interfaces.world": ("sensor",),
    "orbit_core.plugin_kit.bodies": ("inertias", "massless", "mimics", "ropes", "springs"),
    "orbit_core.plugin_kit.engines": ("parts", "velocities"),
    "orbit_core.plugin_kit.meshes": ("faces", "markers"),
    "orbit_core.plugin_kit.rendering": ("deformable_surface",),
    "orbit_core.preparation.scene_data": ("deformable_checks", "surface_checks"),
    "orbit_core.preparation.validation": ("massless", "posture"),
    "orbit_core.rollout.stepping": ("counter", "reach_watch"),
    "orbit_core.rollout.video": ("pictures",),
    "orbit_core.scene.actuators": ("motors",),
    "orbit_core.scene.articulation": ("joints",),
    "orbit_core.scene.entities": ("active",),
    "orbit_core.scene.scene": ("lights", "markers"),
    "orbit_core.scene.shapes": ("materials", "textures"),
    "orbit_core.sensors.camera": ("points",),
    "orbit_core.sensors.proprioception": ("force_torque", "frame", "imu", "joint", "mount"),
    "orbit_core.sensors.rays": ("patterns",),
    "orbit_core.sensors.timed": ("averaging", "context", "memory"),
}
MODULES = {
    "orbit_core.actuators.fitting": "orbit_learn.actuators.fitting",
    "orbit_core.actuators.network_model": "orbit_learn.actuators.network_model",
    "orbit_core.actuators.networks": "orbit_learn.actuators.networks",
    "orbit_core.actuators.recordings": "orbit_learn.actuators.recordings",
    "orbit_core.assets": "orbit_assets",
    "orbit_core.assets.catalogue": "orbit_core.robots",
    "orbit_core.assets.deformable_checks": "orbit_core.preparation.scene_data",
    "orbit_core.assets.inertia": "orbit_assets.mass_properties",
    "orbit_core.assets.massless": "orbit_core.preparation.validation",
    "orbit_core.assets.merge": "orbit_core.preparation.merge",
    "orbit_core.assets.posture": "orbit_core.preparation.validation",
    "orbit_core.assets.scene_data": "orbit_core.preparation.scene_data",
    "orbit_core.assets.surface_checks": "orbit_core.preparation.scene_data",
    "orbit_core.assets.validation": "orbit_core.preparation.validation",
    "orbit_core.audit": "orbit_assets.audit",
    "orbit_core.capture.fusion": "orbit_motion.fusion",
    "orbit_core.cli.augment": "orbit_data.cli.augment",
    "orbit_core.cli.check_asset": "orbit_assets.cli.check_asset",
    "orbit_core.cli.check_robot": "orbit_assets.cli.check_robot",
    "orbit_core.cli.conformance": "orbit_conformance.cli.conformance",
    "orbit_core.cli.convert": "orbit_assets.cli.convert",
    "orbit_core.cli.data": "orbit_data.cli.data",
    "orbit_core.cli.export": "orbit_learn.cli.export",
    "orbit_core.cli.grasp": "orbit_motion.cli.grasp",
    "orbit_core.cli.play": "orbit_learn.cli.play",
    "orbit_core.cli.reading": "orbit_assets.cli.reading",
    "orbit_core.cli.read_budget": "orbit_data.cli.read_budget",
    "orbit_core.cli.record": "orbit_data.cli.record",
    "orbit_core.cli.replay": "orbit_data.cli.replay",
    "orbit_core.cli.teleop": "orbit_data.cli.teleop",
    "orbit_core.cli.train": "orbit_learn.cli.train",
    "orbit_core.cli.train_actuator": "orbit_learn.cli.train_actuator",
    "orbit_core.cli.trained": "orbit_learn.cli.trained",
    "orbit_core.cli.view": "orbit_viewer.cli.view",
    "orbit_core.conformance": "orbit_conformance",
    "orbit_core.data": "orbit_data",
    "orbit_core.data.compare": "orbit_data.manifest.compare",
    "orbit_core.data.manifest": "orbit_data.manifest.manifest",
    "orbit_core.data.plain": "orbit_data.manifest.plain",
    "orbit_core.dynamics.drive_design": "orbit_assets.drive_design",
    "orbit_core.dynamics.drive_response": "orbit_conformance.drive_response",
    "orbit_core.dynamics.drive_stability": "orbit_core.actuators.stability",
    "orbit_core.dynamics.qp": "orbit_motion.qp",
    "orbit_core.envs.expert": "orbit_motion.experts.expert",
    "orbit_core.envs.expert_base": "orbit_motion.experts.expert_base",
    "orbit_core.envs.mppi": "orbit_motion.experts.mppi",
    "orbit_core.interfaces.fields": "orbit_core.configuration",
    "orbit_core.interfaces.typed": "orbit_core.configuration",
    "orbit_core.learning": "orbit_learn",
    "orbit_core.manifest": "orbit_data.manifest",
    "orbit_core.mdp.crumpled": "orbit_tasks.mdp.crumpled",
    "orbit_core.mdp.held": "orbit_tasks.mdp.held",
    "orbit_core.mdp.matter": "orbit_tasks.mdp.matter",
    "orbit_core.mdp.picking": "orbit_tasks.mdp.picking",
    "orbit_core.mdp.premises": "orbit_tasks.mdp.premises",
    "orbit_core.mdp.stages": "orbit_tasks.mdp.stages",
    "orbit_core.mdp.tabletop": "orbit_tasks.mdp.tabletop",
    "orbit_core.mdp.terrain": "orbit_tasks.mdp.terrain",
    "orbit_core.motion": "orbit_motion",
    "orbit_core.motion.actuate": "orbit_core.actions.actuate",
    "orbit_core.motion.arm_dynamics": "orbit_core.actions.arm_dynamics",
    "orbit_core.motion.base": "orbit_core.actions.base",
    "orbit_core.motion.base_velocity": "orbit_core.actions.base_velocity",
    "orbit_core.motion.binary_gripper": "orbit_core.actions.binary_gripper",
    "orbit_core.motion.differential_drive": "orbit_core.actions.differential_drive",
    "orbit_core.motion.differential_ik": "orbit_core.actions.differential_ik",
    "orbit_core.motion.drives": "orbit_core.actions.drives",
    "orbit_core.motion.embodiment": "orbit_core.actions.embodiment",
    "orbit_core.motion.full_ik": "orbit_core.actions.full_ik",
    "orbit_core.motion.full_ik_term": "orbit_core.actions.full_ik_term",
    "orbit_core.motion.grasp_synergies": "orbit_core.actions.grasp_synergies",
    "orbit_core.motion.ik": "orbit_core.actions.ik",
    "orbit_core.motion.joint_effort": "orbit_core.actions.joint_effort",
    "orbit_core.motion.joint_position": "orbit_core.actions.joint_position",
    "orbit_core.motion.joint_velocity": "orbit_core.actions.joint_velocity",
    "orbit_core.motion.modes": "orbit_core.actions.modes",
    "orbit_core.motion.pose_command": "orbit_core.actions.pose_command",
    "orbit_core.motion.presets": "orbit_core.actions.presets",
    "orbit_core.motion.reach": "orbit_core.actions.reach",
    "orbit_core.motion.registry": "orbit_core.actions.registry",
    "orbit_core.motion.term": "orbit_core.actions.term",
    "orbit_core.perception": "orbit_motion.perception",
    "orbit_core.preparation.inertia": "orbit_assets.mass_properties",
    "orbit_core.pretrained": "orbit_learn.pretrained",
    "orbit_core.reading": "orbit_data.reading",
    "orbit_core.rollout.ends": "orbit_learn.ends",
    "orbit_core.rollout.recording": "orbit_conformance.recording",
    "orbit_core.tensor_file": "orbit_data.tensor_file",
    "orbit_core.sensors.boxes": "orbit_data.bounding_boxes",
    "orbit_core.sensors.entity_boxes": "orbit_data.bounding_boxes",
    "orbit_core.sensors.outlines": "orbit_data.bounding_boxes",
    "orbit_core.sensors.shape_bounds": "orbit_data.shape_bounds",
    "orbit_core.teleoperation": "orbit_data.teleoperation",
    "orbit_core.viewer": "orbit_viewer",
    "orbit_core.viewer.grasp_tool": "orbit_motion.grasping.tool",
    "orbit_core.viewer.pictures": "orbit_core.rollout.video",
    "orbit_core.viewer.video": "orbit_core.rollout.video",
    "orbit_core.world.preparation": "orbit_core.preparation.scenes",
    "orbit_learn.plain": "orbit_core.configuration",
    "orbit_tasks.pretrained": "orbit_policies",
    **{f"{new.rpartition('.')[0]}.{old}": new for new, olds in _MERGED.items() for old in olds},
}
"""Old name of a module or package -> its name now; the longest prefix counts."""
_ROBOTS = ("RobotCatalogue", "RobotEntry", "robot", "robot_info", "robot_names")
_OBJECTS = ("ObjectConfig", "object_config", "object_kinds")
NAMES = {
    "orbit_motion": {"orbit_core.actions": ()},
    "orbit_assets": {
        "orbit_core.robots": _ROBOTS,
        "orbit_core.objects": _OBJECTS,
        "orbit_core.preparation.merge": ("merge_fixed_links",),
        "orbit_core.preparation.validation": ("sort_links", "validate", "validate_entity"),
    },
    "orbit_assets.object_kinds": {"orbit_core.objects": _OBJECTS},
    "orbit_core.envs": {"orbit_motion.experts": ()},
    "orbit_core.mdp.common": {"orbit_assets.objects": ("BENCH_HEIGHT", "work_bench")},
}
"""Module -> modules that have names now which were its own: these, or all of ``__all__`` where none is given."""


def moved_name(module: str, name: str) -> Any:
    """Return what a module had under a name, from the module that has it now.

    Raises:
        AttributeError: it never had that name, or the distribution that brings it is not installed.
    """
    for other, names in NAMES[module].items():
        if names and name not in names:
            continue
        try:
            found = importlib.import_module(other)
        except ModuleNotFoundError:
            continue
        if name in (names or found.__all__):
            _warn(f"{module}.{name}", f"{other}.{name}", 3)
            return getattr(found, name)
    raise AttributeError(f"module '{module}' has no attribute '{name}'")


def new_name(name: str) -> str | None:
    """Return the name that a module has now; None where it has not moved."""
    parts = name.split(".")
    for count in range(len(parts), 1, -1):
        if (new := MODULES.get(".".join(parts[:count]))) is not None:
            return ".".join([new, *parts[count:]])
    return None


class MovedFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds modules by their old names."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return a specification that loads the module of the new name, if the name is an old one."""
        new = new_name(fullname) if fullname.startswith("orbit_") else None
        if new is None:
            return None
        return importlib.util.spec_from_loader(fullname, MovedFinder(), origin=new)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        """Return the module of the new name.

        Raises:
            ConfigurationError: the distribution that brings it is not installed.
        """
        new = str(spec.origin)
        _warn(spec.name, new, 2)
        try:
            module = importlib.import_module(new)
        except ModuleNotFoundError as error:
            top = new.partition(".")[0]
            if error.name != top:
                raise
            distribution = top.replace("_", "-")
            raise ConfigurationError(
                f"{spec.name} is {new} now, of the distribution {distribution}: {install_command(distribution)}"
            ) from error
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module its own specification back, which the import system has replaced."""
        module.__spec__ = self._spec


def install() -> None:
    """Let old names be imported; once."""
    if not any(isinstance(finder, MovedFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, MovedFinder())  # before what finds files in the folder of a package under its old name


def _warn(old: str, new: str, level: int) -> None:
    warnings.warn(f"{old} is {new} now; the old name goes with the next release", FutureWarning, stacklevel=level + 1)

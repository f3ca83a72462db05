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
    "orbit_conformance.contract.fixtures": ("on_host",),
    "orbit_conformance.execution": ("videos",),
    "orbit_conformance.report.plots": ("courses",),
    "orbit_conformance.robots.grasping": ("placing",),
    "orbit_conformance.robots.standing": ("holding",),
    "orbit_conformance.scenarios.drives": ("efforts",),
    "orbit_conformance.scenarios.fits": ("screws", "touching", "wedging"),
    "orbit_conformance.scenarios.images": ("image_boxes", "lighting"),
    "orbit_conformance.scenarios.impact": ("dominoes", "oblique_impact"),
    "orbit_conformance.scenarios.linkages": ("couplings",),
    "orbit_conformance.scenarios.pendula": ("gyroscopes",),
    "orbit_conformance.scenarios.resting": ("stacks", "velocities"),
    "orbit_conformance.scenarios.rolling": ("driving",),
    "orbit_conformance.scenarios.springs": ("stops",),
    "orbit_conformance.scenarios.terrain": ("floors",),
    "orbit_core.actions.base": ("actuate", "modes"),
    "orbit_core.actions.differential_ik": ("full_ik_term",),
    "orbit_core.actions.grippers": ("binary_gripper", "grasp_synergies"),
    "orbit_core.actions.ik": ("pose_command",),
    "orbit_core.actions.joints": ("joint_effort", "joint_position", "joint_velocity"),
    "orbit_core.actions.mobile_base": ("base_velocity", "differential_drive"),
    "orbit_core.actions.presets": ("drives", "registry"),
    "orbit_core.actions.workspace": ("reach",),
    "orbit_core.active.laws": ("factory", "law", "magnetic_seal"),
    "orbit_core.actuators.actuators": ("delay", "factory"),
    "orbit_core.actuators.models": ("model", "motors"),
    "orbit_core.agent.graph": ("cut", "runner"),
    "orbit_core.agent.wiring": ("nodes",),
    "orbit_core.capture.replay": ("kernels", "phases"),
    "orbit_core.capture.trace": ("stages",),
    "orbit_core.cli.info": ("info_scene",),
    "orbit_core.cli.making": ("acting",),
    "orbit_core.cli.run": ("runner",),
    "orbit_core.cli.settings": ("checks", "parsing"),
    "orbit_core.dynamics.kinematics": ("tree",),
    "orbit_core.envs.captured_step": ("step_parts",),
    "orbit_core.interfaces.capabilities": ("gaps",),
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
    "orbit_core.world.checks": ("build_check", "capacity"),
    "orbit_core.world.deformables": ("covered_area",),
    "orbit_core.world.drawing": ("frames", "matter_pictures", "outer_renderer", "painting", "texturing"),
    "orbit_core.world.entities": ("markers", "robots"),
    "orbit_core.world.lifetime": ("closing", "forking"),
    "orbit_core.world.state": ("clock", "copies", "divergence", "settling", "world_state"),
    "orbit_core.world.world": ("simulation",),
}
MODULES = {
    "orbit_assets.actuator_law": "orbit_assets.joint_models",
    "orbit_assets.archives": "orbit_assets.outside",
    "orbit_assets.audit.bodies": "orbit_assets.audit.checks",
    "orbit_assets.audit.findings": "orbit_assets.audit.checks",
    "orbit_assets.audit.joints": "orbit_assets.audit.checks",
    "orbit_assets.audit.mechanics": "orbit_assets.audit.geometry",
    "orbit_assets.audit.robots.drives": "orbit_assets.audit.robots.report",
    "orbit_assets.audit.robots.ground": "orbit_assets.audit.robots.report",
    "orbit_assets.audit.robots.hands": "orbit_assets.audit.robots.report",
    "orbit_assets.audit.urdf_reference": "orbit_assets.audit.reference",
    "orbit_assets.boards": "orbit_assets.objects",
    "orbit_assets.cli.findings_table": "orbit_assets.cli.check_asset",
    "orbit_assets.compound_joints": "orbit_assets.joint_models",
    "orbit_assets.couplings": "orbit_assets.joint_models",
    "orbit_assets.drives": "orbit_assets.scene_files",
    "orbit_assets.findings": "orbit_assets.source_text",
    "orbit_assets.hockey": "orbit_assets.objects",
    "orbit_assets.installed": "orbit_assets.sources",
    "orbit_assets.mesh_colors": "orbit_assets.meshes",
    "orbit_assets.mesh_faults": "orbit_assets.mesh_files",
    "orbit_assets.mjcf.actuators": "orbit_assets.mjcf.joints",
    "orbit_assets.mjcf.bodies_writer": "orbit_assets.mjcf.writer",
    "orbit_assets.mjcf.collisions": "orbit_assets.mjcf.geometry",
    "orbit_assets.mjcf.files": "orbit_assets.mjcf.model",
    "orbit_assets.mjcf.leftovers": "orbit_assets.mjcf.reader",
    "orbit_assets.mjcf.losses": "orbit_assets.mjcf.writer",
    "orbit_assets.mjcf.relations": "orbit_assets.mjcf.couplings",
    "orbit_assets.mjcf.shapes_writer": "orbit_assets.mjcf.writer",
    "orbit_assets.mjcf.tendons": "orbit_assets.mjcf.couplings",
    "orbit_assets.parts": "orbit_assets.robot_parts",
    "orbit_assets.sdf.fields": "orbit_assets.sdf.sources",
    "orbit_assets.sdf.frames": "orbit_assets.sdf.structure",
    "orbit_assets.sdf.model": "orbit_assets.sdf.reader",
    "orbit_assets.sdf.shapes": "orbit_assets.sdf.structure",
    "orbit_assets.thin_shapes": "orbit_assets.urdf.shapes",
    "orbit_assets.towers": "orbit_assets.objects",
    "orbit_assets.trees": "orbit_assets.urdf.reader",
    "orbit_assets.urdf.losses": "orbit_assets.urdf.writer",
    "orbit_assets.urdf.shapes_writer": "orbit_assets.urdf.writer",
    "orbit_assets.urdf.text": "orbit_assets.urdf.writer",
    "orbit_assets.usd.actuators": "orbit_assets.usd.joints",
    "orbit_assets.usd.freedoms": "orbit_assets.usd.dynamics",
    "orbit_assets.usd.joint_writer": "orbit_assets.usd.writer",
    "orbit_assets.usd.layers": "orbit_assets.usd.stage",
    "orbit_assets.usd.links": "orbit_assets.usd.articulations",
    "orbit_assets.usd.mass": "orbit_assets.usd.articulations",
    "orbit_assets.usd.names": "orbit_assets.usd.library",
    "orbit_assets.usd.prims": "orbit_assets.usd.library",
    "orbit_assets.usd.scene": "orbit_assets.usd.reader",
    "orbit_assets.usd.sizes": "orbit_assets.usd.stage",
    "orbit_assets.usd.surfaces": "orbit_assets.usd.geometry",
    "orbit_assets.vertices": "orbit_assets.meshes",
    "orbit_assets.written": "orbit_assets.files",
    "orbit_assets.xacro.formatting": "orbit_assets.xacro.values",
    "orbit_assets.xacro.markup": "orbit_assets.xacro.process",
    "orbit_assets.xml_fields": "orbit_assets.source_text",
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
    "orbit_core.cli.read_budget": "orbit_data.cli.read_budget",
    "orbit_core.cli.reading": "orbit_assets.cli.reading",
    "orbit_core.cli.record": "orbit_data.cli.record",
    "orbit_core.cli.replay": "orbit_data.cli.data",
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
    "orbit_core.envs.expert_base": "orbit_motion.experts.expert",
    "orbit_core.envs.live_configuration": "orbit_core.envs.configuration",
    "orbit_core.envs.lost_episodes": "orbit_core.envs.episode",
    "orbit_core.envs.mppi": "orbit_motion.experts.mppi",
    "orbit_core.envs.observation_check": "orbit_core.envs.observation_layout",
    "orbit_core.envs.observation_corruption": "orbit_core.envs.observation_manager",
    "orbit_core.envs.observation_groups": "orbit_core.envs.observation_layout",
    "orbit_core.envs.observation_history": "orbit_core.envs.observation_manager",
    "orbit_core.envs.settings_check": "orbit_core.envs.configuration",
    "orbit_core.envs.step_parts": "orbit_core.envs.captured_step",
    "orbit_core.envs.task_checks": "orbit_core.envs.task",
    "orbit_core.envs.term_values": "orbit_core.envs.terms",
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
    "orbit_core.motion.actuate": "orbit_core.actions.base",
    "orbit_core.motion.arm_dynamics": "orbit_core.actions.arm_dynamics",
    "orbit_core.motion.base": "orbit_core.actions.base",
    "orbit_core.motion.base_velocity": "orbit_core.actions.mobile_base",
    "orbit_core.motion.binary_gripper": "orbit_core.actions.grippers",
    "orbit_core.motion.differential_drive": "orbit_core.actions.mobile_base",
    "orbit_core.motion.differential_ik": "orbit_core.actions.differential_ik",
    "orbit_core.motion.drives": "orbit_core.actions.presets",
    "orbit_core.motion.embodiment": "orbit_core.actions.embodiment",
    "orbit_core.motion.full_ik": "orbit_core.actions.full_ik",
    "orbit_core.motion.full_ik_term": "orbit_core.actions.differential_ik",
    "orbit_core.motion.grasp_synergies": "orbit_core.actions.grippers",
    "orbit_core.motion.ik": "orbit_core.actions.ik",
    "orbit_core.motion.joint_effort": "orbit_core.actions.joints",
    "orbit_core.motion.joint_position": "orbit_core.actions.joints",
    "orbit_core.motion.joint_velocity": "orbit_core.actions.joints",
    "orbit_core.motion.modes": "orbit_core.actions.base",
    "orbit_core.motion.pose_command": "orbit_core.actions.ik",
    "orbit_core.motion.presets": "orbit_core.actions.presets",
    "orbit_core.motion.reach": "orbit_core.actions.workspace",
    "orbit_core.motion.registry": "orbit_core.actions.presets",
    "orbit_core.motion.term": "orbit_core.actions.term",
    "orbit_core.perception": "orbit_motion.perception",
    "orbit_core.preparation.inertia": "orbit_assets.mass_properties",
    "orbit_core.reading": "orbit_data.reading",
    "orbit_core.rollout.ends": "orbit_learn.ends",
    "orbit_core.rollout.recording": "orbit_conformance.recording",
    "orbit_core.sensors.boxes": "orbit_data.bounding_boxes",
    "orbit_core.sensors.entity_boxes": "orbit_data.bounding_boxes",
    "orbit_core.sensors.outlines": "orbit_data.bounding_boxes",
    "orbit_core.sensors.shape_bounds": "orbit_data.shape_bounds",
    "orbit_core.teleoperation": "orbit_data.teleoperation",
    "orbit_core.tensor_file": "orbit_data.tensor_file",
    "orbit_core.viewer": "orbit_viewer",
    "orbit_core.viewer.grasp_tool": "orbit_motion.grasping.tool",
    "orbit_core.viewer.pictures": "orbit_core.rollout.video",
    "orbit_core.viewer.video": "orbit_core.rollout.video",
    "orbit_core.world.preparation": "orbit_core.preparation.scenes",
    "orbit_core.world.threads": "orbit_core.dynamics.linear",
    "orbit_data.cli.replay": "orbit_data.cli.data",
    "orbit_data.parts": "orbit_data.recording",
    "orbit_data.recorder": "orbit_data.recording",
    "orbit_data.teleoperation.body": "orbit_data.teleoperation.driver",
    "orbit_data.teleoperation.gamepad": "orbit_data.teleoperation.devices",
    "orbit_data.teleoperation.keyboard": "orbit_data.teleoperation.devices",
    "orbit_data.teleoperation.pad": "orbit_data.teleoperation.browser",
    "orbit_data.teleoperation.spacemouse": "orbit_data.teleoperation.devices",
    "orbit_data.teleoperation.views": "orbit_data.teleoperation.session",
    "orbit_data.video": "orbit_data.lerobot",
    "orbit_learn.checkpoint": "orbit_learn.training",
    "orbit_learn.deployment": "orbit_learn.onnx_file",
    "orbit_learn.distill_settings": "orbit_learn.distill",
    "orbit_learn.loop": "orbit_learn.trainer",
    "orbit_learn.network_registry": "orbit_learn.policy_file",
    "orbit_learn.onnx_graph": "orbit_learn.onnx_file",
    "orbit_learn.picture_features": "orbit_learn.convolutional",
    "orbit_learn.plain": "orbit_core.configuration",
    "orbit_learn.replay_buffer": "orbit_learn.distill",
    "orbit_learn.sb3_pictures": "orbit_learn.sb3",
    "orbit_learn.skrl_models": "orbit_learn.skrl",
    "orbit_learn.student": "orbit_learn.distill",
    "orbit_learn.torchrl_groups": "orbit_learn.torchrl",
    "orbit_motion.barrier": "orbit_motion.rmpflow",
    "orbit_motion.collision_spheres": "orbit_motion.clearance",
    "orbit_motion.experts.expert_base": "orbit_motion.experts.expert",
    "orbit_motion.fusion.interpreter": "orbit_motion.fusion.operations",
    "orbit_motion.fusion.kernel": "orbit_motion.fusion.fused",
    "orbit_motion.fusion.source": "orbit_motion.fusion.fused",
    "orbit_motion.grasping.arm_driver": "orbit_motion.grasping.workflow",
    "orbit_motion.grasping.hand_boxes": "orbit_motion.grasping.antipodal",
    "orbit_motion.grasping.search": "orbit_motion.grasping.planner",
    "orbit_motion.grasping.surface": "orbit_motion.grasping.antipodal",
    "orbit_motion.manipulability": "orbit_motion.prioritized_ik",
    "orbit_motion.mpc.gait": "orbit_motion.mpc.trunk",
    "orbit_motion.mpc.plan": "orbit_motion.mpc.predictive",
    "orbit_motion.mpc.trunk_problem": "orbit_motion.mpc.trunk",
    "orbit_motion.planning.base_follower": "orbit_motion.planning.follower",
    "orbit_tasks.pretrained": "orbit_policies",
    "orbit_viewer.camera_pictures": "orbit_viewer.viewer",
    "orbit_viewer.controls": "orbit_viewer.panel",
    "orbit_viewer.geometry": "orbit_viewer.scene_view",
    "orbit_viewer.ghost": "orbit_viewer.scene_view",
    "orbit_viewer.information": "orbit_viewer.cli.view",
    "orbit_viewer.lights": "orbit_viewer.scene_view",
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
    "orbit_assets.drive_design": {
        "orbit_core.dynamics.workspace": ("DriveResponse", "ReflectedInertia", "drive_responses", "reflected_inertia"),
    },
    "orbit_core.cli.settings": {
        "orbit_learn.cli.trained": ("PlaySettings",),
        "orbit_motion.cli.grasp": ("GraspSettings",),
        "orbit_viewer.cli.view": ("ViewSettings",),
    },
    "orbit_core.envs": {"orbit_motion.experts": ()},
    "orbit_core.mdp.common": {"orbit_assets.objects": ("BENCH_HEIGHT", "work_bench")},
    "orbit_core.sensors": {"orbit_data.bounding_boxes": ("BoundingBoxes2d", "BoundingBoxes3d")},
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

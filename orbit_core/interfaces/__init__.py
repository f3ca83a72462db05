"""The contract: what an engine provides, and what tasks and agents may rely on.

Names load on first use, so that reading a backend's declaration does not load the tensor library.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbit_core.exports import lazy_names

# Type checkers see every name; at run time a name's module is imported when the name is used.
if TYPE_CHECKING:
    from orbit_core.interfaces.backend import CONTRACT, Backend
    from orbit_core.interfaces.capabilities import (
        EXACT,
        IMAGES,
        MATTER,
        Capabilities,
        Capability,
        DriveIntegration,
        Gap,
        Level,
        Support,
        approximate,
        unsupported,
    )
    from orbit_core.interfaces.capture import CaptureFacet
    from orbit_core.interfaces.engine import Engine, RayHits
    from orbit_core.interfaces.entities import Deformable, JointTarget, Marker, Object, Robot
    from orbit_core.interfaces.errors import (
        MAX_DISTANCE,
        MAX_SPEED,
        ArgumentError,
        AssetError,
        BackendNotInstalledError,
        BuildError,
        ClosedError,
        ConfigurationError,
        FailedEnvironmentsError,
        NonFiniteError,
        OrbitError,
        PlanningError,
        PremiseError,
        ShapeError,
        SimulationError,
        StorageError,
        UnknownNameError,
        UnsupportedCapabilityError,
        diverged,
        divergence_error,
        first_few,
        matter_divergence_error,
    )
    from orbit_core.interfaces.layout import (
        BACKGROUND,
        TERRAIN,
        Approximation,
        BuiltModel,
        ContactQuery,
        EntityLayout,
        JointParameters,
        SceneLayout,
    )
    from orbit_core.interfaces.matter import Matter, MatterSolver
    from orbit_core.interfaces.names import NamedThings, find_name, match_names, match_values
    from orbit_core.interfaces.node import Node, Port
    from orbit_core.interfaces.renderer import Image, LightTable, Renderer, albedo_table, drawn_shapes
    from orbit_core.interfaces.requirements import required_capabilities
    from orbit_core.interfaces.world import Sensor, World, WorldClock, WorldRandom, WorldSelector

_MODULES = {
    "backend": ("CONTRACT", "Backend"),
    "capabilities": (
        "EXACT", "IMAGES", "MATTER", "Capabilities", "Capability", "DriveIntegration", "Gap", "Level", "Support",
        "approximate", "unsupported",
    ),
    "capture": ("CaptureFacet",),
    "engine": ("Engine", "RayHits"),
    "entities": ("Deformable", "JointTarget", "Marker", "Object", "Robot"),
    "errors": (
        "MAX_DISTANCE", "MAX_SPEED", "ArgumentError", "AssetError", "BackendNotInstalledError", "BuildError",
        "ClosedError", "ConfigurationError", "FailedEnvironmentsError", "NonFiniteError", "OrbitError", "PlanningError",
        "PremiseError", "ShapeError", "SimulationError", "StorageError", "UnknownNameError",
        "UnsupportedCapabilityError", "diverged", "divergence_error", "first_few", "matter_divergence_error",
    ),
    "layout": (
        "BACKGROUND", "TERRAIN", "Approximation", "BuiltModel", "ContactQuery", "EntityLayout", "JointParameters",
        "SceneLayout",
    ),
    "matter": ("Matter", "MatterSolver"),
    "names": ("NamedThings", "find_name", "match_names", "match_values"),
    "node": ("Node", "Port"),
    "renderer": ("Image", "LightTable", "Renderer", "albedo_table", "drawn_shapes"),
    "requirements": ("required_capabilities",),
    "world": ("Sensor", "World", "WorldClock", "WorldSelector", "WorldRandom"),
}  # fmt: skip
__all__ = [
    "BACKGROUND", "CONTRACT", "EXACT", "IMAGES", "MATTER", "MAX_DISTANCE", "MAX_SPEED", "TERRAIN", "Approximation",
    "ArgumentError", "AssetError", "Backend", "BackendNotInstalledError", "BuildError", "BuiltModel", "Capabilities",
    "Capability", "CaptureFacet", "ClosedError", "ConfigurationError", "ContactQuery", "Deformable", "DriveIntegration",
    "Engine", "EntityLayout", "FailedEnvironmentsError", "Gap", "Image", "JointParameters", "JointTarget", "Level",
    "LightTable", "Marker", "Matter", "MatterSolver", "NamedThings", "Node", "NonFiniteError", "Object", "OrbitError",
    "PlanningError", "Port", "PremiseError", "RayHits", "Renderer", "Robot", "SceneLayout", "Sensor", "ShapeError",
    "SimulationError", "StorageError", "Support", "UnknownNameError", "UnsupportedCapabilityError", "World",
    "WorldClock", "WorldRandom", "WorldSelector", "albedo_table", "approximate", "diverged", "divergence_error",
    "drawn_shapes", "find_name", "first_few", "match_names", "match_values", "matter_divergence_error",
    "required_capabilities", "unsupported",
]  # fmt: skip

__getattr__, __dir__ = lazy_names(__name__, _MODULES)

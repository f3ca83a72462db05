"""Prims of a USD stage sorted by their meaning for physics: bodies and their parts, joints, lights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from orbit_assets.usd.library import pxr
from orbit_assets.usd.stage import Reading, applies, array, attribute, label, targets
from orbit_core.interfaces.errors import AssetError

FRAME = "orbit:frame"
"""Attribute that marks a named frame."""
ARTICULATION = "orbit:articulation"
"""Attribute that marks a prim whose name is that of the one articulation below it."""
MASSLESS = "orbit:massless"
"""Attribute that marks a body without mass, where UsdPhysics would compute one from its colliders."""
STAGE = "/"
"""Path of everything that does not move: the stage itself."""
_INSTANCES = "orbit_instance_"
# Prefixes of types and applied schemas that the description cannot hold, and their meaning.
_LACKING = {
    "PhysxDeformable": "a deformable body",
    "OmniPhysicsDeformable": "a deformable body",
    "OmniPhysicsVolumeDeformable": "a deformable body",
    "OmniPhysicsSurfaceDeformable": "a deformable body",
    "OmniPhysicsCurvesDeformable": "a deformable body",
    "PhysxParticle": "particles",
    "PhysxTendon": "a tendon",
    "PhysxVehicle": "a vehicle",
    "PhysxForceAPI": "a force of its own",
    "PhysxSurfaceVelocityAPI": "a surface that conveys",
    "PhysxPhysicsGearJoint": "a gear between joints",
    "PhysxPhysicsRackAndPinionJoint": "a rack and pinion between joints",
    "PhysxPhysicsAttachment": "an attachment",
    "MjcTendon": "a tendon",
}
# Attributes by applied schema that are left out with a note, for each engine treats them differently.
_SMALL = {
    "PhysxCollisionAPI": ("physxCollision:contactOffset", "physxCollision:restOffset"),
    "NewtonCollisionAPI": ("newton:contactMargin", "newton:contactGap"),
    "PhysicsRigidBodyAPI": ("physics:velocity", "physics:angularVelocity"),
    "PhysxRigidBodyAPI": ("physxRigidBody:linearDamping", "physxRigidBody:angularDamping"),
}


@dataclass(eq=False)
class Contents:
    """Prims of one stage, sorted by their meaning for physics."""

    bodies: dict[str, Any] = field(default_factory=dict)
    """Rigid bodies by path, in the stage's order."""
    parts: dict[str, list[Any]] = field(default_factory=dict)
    """Geometry and frames by the path of the body that carries them; :data:`STAGE` for static ones."""
    joints: list[Any] = field(default_factory=list)
    """Prims of joints."""
    actuators: list[Any] = field(default_factory=list)
    """Actuators of MuJoCo's schema."""
    lights: list[Any] = field(default_factory=list)
    """Prims of lights."""
    scene: Any = None
    """The first physics scene, or ``None``."""
    owners: dict[str, str] = field(default_factory=dict)
    """The path of the body that carries a prim, by the prim's path."""

    @property
    def static_colliders(self) -> list[Any]:
        """Colliders outside every rigid body."""
        return [prim for prim in self.parts.get(STAGE, []) if prim.HasAPI(pxr().UsdPhysics.CollisionAPI)]

    @property
    def geometry(self) -> list[Any]:
        """All geometric prims."""
        return [prim for parts in self.parts.values() for prim in parts if prim.IsA(pxr().UsdGeom.Gprim)]


def is_frame(prim: Any) -> bool:
    """Return True if a prim is a named frame: one of ORBIT's own, or a site of MuJoCo's or Newton's."""
    return bool(attribute(prim, FRAME, False)) or applies(prim, "MjcSiteAPI") or applies(prim, "NewtonSiteAPI")


def collect(reading: Reading) -> Contents:
    """Sort the stage's prims, with instancers expanded.

    Raises:
        AssetError: the stage holds more prims than the limits allow, an instancer of which the prototypes are missing,
            or something that the description lacks.
    """
    _set_out_instancers(reading)
    contents = Contents()
    for prim in _prims(reading):
        _sort(reading, contents, prim)
        _notice(reading, prim)
    return contents


def _prims(reading: Reading) -> Iterator[Any]:
    """Yield all prims of the stage except the prototypes of instancers."""
    prims = iter(pxr().Usd.PrimRange(reading.stage.GetPseudoRoot(), pxr().Usd.TraverseInstanceProxies()))
    most = reading.options.limits.elements
    for count, prim in enumerate(prims):
        if count > most:
            raise AssetError(f"the stage has over {most} prims: make it smaller, or raise ReadLimits.elements")
        if prim.IsPseudoRoot():
            # Children of an instancer are prototypes, which only their instances show.
            continue
        parent = prim.GetParent()
        if parent.GetTypeName() == "PointInstancer" and not prim.GetName().startswith(_INSTANCES):
            prims.PruneChildren()
            continue
        yield prim


def _sort(reading: Reading, contents: Contents, prim: Any) -> None:
    usd = pxr()
    path = str(prim.GetPath())
    owner = contents.owners.get(str(prim.GetPath().GetParentPath()), STAGE)
    if prim.HasAPI(usd.UsdPhysics.RigidBodyAPI) and attribute(prim, "physics:rigidBodyEnabled", True):
        contents.bodies[path] = prim
        owner = path
    contents.owners[path] = owner
    if prim.IsA(usd.UsdPhysics.Joint):
        contents.joints.append(prim)
    elif prim.IsA(usd.UsdGeom.Gprim) or is_frame(prim):
        contents.parts.setdefault(owner, []).append(prim)
    elif prim.GetTypeName() == "MjcActuator":
        contents.actuators.append(prim)
    elif prim.HasAPI(usd.UsdLux.LightAPI):
        contents.lights.append(prim)
    elif prim.IsA(usd.UsdPhysics.Scene) and contents.scene is None:
        contents.scene = prim


def _notice(reading: Reading, prim: Any) -> None:
    """Note or reject content of the prim that ORBIT leaves out."""
    kind = str(prim.GetTypeName())
    applied = [name.partition(":")[0] for name in prim.GetPrimTypeInfo().GetAppliedAPISchemas()]
    for name in (kind, *applied):
        for beginning, what in _LACKING.items():
            if name.startswith(beginning):
                reading.lack(f"{prim.GetPath()} is {what} ({name}), which descriptions cannot hold")
        for attribute_name in _SMALL.get(name, ()):
            found = prim.GetAttribute(attribute_name)
            if found and found.HasAuthoredValue() and found.Get() not in (0.0, pxr().Gf.Vec3f(0.0)):
                reading.note(f"{attribute_name} is left out everywhere, as on {prim.GetPath()}")
    if attribute(prim, "mjc:body:gravcomp", 0.0):
        reading.lack(f"{prim.GetPath()} is held up against gravity (mjc:body:gravcomp), which descriptions cannot hold")
    if kind == "PhysicsCollisionGroup":
        reading.note(f"the collision group {prim.GetPath()} is left out: its members collide as all others do")
    if prim.HasVariantSets():
        sets = prim.GetVariantSets()
        chosen = ", ".join(f"{name} = '{sets.GetVariantSelection(name)}'" for name in sets.GetNames())
        reading.note(f"{prim.GetPath()} has variants and is read as the file selects: {chosen}")


def _set_out_instancers(reading: Reading) -> None:
    """Expand each instance of a ``PointInstancer`` to a prim on the session layer, which is not saved."""
    stage, usd = reading.stage, pxr()
    every = usd.Usd.PrimRange(stage.GetPseudoRoot(), usd.Usd.TraverseInstanceProxies())
    instancers = [prim for prim in every if prim.IsA(usd.UsdGeom.PointInstancer)]
    if not instancers:
        return
    stage.SetEditTarget(stage.GetSessionLayer())
    made = 0
    for prim in instancers:
        if prim.IsInstanceProxy():
            raise AssetError(f"{prim.GetPath()} is an instancer within an instance: make the outer one a plain prim")
        made += _set_out(reading, prim, reading.options.limits.elements - made)


def _set_out(reading: Reading, prim: Any, most: int) -> int:
    """Expand at most ``most`` instances; return their number."""
    usd, stage = pxr(), reading.stage
    instancer = usd.UsdGeom.PointInstancer(prim)
    prototypes = targets(prim, "prototypes")
    indices = array(prim, "protoIndices", 1, int)
    if len(indices) > most:
        raise AssetError(f"{prim.GetPath()} draws {len(indices)} instances: draw fewer, or raise ReadLimits.elements")
    if len(indices) and not 0 <= indices.min() <= indices.max() < len(prototypes):
        raise AssetError(f"{prim.GetPath()} draws prototypes {indices.min()} to {indices.max()} of {len(prototypes)}")
    for path in prototypes:
        if not stage.GetPrimAtPath(path):
            raise AssetError(f"{prim.GetPath()} draws {path}, which the stage lacks: put it there")
    now = usd.Usd.TimeCode.Default()
    keep = usd.UsdGeom.PointInstancer
    # The mask is applied below, to keep the numbers of instances.
    transforms = instancer.ComputeInstanceTransformsAtTime(now, now, keep.IncludeProtoXform, keep.IgnoreMask)
    shown = instancer.ComputeMaskAtTime(now) or [True] * len(indices)
    if len(transforms) != len(indices):
        raise AssetError(f"{prim.GetPath()} has {len(indices)} indices and {len(transforms)} positions: give one each")
    for number, (index, transform, drawn) in enumerate(zip(indices, transforms, shown, strict=True)):
        if drawn:
            copy = stage.DefinePrim(prim.GetPath().AppendChild(f"{_INSTANCES}{number}"))
            copy.GetReferences().AddInternalReference(prototypes[index])
            copy.SetDisplayName(f"{label(stage.GetPrimAtPath(prototypes[index]))}_{number}")
            operations = usd.UsdGeom.Xformable(copy)
            operations.ClearXformOpOrder()
            operations.AddTransformOp(opSuffix="orbit").Set(transform)
    return len(indices)

"""Descriptions of scenes as plain typed data: no engine, no tensor library, no file format.

Units are SI, angles radians, z is up, quaternions are ``(w, x, y, z)``.
"""

# Modules below import one way: poses and shapes first, then articulations and actuators, entities, the scene last.
# None of them imports torch, so that listing robots and tasks stays fast.
from orbit_core.scene.actuators import (
    ActuatorConfig,
    ActuatorNetwork,
    DcMotor,
    IdealPd,
    ImplicitPd,
    Transmission,
    Windings,
    four_bar,
    linear_drive,
)
from orbit_core.scene.articulation import (
    Articulation,
    DriveGains,
    Frame,
    Joint,
    JointType,
    Link,
    LoopJoint,
    LoopType,
    Mimic,
    single_link,
)
from orbit_core.scene.deformables import (
    Attachment,
    Cloth,
    DeformableSpec,
    Fluid,
    KeyPoint,
    Region,
    Rope,
    SoftBody,
)
from orbit_core.scene.entities import (
    END_EFFECTOR,
    ActiveModel,
    DifferentialBase,
    EndEffector,
    Entity,
    Gripper,
    JointCommands,
    Lean,
    MagneticSeal,
    ObjectSpec,
    PlanarBase,
    RobotCategory,
    RobotSpec,
    Workspace,
)
from orbit_core.scene.pose import Pose, look_at
from orbit_core.scene.scene import (
    AmbientLight,
    DirectionalLight,
    Light,
    MarkerShape,
    MarkerSpec,
    Rgb,
    Scene,
    Sky,
    ghost,
)
from orbit_core.scene.sensors import (
    CameraSpec,
    Channel,
    ContactSensorSpec,
    EventCameraSpec,
    ForceTorqueSpec,
    FrameSensorSpec,
    ImuSpec,
    JointSensorSpec,
    Noise,
    RayCameraSpec,
    RayCasterSpec,
    SensorSpec,
    TactileSpec,
)
from orbit_core.scene.shapes import (
    Box,
    Capsule,
    Color,
    Compliance,
    Cylinder,
    Finish,
    Geometry,
    HeightField,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Plane,
    Shape,
    Sphere,
    Texture,
)
from orbit_core.scene.studio import STUDIO, Studio

__all__ = [
    "END_EFFECTOR", "STUDIO", "ActiveModel", "ActuatorConfig", "ActuatorNetwork", "AmbientLight", "Articulation",
    "Attachment", "Box", "CameraSpec", "Capsule", "Channel", "Cloth", "Color", "Compliance", "ContactSensorSpec",
    "Cylinder", "DcMotor", "DeformableSpec", "DifferentialBase", "DirectionalLight", "DriveGains", "EndEffector",
    "Entity", "EventCameraSpec", "Finish", "Fluid", "ForceTorqueSpec", "Frame", "FrameSensorSpec", "Geometry",
    "Gripper", "HeightField", "IdealPd", "ImplicitPd", "ImuSpec", "Joint", "JointCommands", "JointSensorSpec",
    "JointType", "KeyPoint", "Lean", "Light", "Link", "LoopJoint", "LoopType", "MagneticSeal", "MarkerShape",
    "MarkerSpec", "Mesh", "MeshCollision", "Mimic", "Noise", "ObjectSpec", "PhysicsMaterial", "PlanarBase", "Plane",
    "Pose", "RayCameraSpec", "RayCasterSpec", "Region", "Rgb", "RobotCategory", "RobotSpec", "Rope", "Scene",
    "SensorSpec", "Shape", "Sky", "SoftBody", "Sphere", "Studio", "TactileSpec", "Texture", "Transmission",
    "Windings", "Workspace", "four_bar", "ghost", "linear_drive", "look_at", "single_link",
]  # fmt: skip

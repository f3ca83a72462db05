"""What to simulate, as plain typed data: no engine, no tensor library, no file format.

Units are SI, angles radians, z is up, quaternions are ``(w, x, y, z)``.
"""

from orbit_core.scene.active import ActiveModel, MagneticSeal
from orbit_core.scene.actuators import ActuatorConfig, ActuatorNetwork, DcMotor, IdealPd, ImplicitPd
from orbit_core.scene.articulation import Articulation, Frame, Link, single_link
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
    DifferentialBase,
    EndEffector,
    Entity,
    Gripper,
    JointCommands,
    ObjectSpec,
    PlanarBase,
    RobotCategory,
    RobotSpec,
    Workspace,
)
from orbit_core.scene.joints import DriveGains, Joint, JointType, LoopJoint, LoopType, Mimic
from orbit_core.scene.lights import AmbientLight, DirectionalLight, Light, Rgb, Sky
from orbit_core.scene.markers import MarkerShape, MarkerSpec
from orbit_core.scene.materials import Color, Compliance, PhysicsMaterial
from orbit_core.scene.motors import Transmission, Windings, four_bar, linear_drive
from orbit_core.scene.pose import Pose, look_at
from orbit_core.scene.scene import Scene
from orbit_core.scene.sensors import (
    CameraSpec,
    Channel,
    ContactSensorSpec,
    ForceTorqueSpec,
    FrameSensorSpec,
    ImuSpec,
    JointSensorSpec,
    Noise,
    RayCasterSpec,
    SensorSpec,
)
from orbit_core.scene.shapes import (
    Box,
    Capsule,
    Cylinder,
    Geometry,
    HeightField,
    Mesh,
    MeshCollision,
    Plane,
    Shape,
    Sphere,
)
from orbit_core.scene.textures import Texture

__all__ = [
    "END_EFFECTOR", "ActiveModel", "ActuatorConfig", "ActuatorNetwork", "AmbientLight", "Articulation",
    "Attachment", "Box", "CameraSpec", "Capsule", "Channel", "Cloth", "Color", "Compliance", "ContactSensorSpec",
    "Cylinder", "DcMotor", "DeformableSpec", "DifferentialBase", "DirectionalLight", "DriveGains", "EndEffector",
    "Entity", "Fluid", "ForceTorqueSpec", "Frame", "FrameSensorSpec", "Geometry", "Gripper", "HeightField",
    "IdealPd", "ImplicitPd", "ImuSpec", "Joint", "JointCommands", "JointSensorSpec", "JointType", "KeyPoint",
    "Light", "Link", "LoopJoint", "LoopType", "MagneticSeal", "MarkerShape", "MarkerSpec", "Mesh", "MeshCollision",
    "Mimic", "Noise", "ObjectSpec", "PhysicsMaterial", "PlanarBase", "Plane", "Pose", "RayCasterSpec", "Region",
    "Rgb", "RobotCategory", "RobotSpec", "Rope", "Scene", "SensorSpec", "Shape", "Sky", "SoftBody", "Sphere",
    "Texture", "Transmission", "Windings", "Workspace", "four_bar", "linear_drive", "look_at", "single_link",
]  # fmt: skip

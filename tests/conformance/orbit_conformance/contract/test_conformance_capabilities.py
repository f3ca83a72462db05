"""Declarations: complete, with reasons, and true where a backend says that it cannot."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_conformance.bodies import cube, fixed, geared, index, pendulum, rotor, scene
from orbit_conformance.contract.fixtures import MakeEngine
from orbit_conformance.scenarios.linkages import four_bar
from orbit_core import backends
from orbit_core.interfaces import Backend, Capability, Engine, Level, UnsupportedCapabilityError, required_capabilities
from orbit_core.scene import (
    Cloth,
    Compliance,
    ContactSensorSpec,
    ForceTorqueSpec,
    HeightField,
    ImplicitPd,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Plane,
    Pose,
    RayCasterSpec,
    Scene,
    Shape,
    SoftBody,
    TactileSpec,
)

TETRAHEDRON = Mesh(
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
)
FIELD = Mesh(TETRAHEDRON.vertices, TETRAHEDRON.faces, MeshCollision.SIGNED_DISTANCE)
TRIANGLES = Mesh(TETRAHEDRON.vertices, TETRAHEDRON.faces, MeshCollision.TRIANGLES)

SCENES: dict[Capability, Callable[[], Scene]] = {
    Capability.CLOTH: lambda: Scene(deformables=(Cloth("cloth", TETRAHEDRON, 1.0),)),
    Capability.SOFT_BODIES: lambda: Scene(deformables=(SoftBody("soft", TETRAHEDRON, 1000.0),)),
    Capability.TRIANGLE_MESHES: lambda: scene(fixed("rock", TRIANGLES, Pose())),
    Capability.SIGNED_DISTANCE_FIELDS: lambda: scene(_with(cube(), Shape(FIELD))),
    Capability.DYNAMIC_TRIANGLE_MESHES: lambda: scene(_with(cube(), Shape(TRIANGLES))),
    Capability.CONVEX_MESHES: lambda: scene(_with(cube(), Shape(TETRAHEDRON))),
    Capability.HEIGHT_FIELDS: lambda: scene(cube(), terrain=(Shape(HeightField(np.zeros((3, 3)), (1.0, 1.0))),)),
    Capability.RESTITUTION: lambda: scene(cube(material=PhysicsMaterial(restitution=0.5))),
    Capability.STATIC_FRICTION: lambda: scene(cube(material=PhysicsMaterial(1.0, 0.5))),
    Capability.TORSIONAL_FRICTION: lambda: scene(cube(material=PhysicsMaterial(torsional_friction=0.02))),
    Capability.ROLLING_FRICTION: lambda: scene(cube(material=PhysicsMaterial(rolling_friction=0.001))),
    Capability.COMPLIANT_CONTACT: lambda: scene(cube(material=PhysicsMaterial(compliance=Compliance(1e3, 10.0)))),
    Capability.MIMIC_JOINTS: lambda: scene(geared(1.0, 0.0)),
    Capability.ARMATURE: lambda: scene(rotor(armature=0.1)),
    Capability.JOINT_DAMPING: lambda: scene(rotor(damping=0.1)),
    Capability.JOINT_FRICTION: lambda: scene(rotor(friction=0.1)),
    Capability.GRAVITY_COMPENSATION: lambda: scene(pendulum(gravity_compensation=True)),
    Capability.IMPLICIT_DRIVES: lambda: scene(rotor(actuators=(ImplicitPd(joints=(".*",), stiffness=1.0),))),
    Capability.SHAPES_PER_ENVIRONMENT: lambda: scene(replace(cube(), variants=(cube(half=0.1).articulation,))),
    Capability.CONTACT_FORCES: lambda: scene(cube(), sensors=(ContactSensorSpec(name="c", entity="cube"),)),
    Capability.FRICTION_FORCES: lambda: scene(
        cube(), sensors=(TactileSpec(name="t", entity="cube", frame="cube", shear=True),)
    ),
    Capability.JOINT_WRENCHES: lambda: scene(
        rotor(), sensors=(ForceTorqueSpec(name="w", entity="rotor", link="rotor"),)
    ),
    Capability.LOOP_WRENCHES: lambda: scene(
        four_bar("bar", (0.4, 0.3, 0.4, 0.3), (0.5, -0.5, 0.5)),
        sensors=(ForceTorqueSpec(name="w", entity="bar", link="rocker"),),
    ),
    Capability.RAY_CASTS: lambda: scene(
        cube(), sensors=(RayCasterSpec(name="r", entity="cube", frame="cube", directions=((0, 0, -1),)),)
    ),
}

CALLS: dict[Capability, Callable[[Engine], object]] = {
    Capability.EXTERNAL_WRENCHES: lambda engine: engine.set_wrenches(index(0), torch.zeros(1, 1, 6)),
    Capability.RANDOMIZE_MASS: lambda engine: engine.set_masses(index(0), torch.ones(1, 1)),
    Capability.RANDOMIZE_CENTER_OF_MASS: lambda engine: engine.set_centers_of_mass(index(0), torch.zeros(1, 1, 3)),
    Capability.RANDOMIZE_FRICTION: lambda engine: engine.set_friction(index(0), torch.ones(1, 1)),
    Capability.RANDOMIZE_GAINS: lambda engine: engine.set_drive_gains(index(0), torch.ones(1, 1), torch.ones(1, 1)),
    Capability.RANDOMIZE_JOINTS: lambda engine: engine.set_joint_parameters(
        index(0), torch.ones(1, 1), None, None, None
    ),
    Capability.RANDOMIZE_LIMITS: lambda engine: engine.set_joint_limits(index(0), torch.zeros(1, 1), torch.ones(1, 1)),
    Capability.RANDOMIZE_GRAVITY: lambda engine: engine.set_gravity(torch.zeros(1, 3)),
    Capability.RAY_CASTS: lambda engine: engine.cast_rays(torch.zeros(1, 1, 3), torch.ones(1, 1, 3), 1.0),
    Capability.CLOTH: lambda engine: engine.particle_positions(0),
}


def _with(thing, shape: Shape):
    import dataclasses

    link = dataclasses.replace(thing.articulation.root, collisions=(shape,))
    return dataclasses.replace(thing, articulation=dataclasses.replace(thing.articulation, links=(link,)))


def test_every_capability_is_declared(backend: Backend) -> None:
    missing = [capability.name for capability in Capability if capability not in backend.capabilities().declared]
    assert not missing


def test_names_and_versions(backend: Backend) -> None:
    assert backends.backend(backend.name) is backend
    assert all(backend.versions().values())
    assert backends.backend_config(backend) == backend.config_type()


@pytest.mark.parametrize("capability", SCENES, ids=lambda capability: capability.key)
def test_a_scene_is_taken_or_refused_as_declared(
    backend: Backend, make_engine: MakeEngine, capability: Capability
) -> None:
    """Declared capabilities build and step; others are refused before anything is built, with the reason."""
    asked = SCENES[capability]()
    assert capability in required_capabilities(asked)
    if backend.capabilities().has(capability):
        engine = make_engine(asked)
        engine.step(2)
        assert engine.link_poses.isfinite().all()
    else:
        with pytest.raises(UnsupportedCapabilityError) as refusal:
            backends.check_scene(backend, asked)
        assert backend.capabilities()[capability].reason in str(refusal.value)


@pytest.mark.parametrize("capability", CALLS, ids=lambda capability: capability.key)
def test_a_call_works_or_is_refused_as_declared(
    backend: Backend, make_engine: MakeEngine, capability: Capability
) -> None:
    supported = backend.capabilities().has(capability)
    engine = make_engine(SCENES[capability]() if supported and capability is Capability.CLOTH else scene(rotor()))
    if supported:
        CALLS[capability](engine)
        engine.step(1)
    else:
        with pytest.raises(UnsupportedCapabilityError):
            CALLS[capability](engine)


def test_what_is_not_honoured_exactly_is_reported(backend: Backend, make_engine: MakeEngine) -> None:
    """Each scene that needs an approximate capability of materials or joints leaves a line that names the thing."""
    for capability in (Capability.STATIC_FRICTION, Capability.RESTITUTION, Capability.COMPLIANT_CONTACT):
        if backend.capabilities()[capability].level is Level.APPROXIMATE:
            report = make_engine(SCENES[capability]()).build_report
            assert any("cube" in line.subject for line in report), capability
            assert all(line.asked and line.got and line.why for line in report)


def test_a_material_that_asks_for_no_more_than_the_default_needs_neither_torsional_nor_rolling_friction() -> None:
    """So that any scene may be made without a word of them, and simulates on every backend."""
    for material in (PhysicsMaterial(), PhysicsMaterial(torsional_friction=0.0, rolling_friction=0.0)):
        needs = required_capabilities(scene(cube(material=material)))
        assert not {Capability.TORSIONAL_FRICTION, Capability.ROLLING_FRICTION} & needs.keys()


def test_an_unlimited_velocity_is_reported(backend: Backend, make_engine: MakeEngine) -> None:
    if not backend.capabilities().has(Capability.VELOCITY_LIMITS):
        report = make_engine(scene(rotor(velocity_limit=2.0))).build_report
        assert any("velocity" in line.asked and "spin" in f"{line.subject} {line.asked}" for line in report)


def test_nothing_is_reported_for_a_scene_that_is_honoured(make_engine: MakeEngine) -> None:
    assert make_engine(scene(rotor(), cube(), terrain=(Shape(Plane()),))).build_report == ()


def test_importing_a_plugin_does_not_import_its_engine(backend: Backend) -> None:
    distributions = sorted(backend.versions())
    code = (
        "import sys; from orbit_core import backends; "
        f"backends.backend({backend.name!r}).capabilities(); print([n for n in {distributions} if n in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"

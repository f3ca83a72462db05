"""Gains that diverge are told from those that do not, sharply, and what is told to be stable is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orbit_core.actuators.stability import ExplicitGains, unstable_drive
from orbit_core.dynamics.rigid_body import workspace_mass_matrices
from orbit_core.scene import Articulation, Joint, JointType, Link, Mimic, Pose

STEP = 0.01


def chain(masses: tuple[float, ...] = (2.0,), **changes: object) -> Articulation:
    """Bars 0.4 m long, hinged to each other about y, that can hardly leave the straight line."""
    links, joints = [Link("base")], []
    for index, mass in enumerate(masses):
        inertia = np.eye(3) * mass * 0.01
        place = Pose((0.4 if index else 0.0, 0.0, 0.0))
        links.append(Link(f"bar{index}", mass, (0.2, 0.0, 0.0), inertia))
        joints.append(Joint(f"joint{index}", JointType.REVOLUTE, links[-2].name, links[-1].name, place,
                            axis=(0.0, 1.0, 0.0), lower_limit=-1e-3, upper_limit=1e-3))  # fmt: skip
    return Articulation("chain", tuple(links), tuple(replace(joint, **changes) for joint in joints))


def gains(*stiffness: float, damping: float = 0.0, implicit: float = 0.0) -> ExplicitGains:
    """Damping as a multiple (s) of stiffness where there is any, else N m s/rad."""
    values = np.array(stiffness)
    return ExplicitGains(
        stiffness=values,
        damping=values * damping,
        implicit_damping=np.full(len(values), implicit),
    )


def found_in(body: Articulation, asked: ExplicitGains, step: float = STEP, **changes: bool):
    armature = np.array([joint.armature for joint in body.movable_joints])
    return unstable_drive(body, asked, armature, step, **{"fixed_base": True, **changes})


def growth(body: Articulation, asked: ExplicitGains, step: float = STEP, free_root: bool = False) -> float:
    """The most by which a motion grows per step: the spectral radius of the map of one step, in a straight line."""
    mass = workspace_mass_matrices(body, free_root=free_root)[0]
    base = 6 if free_root else 0
    k, d, c = (
        np.diag(np.concatenate((np.zeros(base), values)))
        for values in (asked.stiffness, asked.damping, asked.implicit_damping)
    )
    inverse = np.linalg.inv(mass + step * c)
    faster = np.block([-step * inverse @ k, inverse @ (mass - step * d)])
    further = np.concatenate((np.eye(len(mass)), np.zeros_like(mass)), 1) + step * faster
    return float(np.abs(np.linalg.eigvals(np.concatenate((further, faster)))).max())


@pytest.mark.parametrize("implicit", [0.0, 5.0])
@pytest.mark.parametrize("damping", [0.0, 0.002, 0.05])
@pytest.mark.parametrize("masses", [(2.0,), (2.0, 0.02), (1.0, 1.0, 0.1)])
def test_the_limit_is_where_steps_begin_to_diverge(masses: tuple[float, ...], damping: float, implicit: float) -> None:
    body = chain(masses)
    much = np.full(len(masses), 1e7)
    edge = found_in(body, gains(*much, damping=damping, implicit=implicit))
    assert edge is not None
    for factor, diverges in ((0.98, False), (1.02, True)):
        asked = gains(*much * edge.share * factor, damping=damping, implicit=implicit)
        found = found_in(body, asked)
        assert (found is not None) is diverges
        assert (growth(body, asked) > 1.0 + 1e-9) is diverges


def test_the_step_that_is_told_is_the_longest_that_is_stable() -> None:
    body, asked = chain((2.0, 0.02)), gains(300.0, 300.0, damping=0.01)
    found = found_in(body, asked)
    assert found is not None
    assert found.time_step < STEP
    assert found_in(body, asked, 0.99 * found.time_step) is None
    assert growth(body, asked, 0.99 * found.time_step) <= 1.0 + 1e-9
    assert growth(body, asked, 1.01 * found.time_step) > 1.0


def test_the_joint_that_diverges_is_named() -> None:
    found = found_in(chain((2.0, 0.02)), gains(300.0, 30.0, damping=0.1))
    assert found is not None
    assert (found.joint, found.stiffness, found.damping) == ("joint1", 30.0, pytest.approx(3.0))
    found = found_in(chain((2.0, 0.02)), gains(1e6, 1e-6))
    assert found is not None
    assert found.joint == "joint0"


def test_armature_steadies_a_drive() -> None:
    asked = gains(2000.0, 2000.0)
    assert found_in(chain((2.0, 0.02)), asked) is not None
    assert found_in(chain((2.0, 0.02), armature=0.1), asked) is None


def test_a_base_that_is_free_to_move_adds_less_inertia_than_one_that_is_held() -> None:
    body = chain((2.0,))
    body = replace(body, links=(replace(body.root, mass=0.5, inertia=np.eye(3) * 1e-3), *body.links[1:]))
    held, free = (found_in(body, gains(1e7), fixed_base=fixed) for fixed in (True, False))
    assert held is not None
    assert free is not None
    assert free.share < 0.5 * held.share
    for factor, diverges in ((0.98, False), (1.02, True)):
        grown = growth(body, gains(1e7 * free.share * factor), free_root=True)
        assert (grown > 1.0 + 1e-6) is diverges


def test_followers_add_their_inertia_to_their_leader() -> None:
    body = chain((2.0, 2.0))
    follower = replace(body.joints[1], parent="base", parent_pose=Pose(), mimic=Mimic("joint0", 2.0))
    body = replace(body, joints=(body.joints[0], follower))
    alone, together = found_in(chain((2.0,)), gains(1e7)), found_in(body, gains(1e7, 1e9))
    assert alone is not None
    assert together is not None
    assert together.share == pytest.approx(5.0 * alone.share, rel=1e-3)


def test_without_gains_nothing_diverges() -> None:
    assert found_in(chain(), gains(0.0)) is None

"""Contacts with height fields against MuJoCo's own, on fields of random heights."""

# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportPrivateUsage=false

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import mujoco_warp as mjw
import numpy as np
import numpy.typing as npt
import pytest
import warp as wp

from orbit_warp.field_contacts import FieldContacts

_POSES = 200


@dataclass
class Contact:
    distance: float
    position: npt.NDArray[np.float64]
    normal: npt.NDArray[np.float64]
    material: tuple[tuple[float, ...], ...]


def _model(shape: str, height: float) -> mujoco.MjModel:
    """A free shape over a field that is turned, whose heights are random up to that height (m)."""
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><asset><hfield name="field" nrow="21" ncol="25" size="1.2 1.0 {height} 0.3"/></asset><worldbody>
        <body><freejoint/><geom {shape} friction="0.7 0.02 0.001" condim="4"/></body>
        <geom type="hfield" hfield="field" pos="0.1 -0.2 0.3" euler="0 0 30" solref="0.05 1" friction="0.4"/>
        </worldbody></mujoco>""")
    model.hfield_data[:] = np.random.default_rng(0).random(model.nhfielddata)
    return model


def _poses(model: mujoco.MjModel, lowest: float, highest: float) -> npt.NDArray[np.float32]:
    """Random poses whose origins are so high above the surface."""
    rng, data = np.random.default_rng(1), mujoco.MjData(model)
    data.qpos[2] = 9.0
    mujoco.mj_forward(model, data)
    poses = np.zeros((_POSES, 7), dtype=np.float32)
    for pose in poses:
        x, y = rng.uniform(-0.5, 0.5, 2)
        down = mujoco.mj_ray(model, data, [x, y, 4.0], [0.0, 0.0, -1.0], None, 1, 1, np.zeros(1, dtype=np.int32))
        turn = rng.normal(size=4)
        pose[:] = [x, y, 4.0 - down + rng.uniform(lowest, highest), *(turn / np.linalg.norm(turn))]
    return poses


def _found(model: mjw.Model, host: mujoco.MjModel, poses: npt.NDArray[np.float32]) -> list[list[Contact]]:
    data = mjw.make_data(host, nworld=len(poses), nconmax=30, njmax=10)
    data.qpos = wp.array(poses, dtype=float)
    FieldContacts.replace(model, data)
    mjw.kinematics(model, data)
    mjw.collision(model, data)
    contact, count = data.contact, int(data.nacon.numpy()[0])
    columns = (contact.dist, contact.pos, contact.frame, contact.friction, contact.solref, contact.dim, contact.geom)
    of_poses: list[list[Contact]] = [[] for _ in poses]
    for env, distance, position, frame, *rest in zip(
        contact.worldid.numpy()[:count], *(column.numpy()[:count] for column in columns), strict=True
    ):
        of_poses[env].append(Contact(distance, position, frame[0], _rounded(*rest)))
    return of_poses


def _rounded(*values: npt.ArrayLike) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(round(float(number), 5) for number in np.atleast_1d(value)) for value in values)


def _on_device(host: mujoco.MjModel) -> mjw.Model:
    model = mjw.put_model(host)
    model.opt.warn_overflow = 0
    return model


def _of_mujoco(model: mujoco.MjModel, poses: npt.NDArray[np.float32]) -> list[list[Contact]]:
    data, of_poses = mujoco.MjData(model), list[list[Contact]]()
    for pose in poses:
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        of_poses.append(
            [
                Contact(
                    one.dist,
                    one.pos.copy(),
                    one.frame[:3].copy(),
                    _rounded(one.friction, one.solref, one.dim, one.geom),
                )
                for one in data.contact[: data.ncon]
            ]
        )
    return of_poses


@pytest.mark.parametrize(("radius", "height"), [(0.03, 0.1), (0.03, 0.4), (0.25, 0.1)])
def test_the_deepest_contact_of_a_sphere_is_mujocos(radius: float, height: float) -> None:
    host = _model(f'type="sphere" size="{radius}"', height)
    poses = _poses(host, 0.2 * radius, 1.3 * radius)
    touching = 0
    for theirs, ours in zip(_of_mujoco(host, poses), _found(_on_device(host), host, poses), strict=True):
        assert bool(theirs) == bool(ours)
        if not theirs:
            continue
        touching += 1
        deepest, own = (min(contacts, key=lambda contact: contact.distance) for contacts in (theirs, ours))
        assert own.distance == pytest.approx(deepest.distance, abs=1e-5)
        assert own.material == deepest.material
        for contact in ours:  # those that are not the deepest are among MuJoCo's too
            assert any(
                np.allclose(contact.normal, one.normal, atol=1e-3)
                and np.allclose(contact.position, one.position, atol=1e-3)
                for one in theirs
            )
    assert touching > _POSES // 3


def test_a_sphere_on_a_slope_has_one_contact() -> None:
    """The rims of the triangles beside that under it do not push, as MuJoCo's do."""
    host = _model('type="sphere" size="0.03"', 0.3)
    host.hfield_data[:] = np.tile(np.linspace(0.0, 1.0, 25), 21)
    poses = _poses(host, 0.01, 0.029)
    across = 1.0 / np.hypot(1.0, 0.3 / 2.4)
    turned = np.array([-0.3 / 2.4 * np.cos(np.pi / 6), -0.3 / 2.4 * np.sin(np.pi / 6), 1.0]) * across
    for (contact,), theirs in zip(_found(_on_device(host), host, poses), _of_mujoco(host, poses), strict=True):
        np.testing.assert_allclose(contact.normal, turned, atol=1e-5)
        assert contact.distance == pytest.approx(min(one.distance for one in theirs), abs=1e-5)


@pytest.mark.parametrize(("up", "contacts"), [(1.0, 2), (-1.0, 1)])
def test_a_sphere_touches_both_sides_of_a_valley_and_the_rim_of_a_ridge_once(up: float, contacts: int) -> None:
    host = _model('type="sphere" size="0.03"', 0.3)
    host.hfield_data[:] = np.tile(0.5 + up * (np.abs(np.linspace(-1.0, 1.0, 25)) - 0.5), 21)
    slope = 0.3 / 1.2
    bottom = np.array([0.1, -0.2, 0.3 + (0.0 if up > 0 else 0.3)])
    height = 0.029 * (np.hypot(1.0, slope) if up > 0 else 1.0)
    poses = np.tile(np.array([0, 0, 0, 1, 0, 0, 0], dtype=np.float32), (20, 1))
    along = np.array([-0.5, np.cos(np.pi / 6), 0.0])  # the field's y
    poses[:, :3] = bottom + np.linspace(-0.4, 0.4, 20)[:, None] * along + [0.0, 0.0, height]
    for found in _found(_on_device(host), host, poses):
        assert len(found) == contacts
        for contact in found:
            assert contact.distance == pytest.approx(-0.001, abs=1e-5)
            assert contact.normal[2] == pytest.approx(1.0 / np.hypot(1.0, slope) if up > 0 else 1.0, abs=1e-4)
        np.testing.assert_allclose(sum(contact.normal[:2] for contact in found), 0.0, atol=1e-4)


def test_a_sphere_whose_center_is_below_the_surface_is_pushed_out_by_the_nearest_way() -> None:
    host = _model('type="sphere" size="0.03"', 0.05)
    poses = _poses(host, -0.02, -0.001)
    for (contact,) in _found(_on_device(host), host, poses):
        assert -0.051 < contact.distance < -0.03
        assert contact.normal[2] > 0.5


def test_other_shapes_touch_where_mujocos_do_and_few_are_searched() -> None:
    """How deep they are, a search in single precision tells badly: seen from the world it would be off by 8 mm here."""
    host = _model('type="box" size="0.03 0.05 0.02"', 0.15)
    poses = _poses(host, 0.02, 0.1)
    model = _on_device(host)
    ours, theirs = _found(model, host, poses), _of_mujoco(host, poses)
    fields = model.callback.contactfilter
    assert isinstance(fields, FieldContacts)
    near = int(fields._near.count.numpy()[0])
    touching = [bool(contacts) for contacts in theirs]
    assert [bool(contacts) for contacts in ours] == touching
    assert _POSES // 3 < sum(touching) <= near < 0.8 * _POSES
    depths, exact = (
        np.array([min(contact.distance for contact in contacts) for contacts in all_of if contacts])
        for all_of in (ours, theirs)
    )
    assert np.median(np.abs(depths - exact)) < 1e-5
    assert np.abs(depths - exact).mean() < 6e-3

"""The solver in one launch does what MuJoCo-Warp's loop over launches does, of which it must be a copy."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportPrivateUsage=false

from __future__ import annotations

import hashlib
import inspect
from dataclasses import dataclass

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import torch
import warp as wp
from mujoco_warp._src import solver

from orbit_core.envs import make
from orbit_warp.engine import WarpEngine
from orbit_warp.fused_solver import FusedSolver, is_fit
from orbit_warpkit.start import start

WORLDS = 16
# An arm with limits, dry friction, a mimic joint and contacts of one to six rows, and two boxes on each other.
SCENE = """
<mujoco>
  <option cone="{cone}" iterations="{iterations}" integrator="{integrator}" jacobian="{jacobian}" solver="{solver}"/>
  <worldbody>
    <geom type="plane" size="2 2 .1"/>
    <body pos="0 0 .3">
      <joint name="a" axis="0 1 0" range="-0.2 0.2" limited="true" frictionloss="0.3"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
      <body pos=".3 0 0">
        <joint name="b" axis="0 1 0" frictionloss="0.1"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" condim="4"/>
        <body pos=".3 0 0">
          <joint name="c" type="slide" axis="1 0 0" range="-0.05 0.05" limited="true"/>
          <geom type="sphere" size=".05" condim="6"/>
        </body>
      </body>
    </body>
    <body pos="0.2 0.3 .06"><freejoint/><geom type="box" size=".05 .05 .05"/></body>
    <body pos="0.2 0.3 .16"><freejoint/><geom type="box" size=".05 .05 .05" friction="0.3 .01 .001"/></body>
  </worldbody>
  <equality><joint joint1="a" joint2="b" polycoef="0 0.5 0 0 0"/></equality>
</mujoco>
"""
# Digests of MuJoCo-Warp's functions that the kernel repeats, of version 3.17.0.
REPEATED = {
    "solve": "912386ccde41ccd7",
    "_solve": "ccdbc0e66f703d1c",
    "init_context": "23f465d379eacc54",
    "_solver_iteration": "d7062671c414eb9c",
    "_linesearch": "9cceb63f07acf9fd",
    "_linesearch_iterative_kernel": "4490674f92f7b24a",
    "_solve_init_dof": "e4181ee9d37d22f6",
    "_solve_init_jaref_kernel": "f47f3a9781e6ed4a",
    "_inertia_scale": "be18ba04d5f12eb8",
    "_update_constraint": "bb3241b42b78170d",
    "_update_constraint_efc": "312cecd678d2b7c8",
    "_update_constraint_init_qfrc_constraint_dense": "834dda8948f8799b",
    "_qfrc_constraint_from_grad": "b0ce829e007d87e1",
    "_update_gradient": "b14bd774cda8511c",
    "_update_gradient_incremental": "322af375a2aa7776",
    "_update_gradient_zero_grad_dot": "501b70a04bd1dddf",
    "_update_gradient_grad": "ddc637ad5ebba5c5",
    "_update_gradient_JTDAJ_dense_tiled": "e2b8e2642cd33ea2",
    "_update_gradient_JTCJ_dense": "6098f14cded6eaec",
    "_update_gradient_cholesky": "85293d80abe9d74e",
    "_solve_done": "f691f485dcca90ff",
}


@dataclass
class Solved:
    """Results of a solver, of rows in use."""

    acceleration: np.ndarray
    constraint_force: np.ndarray
    momentum: np.ndarray
    force: list[np.ndarray]
    state: list[np.ndarray]
    rounds: np.ndarray
    overflow: np.ndarray

    @staticmethod
    def of(data: mjw.Data) -> Solved:
        counts, efc = data.nefc.numpy(), data.efc
        force, state = (
            [row[:count].copy() for row, count in zip(array.numpy(), counts, strict=True)]
            for array in (efc.force, efc.state)
        )
        arrays = (data.qacc, data.qfrc_constraint, efc.Ma)
        rounds, overflow = data.solver_niter.numpy().copy(), data.overflow.numpy().copy()
        return Solved(*(array.numpy().copy() for array in arrays), force, state, rounds, overflow)


def model_of(**options: object) -> tuple[mjw.Model, mjw.Data]:
    """The scene with bodies near and in each other and in motion."""
    start()
    settings = {"cone": "elliptic", "iterations": 30, "integrator": "implicitfast", "jacobian": "dense"}
    host = mujoco.MjModel.from_xml_string(SCENE.format(**{"solver": "Newton", **settings, **options}))
    model = mjw.put_model(host)
    model.opt.warn_overflow = 0
    data = mjw.make_data(host, nworld=WORLDS, nconmax=40, njmax=160)
    random = np.random.default_rng(0)
    positions = data.qpos.numpy()
    positions[:, :3] = random.normal(0.0, 0.3, (WORLDS, 3))
    positions[:, 5] = random.uniform(0.03, 0.08, WORLDS)
    positions[:, 12] = positions[:, 5] + random.uniform(0.08, 0.1, WORLDS)
    positions[:, 6:10] += random.normal(0.0, 0.1, (WORLDS, 4))
    positions[:, 6:10] /= np.linalg.norm(positions[:, 6:10], axis=1, keepdims=True)
    data.qpos.assign(positions)
    data.qvel.assign(random.normal(0.0, 0.5, data.qvel.shape))
    return model, data


def solved_fused(model: mjw.Model, data: mjw.Data, monkeypatch: pytest.MonkeyPatch) -> Solved:
    """Solve the present constraints again with 32 fibers for each world."""
    for array in (data.qacc, data.qfrc_constraint, data.efc.Ma, data.efc.force):
        array.fill_(123.0)
    data.efc.state.fill_(0)
    data.overflow.zero_()
    with monkeypatch.context() as patch:
        patch.setattr(wp.config, "enable_cpu_blocks", True)
        FusedSolver(model, data).solve(model, data)
    return Solved.of(data)


@pytest.mark.parametrize(("cone", "iterations"), [("elliptic", 30), ("pyramidal", 30), ("elliptic", 3)])
def test_one_launch_solves_as_mujoco_warp_does(cone: str, iterations: int, monkeypatch: pytest.MonkeyPatch) -> None:
    model, data = model_of(cone=cone, iterations=iterations)
    assert is_fit(model, data)
    for _ in range(3):
        mjw.step(model, data)
    data.overflow.zero_()
    mjw.forward(model, data)
    theirs = Solved.of(data)
    mine = solved_fused(model, data, monkeypatch)
    assert theirs.rounds.max() >= min(iterations, 5)
    np.testing.assert_array_equal(mine.rounds, theirs.rounds)
    np.testing.assert_array_equal(mine.overflow, theirs.overflow)
    # All states occur: satisfied, quadratic, both slidings of dry friction and, if there are cones, their surface.
    seen = set(np.concatenate(theirs.state).tolist())
    assert seen == ({0, 1, 2, 3, 4} if cone == "elliptic" else {0, 1, 2, 3})
    for world in range(WORLDS):
        np.testing.assert_array_equal(mine.state[world], theirs.state[world])
        pairs = [(mine.force[world], theirs.force[world])]
        for name in ("acceleration", "constraint_force", "momentum"):
            pairs.append((getattr(mine, name)[world], getattr(theirs, name)[world]))
        for its, other in pairs:
            np.testing.assert_allclose(its, other, rtol=0.0, atol=1e-4 * np.abs(other).max())


@pytest.mark.parametrize(
    "options", [{"solver": "CG"}, {"jacobian": "sparse"}, {"integrator": "discrete"}, {"iterations": 0}]
)
def test_what_one_launch_cannot_solve_is_left_to_mujoco_warp(options: dict[str, object]) -> None:
    assert not is_fit(*model_of(**options))


def test_more_degrees_of_freedom_than_lanes_are_left_to_mujoco_warp() -> None:
    start()
    bodies = '<body><freejoint/><geom size=".1"/></body>' * 6
    host = mujoco.MjModel.from_xml_string(f'<mujoco><option jacobian="dense"/><worldbody>{bodies}</worldbody></mujoco>')
    assert not is_fit(mjw.put_model(host), mjw.make_data(host, njmax=10))


def test_steps_of_its_data_are_solved_here_within_the_context(monkeypatch: pytest.MonkeyPatch) -> None:
    (model, data), (_, other) = model_of(), model_of()
    theirs, asked = solver.solve, []
    monkeypatch.setattr("orbit_warp.fused_solver._solve", lambda _, data: asked.append(id(data)))
    fused = FusedSolver(model, data)
    with fused.installed():
        assert solver.solve == fused.solve
        solver.solve(model, other)
    assert asked == [id(other)]
    assert solver.solve != fused.solve
    solver.solve = theirs


def test_a_cpu_keeps_the_solver_of_mujoco_warp() -> None:
    environment = make("Reach", 2, "warp")
    environment.step(torch.zeros(2, environment.action_size))
    engine = environment.world.engine
    assert isinstance(engine, WarpEngine)
    assert engine._solver is None
    environment.close()


def test_the_functions_that_the_kernel_repeats_are_those_it_was_written_from() -> None:
    """Compare MuJoCo-Warp's source: whoever changes its version must look at what changed in its solver."""
    for name, digest in REPEATED.items():
        source = inspect.getsource(getattr(solver, name))
        assert hashlib.sha256(source.encode()).hexdigest()[:16] == digest, f"{name} of MuJoCo-Warp changed"

"""Newton's method of MuJoCo-Warp in one launch, in the place of its loop over launches."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportPrivateUsage=false
# pyright: reportGeneralTypeIssues=false
# Warp's structures are classes to it alone.

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import mujoco_warp as mjw
import warp as wp
from mujoco_warp._src import solver, types

from orbit_warp.lanes import LANES
from orbit_warp.solver_arrays import Contacts, Found, Inertia, Limits, Rows, Work
from orbit_warp.solver_kernel import solver_kernel

# MuJoCo-Warp's own.
_solve = solver.solve


class FusedSolver:
    """Solves the constraints of each world in a block of its own, which goes on until that world has converged.

    MuJoCo-Warp launches some ten kernels over all worlds for each round of the world that needs most rounds.

    Args:
        model: the model; :func:`is_fit` says whether it can be solved so.
        data: its data, whose arrays must stay where they are.
    """

    def __init__(self, model: mjw.Model, data: mjw.Data) -> None:
        self._data = data
        elliptic = model.opt.cone == types.ConeType.ELLIPTIC
        self._kernel = solver_kernel(elliptic, model.opt.ls_iterations)
        self._warm = not model.opt.disableflags & types.DisableBit.WARMSTART
        worlds, rows, padded = data.nworld, data.njmax, data.efc.J.shape[2]
        self._work = work = Work()
        work.vector = wp.zeros((worlds, padded), dtype=float)
        work.hessian = wp.zeros((worlds, padded, padded), dtype=float)
        work.residual, work.slope = (wp.zeros((worlds, rows), dtype=float) for _ in range(2))
        work.quad = wp.zeros((worlds, rows if elliptic else 0), dtype=wp.vec3)

    def solve(self, model: mjw.Model, data: mjw.Data) -> None:
        """Do what ``mujoco_warp._src.solver.solve`` does, and for other data than this one's let that do it."""
        if data is not self._data:  # of an engine that steps in another thread
            _solve(model, data)
            return
        wp.launch_tiled(
            self._kernel,
            dim=data.nworld,
            inputs=[
                model.nv, self._warm, _limits(model), _inertia(model, data), _rows(data), _contacts(data),
                data.qacc_warmstart, data.qacc_smooth, data.qfrc_smooth, self._work,
            ],
            outputs=[_found(data)],
            block_dim=LANES,
        )  # fmt: skip
        if model.opt.noslip_iterations > 0:
            solver.noslip(model, data)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Let MuJoCo-Warp's steps within this context be solved here."""
        solver.solve = self.solve
        try:
            yield
        finally:
            solver.solve = _solve


def is_fit(model: mjw.Model, data: mjw.Data) -> bool:
    """Return True if a model is one that :class:`FusedSolver` solves: by Newton's method, with a dense Jacobian.

    MuJoCo-Warp's Jacobians are dense up to 32 degrees of freedom, one for each lane.
    """
    options = model.opt
    return (
        options.solver == types.SolverType.NEWTON
        and not model.is_sparse
        and 0 < model.nv <= LANES
        and data.njmax > 0
        and options.iterations > 0
        and options.integrator != types.IntegratorType.DISCRETE
        and not options.enableflags & types.EnableBit.SLEEP
    )


def _limits(model: mjw.Model) -> Limits:
    limits, options = Limits(), model.opt
    limits.iterations = options.iterations
    limits.tolerance, limits.line_tolerance = options.tolerance, options.ls_tolerance
    limits.narrowing = options.impratio_invsqrt
    return limits


def _inertia(model: mjw.Model, data: mjw.Data) -> Inertia:
    inertia = Inertia()
    inertia.values, inertia.rows, inertia.columns = data.M, model.M_hinit_i, model.M_colind
    inertia.starts, inertia.row_entries = model.M_mulm_rowadr, model.M_mulm_madr
    inertia.row_columns = model.M_mulm_col
    inertia.diagonal_starts, inertia.diagonal_counts = model.M_rowadr, model.M_rownnz
    return inertia


def _rows(data: mjw.Data) -> Rows:
    rows, efc = Rows(), data.efc
    rows.most, rows.equalities, rows.frictions, rows.counts = data.njmax, data.ne, data.nf, data.nefc
    rows.kinds, rows.ids, rows.jacobian, rows.stiffness = efc.type, efc.id, efc.J, efc.D
    rows.reference, rows.friction_bounds = efc.aref, efc.frictionloss
    return rows


def _contacts(data: mjw.Data) -> Contacts:
    contacts, contact = Contacts(), data.contact
    contacts.count, contacts.friction, contacts.dimensions = data.nacon, contact.friction, contact.dim
    contacts.addresses, contacts.distances = contact.efc_address, contact.dist
    contacts.margins = contact.includemargin
    return contacts


def _found(data: mjw.Data) -> Found:
    found = Found()
    found.force, found.state, found.momentum = data.efc.force, data.efc.state, data.efc.Ma
    found.acceleration, found.constraint_force = data.qacc, data.qfrc_constraint
    found.rounds, found.overflow = data.solver_niter, data.overflow
    return found

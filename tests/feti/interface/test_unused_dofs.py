# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Dofs of the assembled problem that no subdomain has are refused, unless they are prescribed."""

from petsc4py import PETSc

import numpy as np
from cases import case, each, every_formulation, every_type
from collective import agree, equal
from hand_torn import dofs_of, grid, random_values, solve, tear

from dolfinx_feti.scalars.border import Border
from dolfinx_feti.scalars.bordered import BorderedSolver

#: Nodes of the numbering, of 25 with the 20 that are used, that no cell has.
UNUSED = {
    "first": [0],
    "last": [24],
    "both ends": [0, 24],
    "inside": [7, 8, 13],
    "the last process": list(range(20, 45)),
    "the first process": list(range(25)),
}
every_place = each("unused", UNUSED)
BODIES = {
    "heat": case((2, 2), (2, 1), 1),
    "elasticity": case((2, 2), (2, 1), 2),
    "one subdomain": case((1, 1), (4, 2), 2),
}
every_body = each("body", BODIES)


def with_unused_nodes(body, unused, lifetime, *, prescribed):
    """Number the nodes of a grid with gaps; return the problem and the mask of the unused dofs."""
    plain = lifetime.own(grid(**body))
    n = len(plain.x) + len(unused)
    bs = body["components"]
    used = np.setdiff1d(np.arange(n), unused)[: len(plain.x)]
    rows = dofs_of(used, bs)
    x = np.zeros((n, plain.x.shape[1]))
    x[used] = plain.x
    modes = np.zeros((n * bs, plain.modes.shape[1]))
    modes[rows] = plain.modes
    is_unused = np.ones(n * bs, dtype=bool)
    is_unused[rows] = False
    dirichlet = is_unused & prescribed
    dirichlet[rows] = plain.dirichlet
    problem = tear(plain.K, [rows[dofs] for dofs in plain.dofs], x, modes, dirichlet)
    return lifetime.own(problem), is_unused


@every_formulation
@every_place
@every_body
def test_unused_dofs_are_refused_on_all_processes(body, unused, formulation, lifetime, create_ksp):
    """The message has their count, the first one, and the remedy."""
    problem, is_unused = with_unused_nodes(body, unused, lifetime, prescribed=False)
    ksp = create_ksp(problem.A, feti_formulation=formulation)
    reason, _ = solve(ksp, problem, random_values(problem))
    message = ksp.getPythonContext().message
    agree(reason == PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED)
    count = np.count_nonzero(is_unused)
    first = np.flatnonzero(is_unused)[0]
    expected = f"entry for {count} of the {len(is_unused)} dofs, the first of which is {first}:"
    agree(expected in message, message)
    agree("dirichlet= of create_torn_matrix" in message, message)


@every_formulation
def test_torn_dof_without_entries_is_refused(formulation, torn_grid, lifetime, create_ksp):
    """A local numbering may have rows that no element of the subdomain has filled."""
    plain = torn_grid((2, 2), (2, 1))
    n = len(plain.x)
    x = np.vstack([plain.x, np.zeros((1, 2))])
    modes = np.ones((n + 1, 1))
    dirichlet = np.append(plain.dirichlet, False)
    blocks = [*plain.K, np.zeros((1, 1))]
    dofs = [*plain.dofs, np.array([n])]
    problem = lifetime.own(tear(blocks, dofs, x, modes, dirichlet, only_nonzeros=True))
    ksp = create_ksp(problem.A, feti_formulation=formulation)
    reason, _ = solve(ksp, problem, random_values(problem))
    message = ksp.getPythonContext().message
    agree(reason == PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED)
    agree(f"for 1 of the {n + 1} dofs, the first of which is {n}:" in message, message)


@every_formulation
@every_type
@every_place
@every_body
def test_prescribed_unused_dofs_have_their_values(
    body, unused, kind, formulation, lifetime, create_ksp
):
    """A Dirichlet condition determines a dof that no subdomain has."""
    problem, is_unused = with_unused_nodes(body, unused, lifetime, prescribed=True)
    values = random_values(problem)
    ksp = create_ksp(problem.A, feti_type=kind, feti_formulation=formulation, ksp_rtol=1e-11)
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x[is_unused], values[is_unused])
    equal(x, problem.solve(values), 1e-8)


@every_place
def test_unused_dofs_are_refused_beside_scalars(unused, lifetime, create_ksp):
    """The search for free rigid motions, before the set-up, must not fail on them."""
    problem, _ = with_unused_nodes(BODIES["elasticity"], unused, lifetime, prescribed=False)
    ksp = create_ksp(problem.A)
    solver = BorderedSolver()
    rows = slice(*problem.A.getOwnershipRange())
    b = random_values(problem)
    border = Border(b[rows, None], b[rows, None], np.zeros((1, 1)))
    solver.solve(ksp, problem.A, b[rows], border, np.ones(1))
    agree(ksp.getConvergedReason() < 0)
    agree("No subdomain has an entry for" in ksp.getPythonContext().message)

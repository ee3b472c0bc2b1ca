# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The study's own opponents of FETI solve the same systems."""

from __future__ import annotations

import importlib.machinery
import sys
import types

import pytest
from collective import agree, small
from problems import cube, poisson
from walls import tube, wall

from dolfinx.fem import petsc

from benchmarks.compare.opponents import OPPONENTS
from benchmarks.compare.split import blocks_of, split
from dolfinx_feti import LinearProblem, compare, loads
from dolfinx_feti.comparison import assembled_system

RTOL = 1e-9

#: Solvers of one process, and of modules that may not be there.
ALONE = ("cholmod", "pardiso")


@pytest.mark.parametrize("degree", [1, 2])
def test_everybody_solves_the_condensed_system(degree):
    """In a loaded state; the uncondensed one is solved until that is, with κ/μ of 1000."""
    body = wall(tube(around=8, along=2), degree=degree)
    problem = body.problem(4, {"ksp_rtol": RTOL})
    body.inflate(problem, [1.0])
    body.load.value = loads.mmhg(1.2)
    with blocks_of(problem):
        found = compare(problem, OPPONENTS)
    solved = [s for s in found.solved if s.solver not in ALONE]
    agree(len(solved) >= 6, found)
    agree(all(s.converged and not s.note for s in solved), found)
    for each in solved:
        small(each.relative_residual, 1.01 * RTOL)
        small(each.difference_to_direct, 1e4 * RTOL)


def test_condensation_undone():
    """K_uu is the tangent that was assembled without a pressure, and K = K_uu − Cᵀ S."""
    body = wall(tube(around=6, along=1), degree=2)
    body.load.value = loads.mmhg(1.0)
    problem = body.problem(3, {})
    problem.solve()
    A, b = problem.linear_system()
    K, f = assembled_system(A, b)
    dofs, blocks = problem.condensed_blocks()
    system = split(K, A.query("dirichlet"), dofs, blocks.k_up, blocks.slope)
    K_uu = petsc.assemble_matrix(problem.J, bcs=problem.bcs)
    K_uu.assemble()
    size = K_uu.norm()
    K_uu.axpy(-1.0, system.K_uu)
    small(K_uu.norm(), 1e-12 * K.norm())
    agree(size < 0.5 * K.norm(), "κ is gone")
    for made in (K_uu, K, f, b, system.K_uu, system.C, system.S):
        made.destroy()


def test_no_field_is_condensed():
    body = poisson(cube(2, 4))
    problem = LinearProblem(body.a, body.L, bcs=body.bcs, subdomains=3)
    name = "fieldsplit-augmented"
    (record,) = compare(problem, {name: OPPONENTS[name]}).records
    agree(record["converged"] is False and record["note"].startswith("failed"), record)


@pytest.mark.serial
def test_pardiso(monkeypatch):
    """By a module of its name; the note says what one without MKL says."""
    module = types.ModuleType("pypardiso")
    module.__spec__ = importlib.machinery.ModuleSpec("pypardiso", None)
    monkeypatch.setitem(sys.modules, "pypardiso", module)
    body = poisson(cube(2, 4))
    problem = LinearProblem(body.a, body.L, bcs=body.bcs, subdomains=3)
    chosen = {"mumps": {}, "pardiso": OPPONENTS["pardiso"]}
    assert not compare(problem, chosen).solved[1].converged
    module.PyPardisoSolver = Direct
    assert compare(problem, chosen).solved[1].difference_to_direct < 1e-10


class Direct:
    """What PARDISO's module offers, by scipy."""

    def __init__(self, mtype):
        self.symmetric = mtype != 11

    def factorize(self, A):
        """Keep the factors of a matrix, given by its upper half if it is symmetric."""
        from scipy.sparse import triu
        from scipy.sparse.linalg import splu

        self.factors = splu((A + triu(A, 1).T if self.symmetric else A).tocsc())

    def solve(self, _A, b):
        """Solve."""
        return self.factors.solve(b)

    def free_memory(self, everything):
        """Free the factors."""
        del self.factors

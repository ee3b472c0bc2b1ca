# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Programs of the pages on FETI in other people's solvers, beside closed forms and LU."""

from __future__ import annotations

import importlib.util
import re
from typing import Any

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, dense, equal, lu_solve, norm, small, whole
from pages import programs
from problems import Problem, owned
from programs import finish, start
from wall_files import ROOT

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import FETI, LinearProblem, create_torn_matrix, set_near_kernel

SOLVERS = "docs/own_solvers.md"
OPERATORS = "docs/own_operators.md"

#: Cells along an edge of the square of docs/own_solvers.md.
N = 16


def eigenvalue(*waves: int) -> float:
    """Return the eigenvalue of bilinear elements with so many half waves along x and y.

    On a grid of squares of width h it is the sum over the directions of
    6/h² (1 − cos jπh)/(2 + cos jπh) for j half waves.
    """
    h = 1.0 / N
    cosines = np.cos(np.pi * h * np.array(waves))
    return float(np.sum(6.0 / h**2 * (1.0 - cosines) / (2.0 + cosines)))


def require_feti(ksp: PETSc.KSP) -> None:
    """Assert that the last solve of a KSP took iterations of FETI, and converged."""
    feti = ksp.getPythonContext()
    agree(ksp.getConvergedReason() > 0, feti.message)
    agree(feti.iterations > 0, "FETI took no iteration")


@pytest.fixture(scope="module")
def first() -> dict[str, Any]:
    """Variables of the first program of docs/own_solvers.md after it has run."""
    names: dict[str, Any] = {}
    exec(*programs("KSP", SOLVERS), names)
    return names


@pytest.fixture(scope="module")
def minimised(first) -> dict[str, Any]:
    """Variables of the program for SNES after it has run."""
    names = dict(first)
    exec(*programs("SNES", SOLVERS), names)
    return names


@pytest.mark.serial
@pytest.mark.parametrize(
    ("page", "options"),
    [
        ("docs/own_matrix.md", "-ksp_type python -ksp_python_type dolfinx_feti.FETI"),
        (SOLVERS, "-mine_ksp_rtol 1e-9"),
        (OPERATORS, ""),
    ],
    ids=["own_matrix", "own_solvers", "own_operators"],
)
def test_a_page_runs_as_printed(tmp_path, page, options):
    """In a separate interpreter: with MPI from a wheel, the order of imports matters."""
    script = tmp_path / "page.py"
    blocks = programs(page=page)
    if importlib.util.find_spec("slepc4py") is None:
        blocks = [block for block in blocks if "slepc4py" not in block]
    script.write_text("\n".join(blocks), encoding="utf-8")
    finish(start(*options.split(), script=script))


def test_own_matrix():
    """The solution balances the loads on free dofs, and has the values on Dirichlet dofs."""
    options = PETSc.Options()
    given = {"ksp_type": "python", "ksp_python_type": "dolfinx_feti.FETI"}
    for name, value in given.items():
        options[name] = value
    names: dict[str, Any] = {}
    exec(*programs(page="docs/own_matrix.md"), names)
    for name in given:
        options.delValue(name)
    require_feti(names["ksp"])
    A, x, b = (names[name] for name in "Axb")
    r = A.createVecLeft()
    A.mult(x, r)
    begin, end = A.getOwnershipRange()
    free = np.arange(begin, end) >= names["side"]  # the first row of nodes is held
    equal(r.array_r[free], b.array_r[free], 1e-6)
    equal(x.array_r[~free], np.ones(np.count_nonzero(~free)), 1e-14)


def test_own_ksp(first):
    require_feti(first["ksp"])
    known = Problem(first["V"], first["a"], first["v"] * ufl.dx, [first["hot"]])
    equal(owned(first["uh"]), known.solve_directly(), 1e-7)


def test_many_right_hand_sides(first):
    names = dict(first)
    exec(*programs("Many right-hand sides", SOLVERS), names)
    require_feti(names["ksp"])
    columns = names["X"].getDenseArray()
    for column, load in zip(columns.T, names["loads"], strict=True):
        known = Problem(names["V"], names["a"], load, [names["hot"]])
        equal(column, known.solve_directly(), 1e-7)


def test_adjoint_of_an_unsymmetric_form(first):
    """The goal at the solution is the load at the adjoint solution, J(u) = L(z)."""
    names = dict(first)
    exec(*programs("Adjoints", SOLVERS), names)
    require_feti(names["adjoint"].solver)
    uh = names["uh"]
    z = names["z"]
    v = names["v"]
    x = ufl.SpatialCoordinate(names["mesh"])[0]
    goal, load = (
        COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form)))
        for form in (x * uh * ufl.dx, z * ufl.dx)
    )
    agree(goal > 1e-3, f"J(u) = {goal}")
    small(load / goal - 1.0, 1e-6)
    known = Problem(names["V"], ufl.adjoint(names["a_wind"]), x * v * ufl.dx, [names["cold"]])
    equal(owned(z), known.solve_directly(), 1e-6)


def test_adjoint_of_a_symmetric_matrix(first):
    """``solveTranspose`` solves as ``solve`` does."""
    A = first["A"]
    ksp = first["ksp"]
    c = first["b"].duplicate()
    x = A.createVecRight()
    z = A.createVecRight()
    c.set(1.0)
    ksp.solve(c, x)
    ksp.solveTranspose(c, z)
    require_feti(ksp)
    equal(z.array_r, x.array_r, 1e-12)


def test_own_snes(minimised):
    """Its solution is that of the problem's own Newton method."""
    snes = minimised["snes"]
    problem = minimised["nonlinear"]
    agree(snes.getConvergedReason() > 0)
    agree(snes.getIterationNumber() > 2)
    require_feti(snes.getKSP())
    minimised["w"].x.array[:] = 0.0
    problem.solve()
    equal(minimised["x"].array_r, owned(minimised["w"]), 1e-6)


def test_own_tao(minimised):
    """The minimum of the energy is where SNES finds the residual zero."""
    names = dict(minimised)
    exec(*programs("TAO", SOLVERS), names)
    tao = names["tao"]
    agree(tao.getConvergedReason() > 0)
    agree(tao.getIterationNumber() > 2)
    require_feti(tao.getKSP())
    equal(names["minimiser"].array_r, names["x"].array_r, 1e-6)


def test_own_ts(first):
    """The lowest mode shrinks by the factor of the trapezoidal rule in each step."""
    names = dict(first)
    exec(*programs("TS", SOLVERS), names)
    ts = names["ts"]
    agree(ts.getConvergedReason() > 0)
    agree(ts.getStepNumber() == 10)
    require_feti(ts.getSNES().getKSP())
    half = 0.005 * eigenvalue(1, 1)
    names["y"].interpolate(lambda x: np.sin(np.pi * x[0]) * np.sin(np.pi * x[1]))
    equal(names["state"].array_r, ((1 - half) / (1 + half)) ** 10 * owned(names["y"]), 1e-6)


def test_own_slepc(first):
    """Eigenvalues of bilinear elements on a grid are known; one is double, and near 60 all are."""
    pytest.importorskip("slepc4py")
    names = dict(first)
    exec(*programs("SLEPc", SOLVERS), names)
    modes = [(1, 1), (1, 2), (2, 1), (2, 2)]
    known = [eigenvalue(*waves) for waves in modes]
    equal(names["lowest"], known, 1e-6)
    equal(np.sort(names["inside"]), known[1:], 1e-6)


@pytest.fixture(scope="module")
def split() -> dict[str, Any]:
    """Variables of the program with a field split; ``iterations`` are FETI's in each step."""
    (code,) = programs("A continuous pressure by a field split", OPERATORS)
    names: dict[str, Any] = {"iterations": []}

    def count(ksp, step, norm):
        if step:
            of_u, _ = ksp.getPC().getFieldSplitSubKSP()
            names["iterations"].append(of_u.getIterationNumber())

    names["count"] = count
    exec(code.replace("\nksp.solve(", "\nksp.setMonitor(count)\nksp.solve("), names)
    return names


def error_of_split(names: dict[str, Any], b_u: PETSc.Vec, b_p: PETSc.Vec) -> float:
    """Return how far u and p are off those of LU, relative to the largest entry of each."""
    K = names["K"].copy().convert("aij")
    b = K.createVecLeft()
    b.array[:] = np.concatenate([b_u.array_r, b_p.array_r])
    known = np.split(lu_solve(K, b), [b_u.local_size])
    found = [names["x_u"].array_r, names["x_p"].array_r]
    errors = [
        np.abs(whole(each - exact)).max() / np.abs(whole(exact)).max()
        for each, exact in zip(found, known, strict=True)
    ]
    return float(max(errors))


def test_taylor_hood(split):
    agree(split["ksp"].getConvergedReason() > 0)
    small(error_of_split(split, split["b_u"], split["b_p"]), 1e-6)


def test_price_of_taylor_hood(split):
    """The numbers of the page, and those of P2–P0 on the same mesh."""
    (text,) = re.findall(
        r"^The price: (.*?)\n\n", (ROOT / OPERATORS).read_text("utf-8"), re.M | re.S
    )
    outer, inner, condensed = (
        int(re.search(pattern, text)[1])
        for pattern in (r"(\d+) outer", r"(\d+) iterations", r"takes (\d+)")
    )
    found = [split["ksp"].getIterationNumber(), sum(split["iterations"])]
    mesh, u, v = (split[name] for name in ("mesh", "u", "v"))
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    p = ufl.TrialFunction(Q)
    q = ufl.TestFunction(Q)
    zero = dolfinx.fem.Constant(mesh, 0.0)
    a = [
        [split["a"], -p * ufl.div(v) * ufl.dx],
        [-q * ufl.div(u) * ufl.dx, -p * q / split["lmbda"] * ufl.dx],
    ]
    other = LinearProblem(a, [split["load"], zero * q * ufl.dx], bcs=[split["bc"]], subdomains=8)
    other.solve()
    found.append(other.solver.getPythonContext().iterations)
    for name, said, counted in zip(
        ("outer", "FETI", "P2–P0"), (outer, inner, condensed), found, strict=True
    ):
        agree(abs(counted / said - 1.0) <= 0.2, f"{name}: the page says {said}, found {counted}")


def test_taylor_hood_with_prescribed_values(split):
    """Both parts of b are lifted, then set, as dolfinx does."""
    held = split["held"]
    bc = split["bc"]
    held.value[:] = (0.01, -0.02)
    a_u = dolfinx.fem.form(split["a"])
    a_p = dolfinx.fem.form(-split["q"] * ufl.div(split["u"]) * ufl.dx)
    b_u = dolfinx.fem.petsc.assemble_vector(dolfinx.fem.form(split["load"]))
    zero = dolfinx.fem.Constant(split["mesh"], 0.0)
    b_p = dolfinx.fem.petsc.assemble_vector(dolfinx.fem.form(zero * split["q"] * ufl.dx))
    for b, form in ((b_u, a_u), (b_p, a_p)):
        dolfinx.fem.petsc.apply_lifting(b, [form], [[bc]])
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
    dolfinx.fem.petsc.set_bc(b_u, [bc])
    plain = [each.duplicate() for each in (split["b_u"], split["b_p"])]
    for each, b in zip(plain, (b_u, b_p), strict=True):
        each.array[:] = b.array_r
    split["ksp"].solve(PETSc.Vec().createNest(plain), split["x"])
    held.value[:] = 0.0
    agree(split["ksp"].getConvergedReason() > 0)
    small(error_of_split(split, *plain), 1e-6)


def periodic_solution(names: dict[str, Any], A: PETSc.Mat, b: PETSc.Vec, bs: int) -> np.ndarray:
    """Solve the periodic problem densely from A with free sides, and return all of its values.

    Args:
        names: What the program leaves, with ``periodic``, (blocks,).
        A: Assembled matrix with free sides, (N, N).
        b: Its load.
        bs: Dofs of a block.
    """
    classes = (bs * names["periodic"][:, None] + np.arange(bs)).ravel()
    T = np.eye(classes.max() + 1)[classes]  # (N, dofs of the periodic problem)
    x = np.linalg.lstsq(T.T @ dense(A) @ T, T.T @ whole(b.array_r), rcond=1e-10)[0]
    return T @ x


def assembled(form: ufl.Form) -> PETSc.Mat:
    """Assemble a matrix with free sides."""
    A = dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(form))
    A.assemble()
    return A


@pytest.mark.parametrize(
    "where", ["x[0] < 0.5", "np.hypot(x[0] - 0.4, x[1] - 0.6) < 0.3"], ids=["laminate", "inclusion"]
)
def test_periodic_cell(split, where):
    """The effective conductivity of a laminate is known; the corrector is that of a dense solve."""
    (code,) = programs("Periodic cells", OPERATORS)
    agree("x[0] < 0.5" in code)
    names = dict(split)
    exec(code.replace("x[0] < 0.5", where), names)
    require_feti(names["solver"])
    if where == "x[0] < 0.5":
        small(names["effective"] / 1.8 - 1.0, 1e-8)
    w, v, k = (names[name] for name in "wvk")
    A = assembled(k * ufl.inner(ufl.grad(w), ufl.grad(v)) * ufl.dx)
    b = names["torn"].assemble_rhs(-k * v.dx(0) * ufl.dx)
    known = periodic_solution(names, A, b, 1)
    found = whole(owned(names["corrector"]))
    agree(np.abs(known - known.mean()).max() > 1e-2, "the corrector is not zero")
    equal(found - found.mean(), known - known.mean(), 1e-6)


def test_periodic_cell_of_an_elastic_body(split):
    """Translations alone are the near kernel and the null space, as the page says."""
    (code,) = programs("Periodic cells", OPERATORS)
    names = dict(split)
    exec(code.replace("x[0] < 0.5", "np.hypot(x[0] - 0.4, x[1] - 0.6) < 0.3"), names)
    k = names["k"]
    cell = names["cell"]
    V = dolfinx.fem.functionspace(cell, ("Lagrange", 1, (2,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    a = k * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx
    torn = LinearProblem(a, -k * v[0].dx(0) * ufl.dx, subdomains=8)
    A, b = torn.linear_system()
    blocks = names["periodic"][A.getLGMap()[0].getBlockIndices()]
    sizes = 2 * names["owned"], 2 * names["total"]
    A_periodic = create_torn_matrix(A.getISLocalMat(), blocks, sizes, comm=COMM)
    x, load = A_periodic.createVecs()
    translations = [A_periodic.createVecRight() for _ in range(2)]
    for j, mode in enumerate(translations):
        mode.array[j::2] = 1.0
    set_near_kernel(A_periodic, translations)
    A_periodic.setNullSpace(PETSc.NullSpace().create(vectors=translations, comm=COMM))
    mine = (2 * names["mine"][:, None] + np.arange(2)).ravel().astype(PETSc.IntType)
    load.setValues(mine, b.array_r, addv=True)
    load.assemble()
    ksp = PETSc.KSP().create(COMM)
    ksp.setType("python")
    ksp.setPythonContext(FETI())
    ksp.setOperators(A_periodic)
    ksp.solve(load, x)
    require_feti(ksp)
    known = periodic_solution(names, assembled(a), b, 2).reshape(-1, 2)
    whole_x = whole(x.array_r).reshape(-1, 2)[names["periodic"]]
    equal(whole_x - whole_x.mean(axis=0), known - known.mean(axis=0), 1e-6)


def test_subclass_that_used_private_names(split):
    """One matrix, several loads, values that are not zero."""
    names = dict(split)
    for heading in ("Periodic cells", "A subclass that used private names"):
        exec(*programs(heading, OPERATORS), names)
    reused = names["reused"]
    v = names["v"]
    for factor in (2.0, 3.0):
        uh = reused.solve_for(factor * v * ufl.dx)
        require_feti(reused.solver)
        known = Problem(names["W"], names["conduction"], factor * v * ufl.dx, [names["hot"]])
        equal(owned(uh), known.solve_directly(), 1e-7)
    agree(norm(owned(names["temperature"])) > 1.0)

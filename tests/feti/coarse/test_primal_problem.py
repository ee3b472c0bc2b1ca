# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The averaged coarse space agrees with dense matrices; stiffness jumps and rounding do no harm."""

import numpy as np
import primal_form
import pytest
import scipy.linalg
from cases import case, each, every_interior, every_type
from collective import COMM, agree, dense, equal, small, whole
from hand_torn import brick, random_values, softened, solve
from problems import Problem, dirichlet, left, torn

import dolfinx
import ufl

from dolfinx_feti.runtime.petsc_options import inserted

SEED = 2003
PREFIX = "test_feti_coarse_"
GRID = case((3, 2), (3, 2), 2)


def random_local(n):
    """Return random numbers, (n,), others on each process."""
    return np.random.default_rng(SEED + COMM.rank).standard_normal(n)


@every_type
@every_interior
def test_galerkin_matrix_and_projection_agree_with_dense_formulas(
    kind, interior, torn_grid, create_primal
):
    """A₀ = Vᵀ A V in a basis of unit energy; Π V = 0 and Vᵀ A Π = 0."""
    problem = torn_grid(**GRID)
    primal = create_primal(problem, type=kind, interior=interior, coarse_modes=2)
    exact = primal_form.reference(problem, primal)
    space = primal.coarse
    copies = primal.system.copies
    basis = scipy.linalg.block_diag(*COMM.allgather(space.combinations.B.toarray()))
    equal(dense(space.A_0), basis.T @ exact.V.T @ exact.A @ exact.V @ basis, 1e-10)
    equal(dense(space.A_0).diagonal(), np.ones(space.A_0.getSize()[0]), 1e-12)
    v = space.V.prolong(random_local(space.V.n_c))
    zero = np.zeros(copies.size)
    projected_v = space.correct(v, zero)
    small(np.abs(projected_v).max(initial=0.0), 1e-9 * np.abs(whole(v)).max())
    projected_z = space.correct(copies.average(random_local(copies.size)), zero)
    coarse_forces = exact.V.T @ exact.A @ (exact.average @ whole(projected_z))
    small(
        np.abs(coarse_forces).max(), 1e-9 * np.abs(exact.A).max() * np.abs(whole(projected_z)).max()
    )
    r = copies.sum(random_local(copies.size))
    equal(space.initial_guess(r), space.correct(zero, r))
    start = exact.average @ whole(space.initial_guess(r))
    equal(exact.V.T @ exact.A @ start, exact.V.T @ (exact.average @ whole(r)), 1e-9)


def test_single_precision_products_keep_the_coarse_matrix(torn_grid, create_primal, monkeypatch):
    """A V is stored in single precision; A₀ stays as it is."""
    problem = torn_grid(**GRID)
    double = create_primal(problem, type="all_floating", interior="eliminate", coarse_modes=2)
    monkeypatch.undo()  # what the fixture double_precision_products of create_primal has set
    single = create_primal(problem, type="all_floating", interior="eliminate", coarse_modes=2)
    agree(all(part.is_single_precision for part in single.coarse.VtA.by_subdomain))
    equal(dense(single.coarse.A_0), dense(double.coarse.A_0), 1e-12)
    copies = double.system.copies
    z = copies.average(random_local(copies.size))
    r = copies.sum(random_local(copies.size))
    equal(single.coarse.initial_guess(r), double.coarse.initial_guess(r), 1e-7)
    equal(single.coarse.correct(z, r), double.coarse.correct(z, r), 1e-6)


def test_dependent_columns_are_dropped(torn_grid, create_primal):
    """Repeated, zero and large columns do not change the projection."""
    problem = torn_grid(**GRID)
    plain = create_primal(problem, type="all_floating", interior="eliminate", coarse_modes=2)

    def again(setup, copies):
        columns = []
        for contributed in plain.coarse.V.by_subdomain:
            U_i = contributed.U
            noise = 1e-12 * np.random.default_rng(SEED).standard_normal(U_i.shape)
            columns.append(np.hstack([1e5 * (U_i + noise), 0.0 * U_i[:, :1]]))
        return columns

    space = create_primal(
        problem, again, type="all_floating", interior="eliminate", coarse_modes=2
    ).coarse
    # All repeated columns are dropped, and a zero column of each of the six subdomains.
    agree(space.N_c - space.A_0.getSize()[0] == plain.coarse.N_c + 6)
    agree(plain.coarse.A_0.getSize()[0] == plain.coarse.N_c and space.negative_eigenvalues == 0)
    copies = plain.system.copies
    z = copies.average(random_local(copies.size))
    zero = np.zeros(copies.size)
    equal(space.correct(z, zero), plain.coarse.correct(z, zero), 1e-7)


def multiplicity_of_rows(copies):
    """Return the number of copies of the dof of each interface row, (n_Γ,)."""
    return np.bincount(copies.pair_rows, minlength=copies.size)


def corner_columns(copies, *, has_one_contributor):
    """Unit displacements of dofs with more than two copies, of the first copy alone or of each."""
    contributes = multiplicity_of_rows(copies) > 2
    if has_one_contributor:
        first_row = COMM.scan(copies.size) - copies.size
        first_copy = np.full(copies.size, np.iinfo(np.int64).max)
        np.minimum.at(first_copy, copies.pair_rows, copies.pair_copies)
        contributes &= first_copy == first_row + np.arange(copies.size)
    return [np.eye(rows.stop - rows.start)[:, contributes[rows]] for rows in copies.rows]


def test_corner_columns_are_projected_out(torn_grid, create_primal):
    """Π vanishes on a displacement of the corners; each repeated column is a zero pivot."""
    problem = torn_grid(**GRID)
    zero_energies = []
    for has_one_contributor in (True, False):

        def corners(setup, copies, has_one_contributor=has_one_contributor):
            return corner_columns(copies, has_one_contributor=has_one_contributor)

        primal = create_primal(
            problem, corners, type="all_floating", interior="eliminate", coarse_modes=0
        )
        space = primal.coarse
        copies = space.V.copies
        multiplicity = multiplicity_of_rows(copies)
        is_corner = multiplicity > 2
        projected = space.correct(is_corner.astype(float), np.zeros(copies.size))
        small(np.abs(projected).max(initial=0.0), 1e-9)
        agree(not space.zero_energy_fields.has_mechanism())
        zero_energies.append(space.zero_energy_fields.count())
    corner_dofs = round(COMM.allreduce((1.0 / multiplicity[is_corner]).sum()))
    repetitions = COMM.allreduce(np.count_nonzero(is_corner)) - corner_dofs
    agree(repetitions > 0 and zero_energies[1] - zero_energies[0] == repetitions, zero_energies)


@pytest.mark.parametrize("share", [0.0, 0.02], ids=["definite", "indefinite"])
def test_inertia_is_unknown_if_the_solver_does_not_count_pivots(share, torn_grid, create_primal):
    """Then negative curvature is not known before the iterations."""
    problem = torn_grid((2, 2), (4, 4), components=2, change=softened(share))
    with inserted(PREFIX, {"pc_factor_mat_solver_type": "petsc"}):
        primal = create_primal(problem, type="classical", interior="eliminate", coarse_modes=0)
    agree(primal.coarse.negative_eigenvalues is None)
    agree(not primal.system.deflation.is_indefinite)


# ---- many subdomains, and jumps of the stiffness --------------------------------------------

FORMULATIONS = {
    "primal": {"feti_formulation": "primal"},
    "Q = I": {"feti_formulation": "dual", "feti_coarse_q": "identity"},
    "Q = M": {"feti_formulation": "dual"},
}

#: Where the modulus is another one, by the cell of a grid.
PATTERNS = {
    "columns": lambda i: (i[0] % 2 == 0) & (i[1] % 2 == 0),
    "layers": lambda i: i[1] % 2 == 0,
    "channels": lambda i: (i[2] % 4 == 1) & (i[1] % 2 == 1),
    "checkerboard": lambda i: i.sum(axis=0) % 2 == 0,
}


def cube_with_jumps(n, grid, pattern, jump, subdomains=None, options=FORMULATIONS["primal"]):
    """Tear a cube of n³ cells of which some have a larger modulus.

    Args:
        n: Number of cells along an edge.
        grid: Number of cubes along an edge, each of one modulus.
        pattern: Name in PATTERNS, which selects the stiff cubes.
        jump: Modulus of the stiff cubes; that of the others is one.
        subdomains: Number of subdomains; if None, each cube is one.
        options: PETSc options without prefix.
    """
    mesh = dolfinx.mesh.create_unit_cube(COMM, n, n, n)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    E = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    place = np.floor(grid * E.function_space.tabulate_dof_coordinates().T).astype(int)
    E.x.array[:] = np.where(PATTERNS[pattern](place), jump, 1.0)[: len(E.x.array)]
    if subdomains is None:
        own = mesh.topology.index_map(3).size_local
        subdomains = np.ravel_multi_index(place[:, :own], (grid,) * 3)
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    stress = ufl.sym(ufl.grad(u)) + 0.5 * ufl.div(u) * ufl.Identity(3)
    a = E * ufl.inner(stress, ufl.grad(v)) * ufl.dx
    return torn(Problem(V, a, v[2] * ufl.dx, [dirichlet(V, left)]), subdomains, "jumps_", **options)


def check_residual(problem, rtol=1e-8):
    """Assert that the residual is within its tolerance or its floor; return the FETI context."""
    problem.solver.setTolerances(rtol=rtol)
    problem.solve()
    context = problem.solver.getPythonContext()
    agree(context.residual <= max(1.01 * rtol, np.nan_to_num(context.floor)))
    coarse_solver = context.report().coarse_solver
    agree("factor" in coarse_solver or "inverse" in coarse_solver)
    return context


@pytest.mark.processes(1, 2, 3)
@pytest.mark.parametrize("subdomains", [None, 20], ids=["aligned", "across"])
@pytest.mark.parametrize("jump", [1e2, 1e5, 1e8])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_stiffness_jumps_take_few_iterations(pattern, jump, subdomains):
    """Rounding grows with the jump; double precision is used where single hides soft dofs."""
    problem = cube_with_jumps(6, 3 if subdomains is None else 2, pattern, jump, subdomains)
    context = check_residual(problem, max(1e-8, 1e-15 * jump))
    agree(context.iterations <= 150)


@pytest.mark.processes(1, 2)
@each("options", FORMULATIONS)
def test_stiffness_jumps_are_solved_in_every_formulation(options):
    """Stiff columns coincide with every other subdomain."""
    check_residual(cube_with_jumps(8, 4, "columns", 1e6, options=options))


@pytest.mark.processes(1, 2)
def test_subdomains_of_one_cell_are_solved():
    """There are 3375 on one process and 1000 on two."""
    n = 15 if COMM.size == 1 else 10
    problem = cube_with_jumps(n, n, "columns", 1e6)
    # Six rigid modes of each cell, except for the n² cells on the clamped face.
    agree(check_residual(problem).report().coarse_size > 6 * n**3 - 6 * n**2)


@pytest.mark.processes(1)
def test_stiffness_jumps_across_many_subdomains_are_solved(torn_grid, create_ksp):
    """A checkerboard of three by three cells on 83² subdomains of two by two."""

    def change(K, dofs):
        for n in range(len(K)):
            corner = 2 * (n // 83), 2 * (n % 83)

            def stiffness(cell, corner=corner):
                i, j = ((a + b) // 3 for a, b in zip(corner, cell, strict=True))
                return 1e8 if (i + j) % 2 else 1.0

            K[n] = brick((2, 2), 2, stiffness)[1]

    problem = torn_grid((83, 83), (2, 2), components=2, change=change)
    ksp = create_ksp(problem.A)
    reason, _ = solve(ksp, problem, random_values(problem))
    context = ksp.getPythonContext()
    agree(reason > 0 and context.message == "", context.message)
    agree(context.residual <= max(1e-8, np.nan_to_num(context.floor)))
    agree(context.report().coarse_size > 20_000)


# ---- rounding -------------------------------------------------------------------------------

#: Stiffness of stripes and of a disc over that of the rest, and λ/μ.
JUMP = 1e3
RATIO = 1e3


def stripes(x):
    """Return the condition, in UFL, that selects stripes across the body."""
    return ufl.lt(ufl.cos(3 * np.pi * x[0]), 0.0)


def disc(x):
    """Return the condition, in UFL, that selects a disc around (½, ½)."""
    return ufl.lt((x[0] - 0.5) ** 2 + (x[1] - 0.5) ** 2, 0.09)


CHOICES = {
    "all-floating": {},
    "classical": {"feti_type": "classical"},
    "primal": {"feti_formulation": "primal"},
    "lumped": {"feti_pc_type": "lumped"},
}


@each("options", CHOICES)
@pytest.mark.parametrize(
    ("cells", "length", "stiff"),
    [((9, 14), 3.0, stripes), ((11, 16), 10.0, stripes), ((6, 19), 3.0, disc)],
    ids=["short", "long", "disc"],
)
def test_rounding_is_not_taken_for_negative_curvature(cells, length, stiff, options):
    """The matrix is definite; near its floor CG meets curvatures that are only rounding.

    Linear elasticity, P1, cut into 13 subdomains.
    """
    corners = [np.zeros(2), np.array([length, 1.0])]
    mesh = dolfinx.mesh.create_rectangle(COMM, corners, cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    mu = ufl.conditional(stiff(ufl.SpatialCoordinate(mesh)), JUMP, 1.0)
    strain = [ufl.sym(ufl.grad(w)) for w in (u, v)]
    a = mu * (2 * ufl.inner(*strain) + RATIO * ufl.div(u) * ufl.div(v))
    a = a * ufl.dx(metadata={"quadrature_degree": 1})
    body = Problem(V, a, -v[1] * ufl.dx, [dirichlet(V, left)])
    problem = torn(body, 13, "rounding_", ksp_rtol=1e-9, **options)
    problem.solve()
    step = problem.history[0]
    agree(step.linear_residual <= np.fmax(1e-9, step.linear_floor) < 1e-6, step)
    agree(step.indefinite in (0, None), step)

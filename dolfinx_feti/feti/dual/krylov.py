# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Krylov method of the dual formulation: PETSc's, with a stopping test on the assembled residual.

CG is the default if the dual system is positive definite on balanced pairs, which is the case if
neither a regularised subdomain nor the defect D has a negative eigenvalue; otherwise GMRES is.

The stopping test compares ‖Tᵀ t‖, the norm of the residual of the *assembled* system, with the
target. PETSc gives the test another norm, called ``rnorm`` as in PETSc: that of the jump r or of
the preconditioned jump.

* CG preconditions its residual just before each test, and the preconditioner computes ‖Tᵀ t‖ of
  the vector that it is applied to. This is the norm itself if D = 0, and an estimate otherwise.
* The other methods precondition other vectors, or precondition after their test. For them ‖Tᵀ t‖
  is estimated as a multiple of rnorm.

Before an estimate ends a solve, ‖Tᵀ t‖ is measured: computed for the true residual. This also
corrects the estimate, and is repeated every :data:`MEASURING_INTERVAL` iterations.

Another method of PETSc's is one more name in ``option_checks.DUAL_METHODS`` and in
docs/petsc_options.md. If it works like CG or GMRES, it is also one in :data:`UNPIPELINED_CG` or
:data:`GMRES_METHODS`. ``tests/feti/dual/test_krylov.py`` runs all methods.

A *run* is one call of PETSc's method. It ends without convergence, for a fresh start, if ‖Tᵀ t‖
stagnates, if the residual that the method updates departs from the true one, or after
:data:`MAX_ITERATIONS_OF_RUN` iterations.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.dual.system import DualSystem, DualUnknowns
from dolfinx_feti.feti.krylov_limits import STAGNATION_ITERATIONS
from dolfinx_feti.feti.monitor import Monitor
from dolfinx_feti.feti.solve_info import NEGATIVE_CURVATURE, NO_RITZ_VALUES, KrylovInfo
from dolfinx_feti.feti.subsolver_options import KrylovOptions
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import warn
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_errors import garbage_collection_resumed, python_errors
from dolfinx_feti.runtime.petsc_options import inserted, mark_as_read

Reason = PETSc.KSP.ConvergedReason

#: Conjugate gradients that precondition their residual just before each test of convergence, and
#: whose coefficients give Ritz values. The pipelined ones, groppcg and pipecg, do neither.
UNPIPELINED_CG = ("cg", "fcg")

#: Norms that PETSc's CG computes after it has preconditioned the residual, so that the test follows
#: at once. With the other norms it tests first and preconditions then.
CG_NORMS = (PETSc.KSP.NormType.PRECONDITIONED, PETSc.KSP.NormType.NATURAL)

#: Methods that are preconditioned from the right, and test the norm of the jump itself.
GMRES_METHODS = ("gmres", "fgmres")

#: Largest number of iterations of a run. A memory bound: CG and FCG reserve 32 bytes for each
#: iteration before the first one, 3 MB for this number. A solve of fewer iterations is the same
#: with any larger bound; a longer one makes a fresh start here.
MAX_ITERATIONS_OF_RUN = 100_000

#: Largest number of directions of GMRES. A memory bound: PETSc reserves 16 bytes for each pair of
#: directions, 64 MB for this number, and a quarter or four times as much for half or twice of it.
#: The default number, ``GMRES_DIRECTIONS``, is far below.
MAX_GMRES_DIRECTIONS = 2000

#: Iterations between two measurements of ‖Tᵀ t‖ in methods that only estimate it. A measurement
#: costs one product with F and two applications of M, about as much as one and a half iterations.
#: On the jump grids (``dual/__init__``) with GMRES and MINRES, an interval of 5 takes 8 % more
#: products and applications, as it measures more often; one of 20 takes 2 % less on average, and
#: up to 6 % more, as it notices convergence later.
MEASURING_INTERVAL = 10

#: Factor on the estimate of ‖Tᵀ t‖ before the first measurement. The estimate is then a multiple of
#: rnorm with the ratio of the start, and ‖Tᵀ t‖ may fall faster than rnorm in the first iterations;
#: with this factor it is measured when the estimate falls below ten times the target. On the jump
#: grids with GMRES and MINRES, 30 of 32 solves take the same work with 0.05 and 0.2; one takes 10 %
#: more with 0.05, and one takes 16 % less with 0.2.
RATIO_MARGIN = 0.1

#: Quotient of the norms of the true and of the updated residual of GMRES above which a fresh start
#: follows. On the jump grids with jumps of 10², 4 takes 0.8 to 1.7 times as many iterations as 2,
#: and no bound up to 5 times as many. A bound of 1 fails in three problems of four, since rounding
#: exceeds it at once. With jumps of 10⁴ and more few of these solves converge with any value.
MAX_RESIDUAL_QUOTIENT = 2.0


def select_method(options: KrylovOptions, *, is_definite: bool) -> str:
    """Return PETSc's name of the Krylov method: the user's ``ksp_type``, or a default.

    Args:
        options: Options of the method.
        is_definite: Whether the dual system is positive definite on balanced pairs. If so, CG is
            the default; otherwise GMRES is.
    """
    if options.ksp_type is not None:
        return options.ksp_type
    return "cg" if is_definite else "gmres"


def solve(
    system: DualSystem,
    r: Array,
    method: str,
    options: KrylovOptions,
    *,
    target: float,
    max_it: int,
    monitor: Monitor,
) -> tuple[DualUnknowns, KrylovInfo]:
    """Solve the dual system for the residual (r, 0) of a balanced (λ₀, s₀), by one run. Collective.

    A tolerance that the user has set for the Krylov method itself ends the run in place of the
    stopping test.

    Args:
        system: The dual system.
        r: Jump of (λ₀, s₀), (m,).
        method: PETSc's name of the Krylov method, from :func:`select_method`.
        options: Options of the method.
        target: Norm ‖Tᵀ t‖ of the residual of the assembled system at which the run ends.
        max_it: Largest number of iterations. One run takes at most :data:`MAX_ITERATIONS_OF_RUN`
            of them; if some remain, the caller makes a fresh start.
        monitor: Called with each iteration and ‖Tᵀ t‖, or its estimate.

    Returns:
        The correction of (λ₀, s₀), and how the method ended: reason, iterations, Ritz values, and
        whether a fresh start has to follow. The correction is the last iterate if the method
        converged, and the best one otherwise.
    """
    run_limit = min(max_it, MAX_ITERATIONS_OF_RUN)
    with Lifetime() as owned:
        ksp = owned.own(_create_ksp(system.comm, method, options, max_it=run_limit))
        if options.has_tolerance:
            # The user's own max_it, or PETSc's default if the user has set none, is a limit, too.
            *_, krylov_max_it = ksp.getTolerances()
            run_limit = min(run_limit, krylov_max_it)
        ksp.setTolerances(max_it=run_limit)

        shell = DualShell(system)
        mat = owned.own(shell.create_matrix())
        ksp.setOperators(mat)
        ksp.getPC().setPythonContext(shell)
        ksp.setUp()  # PETSc chooses the norm here
        test = _create_stopping_test(ksp, shell, r, target=target, monitor=monitor)
        if options.has_tolerance:
            ksp.setMonitor(test.show)
        else:
            ksp.setConvergenceTest(test)

        solution = owned.own(mat.createVecRight())  # the correction of (λ₀, s₀)
        rhs = owned.own(mat.createVecLeft())
        shell.write_residual(r, rhs)
        with event("FETIIterations"), python_errors(ksp):
            ksp.solve(rhs, solution)

        may_continue = run_limit < max_it and not options.has_tolerance
        info = _outcome(ksp, test, may_continue=may_continue)
        last = shell.read_unknowns(solution)
        correction = _choose_correction(system, r, last, test.best, info.reason)
        if method in GMRES_METHODS:
            _warn_if_restarted_early(options, info.iterations, system.comm)
        return correction, info


class DualShell:
    """The dual system as PETSc's shell matrix and shell preconditioner, for one solve.

    PETSc's vectors have λ and s of this process one after the other, (m + n_c,). Only this class
    reads and writes them.

    Attributes:
        system: The dual system.
        preconditioned_norm: ‖Tᵀ t‖ of the last vector that PETSc preconditioned, infinite before
            the first one: a result of :meth:`apply` that PETSc's interface cannot return.
            :class:`ResidualEstimate` reads it.
    """

    def __init__(self, system: DualSystem) -> None:
        """Wrap a system, which outlives the solve; PETSc destroys only the shell."""
        self.system = system
        self.preconditioned_norm = np.inf

    def create_matrix(self) -> PETSc.Mat:
        """Create the shell matrix; the caller destroys it. Collective."""
        size = self.system.m + self.system.coarse.n_c
        sizes = ((size, None), (size, None))
        mat = PETSc.Mat().createPython(sizes, self, comm=self.system.comm)
        mat.setUp()
        return mat

    def read_unknowns(self, x: PETSc.Vec) -> DualUnknowns:
        """Return copies of λ and s in a PETSc vector."""
        m = self.system.m
        return DualUnknowns(x.array_r[:m].copy(), x.array_r[m:].copy())

    def write_residual(self, r: Array, y: PETSc.Vec) -> None:
        """Write (r, 0) for a jump r, (m,), to a PETSc vector."""
        y.array[: self.system.m] = r
        y.array[self.system.m :] = 0.0

    def mult(self, _mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = 𝒜 x = (F λ − G s, 0) for a balanced x; called by PETSc. Collective.

        Args:
            _mat: This matrix.
            x: Vector (λ, s), (m + n_c,).
            y: Product, (m + n_c,); overwritten.
        """
        self.write_residual(self.system.multiply(self.read_unknowns(x)), y)

    def apply(self, _pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Apply the constraint preconditioner, (r, 0) → z; called by PETSc. Collective.

        Args:
            _pc: This preconditioner.
            r: Residual (r, 0), (m + n_c,).
            z: Preconditioned residual, (m + n_c,); overwritten.
        """
        m = self.system.m
        correction, self.preconditioned_norm = self.system.precondition(r.array_r[:m])
        z.array[:m] = correction.lam
        z.array[m:] = correction.s

    def assembled_norm(self, r: PETSc.Vec) -> float:
        """Return ‖Tᵀ t‖ of a residual (r, 0) in a PETSc vector. Collective."""
        return self.system.assembled_norm(r.array_r[: self.system.m])


class ResidualEstimate:
    """Estimate of ‖Tᵀ t‖ of the residual in an iteration: ratio times reference norm.

    ===================================  =============================  ========================
    method                               reference norm                 ratio before measurement
    ===================================  =============================  ========================
    CG, which preconditions its          ‖Tᵀ t‖ of the preconditioned   1
    residual just before each test       vector, computed on the way
    all others                           rnorm                          that of the start, times
                                                                        :data:`RATIO_MARGIN`
    ===================================  =============================  ========================

    A measurement of ‖Tᵀ t‖ replaces the ratio by the measured one.

    Attributes:
        preconditions_residual: Whether the method preconditions its residual just before each test,
            so that ``DualShell.preconditioned_norm`` is that of the residual under test.
    """

    def __init__(self, shell: DualShell, *, preconditions_residual: bool, initial: float) -> None:
        """Create the estimate of one run.

        Args:
            shell: The shell, with ‖Tᵀ t‖ of the vector preconditioned last.
            preconditions_residual: Whether the method preconditions its residual just before each
                test, as CG does.
            initial: ‖Tᵀ t‖ of the right-hand side; nan in CG, which does not need it.
        """
        self._shell = shell
        self._initial = initial
        self._ratio = 1.0
        self.preconditions_residual = preconditions_residual

    def update(self, its: int, rnorm: float) -> float:
        """Return the estimate in an iteration.

        Call it exactly once in each iteration, in order: if the method does not precondition its
        residual, iteration 0 sets the ratio to that of the start, which is exact there, and
        iteration 1 applies the margin.
        """
        if not self.preconditions_residual and its == 0:
            self._ratio = _quotient(self._initial, rnorm)
        elif not self.preconditions_residual and its == 1:
            self._ratio *= RATIO_MARGIN
        return self._reference_norm(rnorm) * self._ratio

    def measure(self, residual: PETSc.Vec, rnorm: float) -> float:
        """Return ‖Tᵀ t‖ of a true residual, and store its ratio to the reference. Collective."""
        reference = self._reference_norm(rnorm)
        norm = self._shell.assembled_norm(residual)
        self._ratio = _quotient(norm, reference)
        return norm

    def _reference_norm(self, rnorm: float) -> float:
        """Return the norm that the estimate is a multiple of."""
        return self._shell.preconditioned_norm if self.preconditions_residual else rnorm


class StoppingTest:
    """PETSc's convergence test of one run, on ‖Tᵀ t‖.

    Attributes:
        best: Iterate with the smallest ‖Tᵀ t‖ in CG, which updates its iterate in each iteration;
            None in other methods, which may form it only at the end.
        needs_fresh_start: Whether the test has ended the run for a fresh start.
    """

    def __init__(
        self,
        shell: DualShell,
        estimate: ResidualEstimate,
        *,
        target: float,
        max_it: int,
        monitor: Monitor,
    ) -> None:
        """Create the test of one run.

        Args:
            shell: The dual system.
            estimate: Estimate of ‖Tᵀ t‖.
            target: Norm ‖Tᵀ t‖ at which the run ends.
            max_it: Largest number of iterations.
            monitor: Called with each iteration and ‖Tᵀ t‖, or its estimate.
        """
        self._shell = shell
        self._estimate = estimate
        self._target = target
        self._max_it = max_it
        self._monitor = monitor
        # Whether the estimate is ‖Tᵀ t‖ itself, so that measuring it would add nothing.
        self._is_exact = estimate.preconditions_residual and shell.system.has_exact_kernel
        # If the estimate is not exact, CG measures ‖Tᵀ t‖ first when it reaches the target.
        self._next_measurement = np.inf if estimate.preconditions_residual else MEASURING_INTERVAL
        self._smallest = np.inf
        self._smallest_at = 0
        self.best: DualUnknowns | None = None
        self.needs_fresh_start = False

    def show(self, ksp: PETSc.KSP, its: int, rnorm: float) -> None:
        """Pass an iteration to the monitor; called by PETSc in place of the test. Collective.

        It is used if the user's own tolerance ends the method.
        """
        with garbage_collection_resumed(ksp):
            self._monitor(its, self._estimate.update(its, rnorm))

    def __call__(self, ksp: PETSc.KSP, its: int, rnorm: float) -> int:
        """Return PETSc's converged reason after an iteration; called by PETSc. Collective."""
        with garbage_collection_resumed(ksp):
            reason = self._reason(ksp, its, rnorm)
        if self.needs_fresh_start:
            return Reason.CONVERGED_ITS  # any reason that ends the run; ``_outcome`` replaces it
        return reason

    def _reason(self, ksp: PETSc.KSP, its: int, rnorm: float) -> int:
        """Return the converged reason, and set ``needs_fresh_start``. Collective.

        If ``needs_fresh_start`` is True, the caller ends the run whatever the reason is.
        """
        norm = self._estimate.update(its, rnorm)
        if not (np.isfinite(rnorm) and np.isfinite(norm)):
            self._monitor(its, norm)
            return Reason.DIVERGED_NANORINF
        has_departed = False
        if not self._is_exact and (norm <= self._target or its >= self._next_measurement):
            norm, has_departed = self._measure(ksp, rnorm)
            self._next_measurement = its + MEASURING_INTERVAL
        self._monitor(its, norm)
        if norm <= self._target:
            return Reason.CONVERGED_RTOL
        if rnorm == 0.0 and not has_departed:
            # No method can continue with a zero residual. The outer loop computes the true one.
            return Reason.CONVERGED_RTOL
        self._store_if_best(ksp, its, norm)
        self.needs_fresh_start = has_departed or its - self._smallest_at >= STAGNATION_ITERATIONS
        return Reason.DIVERGED_MAX_IT if its >= self._max_it else Reason.ITERATING

    def _measure(self, ksp: PETSc.KSP, rnorm: float) -> tuple[float, bool]:
        """Compute the true residual and compare the updated one with it. Collective.

        Returns:
            ‖Tᵀ t‖ of the true residual, and whether the residual that the method updates departs
            from the true one. This is only known if rnorm is the norm of the updated residual
            itself, as in GMRES; otherwise the answer is False.
        """
        residual = ksp.buildResidual()
        norm = self._estimate.measure(residual, rnorm)
        true_rnorm = residual.norm()
        residual.destroy()
        tests_residual = ksp.getNormType() == PETSc.KSP.NormType.UNPRECONDITIONED
        return norm, tests_residual and true_rnorm > MAX_RESIDUAL_QUOTIENT * rnorm

    def _store_if_best(self, ksp: PETSc.KSP, its: int, norm: float) -> None:
        """Store iteration and iterate if ‖Tᵀ t‖ is smaller than in all iterations before."""
        if norm < self._smallest:
            self._smallest = norm
            self._smallest_at = its
            if self._estimate.preconditions_residual:
                self.best = self._shell.read_unknowns(ksp.getSolution())


def _create_stopping_test(
    ksp: PETSc.KSP, shell: DualShell, r: Array, *, target: float, monitor: Monitor
) -> StoppingTest:
    """Create the stopping test of a KSP that is set up. Collective.

    Args:
        ksp: Krylov method, with its norm and its largest number of iterations.
        shell: The dual system.
        r: Jump of the start, (m,).
        target: Norm ‖Tᵀ t‖ at which the run ends.
        monitor: Called with each iteration and ‖Tᵀ t‖, or its estimate.
    """
    method = ksp.getType()
    preconditions_residual = method in UNPIPELINED_CG and ksp.getNormType() in CG_NORMS
    estimate = ResidualEstimate(
        shell,
        preconditions_residual=preconditions_residual,
        initial=np.nan if preconditions_residual else shell.system.assembled_norm(r),
    )
    *_, max_it = ksp.getTolerances()
    return StoppingTest(shell, estimate, target=target, max_it=max_it, monitor=monitor)


def _outcome(ksp: PETSc.KSP, test: StoppingTest, *, may_continue: bool) -> KrylovInfo:
    """Return how a run ended.

    Args:
        ksp: Krylov method after the run.
        test: Its stopping test.
        may_continue: Whether iterations remain after the largest number of one run.
    """
    reason = ksp.getConvergedReason()
    its = ksp.getIterationNumber()
    needs_fresh_start = test.needs_fresh_start
    if reason == Reason.DIVERGED_MAX_IT and may_continue:
        needs_fresh_start = True
    if needs_fresh_start:
        reason = Reason.ITERATING
    if ksp.getType() in UNPIPELINED_CG and its > 0:
        ritz_values = _ritz_values(ksp)
    else:
        ritz_values = NO_RITZ_VALUES
    return KrylovInfo(reason, its, ritz_values, needs_fresh_start=needs_fresh_start)


def _choose_correction(
    system: DualSystem, r: Array, last: DualUnknowns, best: DualUnknowns | None, reason: int
) -> DualUnknowns:
    """Return the iterate with the smallest ‖Tᵀ t‖ that a run yields. Collective.

    If CG breaks down, the last iterate plus its preconditioned residual z is a candidate, too. CG
    divides by r·z, which is ‖r − G w‖²_Q + w·D w for Q = M. If only a motion w of the subdomains is
    missing, r = G w and D w = 0, and r·z vanishes or is negative by rounding. Then z contains w,
    and the sum is the solution.

    Args:
        system: The dual system.
        r: Right-hand side, (m,).
        last: The last iterate.
        best: Iterate with the smallest ‖Tᵀ t‖; None if the method has not stored any.
        reason: Converged reason of the run.
    """
    if reason == Reason.CONVERGED_RTOL or best is None:
        best = last
    if reason not in NEGATIVE_CURVATURE:
        return best
    z, _ = system.precondition(r - system.multiply(last))
    corrected = last + z
    corrected_norm = system.assembled_norm(r - system.multiply(corrected))
    best_norm = system.assembled_norm(r - system.multiply(best))
    return corrected if corrected_norm < best_norm else best


def _create_ksp(comm: MPI.Comm, method: str, options: KrylovOptions, *, max_it: int) -> PETSc.KSP:
    """Create a KSP with the user's options; the caller destroys it. Collective.

    Args:
        comm: Communicator of the torn matrix.
        method: PETSc's name of the Krylov method.
        options: Options of the method.
        max_it: Largest number of iterations that memory is reserved for.
    """
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix(options.prefix)
    ksp.setType(method)
    ksp.getPC().setType(PETSc.PC.Type.PYTHON)
    fcg_directions = {"ksp_fcg_mmax": min(options.fcg_mmax, max_it)}
    with inserted(options.prefix, fcg_directions):  # petsc4py has no setter
        ksp.setFromOptions()
    # After ``inserted`` the database has the user's value again, which PETSc has not read and would
    # report as unused.
    mark_as_read(options.prefix, "ksp_fcg_mmax")
    if ksp.getType() in UNPIPELINED_CG:
        ksp.setComputeSingularValues(True)
        if not (options.has_tolerance or options.has_norm_type):
            ksp.setNormType(PETSc.KSP.NormType.NATURAL)  # √(rᵀ z), which CG computes anyway
    if ksp.getType() in GMRES_METHODS:
        ksp.setPCSide(PETSc.PC.Side.RIGHT)
        ksp.setGMRESRestart(min(options.gmres_restart, max_it, MAX_GMRES_DIRECTIONS))
    return ksp


def _warn_if_restarted_early(options: KrylovOptions, iterations: int, comm: MPI.Comm) -> None:
    """Log if GMRES has restarted after fewer directions than the options name."""
    if options.gmres_restart > MAX_GMRES_DIRECTIONS and iterations > MAX_GMRES_DIRECTIONS:
        warn(
            f"-{options.prefix}ksp_gmres_restart is {options.gmres_restart}, but GMRES stores at "
            f"most {MAX_GMRES_DIRECTIONS} directions and has restarted after them, which may cost "
            "further iterations.",
            comm,
        )


def _quotient(a: float, b: float) -> float:
    """Return a / b for two norms, and zero for b = 0."""
    return a / b if b > 0.0 else 0.0


def _ritz_values(ksp: PETSc.KSP) -> tuple[float, float]:
    """Return the extreme Ritz values (λ_min, λ_max) of CG, nan if its coefficients are nan."""
    try:
        largest, smallest = ksp.computeExtremeSingularValues()
    except PETSc.Error:  # LAPACK does not accept the coefficients
        return NO_RITZ_VALUES
    return smallest, largest

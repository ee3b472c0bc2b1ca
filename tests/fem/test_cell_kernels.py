# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Kernels of eight cells agree with dolfinx's matrices, vectors and scalars to rounding."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable

import numpy as np
import pytest
from cases import each
from collective import COMM, agree, equal
from problems import Cell, cube
from ufl_values import displacement, require_equal

import basix.ufl
import dolfinx
import ufl

import dolfinx_feti.fem.cell_kernels
from dolfinx_feti import kinematics, materials
from dolfinx_feti.fem.cell_kernels import generator
from dolfinx_feti.fem.cell_kernels.generator import CellKernels, KernelGenerator
from dolfinx_feti.fem.cell_kernels.kernel import Kernel
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.condensation.cellwise_forms import CellwiseForms

EPS = np.finfo(float).eps


def create_kernels(forms: list[ufl.Form], mesh: dolfinx.mesh.Mesh) -> list[Kernel] | None:
    """Return kernels of forms over all cells, from a new generator."""
    return KernelGenerator().create_kernels(forms, mesh)


def split_cells(forms: list[ufl.Form], mesh: dolfinx.mesh.Mesh) -> CellKernels:
    """Split forms into kernels and other integrals, by a new generator."""
    return KernelGenerator().generate(forms, mesh)


def curved(mesh: dolfinx.mesh.Mesh) -> dolfinx.mesh.Mesh:
    """Move the vertices, so that faces of hexahedra are not plane."""
    x = mesh.geometry.x
    x[:, 0] += 0.1 * x[:, 1] ** 2 - 0.05 * x[:, 0] * x[:, 2]
    return mesh


def artery(mesh: dolfinx.mesh.Mesh, degree: int, pressure: tuple) -> list[ufl.Form]:
    """Return all forms of a fibre-reinforced wall, with fibres and cellwise coefficients."""
    u = displacement(mesh, degree)
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, pressure))
    p.interpolate(lambda x: np.cos(3 * x[0]))
    stiffness = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    stiffness.interpolate(lambda x: 2.0 + x[1])
    gdim = mesh.geometry.dim
    fibre = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0, (gdim,))))
    fibre.interpolate(lambda x: np.stack([np.cos(x[0]), np.sin(x[0]), 0 * x[0]])[:gdim])
    F = kinematics.deformation_gradient(u)
    C = kinematics.right_cauchy_green(F)
    J = kinematics.jacobian(F)
    e = ufl.as_vector([1.0, *[0.0] * (gdim - 1)])
    psi = materials.holzapfel_gasser_ogden(C, fibre, e, c=stiffness, k1=2.0, k2=0.8, J=J)
    energy = (psi + p * (J - 1) - p**2 / 20) * ufl.dx(metadata={"quadrature_degree": 2 * degree})
    F_u, F_p = (ufl.derivative(energy, f) for f in (u, p))
    return [energy, F_u, F_p, *(ufl.derivative(F, f) for F in (F_u, F_p) for f in (u, p))]


BODIES: dict[str, Callable[[], list[ufl.Form]]] = {
    "P2-P0": lambda: artery(cube(3, 2), 2, ("DG", 0)),
    "P1-P0": lambda: artery(cube(3, 2), 1, ("DG", 0)),
    "Q2-P1": lambda: artery(curved(cube(3, 2, Cell.hexahedron)), 2, ("DPC", 1)),
    "P2-P1 in the plane": lambda: artery(cube(2, 3), 2, ("DG", 1)),
    "Q2-P0 in the plane": lambda: artery(curved(cube(2, 3, Cell.quadrilateral)), 2, ("DG", 0)),
}


@pytest.mark.serial
@each("body", BODIES)
def test_kernel_is_the_assembled_form(body):
    """One kernel has dolfinx's energy, residuals and blocks of the tangent."""
    forms = body()
    mesh = forms[-1].arguments()[0].ufl_function_space().mesh
    (kernel,) = create_kernels(forms, mesh)
    for form, values in zip(forms, kernel.evaluate(), strict=True):
        require_equal(form, values, 200 * EPS)


ORDERS = {
    "two functions": lambda one, other: (one, other),
    "one function and another constant": lambda one, other: (one, (*one[:2], other[2])),
    "two functions the other way round": lambda one, other: (other, one),
}


@each("order", ORDERS)
def test_functions_of_several_forms(order):
    """Forms in one kernel read their own coefficients, in any order of the forms."""
    mesh = cube(2, 2)
    f = displacement(mesh, 1)
    g = displacement(mesh, 1)
    g.x.array[:] += 2.0
    a, b = (dolfinx.fem.Constant(mesh, value) for value in (4.0, 10.0))
    v = ufl.TestFunction(f.function_space)
    forms = [
        c * ufl.dot(first, second) * first[0] * v[1] * ufl.dx
        for first, second, c in order((f, g, a), (g, f, b))
    ]
    (kernel,) = create_kernels(forms, mesh)
    for form, values in zip(forms, kernel.evaluate(), strict=True):
        require_equal(form, values, 1e-13)


def test_tagged_integrals_contribute_on_their_cells_only():
    """Integrals over tags contribute on their cells only, and on each of several tags."""
    mesh = cube(2, 2)
    u = displacement(mesh, 1)
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    tags = dolfinx.mesh.meshtags(mesh, 2, cells, (cells % 3).astype(np.int32))
    dx = ufl.Measure("dx", mesh, subdomain_data=tags)
    form = u[0] * (dx + dx((1, 2)) + dx(2)) + u[0] * ufl.ds + u[1] * dx(scheme="vertex")
    split = split_cells([form], mesh)
    (rest,) = split.remaining
    one, two, everywhere = (kernel.cells for kernel in split.kernels)
    agree(everywhere is None and all(kernel.forms == (0,) for kernel in split.kernels))
    equal(one, cells[1::3])
    equal(two, cells[2::3])
    agree({i.integral_type() for i in rest.integrals()} == {"exterior_facet", "cell"}, rest)
    form = u[0] * ufl.dx + u[0] * ufl.dx(3)  # dolfinx tells what 3 is
    split = split_cells([form], mesh)
    agree(len(split.kernels) == 1)
    agree(len(split.remaining[0].integrals()) == 1)


def at_points(mesh: dolfinx.mesh.Mesh, shape: tuple[int, ...]) -> dolfinx.fem.Function:
    """Return values at the points of quadrature of degree 2."""
    element = basix.ufl.quadrature_element(mesh.topology.cell_name(), value_shape=shape, degree=2)
    f = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))
    f.x.array[:] = np.linspace(1.0, 2.0, len(f.x.array))
    return f


@pytest.mark.parametrize(
    "what", ["second derivative", "size of cells", "Bessel", "edge element", "quadrature element"]
)
def test_unsupported_forms_are_compiled_by_ffcx(what):
    """Forms that the generator does not support are compiled by FFCx, with dolfinx's values."""
    mesh = cube(2, 3)
    u = displacement(mesh, 2)
    f = {
        "second derivative": lambda: ufl.div(ufl.grad(u[0])),
        "size of cells": lambda: ufl.CellVolume(mesh),
        "quadrature element": lambda: ufl.tr(at_points(mesh, (3, 3))),
        "Bessel": lambda: ufl.bessel_J(1, u[0]),
        "edge element": lambda: (
            dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("N1curl", 1)))[0] + 1.0
        ),
    }[what]()
    v = ufl.TestFunction(u.function_space)
    du = ufl.TrialFunction(u.function_space)
    dx = ufl.dx(degree=2)
    forms = [f * v[0] * dx, f * ufl.inner(ufl.grad(du), ufl.grad(v)) * dx]
    agree(create_kernels(forms, mesh) is None)
    for form, values in zip(forms, tensors(forms, mesh)(), strict=True):
        require_equal(form, values, 1e-13)


def test_facet_integrals_are_added_to_their_cells():
    """Exterior facet integrals are added to the values of their cells."""
    u = displacement(cube(3, 2), 1)
    v = ufl.TestFunction(u.function_space)
    du = ufl.TrialFunction(u.function_space)
    forms = [u[0] * v[1] * (ufl.dx + ufl.ds), ufl.inner(du, v) * ufl.dx + du[0] * v[1] * ufl.ds]
    for form, values in zip(forms, tensors(forms, u.function_space.mesh)(), strict=True):
        require_equal(form, values, 1e-13)


def tensors(forms: list[ufl.Form], mesh: dolfinx.mesh.Mesh) -> Callable[[], list[np.ndarray]]:
    """Return a function that assembles compiled forms cell by cell."""
    return CellwiseForms(forms, mesh, Compiler(COMM)).assemble


def test_nan_stays_in_the_inverted_cell():
    """An inverted cell has NaN in energy, residual and tangent, and other cells do not."""
    mesh = cube(3, 2)
    energy, F_u, _, K, *_ = artery(mesh, 1, ("DG", 0))
    V = K.arguments()[0].ufl_function_space()
    (u,) = (f for f in F_u.coefficients() if f.function_space == V)
    if mesh.topology.index_map(3).size_local:
        u.x.array[3 * V.dofmap.list[0, 0]] += 1.5
    cells = tensors([energy, F_u, K], mesh)()
    inverted = np.isnan(cells[0])
    agree(COMM.allreduce(int(inverted.sum())) > 0)
    for values in cells[1:]:
        equal(np.isnan(values).any(axis=tuple(range(1, values.ndim))), inverted)


def test_values_at_the_time_of_evaluation():
    """Kernels use the current values of coefficients, constants and coordinates."""
    mesh = cube(2, 2)
    u = displacement(mesh, 1)
    k = dolfinx.fem.Constant(mesh, 2.0)
    assemble = tensors([k * u[0] * u[0] * ufl.dx], mesh)
    (before,) = assemble()
    u.x.array[:] *= 3.0
    k.value = 1.0
    mesh.geometry.x[:] *= 2.0
    (after,) = assemble()
    equal(after, 18.0 * before, 1e-14)


WAYS = ["all", "last process", "import"]


@pytest.mark.parametrize("way", WAYS)
def test_private_parts_of_ffcx_that_have_moved(way, monkeypatch, caplog):
    """If FFCx has changed, it compiles all forms itself, with one warning."""
    mesh = cube(2, 3)
    u = displacement(mesh, 1)
    v = ufl.TestFunction(u.function_space)
    du = ufl.TrialFunction(u.function_space)
    form = ufl.inner(ufl.grad(u), ufl.grad(v)) * u[0] * ufl.dx
    forms = [form, ufl.derivative(form, u, du)]
    generate = generator.import_and_generate

    def moved(*arguments):
        if way == "last process" and COMM.rank < COMM.size - 1:
            return generate(*arguments)
        raise AttributeError(f"module 'ffcx.ir' has no attribute '{way}'")

    if way == "import":
        package = dolfinx_feti.fem.cell_kernels
        monkeypatch.delitem(sys.modules, f"{package.__name__}.program", raising=False)
        monkeypatch.delitem(sys.modules, f"{package.__name__}.integrand", raising=False)
        monkeypatch.delattr(package, "program", raising=False)
        monkeypatch.setitem(sys.modules, "ffcx.ir.analysis.graph", None)
    else:
        monkeypatch.setattr(generator, "import_and_generate", moved)
    of_problem = KernelGenerator()
    for _ in range(2):
        agree(of_problem.create_kernels(forms, mesh) is None)
    split = of_problem.generate(forms, mesh)
    agree(not split.kernels)
    agree(not any(form.empty() for form in split.remaining))
    said = COMM.allgather([r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING])
    agree([len(each) for each in said] == [1] + [0] * (COMM.size - 1), said)
    agree("kernels of cells are off" in said[0][0] and "FFCx" in said[0][0], said)
    for form, values in zip(forms, tensors(forms, mesh)(), strict=True):
        require_equal(form, values, 1e-13)


def test_a_form_that_fails_alone_is_no_reason_to_warn(monkeypatch, caplog):
    """One form that cannot be generated causes no warning if others can be."""
    mesh = cube(2, 2)
    u = displacement(mesh, 1)
    generate = generator.import_and_generate

    def partly(forms, mesh, functions, constants):
        if functions:
            raise KeyError("a function that no tape has")
        return generate(forms, mesh, functions, constants)

    monkeypatch.setattr(generator, "import_and_generate", partly)
    agree(create_kernels([u[0] * ufl.dx], mesh) is None)
    agree(not [r for r in caplog.records if r.levelno >= logging.WARNING], caplog.records)

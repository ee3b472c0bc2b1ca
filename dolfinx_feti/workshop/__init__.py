# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Workshop for materials: check, draw and fit an energy in UFL without a mesh of a body.

Example::

    from functools import partial

    psi = partial(materials.neo_hookean, c=3.0)  # any function of C and J, or of F
    material = compile_material(psi)  # incompressible
    print(check(material))
    curve = respond(material, uniaxial(np.linspace(0.8, 1.6, 41)))

In the order of the data: compiled, paths, equilibrium, response, moduli, ellipticity,
checks, report, fitting.
"""

from dolfinx_feti.workshop.checks import Check
from dolfinx_feti.workshop.compiled import Material, States, compile_material, evaluate
from dolfinx_feti.workshop.ellipticity import Ellipticity, least_eigenvalues, scan_ellipticity
from dolfinx_feti.workshop.fitting import Fit, fit
from dolfinx_feti.workshop.moduli import Moduli, small_strain_moduli
from dolfinx_feti.workshop.paths import (
    DeformationPath,
    biaxial,
    equibiaxial,
    inflation,
    pure_shear,
    simple_shear,
    uniaxial,
)
from dolfinx_feti.workshop.report import Report, check
from dolfinx_feti.workshop.response import DataSet, Response, plot_responses, respond

__all__ = [
    "Check",
    "DataSet",
    "DeformationPath",
    "Ellipticity",
    "Fit",
    "Material",
    "Moduli",
    "Report",
    "Response",
    "States",
    "biaxial",
    "check",
    "compile_material",
    "equibiaxial",
    "evaluate",
    "fit",
    "inflation",
    "least_eigenvalues",
    "plot_responses",
    "pure_shear",
    "respond",
    "scan_ellipticity",
    "simple_shear",
    "small_strain_moduli",
    "uniaxial",
]

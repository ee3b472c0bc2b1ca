# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Published numbers: the ellipsoid and its fibres, both solvers on the beam, records and page."""

from __future__ import annotations

import json

import numpy as np
import pytest
from collective import COMM, agree, small

import dolfinx
import ufl

from benchmarks.published import page, run
from benchmarks.published.ellipsoid import create_ellipsoid, ellipsoid_fibre


def integral(form: ufl.Form) -> float:
    return COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form)))


def test_ellipsoid():
    """π r_s² (z − z³/(3 r_l²)) between apex and base, outer less inner; curved cells of order 2."""
    mesh = create_ellipsoid(COMM, 2).mesh
    inner, outer = (
        np.pi * a**2 * (5 + b - (5**3 + b**3) / (3 * b**2)) for a, b in ((7, 17), (10, 20))
    )
    small(integral(1.0 * ufl.dx(mesh)) / (outer - inner) - 1, 1e-3)
    f, x = ellipsoid_fibre(mesh), ufl.SpatialCoordinate(mesh)
    length = integral((ufl.dot(f, f) - 1) ** 2 * ufl.dx(mesh, degree=4))
    small(length / (outer - inner), 1e-12)
    outwards = ufl.as_vector([x[0] / 8.5**2, x[1] / 8.5**2, x[2] / 18.5**2])  # of the middle
    across = ufl.dot(f, outwards) ** 2 / ufl.dot(outwards, outwards)
    small(integral(across * ufl.dx(mesh, degree=4)) / (outer - inner), 1e-2)


@pytest.mark.serial
def test_records_and_their_page(tmp_path):
    """The coarsest beam is outside of the published spread, and the page says so."""
    path = tmp_path / "published.json"
    words = ["--case", "land-1", "--mesh", "1", "--json", str(path)]
    first = run.main(words)
    agree(run.main(words) == first == json.loads(path.read_text()))
    small(first[0]["mumps"] / first[0]["value"] - 1, 1e-6)
    text = page.main([str(path), "--output", str(tmp_path)])
    agree("| 4.0 to 4.2 | 4 to 4.2 | 4.215 | **no** |" in text, text)

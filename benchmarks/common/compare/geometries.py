# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The bodies of the comparison. A new one is a function and an entry of :data:`GEOMETRIES`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mpi4py import MPI

from benchmarks.common.bodies import Body, create_linear, create_neo_hookean
from benchmarks.common.walls.problem import create_clamped
from dolfinx_feti import LinearProblem
from dolfinx_feti.output import writable_folder

#: Relative tolerance of the linear systems of compressible bodies.
RTOL = 1e-8


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What a command line wants of a body."""

    dofs: int  # approximate number
    degree: int  # of the displacement
    kappa: float | None  # kPa; None for a compressible body
    folder: Path  # for meshes


#: Builds a body at rest; the mapping holds the keyword arguments of its problem. Collective.
Create = Callable[[MPI.Comm, Request, Mapping[str, object]], Body | LinearProblem]


@dataclass(frozen=True, slots=True, kw_only=True)
class Geometry:
    """A body: its name on the page, how it is built, and its load or tolerance.

    Args:
        title: Name on the page.
        create: Builds it at rest.
        first_load: Pressure of the first Newton step [mmHg]; None for a linear, compressible body.
        rtol: Relative tolerance of the linear systems of a compressible body.
    """

    title: str
    create: Create
    first_load: float | None = None
    rtol: float = RTOL

    @property
    def is_compressible(self) -> bool:
        """Return True if the body is linear, and κ is not varied."""
        return self.first_load is None


def create_wall(
    name: str, comm: MPI.Comm, request: Request, settings: Mapping[str, object]
) -> Body:
    """Build a wall of a given name, clamped at its openings."""
    return create_clamped(
        comm,
        name,
        dofs=request.dofs,
        degree=request.degree,
        kappa=request.kappa,
        folder=writable_folder(request.folder, comm),
        **settings,
    )


def create_cube(
    clamped: int, comm: MPI.Comm, request: Request, settings: Mapping[str, object]
) -> Body:
    """Build a neo-Hookean cube with 1 or 5 clamped faces."""
    return create_neo_hookean(
        comm, clamped, dofs=request.dofs, degree=request.degree, kappa=request.kappa, **settings
    )


def create_compressible(
    kind: str, comm: MPI.Comm, request: Request, settings: Mapping[str, object]
) -> LinearProblem:
    """Build a linear body of a kind that :func:`create_linear` knows."""
    return create_linear(comm, kind, dofs=request.dofs, degree=request.degree, **settings)


def _compressible(kind: str, title: str, rtol: float = RTOL) -> Geometry:
    return Geometry(title=title, create=partial(create_compressible, kind), rtol=rtol)


#: Bodies by name, in the order of the tables. Under more than 0.01 mmHg the tangent of the vessel's
#: thin wall at rest is indefinite, without the tension that the pressure causes. Rounding allows no
#: smaller tolerances than these for the last plate and the last inclusions.
GEOMETRIES = {
    "tube": Geometry(title="thin wall (tube)", create=partial(create_wall, "tube"), first_load=1.0),
    "vessel": Geometry(
        title="branched vessel", create=partial(create_wall, "vessel"), first_load=0.01
    ),
    "block": Geometry(title="compact block", create=partial(create_cube, 5), first_load=1.0),
    "pillar": Geometry(title="pillar", create=partial(create_cube, 1), first_load=1.0),
    "heat": _compressible("heat", "heat in a cube"),
    "square": _compressible("square", "square"),
    "cube": _compressible("cube", "cube"),
    "plate-20": _compressible("plate-20", "plate, t/L = 1/20"),
    "plate-100": _compressible("plate-100", "plate, t/L = 1/100"),
    "plate-1000": _compressible("plate-1000", "plate, t/L = 1/1000", rtol=1e-5),
    "inclusions-1e4": _compressible("inclusions-1e4", "cube, inclusions 1e4"),
    "inclusions-1e8": _compressible("inclusions-1e8", "cube, inclusions 1e8", rtol=1e-4),
}

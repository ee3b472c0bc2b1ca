# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The bodies of the comparison.

A new one is a function and an entry of :data:`GEOMETRIES`; mesh and problem come from
``common/bodies.py``. It is then a choice of ``--geometry``, and has rows on the page. The figures
show the bodies of ``tables.BODIES``, and all compressible ones, which the tests solve, too. A body
with ``first_load=None`` counts as linear and compressible; the tables give all others a constant
pressure, –P0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mpi4py import MPI

import dolfinx

from benchmarks.common import bodies
from benchmarks.common.bodies import Body, facets_in_plane
from benchmarks.common.walls.problem import create_clamped
from dolfinx_feti import LinearProblem, loads
from dolfinx_feti.output import writable_folder

#: Relative tolerance of the linear systems of compressible bodies.
RTOL = 1e-8

#: Load of the neo-Hookean cubes in their first Newton step [kPa], as large as 1 mmHg.
CUBE_LOAD = loads.mmhg(1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """Size and material of a body on the command line."""

    dofs: int  # approximate number
    degree: int  # of the displacement
    kappa: float | None  # kPa; None for a compressible body
    folder: Path  # for meshes


#: Keyword arguments of the problem of a body.
Settings = Mapping[str, object]

#: Builds a body at rest. Collective.
Create = Callable[[MPI.Comm, Request, Settings], Body | LinearProblem]


@dataclass(frozen=True, slots=True, kw_only=True)
class Geometry:
    """A body: its name on the page, how it is built, and its load or tolerance.

    Args:
        title: Name on the page.
        create: Builds it at rest.
        first_load: Load of the first Newton step, of a wall [mmHg], of a cube as a load factor;
            None for a linear, compressible body.
        rtol: Relative tolerance of the linear systems of a compressible body.
        family: Elements on the page: P on simplices, Q on hexahedra.
        is_wall: Whether it can be loaded along a path, in mmHg.
    """

    title: str
    create: Create
    first_load: float | None = None
    rtol: float = RTOL
    family: str = "P"
    is_wall: bool = False

    @property
    def is_compressible(self) -> bool:
        """Return True if the body is linear, and κ is not varied."""
        return self.first_load is None


def create_tube(comm: MPI.Comm, request: Request, settings: Settings) -> Body:
    """Build a two-layer tube, clamped at its ends."""
    return _create_wall("tube", comm, request, settings)


def create_vessel(comm: MPI.Comm, request: Request, settings: Settings) -> Body:
    """Build a branched vessel, clamped at its openings."""
    return _create_wall("vessel", comm, request, settings)


def _create_wall(name: str, comm: MPI.Comm, request: Request, settings: Settings) -> Body:
    return create_clamped(
        comm,
        name,
        dofs=request.dofs,
        degree=request.degree,
        kappa=request.kappa,
        folder=writable_folder(request.folder, comm),
        **settings,
    )


def create_block(comm: MPI.Comm, request: Request, settings: Settings) -> Body:
    """Build a neo-Hookean cube, clamped on all faces but x = 1, with a dead load e_x + e_y there.

    A dead load adds nothing to the tangent.
    """
    mesh = _unit_cube(comm, request)
    faces = ((0, 0.0), (1, 0.0), (1, 1.0), (2, 0.0), (2, 1.0))
    return bodies.create_neo_hookean_cube(
        mesh,
        kappa=request.kappa,
        clamped=[facets_in_plane(mesh, axis, x) for axis, x in faces],
        force=(1.0, 1.0, 0.0),
        degree=request.degree,
        **settings,
    )


def create_pillar(comm: MPI.Comm, request: Request, settings: Settings) -> Body:
    """Build a neo-Hookean cube, clamped at x = 0, with a pressure at x = 1."""
    mesh = _unit_cube(comm, request)
    return bodies.create_neo_hookean_cube(
        mesh,
        kappa=request.kappa,
        clamped=[facets_in_plane(mesh, 0, 0.0)],
        pressure=1.0,
        degree=request.degree,
        **settings,
    )


def create_heat(comm: MPI.Comm, request: Request, settings: Settings) -> LinearProblem:
    """Build Poisson's equation on a cube."""
    mesh = bodies.create_unit_mesh(
        comm, dofs=request.dofs, degree=request.degree, dim=3, components=1
    )
    return bodies.create_heat_problem(mesh, degree=request.degree, **settings)


def create_square(comm: MPI.Comm, request: Request, settings: Settings) -> LinearProblem:
    """Build an elastic square in its weight."""
    mesh = bodies.create_unit_mesh(
        comm, dofs=request.dofs, degree=request.degree, dim=2, components=2
    )
    return bodies.create_elastic_problem(mesh, degree=request.degree, **settings)


def create_cube(comm: MPI.Comm, request: Request, settings: Settings) -> LinearProblem:
    """Build an elastic cube in its weight."""
    return bodies.create_elastic_problem(
        _unit_cube(comm, request), degree=request.degree, **settings
    )


def create_plate(
    slenderness: float, comm: MPI.Comm, request: Request, settings: Settings
) -> LinearProblem:
    """Build an elastic plate in its weight, clamped at two ends; its length is 1.

    Args:
        slenderness: Length over thickness.
        comm: Communicator.
        request: Size and degree.
        settings: Further arguments of the problem.
    """
    mesh = bodies.create_plate_mesh(
        comm, dofs=request.dofs, degree=request.degree, slenderness=slenderness
    )
    return bodies.create_elastic_problem(
        mesh, degree=request.degree, clamped=(0.0, 1.0), **settings
    )


def create_inclusions(
    ratio: float, comm: MPI.Comm, request: Request, settings: Settings
) -> LinearProblem:
    """Build an elastic cube in its weight, with stiff inclusions.

    Args:
        ratio: Stiffness of the inclusions over that of the rest.
        comm: Communicator.
        request: Size and degree.
        settings: Further arguments of the problem.
    """
    mesh = _unit_cube(comm, request)
    modulus = bodies.with_inclusions(mesh, ratio)
    return bodies.create_elastic_problem(
        mesh, degree=request.degree, shear_modulus=modulus, **settings
    )


def _unit_cube(comm: MPI.Comm, request: Request) -> dolfinx.mesh.Mesh:
    return bodies.create_unit_mesh(
        comm, dofs=request.dofs, degree=request.degree, dim=3, components=3
    )


#: Bodies by name, in the order of the tables. Under more than 0.01 mmHg the tangent of the vessel's
#: thin wall at rest is indefinite, without the tension that the pressure causes. Rounding allows no
#: smaller tolerances than these for the last plate and the last inclusions.
GEOMETRIES = {
    "tube": Geometry(title="thin wall (tube)", create=create_tube, first_load=1.0, is_wall=True),
    "vessel": Geometry(
        title="branched vessel", create=create_vessel, first_load=0.01, is_wall=True
    ),
    "block": Geometry(title="compact block", create=create_block, first_load=CUBE_LOAD),
    "pillar": Geometry(title="pillar", create=create_pillar, first_load=CUBE_LOAD),
    "heat": Geometry(title="heat in a cube", create=create_heat),
    "square": Geometry(title="square", create=create_square),
    "cube": Geometry(title="cube", create=create_cube),
    "plate-20": Geometry(title="plate, t/L = 1/20", create=partial(create_plate, 20.0), family="Q"),
    "plate-100": Geometry(
        title="plate, t/L = 1/100", create=partial(create_plate, 100.0), family="Q"
    ),
    "plate-1000": Geometry(
        title="plate, t/L = 1/1000", create=partial(create_plate, 1000.0), family="Q", rtol=1e-5
    ),
    "inclusions-1e4": Geometry(
        title="cube, inclusions 1e4", create=partial(create_inclusions, 1e4)
    ),
    "inclusions-1e8": Geometry(
        title="cube, inclusions 1e8", create=partial(create_inclusions, 1e8), rtol=1e-4
    ),
}

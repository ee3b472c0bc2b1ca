# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Published cases: bodies and loads, measured quantities, and their published values.

A new case is an entry of :data:`CASES`, and a function that builds its body on a communicator at a
refinement n. It is then a choice of ``--case`` and has rows on the page.

Land et al., *Verification of cardiac mechanics software*, Proc. R. Soc. A 471 (2015) 20150641;
Holzapfel, Gasser, Ogden, J. Elasticity 61 (2000) 1-48; Gasser, Ogden, Holzapfel, J. R. Soc.
Interface 3 (2006) 15-35. Millimetres and kPa.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from benchmarks.common.bodies import (
    Body,
    create_block_mesh,
    create_body,
    displacement_at,
    facets_in_plane,
)
from benchmarks.common.walls.inflated_tube import create_inflated_tube, create_slice, residual_part
from benchmarks.common.walls.oracle import KPA_PER_MMHG, LAYERS, Wall, inflate
from dolfinx_feti import materials
from dolfinx_feti.loading import Steps
from dolfinx_feti.meshes.ellipsoid import LONG, THICKNESS, create_ellipsoid, ellipsoid_fibre
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.wall import facets
from dolfinx_feti.wall.opening_angles import OpeningAngles

#: Ψ(C, J, share of the load, f) with fibres f.
Energy = Callable[[Expr, Expr, Expr, Expr], Expr]


@dataclass(frozen=True, slots=True)
class Quantity:
    """A measured quantity: its name, its published value as text, and the accepted range."""

    name: str
    published: str
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A published case.

    Args:
        name: Name of the body on the page.
        source: Where its numbers are published.
        quantities: What is measured, by its key in the record.
        steps: Steps of the load, as a share of the whole load.
        create: Builds the body on mesh n. Collective.
        judged: The mesh that is compared with the publication; the finest if None.
    """

    name: str
    source: str
    quantities: Mapping[str, Quantity]
    steps: Steps
    create: Callable[[MPI.Comm, int], Body]
    judged: int | None = None


def _subdomains(n: int) -> int:
    """Return the number of subdomains on mesh n.

    With the default, one for 2000 dofs, coarse meshes would have a single subdomain, which is a
    direct solver. With this number FETI iterates on all meshes.
    """
    return 4 * n


def _within(name: str, published: str, value: float, share: float) -> Quantity:
    """Return a quantity that holds within a share of the published value."""
    low, high = sorted((value * (1 - share), value * (1 + share)))
    return Quantity(name, published, low, high)


def _steps(first: float) -> Steps:
    """Return the settings of load steps, the first of which has this share of the load."""
    return Steps(first, least=first / 64)


# Land's beam and ellipsoids

HEART = {"c": 2.0, "b_f": 8.0, "b_t": 2.0, "b_fs": 4.0}
SOFT = {"c": 10.0, "b_f": 1.0, "b_t": 1.0, "b_fs": 1.0}
APEX = {"inside": 0.0, "middle": 0.5, "outside": 1.0}  # fractions of the wall


def _beam(comm: MPI.Comm, n: int) -> Body:
    """Build the beam, bent by 4 Pa from below, clamped at x = 0."""
    mesh = create_block_mesh(comm, (10.0, 1.0, 1.0), (10 * n, n, n))
    e_x = ufl.as_vector([1.0, 0.0, 0.0])

    def energy(C: Expr, J: Expr, _share: Expr) -> Expr:
        return materials.guccione(C, e_x, **HEART, J=J)

    def tip(u: dolfinx.fem.Function) -> dict[str, float]:
        return {"tip": 1.0 + float(displacement_at(u, (10.0, 0.5, 1.0))[2])}

    return create_body(
        mesh,
        energy,
        kappa=1000.0,
        supports=[(None, facets_in_plane(mesh, 0, 0.0))],
        loaded=facets_in_plane(mesh, 2, 0.0),
        pressure=0.004,
        measure=tip,
        settings={"subdomains": _subdomains(n)},
    )


def _isotropic(C: Expr, J: Expr, _share: Expr, f: Expr) -> Expr:
    """Return the energy of the inflated ellipsoid, isotropic."""
    return materials.guccione(C, f, **SOFT, J=J)


def _active(C: Expr, J: Expr, share: Expr, f: Expr) -> Expr:
    """Return the energy of the ellipsoid whose fibres contract."""
    passive = materials.guccione(C, f, **HEART, J=J)
    return passive + materials.active_tension(C, f, tension=60.0 * share)


def _inflated_ellipsoid(comm: MPI.Comm, n: int) -> Body:
    """Build the ellipsoid under 10 kPa, with n bricks through the wall."""
    return _ellipsoid(comm, n, bricks=n, energy=_isotropic, pressure=10.0)


def _contracted_ellipsoid(comm: MPI.Comm, n: int) -> Body:
    """Build the ellipsoid that contracts under 15 kPa, with n + 1 bricks through the wall."""
    return _ellipsoid(comm, n, bricks=n + 1, energy=_active, pressure=15.0)


def _ellipsoid(comm: MPI.Comm, n: int, *, bricks: int, energy: Energy, pressure: float) -> Body:
    """Build an ellipsoid with a clamped base."""
    wall = create_ellipsoid(comm, n, bricks)
    f = ellipsoid_fibre(wall.mesh)

    def energy_with_fibres(C: Expr, J: Expr, share: Expr) -> Expr:
        return energy(C, J, share, f)

    def apex(u: dolfinx.fem.Function) -> dict[str, float]:
        """Return z of the points of the apex."""
        at_rest = {key: -LONG - THICKNESS * t for key, t in APEX.items()}
        return {key: z + float(displacement_at(u, (0.0, 0.0, z))[2]) for key, z in at_rest.items()}

    return create_body(
        wall.mesh,
        energy_with_fibres,
        kappa=1e5,
        supports=[(None, facets(wall, "base"))],
        loaded=facets(wall, "lumen"),
        pressure=pressure,
        measure=apex,
        settings={"subdomains": _subdomains(n)},
    )


# The block in compression


def _block(comm: MPI.Comm, n: int) -> Body:
    """Build a quarter of the block, pressed on a quarter of its top, which moves only downwards."""
    mesh = create_block_mesh(comm, (50.0, 50.0, 50.0), (2 * n,) * 3)
    μ = 1.61148  # kPa
    λ = 499.92568  # kPa
    bottom = facets_in_plane(mesh, 2, 0.0)
    top = facets_in_plane(mesh, 2, 50.0)

    def is_pressed(x: Array) -> Array:
        return np.isclose(x[2], 50) & (x[0] < 25 + 1e-6) & (x[1] < 25 + 1e-6)

    def energy(C: Expr, J: Expr, _share: Expr) -> Expr:
        return materials.neo_hookean(C, c=μ, J=J)

    def depth(u: dolfinx.fem.Function) -> dict[str, float]:
        return {"top": -float(displacement_at(u, (0.0, 0.0, 50.0))[2])}

    pressed = dolfinx.mesh.locate_entities_boundary(mesh, 2, is_pressed)
    return create_body(
        mesh,
        energy,
        kappa=λ + 2 * μ / 3,
        supports=[
            (0, facets_in_plane(mesh, 0, 0.0)),
            (1, facets_in_plane(mesh, 1, 0.0)),
            (2, bottom),
            (0, top),
            (1, top),
        ],
        loaded=np.sort(pressed),
        force=(0.0, 0.0, -9.0),
        measure=depth,
        settings={"subdomains": _subdomains(n)},
    )


# The inflated tube with residual stress, and the strip of the adventitia

PRESSURE = 100.0 * KPA_PER_MMHG
OPENED = {
    name: replace(layer, opening=angle, stretch=stretch)
    for name, layer, angle, stretch in zip(
        ("media", "adventitia"), LAYERS, (160.0, 60.0), (1.05, 1.02), strict=True
    )
}


def create_stressed_tube(
    comm: MPI.Comm, *, size: float, subdomains: int = 4, by_shape: bool = False
) -> Body:
    """Build a quarter of the tube with residual stress.

    Args:
        comm: Communicator.
        size: Length of the bricks [mm].
        subdomains: Their number, over all processes.
        by_shape: Whether G follows from the wall's shape, or is exact at each point.
    """
    element = "q2-p1d"
    kappa = 1e5
    wall = create_slice(comm, size=size, element=element)
    if by_shape:
        angles = {name: layer.opening for name, layer in OPENED.items()}
        G = OpeningAngles(wall, angles, {name: layer.stretch for name, layer in OPENED.items()}).G
    else:
        G = residual_part(wall, list(OPENED.values()))
    tube = create_inflated_tube(
        wall, c=3.0, kappa=kappa, subdomains=subdomains, element=element, G=G
    )
    truth = inflate(PRESSURE, Wall(kappa=kappa, layers=tuple(OPENED.values())))

    def measure() -> dict[str, float]:
        found = tube.compare(truth)
        return {
            "u_r": found["u_r_inner"] / found["u_r_inner_exact"],
            "hoop": found["recovered_tt_error"],
            "radial": found["recovered_rr_error"],
        }

    return replace(tube.body, measure=measure, unit=PRESSURE)


def _tube(comm: MPI.Comm, n: int) -> Body:
    return create_stressed_tube(comm, size=0.36 / 2**n, subdomains=_subdomains(n))


def _tube_by_shape(comm: MPI.Comm, n: int) -> Body:
    return create_stressed_tube(comm, size=0.36 / 2**n, subdomains=_subdomains(n), by_shape=True)


ORACLE = {
    "u_r": Quantity("u_r inside over the oracle's", "1", 0.998, 1.002),
    "hoop": Quantity("error of σ_θθ in L²", "0", 0.0, 0.03),
    "radial": Quantity("error of σ_rr in L²", "0", 0.0, 0.03),
}

#: Load steps of the strip: loose tolerances before the whole load.
STRIP_STEPS = Steps(0.001, least=1e-5, growth=2.0, rtol=1e-3, linear_rtol=1e-4)

ANGLE = np.radians(49.98)  # of the fibres from the axis, that is z
ADVENTITIA = {"c": 7.64, "k1": 996.6, "k2": 524.6}


def _strip(comm: MPI.Comm, n: int) -> Body:
    """Build the strip with fibres in two directions."""
    return _pulled_strip(comm, n, dispersion=0.0)


def _dispersed_strip(comm: MPI.Comm, n: int) -> Body:
    """Build the strip with dispersed fibres."""
    return _pulled_strip(comm, n, dispersion=0.226)


def _pulled_strip(comm: MPI.Comm, n: int, *, dispersion: float) -> Body:
    """Build an eighth of the strip of 3 x 0.5 x 10 mm, pulled by 2 N at an end that is gripped."""
    mesh = create_block_mesh(comm, (1.5, 0.25, 5.0), (3 * n, 1, 10 * n))
    a1, a2 = (ufl.as_vector([s * np.sin(ANGLE), 0.0, np.cos(ANGLE)]) for s in (1, -1))
    end = facets_in_plane(mesh, 2, 5.0)
    middles = [(0, 1.5), (1, 0.25), (2, 0.0)]

    def energy(C: Expr, J: Expr, _share: Expr) -> Expr:
        return materials.gasser_ogden_holzapfel(C, a1, a2, **ADVENTITIA, dispersion=dispersion, J=J)

    def elongation(u: dolfinx.fem.Function) -> dict[str, float]:
        return {"end": float(displacement_at(u, (1.5, 0.25, 5.0))[2])}

    return create_body(
        mesh,
        energy,
        kappa=1e6,
        supports=[
            *((axis, facets_in_plane(mesh, axis, x)) for axis, x in middles),
            (0, end),
            (1, end),
        ],
        loaded=end,
        force=(0.0, 0.0, 2000.0 / 1.5),
        flatness_penalty=1e6,
        measure=elongation,
        settings={"subdomains": _subdomains(n)},
    )


LAND = "Land et al. 2015, problem"
PLACES = {key: f"z of the apex, {key} [mm]" for key in APEX}
HGO = "Holzapfel, Gasser, Ogden 2000"
PULSE = "pulse's documentation (FEniCS, P2–P1, one mesh)"
IKARUS = "39.92 to 40.14 (Q2, continuous and discontinuous pressure, 4³ cells)"
SVFSI = "svFSI-Tests 06-ustruct/02, its result file (Q1–Q1, 15 000 cells)"

CASES = {
    "land-1": Case(
        name="beam",
        source=f"{LAND} 1",
        quantities={"tip": Quantity("z of (10, 0.5, 1) [mm]", "4.0 to 4.2", 4.0, 4.2)},
        steps=_steps(0.25),
        create=_beam,
    ),
    "land-2": Case(
        name="inflated ellipsoid",
        source=f"{LAND} 2",
        quantities={"inside": _within(PLACES["inside"], "−26.6, from a plot", -26.6, 0.005)},
        steps=_steps(0.1),
        create=_inflated_ellipsoid,
    ),
    "land-3": Case(
        name="contracted ellipsoid",
        source=f"{LAND} 3",
        quantities={
            "inside": _within(PLACES["inside"], f"−11.855, {PULSE}", -11.855, 0.05),
            "middle": _within(PLACES["middle"], "about −14, from a plot", -14.0, 0.04),
            "outside": _within(PLACES["outside"], f"−15.490, {PULSE}", -15.4904, 0.005),
        },
        steps=_steps(0.05),
        create=_contracted_ellipsoid,
    ),
    "tube": Case(
        name="tube with opening angles",
        source=f"one-dimensional oracle; {HGO}",
        quantities=ORACLE,
        steps=_steps(0.01),
        create=_tube,
    ),
    "tube-shape": Case(
        name="the same, G from the wall's shape",
        source=f"one-dimensional oracle; {HGO}",
        quantities=ORACLE,
        steps=_steps(0.01),
        create=_tube_by_shape,
    ),
    "block": Case(
        name="block in compression",
        source="Ikarus, tests of displacement and pressure",
        quantities={"top": Quantity("−u_z of the middle of the top [mm]", IKARUS, 39.92, 40.15)},
        steps=_steps(0.1),
        create=_block,
        judged=2,
    ),
    "strip": Case(
        name="adventitia strip",
        source="Gasser, Ogden, Holzapfel 2006",
        quantities={"end": _within("u_z of the end [mm]", f"2.4543, {SVFSI}", 2.4543, 0.005)},
        steps=STRIP_STEPS,
        create=_strip,
    ),
    "strip-dispersed": Case(
        name="adventitia strip, ϰ = 0.226",
        source="Gasser, Ogden, Holzapfel 2006",
        quantities={"end": _within("u_z of the end [mm]", f"1.3892, {SVFSI}", 1.3892, 0.005)},
        steps=STRIP_STEPS,
        create=_dispersed_strip,
    ),
}

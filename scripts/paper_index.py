# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Index of the paper: its equations, tables and figures by their numbers in print.

Augustin, Holzapfel, Steinbach (2014). ``scripts/rooms.py`` joins this index with the numbers that
the docstrings name, and writes the tables of ``docs/equations.md``.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["EQUATIONS", "FIGURES", "NOWHERE", "TABLES", "Entry", "Result"]


@dataclass(frozen=True, slots=True)
class Entry:
    """An equation of the paper.

    Attributes:
        subject: What it states.
        label: Its label in the paper's source; empty if it has none.
    """

    subject: str
    label: str = ""


@dataclass(frozen=True, slots=True)
class Result:
    """A table or figure of the paper.

    Attributes:
        subject: What it shows.
        label: Its label in the paper's source.
        here: Where it is reproduced, or how far that is missing.
    """

    subject: str
    label: str
    here: str


_P = "Augustin_eq:"

#: The equations in the order of print; the first one is eq. 1.
EQUATIONS = [
    Entry("deformation $x = X + U(X)$"),
    Entry("deformation gradient $F$"),
    Entry("Flory's split of $F$", _P + "decompositionFlory"),
    Entry("Flory's split of $C$"),
    Entry("equilibrium, current configuration", _P + "current"),
    Entry("equilibrium, reference configuration", _P + "reference"),
    Entry("prescribed displacement", _P + "Dirichlet"),
    Entry("surface traction", _P + "Neumann"),
    Entry("stresses of an energy"),
    Entry("energy: volumetric and isochoric part", _P + "decompositionStrain"),
    Entry("stress: volumetric and isochoric part", _P + "additiveStress"),
    Entry("hydrostatic pressure", _P + "hydrostaticPressure"),
    Entry("energy of the wall: all parts", _P + "isoaniso"),
    Entry("volumetric energy"),
    Entry("neo-Hookean energy", _P + "iso"),
    Entry("energy of the first fibre family", _P + "aniso_1"),
    Entry("energy of the second fibre family", _P + "aniso_2"),
    Entry("weak form, current configuration", _P + "WeakCurrent"),
    Entry("linear strain $ε(v)$"),
    Entry("weak form, reference configuration", _P + "WeakReference"),
    Entry("variation of the Green–Lagrange strain"),
    Entry("Newton's method", _P + "NewtonRecursion"),
    Entry("Newton's method, discretised", _P + "NewtonRecursion_h"),
    Entry("tangent", _P + "Tangent"),
    Entry("load stepping", _P + "loadStepping"),
    Entry("linear system of a Newton step", _P + "LGS"),
    Entry("entries of the tangent"),
    Entry("entries of load and internal force"),
    Entry("equation of the pressure, condensed", _P + "volumetricVariationDis"),
    Entry("decomposition into subdomains", _P + "decomposition"),
    Entry("skeleton, here the interface $Γ$", _P + "skeleton"),
    Entry("linear system, ordered by subdomains", _P + "reordered"),
    Entry("tearing"),
    Entry("continuity across the interface", _P + "jumpConstraints"),
    Entry("interconnecting, here gluing", _P + "jumpConstraints 1"),
    Entry("classical FETI system", _P + "classicalFetiLGS"),
    Entry("gluing with Dirichlet conditions", _P + "jumpoperatorAF"),
    Entry("all-floating FETI system", _P + "AFFETI"),
    Entry("local solutions, kernel", _P + "localSolutions"),
    Entry("solvability of floating subdomains"),
    Entry("Schur complement system for $λ$ and $γ$"),
    Entry("dual system", _P + "classicalFetiF"),
    Entry("$F$, $G$, $d$ and $e$"),
    Entry("projection $P$", _P + "projection"),
    Entry("projected dual system", _P + "dualProblem"),
    Entry("preconditioner", _P + "feti_preconditioner"),
    Entry("start $λ_0$"),
    Entry("recovery of $γ$, here $s$"),
    Entry("lumped preconditioner", _P + "LumpedVK"),
    Entry("Dirichlet preconditioner", _P + "DirichletVK"),
    Entry("Schur complement $S_i$ of a subdomain"),
    Entry("fundamental solution", _P + "fundSol"),
    Entry("L2 error", "eq:L2Error"),
    Entry("estimated order of convergence", "eq:L2Errora"),
    Entry("fibre directions", _P + "rotation"),
    Entry("stress magnitude", "stressmag"),
    Entry("displacement norm, relative displacement"),
    Entry("efficiency of strong scaling", _P + "efficiency"),
]

#: Equations that no file holds, and why.
NOWHERE = {
    5: "none: everything is on the reference configuration",
    6: "none: the strong form; its weak form is eq. 20",
    18: "none: everything is on the reference configuration",
}

_LINEAR = "[The linear study](results/linear.md)"
_LOADING = "[Load stepping](results/loading.md)"
_NEWTON = "[The nonlinear study](results/nonlinear.md), with the paper's values"
_SCALING = (
    "[Strong scaling](results/scaling.md): measured on two cores, and extrapolated by "
    "a model of what was counted"
)

#: The tables in the order of print.
TABLES = [
    Result(
        "material parameters",
        "Augustin_tab:param",
        "The defaults of `ArteryParameters` in `dolfinx_feti/mechanics/materials.py`.",
    ),
    Result(
        "cube, linear elements",
        "Augustin_tab:cube512_linear",
        f"{_LINEAR}, with the paper's values: levels 1 to 4; level 5 was not run.",
    ),
    Result(
        "cube, quadratic elements",
        "Augustin_tab:cube512_quadratic",
        f"{_LINEAR}, without the paper's values: levels 1 to 3; level 4 was not run.",
    ),
    Result(
        "aorta, linear elements",
        "Augustin_tab:aorta_linear",
        f"{_NEWTON}, on another wall of one layer, with up to 30 537 dofs.",
    ),
    Result(
        "carotid artery, linear elements",
        "Augustin_tab:carotis_linear",
        f"{_NEWTON}, on another wall of two layers, with up to 1 881 dofs.",
    ),
    Result(
        "aorta, quadratic elements",
        "Augustin_tab:aorta_quadratic",
        f"{_NEWTON}, on another wall of one layer, with up to 202 740 dofs.",
    ),
    Result(
        "carotid artery, quadratic elements",
        "Augustin_tab:carotis_quadratic",
        f"{_NEWTON}, on another wall of two layers, with up to 11 970 dofs.",
    ),
    Result("aorta, strong scaling", "Augustin_tab:aorta_scaling", f"{_SCALING}."),
    Result("carotid artery, strong scaling", "Augustin_tab:carotis_scaling", f"{_SCALING}."),
]

#: The figures in the order of print.
FIGURES = [
    Result("model of an artery", "Augustin_fig:arterialModel", "A drawing."),
    Result("decomposition of a domain", "Augustin_fig:decomposition", "A drawing."),
    Result("classical and all-floating gluing", "Augustin_fig:allfloating", "A drawing."),
    Result(
        "aorta: displacement, subdomains, stress magnitude",
        "Augustin_fig:aorta",
        "Not yet. `make demo` draws the subdomains and the stress magnitude of another vessel, "
        "as in the picture of README.md.",
    ),
    Result("carotid artery: stress magnitude", "Augustin_fig:carotis", "Not yet."),
    Result(
        "stress inside the aorta; layers and fibre directions",
        "Augustin_fig:fiberDirections",
        "Not yet as pictures. `make demo` writes layers and fibre directions of its vessel for "
        "ParaView.",
    ),
    Result(
        "stress magnitude and displacement over the load steps",
        "Augustin_fig:timestepping",
        f"{_LOADING}, on a tube and on another vessel.",
    ),
    Result(
        "iterations and time of a load step",
        "Augustin_fig:timesteppingIterations",
        f"{_LOADING}, on a tube and on another vessel.",
    ),
    Result("computation times over the cores", "Augustin_fig:scaling", f"{_SCALING}."),
]

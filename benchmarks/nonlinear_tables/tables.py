# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Tables of the nonlinear study: the paper's four beside ours, volume ratios, few points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from benchmarks.common.records import Record
from benchmarks.common.table import Table, count, number
from benchmarks.nonlinear_tables import paper
from benchmarks.nonlinear_tables.groups import (
    CHOICES,
    LAYERS,
    PRECONDITIONERS,
    TYPES,
    is_solved,
    usual,
)

__all__ = ["contact_table", "failure_table", "newton_tables", "volume_table"]

#: The arteries that the walls stand for.
ARTERIES = {1: "aorta", 2: "carotid artery"}

#: What a mesh and its decomposition are told by.
WALL = ("geometry", "size", "degree", "layers", "subdomains", "processes", "pressure")

CONTACTS = {"few": "three points", "none": "none"}


def newton_tables(records: Sequence[Record]) -> Iterator[Table]:
    """Make a table for each wall: a Newton step in the paper and here, with both choices."""
    mine = usual(records)
    for wall in dict.fromkeys(tuple(r[name] for name in WALL) for r in mine):
        of_wall = [r for r in mine if tuple(r[name] for name in WALL) == wall]
        yield _newton_table(of_wall)


def _newton_table(records: Sequence[Record]) -> Table:
    first = records[0]
    layers, degree = int(first["layers"]), int(first["degree"])
    by_case = {(r["type"], r["kappa"], r["pc"], r["choices"]): r for r in records}
    rows = []
    for kind in TYPES:
        for kappa in sorted({r["kappa"] for r in records}):
            for pc in PRECONDITIONERS:
                ours = [by_case.get((kind, kappa, pc, choices)) for choices in CHOICES]
                if any(ours):
                    theirs = paper.SOLVES.get((layers, degree, kind, kappa, pc))
                    cells = [cell for record in ours for cell in _cells(record)]
                    rows.append([TYPES[kind], f"{kappa:g}", pc, *_paper_cells(theirs), *cells])
    head = ["type", "κ [kPa]", "preconditioner", "the paper: it.", "s"]
    for name in CHOICES.values():
        head += [f"{name}: it.", "steps", "set-up [s]", "Krylov [s]"]
    known = [r for r in records if "multipliers" in r]
    most = {name: max((r[name] for r in known), default=0) for name in ("dofs", "cells")}
    title = f"P{degree}–P0, {LAYERS[layers]}: the paper's {ARTERIES[layers]}, here the "
    size = "" if first["size"] is None else f", edges of {first['size']:g} mm"
    note = (
        f"{count(most['dofs'])} dofs, {count(most['cells'])} tetrahedra{size}, "
        f"{first['subdomains']} subdomains, {first['processes']} process(es), "
        f"{first['pressure']:g} mmHg. *it.*: mean "
        "iterations of a Newton step; *steps*: iterations of each; seconds per Newton step. "
        "The paper's mesh, machine and seconds (of a whole Newton step) are others."
    )
    title += str(first["geometry"])
    return Table(title, head, rows, note)


def _paper_cells(solve: paper.Solve | None) -> list[str]:
    if solve is None:
        return ["–", "–"]
    its = "> 10 000" if solve.iterations is None else count(solve.iterations)
    return [its, number(solve.seconds)]


def _cells(record: Record | None) -> list[str]:
    """Return mean iterations, those of each step, and seconds; or what was missing."""
    if record is None:
        return ["–"] * 4
    if "iterations_exceed" in record:
        return [f"> {count(record['iterations_exceed'])}", *["–"] * 3]
    if "failure" in record:
        return ["failed", *["–"] * 3]
    return [
        count(record["linear_iterations_mean"]),
        " ".join(map(str, record["linear_iterations_per_newton"])),
        f"{record['seconds_setup_per_newton']:.2f}",
        f"{record['seconds_krylov_per_newton']:.2f}",
    ]


def volume_table(records: Sequence[Record]) -> Table:
    """Make the table of J, which does not depend on how a system is solved."""
    names = (*WALL, "kappa")
    solved = [r for r in usual(records) if is_solved(r) and r["choices"] == "default"]
    first_of = {tuple(r[name] for name in names): r for r in reversed(solved)}
    rows = [
        [
            str(r["geometry"]),
            LAYERS[r["layers"]],
            f"P{r['degree']}–P0",
            count(r["cells"]),
            f"{r['kappa']:g}",
            *(f"{r[f'{which}_J']:.4f}" for which in ("min", "mean", "max")),
            number(r["mean_deviation_J"]),
            f"{100 * r['share_J']:.1f} %",
        ]
        for r in sorted(
            first_of.values(),
            key=lambda r: (r["geometry"], r["layers"], r["kappa"], r["degree"], r["cells"]),
        )
    ]
    head = ["wall", "layers", "elements", "tetrahedra", "κ [kPa]", "least J", "mean J"]
    head += ["greatest J", "mean of abs(J − 1)", "more than 1 % off"]
    note = (
        "J of an element is its deformed volume over its volume at rest; the last column is the "
        "share of the elements with |J − 1| > 1 %."
    )
    return Table("How well the volume is kept", head, rows, note)


def contact_table(records: Sequence[Record]) -> Table:
    """Make the table of the subdomain that touches the clamped rim in a few points, or not."""
    touched = [r for r in records if r["contact"] in CONTACTS]
    names = ("geometry", "degree", "kappa", "pc", "choices", "type")
    rows = []
    for key in sorted({tuple(r[name] for name in names) for r in touched}):
        of_key = {r["contact"]: r for r in touched if tuple(r[n] for n in names) == key}
        geometry, degree, kappa, pc, choices, kind = key
        cells = [_cells(of_key.get(contact))[0] for contact in CONTACTS]
        name = [str(geometry), f"P{degree}–P0", f"{kappa:g}", str(pc), CHOICES[choices]]
        rows.append([*name, TYPES[kind], *cells])
    head = ["wall", "elements", "κ [kPa]", "preconditioner", "choices", "type"]
    head += [f"points: {name}" for name in CONTACTS.values()]
    note = (
        "Mean iterations of a Newton step. From a subdomain on a clamped rim the cells there are "
        "cut off, all of them or all but a few that touch the rim in three points; the two "
        "decompositions differ in these few cells alone."
    )
    return Table("A subdomain that touches the Dirichlet boundary in few points", head, rows, note)


def failure_table(records: Sequence[Record]) -> Table:
    """Make the table of the cases that did not arrive."""
    lost = [r for r in records if not is_solved(r)]
    rows = [
        [
            str(r["geometry"]),
            LAYERS[r["layers"]],
            f"P{r['degree']}–P0",
            TYPES[r["type"]],
            f"{r['kappa']:g}",
            str(r["pc"]),
            CHOICES[r["choices"]],
            str(r["newton_iterations"]),
            str(r.get("failure") or f"more than {r['iterations_exceed']} iterations"),
        ]
        for r in lost
    ]
    head = ["wall", "layers", "elements", "type", "κ [kPa]", "preconditioner", "choices"]
    head += ["Newton steps before", "reason"]
    return Table("Cases that did not arrive", head, rows)

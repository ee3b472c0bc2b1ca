# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the nonlinear study: the paper's tables beside ours.

    python3 -m benchmarks.nonlinear.page build/nonlinear.json --output build/results

writes ``nonlinear.md``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product

from benchmarks.common.pages import FORMS, Fields, groups, section, write_page
from benchmarks.common.records import Record
from benchmarks.common.walls.first_step import ARTERIES, CHOICES, LAYERS, PRECONDITIONERS, TYPES
from benchmarks.nonlinear import paper
from benchmarks.nonlinear.run import is_known, is_solved

__all__ = ["main"]

#: What a mesh and its decomposition are told by.
WALL = ("geometry", "size", "degree", "layers", "subdomains", "processes", "pressure")


def _fields(records: Sequence[Record]) -> Fields:
    usual = [record for record in records if record["contact"] == "whole"]
    return {
        "walls": [_wall(mine) for _, mine in groups(usual, *WALL)],
        "volumes": section(_volumes(usual)),
        "contacts": section(_contacts(records)),
        "failures": section(_named(r) for r in records if not is_solved(r)),
    }


def _named(record: Record) -> Record:
    """Return a record with the names of its parameters."""
    return record | {
        "kind": TYPES[str(record["type"])],
        "wall": LAYERS[int(record["layers"])],
        "chosen": CHOICES[str(record["choices"])],
        "why": record.get("failure", f"more than {record.get('iterations_exceed')} iterations"),
    }


def _wall(records: Sequence[Record]) -> dict[str, object]:
    """Return a Newton step on one wall, in the paper and here, with both choices."""
    first = records[0]
    layers, degree = int(first["layers"]), int(first["degree"])
    by_case = {(r["type"], r["kappa"], r["pc"], r["choices"]): r for r in records}
    rows = []
    for kind, kappa, pc in product(TYPES, sorted({r["kappa"] for r in records}), PRECONDITIONERS):
        ours = {name: by_case.get((kind, kappa, pc, name)) for name in CHOICES}
        if any(ours.values()):
            row = {"kind": TYPES[kind], "kappa": kappa, "pc": pc}
            theirs = _papers(layers, degree, kind, kappa, pc)
            rows.append(row | theirs | {name: _cells(r) for name, r in ours.items()})
    known = [r for r in records if "multipliers" in r]
    most = {name: max((r[name] for r in known), default=0) for name in ("dofs", "cells")}
    edges = "" if first["size"] is None else f", edges of {first['size']:g} mm"
    names = {"artery": ARTERIES[layers], "wall": LAYERS[layers], "edges": edges}
    names |= dict(zip(("their_cells", "their_vertices"), paper.MESHES[layers], strict=True))
    names |= {"their_subdomains": paper.SUBDOMAINS[layers, degree]}
    return {name: first[name] for name in WALL} | most | names | {"rows": rows}


def _papers(layers: int, degree: int, kind: str, kappa: float, pc: str) -> dict[str, object]:
    solve = paper.SOLVES.get((layers, degree, kind, kappa, pc))
    if solve is None:
        return {}
    its = FORMS["count"](solve.iterations) if solve.iterations else "> 10 000"
    return {"their_its": its, "their_seconds": solve.seconds}


def _cells(record: Record | None) -> dict[str, object]:
    """Return mean iterations, those of each step, and seconds; or what was missing."""
    if record is None:
        return {}
    if "iterations_exceed" in record:
        return {"its": f"> {FORMS['count'](record['iterations_exceed'])}"}
    if "failure" in record:
        return {"its": "failed"}
    steps = " ".join(map(str, record["linear_iterations_per_newton"]))
    return record | {"its": FORMS["count"](record["linear_iterations_mean"]), "steps": steps}


def _volumes(usual: Sequence[Record]) -> list[Record]:
    """Return J by wall, which does not depend on how a system is solved."""
    solved = [r for r in usual if is_solved(r) and r["choices"] == "default"]
    rows = [_named(mine[0]) for _, mine in groups(solved, *WALL, "kappa")]
    names = ("geometry", "layers", "kappa", "degree", "cells")
    return sorted(rows, key=lambda r: tuple(r[name] for name in names))


def _contacts(records: Sequence[Record]) -> Iterator[Record]:
    """Yield the cases of a subdomain that touches the clamped rim in a few points, or not."""
    touched = [r for r in records if r["contact"] != "whole"]
    names = ("geometry", "degree", "kappa", "pc", "choices", "type")
    for _, mine in sorted(groups(touched, *names), key=lambda item: item[0]):
        yield _named(mine[0]) | {str(r["contact"]): _cells(r) for r in mine}


main = partial(write_page, __file__, "nonlinear", known=is_known, fields=_fields)

if __name__ == "__main__":
    main()

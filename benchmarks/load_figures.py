# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's figures of the load stepping (Augustin_fig:timestepping, …Iterations), and a table.

    python3 -m benchmarks.load_figures build/loading.json --output build/results

draws, for each mesh and degree in the records that FETI ran on, the stress magnitude over the
relative displacement u_rel = u_norm / u_max and u_norm over the pressure at the points A–E, for
both variants the iterations of a Newton step, and for them and one subdomain, a direct solver, the
seconds of a load step; for each mesh with records of P1–P0 and P2–P0, the displacements and volume
ratios of both; and writes ``loading.md`` beside them.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from benchmarks.common.pages import by_mesh, run_command
from benchmarks.common.records import Record
from benchmarks.common.table import Table, count, number
from benchmarks.walls.points import NAMES

__all__ = ["main", "write"]

VARIANTS = {
    "all_floating": ("all-floating", "#8a8f98", "o-"),
    "classical": ("classical", "#1c1c1c", "s--"),
    "direct": ("one subdomain, direct", "#b5443a", "^:"),
}
COLOURS = ("#1f5a8a", "#b5443a", "#0f7a5a", "#c9962b", "#6b4a8a")


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw what the command line asks for, see :func:`pages.run_command`."""
    return run_command(
        "load_figures",
        __doc__,
        arguments,
        known=lambda record: "u_norm" in record,
        writer="benchmarks.load_stepping",
        write=write,
    )


def write(folder: Path, records: Sequence[Record], remark: str = "") -> None:
    """Write a picture for each wall and degree, and the page.

    Args:
        folder: Where they go.
        records: Of all load steps.
        remark: Remark about the runs.
    """
    pages = [_introduction(records, remark)]
    for mesh in by_mesh(records):
        for (degree,), mine in _groups(mesh.records, "degree"):
            if any(_variant(record) != "direct" for record in mine):
                picture = f"loading_{mesh.name}_p{degree}.png"
                draw(folder / picture, mine)
                pages.append(f"![Load steps, {mesh.about}, P{degree}–P0]({picture})\n")
        picture = f"locking_{mesh.name}.png"
        if draw_locking(folder / picture, mesh.records):
            pages.append(f"![P1–P0 beside P2–P0, {mesh.about}]({picture})\n")
    pages += [totals(records).markdown(), ends(records).markdown()]
    (folder / "loading.md").write_text("\n".join(pages))


def draw(path: Path, records: Sequence[Record]) -> None:
    """Draw the four panels of one wall and degree."""
    fig, axes = plt.subplots(2, 2, figsize=(10, 7.5))
    (stress, norm), (iterations, seconds) = axes
    path_of = {kind: _of(records, kind) for kind in VARIANTS}
    path_of = {kind: steps for kind, steps in path_of.items() if steps}
    _draw_points(stress, norm, max(path_of.values(), key=lambda path: path[-1]["pressure_mmhg"]))
    for kind, steps in path_of.items():
        name, colour, line = VARIANTS[kind]
        pressure = [step["pressure_mmhg"] for step in steps]
        style = {"color": colour, "label": name, "ms": 4}
        if kind != "direct":
            iterations.plot(pressure, [s["linear_iterations_mean"] for s in steps], line, **style)
        seconds.plot(pressure, [_seconds(step) for step in steps], line, **style)
    iterations.set_ylabel("FETI iterations of a Newton step")
    seconds.set_ylabel("seconds of a load step")
    for ax in (norm, iterations, seconds):
        ax.set_xlabel("pressure [mmHg]")
        ax.set_ylim(bottom=0)
    for ax in axes.ravel():
        ax.grid(color="0.92")
        ax.spines[["top", "right"]].set_visible(False)
        ax.legend(frameon=False)
    fig.tight_layout()
    fig.savefig(path, dpi=120)
    plt.close(fig)


def draw_locking(path: Path, records: Sequence[Record]) -> bool:
    """Draw displacements and volume ratios of P1–P0 beside those of P2–P0 on the same mesh.

    Args:
        path: The file.
        records: Of one mesh; those without volume ratios take no part.

    Returns:
        Whether there are both.
    """
    of_degree: dict[int, list[Record]] = {}
    for (degree, *_), steps in _groups(records, "degree", "subdomains", "type"):
        known = [step for step in steps if "mean_deviation_J" in step]
        if known and len(known) > len(of_degree.get(degree, [])):
            of_degree[degree] = sorted(known, key=lambda step: float(step["pressure_mmhg"]))
    if len(of_degree) < 2:
        return False
    fig, (norm, volume) = plt.subplots(1, 2, figsize=(10, 4))
    for degree, line in ((1, ".--"), (2, ".-")):
        steps = of_degree[degree]
        pressure = [step["pressure_mmhg"] for step in steps]
        for name, colour in zip(NAMES, COLOURS, strict=True):
            u = [step["u_norm"][name] for step in steps]
            norm.plot(pressure, u, line, color=colour, label=f"{name}, P{degree}–P0")
        for of, colour in (("mean_deviation_J", COLOURS[0]), ("min_J", COLOURS[1])):
            off = [s[of] if of == "mean_deviation_J" else 1.0 - s[of] for s in steps]
            label = {"mean_deviation_J": "mean of |J − 1|", "min_J": "1 − least J"}[of]
            volume.plot(pressure, off, line, color=colour, label=f"{label}, P{degree}–P0")
    norm.set_ylabel("displacement norm u_norm [mm]")
    volume.set_ylabel("change of volume of the elements")
    for ax in (norm, volume):
        ax.set_xlabel("pressure [mmHg]")
        ax.set_ylim(bottom=0)
        ax.grid(color="0.92")
        ax.spines[["top", "right"]].set_visible(False)
        ax.legend(frameon=False, fontsize=8, ncols=2 if ax is norm else 1)
    fig.tight_layout()
    fig.savefig(path, dpi=120)
    plt.close(fig)
    return True


def totals(records: Sequence[Record]) -> Table:
    """Sum up each run."""
    head = ["wall", "edges [mm]", "elements", "subdomains", "type", "processes", "recycled"]
    head += ["up to [mmHg]", "load steps"]
    head += ["Newton steps", "FETI iterations", "in a Newton step", "worst residual", "seconds"]
    rows = []
    for key, steps in _runs(records):
        mean = [step["linear_iterations_mean"] for step in steps]
        whole = sum(map(_seconds, steps))
        rows.append(
            [
                *_wall_cells(key),
                VARIANTS[_variant(steps[0])][0],
                str(steps[0]["processes"]),
                str(steps[0]["recycle"]),
                number(max(step["pressure_mmhg"] for step in steps)),
                str(len(steps)),
                str(sum(step["newton_iterations"] for step in steps)),
                count(sum(step["linear_iterations"] for step in steps)),
                f"{min(mean):.0f} to {max(mean):.0f}",
                f"{max(step['max_linear_residual'] for step in steps):.1e}",
                "–" if math.isnan(whole) else count(whole),
            ]
        )
    note = (
        "The paper: 572 load steps of four to five Newton steps, 248 to 268 iterations each with "
        "all-floating and 340 to 358 with classical FETI. Failed attempts are counted here. A run "
        "has no seconds if it was suspended on its way."
    )
    return Table("From rest to the highest pressure", head, rows, note)


def _seconds(step: Record) -> float:
    """Return the seconds of a load step, NaN if the record has none."""
    return math.nan if step["seconds"] is None else float(step["seconds"])


def ends(records: Sequence[Record]) -> Table:
    """Show the last state of each run: variants beside each other, and P1–P0 beside P2–P0."""
    head = ["wall", "edges [mm]", "elements", "subdomains", "type", "pressure [mmHg]"]
    head += [*(f"u {name} [mm]" for name in NAMES), *(f"σ_mag {name} [kPa]" for name in NAMES)]
    head += ["least J", "greatest J", "mean of abs(J − 1)", "more than 1 % off"]
    rows = []
    for key, steps in _runs(records):
        last = max(steps, key=lambda step: step["pressure_mmhg"])
        points = [last[of][name] for of in ("u_norm", "stress_magnitude") for name in NAMES]
        share = last.get("share_J")
        rows.append(
            [
                *_wall_cells(key),
                VARIANTS[_variant(last)][0],
                number(last["pressure_mmhg"]),
                *(f"{value:.6g}" for value in points),
                *(number(last.get(name)) for name in ("min_J", "max_J", "mean_deviation_J")),
                "–" if share is None else f"{100 * share:.1f} %",
            ]
        )
    note = (
        "J of an element is its deformed volume over its volume at rest; the last column is the "
        "share of the elements with |J − 1| > 1 %."
    )
    return Table("At the highest pressure", head, rows, note)


def _runs(records: Sequence[Record]) -> Iterator[tuple[tuple[Any, ...], list[Record]]]:
    """Yield wall, size, degree, subdomains and type of each run, and its load steps."""
    yield from _groups(records, "geometry", "size", "degree", "subdomains", "type")


def _groups(
    records: Sequence[Record], *names: str
) -> Iterator[tuple[tuple[Any, ...], list[Record]]]:
    """Yield the records that agree in some parameters, which come first."""
    for key in dict.fromkeys(tuple(record[name] for name in names) for record in records):
        yield key, [r for r in records if tuple(r[name] for name in names) == key]


def _wall_cells(key: tuple[Any, ...]) -> list[str]:
    """Return the cells of a table that tell the wall of a run, its elements and subdomains."""
    geometry, size, degree, subdomains, _ = key
    return [geometry, "–" if size is None else f"{size:g}", f"P{degree}–P0", str(subdomains)]


def _draw_points(stress: Axes, norm: Axes, steps: Sequence[Record]) -> None:
    for name, colour in zip(steps[0]["u_norm"], COLOURS, strict=True):
        u = [0.0, *(step["u_norm"][name] for step in steps)]
        sigma = [0.0, *(step["stress_magnitude"][name] for step in steps)]
        pressure = [0.0, *(step["pressure_mmhg"] for step in steps)]
        most = max(u) or 1.0
        stress.plot([value / most for value in u], sigma, ".-", color=colour, label=name)
        norm.plot(pressure, u, ".-", color=colour, label=name)
    stress.set_xlabel("relative displacement u_rel")
    stress.set_ylabel("stress magnitude σ_mag [kPa]")
    norm.set_ylabel("displacement norm u_norm [mm]")


def _of(records: Sequence[Record], kind: str) -> list[Record]:
    mine = [record for record in records if _variant(record) == kind]
    return sorted(mine, key=lambda record: record["pressure_mmhg"])


def _variant(record: Record) -> str:
    return "direct" if record["subdomains"] == 1 else str(record["type"])


def _introduction(records: Sequence[Record], remark: str) -> str:
    first = records[0]
    machine = ", ".join(f"{name} {value}" for name, value in first["machine"].items())
    material = f"c = {first['c']:g} kPa and κ = {first['kappa']:g} kPa"
    lines = [
        "# Load stepping",
        "",
        f"A wall with {material} is inflated in load steps that adapt, each Newton step",
        "solved by FETI with the Dirichlet preconditioner; the table has the worst relative",
        "residual and the number of recycled directions. The points A–E are cells far from each",
        "other. On the vessel, a cerebral aneurysm with the material of a carotid artery, such",
        "pressures are a numerical benchmark and no physiology.",
        "",
        f"{machine}. `make figures` runs it again and goes on where it was ended.",
    ]
    return "\n".join([*lines, *(["", remark] if remark else [])]) + "\n"


if __name__ == "__main__":
    sys.exit(main())

# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the scaling study: seconds, counts, a model of both, and the paper's figure.

    python3 -m benchmarks.scaling.page build/scaling.json --output build/results

writes ``scaling.md`` and ``scaling.png`` (Augustin_fig:scaling).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from benchmarks.common.pages import Fields, groups, section, write_page
from benchmarks.common.plots import COLOURS, OPEN, curve, picture
from benchmarks.common.records import Record
from benchmarks.common.walls.first_step import ARTERIES, CHOICES
from benchmarks.common.walls.first_step import TYPES as NAMES
from benchmarks.scaling import paper
from benchmarks.scaling.model import KRYLOV, Machine, Model, create_model, efficiency
from benchmarks.scaling.run import TYPES, is_known

__all__ = ["main"]

#: What cases share that differ in their number of processes alone.
CASE = ("geometry", "size", "subdomains", "layers", "choices")

#: Processes of weak scaling, as many dofs on each.
WEAK = (512, 10_000)

PARTS = ("local", "krylov", "total")

#: Microseconds, GB/s and Gflop/s.
UNITS = {"latency": 1e6, "bandwidth": 1e-9, "stream": 1e-9, "rate": 1e-9, "disk": 1e-9}

STYLES = {"local": {"color": COLOURS[2]}, "krylov": {"color": COLOURS[0]}, "total": {"color": "k"}}

#: Processes that the model is asked for, beyond the paper's.
FURTHER = 10_000


@dataclass(frozen=True, slots=True)
class _Series:
    """Cases that differ in their number of processes alone, in rising order, and their model."""

    layers: int
    choices: str
    measured: list[Record]
    counted: list[Record]
    model: Model | None

    def section(self, rows: Sequence[Fields], **fields: object) -> list[dict[str, object]]:
        """Return a section with its names, and what the first case has."""
        first = (self.measured or self.counted)[0]
        return section(rows, **(first | self.names | fields))

    @property
    def refined(self) -> float:
        """The paper's dofs over those of the model's mesh."""
        return paper.DOFS[self.layers] / self.model.base["dofs"]

    @property
    def names(self) -> dict[str, str]:
        """Its names on the page."""
        kind = NAMES[TYPES[self.layers]]
        return {"kind": kind, "chosen": CHOICES[self.choices], "artery": ARTERIES[self.layers]}


def _fields(records: Sequence[Record]) -> Fields:
    every = list(_series(records))
    modelled = [s for s in every if s.model is not None]
    return {
        "cluster": {name: value * UNITS[name] for name, value in asdict(Machine()).items()},
        "measured": [part for s in every for part in s.section(list(_times(s)))],
        "modelled": [
            part
            for s in modelled
            for part in s.section(list(_model_rows(s)), dofs=paper.DOFS[s.layers])
        ],
        "limits": section(row for s in modelled for row in _limits(s)),
        "weak": section(_weak(s) for s in modelled),
        "once": section(r | s.names | {"s": r["seconds_once"]} for s in every for r in s.measured),
        "reading": section(
            {"P": P, "mb": r["reading_bytes"] / 1e6, "mib": r["reading_mib"], "sent": r["reading"]}
            for P, r in sorted({r["processes"]: r for s in modelled for r in s.counted}.items())
        ),
        "converged": section(
            r | {"kind": NAMES[r["type"]], "rounds": len(r["residuals"])}
            for r in records
            if r["task"] == "converge"
        ),
        "counted": section(
            r | s.names | {"kilobytes": r["setup"]["bytes"]["max"] / 1e3, "grown": grown}
            for s in every
            for r, grown in zip(s.counted, _growth(s.counted, "messages_to_each"), strict=True)
        ),
        "coarse": section(_coarse([r for r in records if r["task"] == "coarse"])),
        "first_processes": paper.FIRST,
    }


def _series(records: Sequence[Record]) -> Iterator[_Series]:
    """Yield the series, the paper's choices first."""
    walls = [record for record in records if record["task"] != "coarse"]
    found = sorted(groups(walls, *CASE), key=lambda s: (list(CHOICES).index(s[0][-1]), s[0][-2]))
    for (*_, layers, choices), mine in found:
        if all(record["task"] == "converge" for record in mine):
            continue
        mine.sort(key=lambda record: record["processes"])
        tasks = [[r for r in mine if r["task"] == task] for task in ("measure", "count")]
        yield _Series(layers, choices, *tasks, create_model(*tasks))


def _coarse(records: Sequence[Record]) -> Iterator[dict[str, object]]:
    """Yield the memory of the coarse problem, and what it is of that on the fewest processes."""
    rising = sorted(records, key=lambda record: record["processes"])
    most = [{"most": record["coarse_peak_mib"]["max"]} for record in rising]
    for record, grown in zip(rising, _growth(most, "most"), strict=True):
        yield record | {"grown": grown}


def _growth(records: Sequence[Record], name: str) -> list[float | None]:
    """Return each record's number over that of the first which has one."""
    numbers = [record.get(name) for record in records]
    first = next((number for number in numbers if number), None)
    return [number / first if number and first else None for number in numbers]


def _times(series: _Series) -> Iterator[dict[str, object]]:
    """Yield seconds and efficiencies of the measured cases, and what the model foresees."""
    for r in series.measured:
        first, P = series.measured[0], int(r["processes"])
        model = series.model.predict(P) if series.model else None
        s, s_1 = ({part: record[f"seconds_{part}"] for part in PARTS} for record in (r, first))
        eff = {part: efficiency(first["processes"], s_1[part], P, s[part]) for part in PARTS}
        foreseen = {part: getattr(model, part) for part in PARTS} if model else {}
        yield {"P": P, "s": s, "eff": eff, "model": foreseen}


def _model_rows(series: _Series) -> Iterator[dict[str, object]]:
    """Yield the model's seconds and efficiencies beside the paper's, of as many dofs."""
    theirs, refined = paper.TIMES[series.layers], series.refined
    first = series.model.predict(paper.FIRST, refined)
    for P in (*theirs, FURTHER):
        foreseen = series.model.predict(P, refined)
        yield {
            "P": P,
            "s": {part: getattr(foreseen, part) for part in (*PARTS, "coarse")},
            "eff": _efficiencies(first, P, foreseen),
            "paper": _efficiencies(theirs[paper.FIRST], P, theirs[P]) if P in theirs else {},
        }


def _efficiencies(first: object, P: int, times: object) -> dict[str, float]:
    """Return the efficiencies of the parts, those of the paper's first number being 1."""
    return {
        part: efficiency(paper.FIRST, getattr(first, part), P, getattr(times, part))
        for part in PARTS
    }


def _limits(series: _Series) -> Iterator[dict[str, object]]:
    """Yield the shares of the parts in all of the time and in the iterations [%]."""
    for P in (max(paper.TIMES[series.layers]), FURTHER):
        foreseen = series.model.predict(P, series.refined)
        parts = {"total": foreseen.shares(), "Krylov": foreseen.shares(KRYLOV)}
        for whole, shares in parts.items():
            percent = {name: 100 * share for name, share in shares.items()}
            yield series.names | {"P": P, "whole": whole, "share": percent}


def _weak(series: _Series) -> dict[str, object]:
    """Return Krylov and coarse set-up on WEAK processes, the paper's dofs on the fewest."""
    dofs, (few, many) = paper.DOFS[series.layers], WEAK
    foreseen = (series.model.predict(P, series.refined * P / few) for P in WEAK)
    t = [p.krylov + p.coarse for p in foreseen]
    dofs_many = dofs * many // few
    return series.names | {
        "few": few,
        "many": many,
        "dofs": dofs,
        "dofs_many": dofs_many,
        "t": t,
        "eff": t[0] / t[1],
    }


def _draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw measured points, the model's curves, and the paper's points, with its choices."""
    of_layers = {s.layers: s for s in _series(records) if s.choices == "paper" and s.measured}
    if not any(series.measured for series in of_layers.values()):
        return []
    legend = {"local": STYLES["local"], "global Krylov method": STYLES["krylov"]}
    legend |= {"total": STYLES["total"], "measured": {"marker": "s", "ls": ""}}
    legend |= {"model": {}, "the paper's": OPEN}
    processes = [2**k for k in range(10)]
    with picture(folder / "scaling.png", 1, 2, legend, sharex=True) as axes:
        axes[0, 0].set_ylabel("seconds of a load step")
        for ax, (layers, kind) in zip(axes[0], TYPES.items(), strict=True):
            ax.set(title=f"{NAMES[kind]}; the paper's {ARTERIES[layers]}", xlabel="processes")
            ax.set_yscale("log")
            ax.set_xscale("log", base=2)
            for part, style in STYLES.items():
                theirs = paper.TIMES[layers].items()
                curve(ax, [(P, getattr(times, part)) for P, times in theirs], **(style | OPEN))
                series = of_layers.get(layers)
                measured = series.measured if series else []
                points = [(r["processes"], r[f"seconds_{part}"]) for r in measured]
                curve(ax, points, **style, marker="s", ls="")
                if series and series.model:
                    foreseen = [(P, getattr(series.model.predict(P), part)) for P in processes]
                    curve(ax, foreseen, **style)
    return [{"picture": "scaling.png"}]


main = partial(write_page, __file__, "scaling", known=is_known, fields=_fields, draw=_draw)

if __name__ == "__main__":
    main()

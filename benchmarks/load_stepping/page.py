# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the load stepping: the paper's figures (Augustin_fig:timestepping, …Iterations).

    python3 -m benchmarks.load_stepping.page build/loading.json --output build/results

writes ``loading.md``, and for each mesh and degree that FETI ran on a picture: the stress magnitude
over the relative displacement u_rel = u_norm / u_max and u_norm over the pressure at the points
A–E, for both variants the iterations of a Newton step, and for them and one subdomain, a direct
solver, the seconds of a load step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from matplotlib.axes import Axes

from benchmarks.common.pages import Fields, groups, section, write_page
from benchmarks.common.plots import COLOURS, curve, picture
from benchmarks.common.records import Record
from benchmarks.load_stepping.points import NAMES

__all__ = ["main"]

VARIANTS = {
    "all-floating": {"color": "#8a8f98", "marker": "o"},
    "classical": {"color": "#1c1c1c", "marker": "s", "ls": "--"},
    "one subdomain, direct": {"color": COLOURS[1], "marker": "^", "ls": ":"},
}
DIRECT = "one subdomain, direct"
POINTS = {name: {"color": colour} for name, colour in zip(NAMES, COLOURS, strict=True)}

#: What tells one wall with its solver from another.
RUN = ("geometry", "size", "degree", "subdomains", "type")


def _fields(records: Sequence[Record]) -> Fields:
    runs = groups(records, *RUN, "augmented")
    by_pressure = [sorted(mine, key=lambda step: step["pressure_mmhg"]) for _, mine in runs]
    first = {name: records[0][name] for name in ("c", "kappa")}
    pairs = section(row for _, mine in groups(records, *RUN) for row in _price(mine))
    return first | {"runs": [_run(steps) for steps in by_pressure], "multipliers": pairs}


def _draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw a picture for each mesh and degree that FETI ran on."""
    pictures = []
    plain = [step for step in records if not step["augmented"]]
    for (geometry, size, degree), mine in groups(plain, "geometry", "size", "degree"):
        if any(_variant(step) != DIRECT for step in mine):
            name, mesh = str(geometry), str(geometry)
            if size is not None:  # the generator's default
                name, mesh = f"{geometry}_{size:g}", f"{geometry}, edges of {size:g} mm"
            file = f"loading_{name}_p{degree}.png"
            _draw_panels(folder / file, mine)
            pictures.append({"picture": file, "mesh": mesh, "degree": degree})
    return pictures


def _run(steps: Sequence[Record]) -> dict[str, object]:
    """Sum up a run, and give its last state."""
    seconds = [_seconds(step) for step in steps]
    mean = [step["linear_iterations_mean"] for step in steps]
    return dict(steps[-1]) | {
        "variant": _variant(steps[0]),
        "with_multipliers": " (λ)" if steps[0]["augmented"] else "",
        "load_steps": len(steps),
        "newton": sum(step["newton_iterations"] for step in steps),
        "linear": sum(step["linear_iterations"] for step in steps),
        "fewest": min(mean),
        "most": max(mean),
        "worst": max(step["max_linear_residual"] for step in steps),
        "seconds_in_all": sum(seconds),
    }


def _price(steps: Sequence[Record]) -> Iterator[dict[str, object]]:
    """Hold a run with multipliers against the one without, where both have been."""
    runs = [[step for step in steps if step["augmented"] is kind] for kind in (True, False)]
    most = [max((step["pressure_mmhg"] for step in run), default=0.0) for run in runs]
    if min(most) > 0.0:
        both = [[step for step in run if step["pressure_mmhg"] <= min(most)] for run in runs]
        newton, without = (sum(step["newton_iterations"] for step in run) for run in both)
        ends = [step[name] for step in both[0] for name in ("min_J", "max_J")]
        yield dict(both[0][-1]) | {
            "variant": _variant(steps[0]),
            "pressure_mmhg": min(most),
            "worst": max(abs(J - 1.0) for J in ends),
            "newton": newton,
            "without": without,
            "ratio": newton / without,
        }


def _variant(step: Record) -> str:
    return DIRECT if step["subdomains"] == 1 else str(step["type"]).replace("_", "-")


def _seconds(step: Record) -> float:
    """Return the seconds of a load step, NaN if the record has none."""
    return math.nan if step["seconds"] is None else float(step["seconds"])


def _draw_panels(path: Path, records: Sequence[Record]) -> None:
    """Draw the four panels of one wall and degree."""
    records = sorted(records, key=lambda step: step["pressure_mmhg"])
    by_variant = {name: [s for s in records if _variant(s) == name] for name in VARIANTS}
    by_variant = {name: steps for name, steps in by_variant.items() if steps}
    legend = POINTS | {name: VARIANTS[name] for name in by_variant}
    with picture(path, 2, 2, legend) as ((stress, norm), (iterations, seconds)):
        farthest = max(by_variant.values(), key=lambda steps: steps[-1]["pressure_mmhg"])
        for name, style in POINTS.items():
            u = [0.0, *(step["u_norm"][name] for step in farthest)]
            sigma = [0.0, *(step["stress_magnitude"][name] for step in farthest)]
            relative = [value / (max(u) or 1.0) for value in u]
            curve(stress, list(zip(relative, sigma, strict=True)), marker=".", **style)
            curve(norm, [(0.0, 0.0), *_over(farthest, u[1:])], marker=".", **style)
        for name, steps in by_variant.items():
            style = VARIANTS[name] | {"ms": 4}
            if name != DIRECT:
                its = [step["linear_iterations_mean"] for step in steps]
                curve(iterations, _over(steps, its), **style)
            curve(seconds, _over(steps, [_seconds(step) for step in steps]), **style)
        stress.set(xlabel="relative displacement u_rel", ylabel="stress magnitude σ_mag [kPa]")
        _label(norm, "displacement norm u_norm [mm]")
        _label(iterations, "FETI iterations of a Newton step")
        _label(seconds, "seconds of a load step")


def _over(steps: Sequence[Record], values: Sequence[float]) -> list[tuple[float, float]]:
    """Return values over the pressure."""
    return list(zip((float(step["pressure_mmhg"]) for step in steps), values, strict=True))


def _label(ax: Axes, text: str) -> None:
    ax.set(xlabel="pressure [mmHg]", ylabel=text)
    ax.set_ylim(bottom=0)


main = partial(
    write_page,
    __file__,
    "loading",
    known=lambda record: "u_norm" in record,
    fields=_fields,
    draw=_draw,
)

if __name__ == "__main__":
    main()

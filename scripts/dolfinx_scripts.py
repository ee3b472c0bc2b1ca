# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Run scripts for dolfinx with both packages, from the same start, and print a table.

FENICSX_SUITE=pip scripts/with-fenicsx python3 scripts/dolfinx_scripts.py SCRIPT…

In each script, which runs unchanged in a process of its own, ``LinearProblem`` and
``NonlinearProblem`` of ``dolfinx.fem.petsc`` solve twice: by FETI, and by LU as dolfinx does. FETI
has DOLFINX_FETI_SUBDOMAINS subdomains (8): with the default, meshes of up to some 2000 dofs would
have a single one, and FETI would not iterate. If this package refuses a problem, dolfinx alone
solves it, with the script's options. Missing packages for pictures are replaced by objects that do
nothing. The exit status is 1 if solutions differ, or if a script that was compared took no FETI
iteration.
"""

from __future__ import annotations

import importlib.util
import json
import os
import runpy
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

SUBDOMAINS = int(os.environ.get("DOLFINX_FETI_SUBDOMAINS", "8"))

#: Largest accepted ‖u − v‖/‖v‖ of FETI's u and dolfinx's v. Both packages solve linear systems to
#: 1e-8 or better; with condition numbers up to 1e3 the solutions still meet this bound.
MAX_DIFFERENCE = 1e-5

#: How dolfinx solves: the answer is then accurate to rounding times the condition number.
DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}

#: Tolerances of Newton's method in both packages. They are tight, so that FETI's accuracy shows.
NEWTON = {"snes_rtol": 1e-10, "snes_atol": 1e-12}

#: Characters of a message that the table shows.
MESSAGE_WIDTH = 100

#: Packages that the tutorial's scripts draw pictures and tables with.
PICTURES = ("pyvista", "pandas", "seaborn", "imageio")

#: Begins the line of a script's process that holds its results.
RESULT = "dolfinx_scripts: "


def replace_missing_pictures() -> None:
    """Replace packages that only draw, and are not installed, by objects that do nothing."""
    import dolfinx.io

    for name in PICTURES:
        if importlib.util.find_spec(name) is None:
            sys.modules[name] = MagicMock(__version__="0.50.0", version_info=(0, 50, 0))
    if not hasattr(dolfinx.io, "VTXWriter"):  # dolfinx was built without ADIOS2
        dolfinx.io.VTXWriter = MagicMock()


def run_script(script: Path) -> dict[str, Any]:
    """Run a script with problems that solve twice, in this process.

    Returns:
        Its name; the number of solves and of those compared; the largest difference; the FETI
        iterations; the refusals; and how it ended if that was an error.
    """
    from mpi4py import MPI  # noqa: F401, before petsc4py with the wheels of PyPI

    import numpy as np

    import dolfinx.fem.petsc

    import dolfinx_feti

    replace_missing_pictures()

    result: dict[str, Any] = {
        "script": script.stem,
        "solves": 0,
        "compared": 0,
        "difference": 0.0,
        "iterations": 0,
        "refusals": [],
        "end": "",
    }

    def values(u: Any) -> Any:
        functions = u if isinstance(u, list | tuple) else [u]
        return np.concatenate([w.x.array for w in functions])

    def set_values(u: Any, start: Any) -> None:
        functions = u if isinstance(u, list | tuple) else [u]
        sizes = np.cumsum([w.x.array.size for w in functions])[:-1]
        for w, part in zip(functions, np.split(start, sizes), strict=True):
            w.x.array[:] = part

    def solving_twice(theirs: Any, ours: Any, is_linear: bool) -> Any:
        class Both(theirs):  # type: ignore[misc]
            def __init__(self, *positional: Any, **named: Any) -> None:
                options = dict(named.get("petsc_options") or {})
                newton = NEWTON | {k: v for k, v in options.items() if k == "snes_max_it"}
                own = {"subdomains": SUBDOMAINS, "petsc_options": {} if is_linear else newton}
                own["petsc_options_prefix"] = "feti_" + named.get("petsc_options_prefix", "")
                shared = {name: given for name, given in named.items() if name not in own}
                if is_linear:
                    shared.pop("u", None)
                self._feti = None
                try:
                    self._feti = ours(*positional, **shared, **own)
                except (ValueError, TypeError) as refusal:
                    result["refusals"].append(str(refusal))
                if self._feti is not None:
                    options |= DIRECT if is_linear else DIRECT | newton
                super().__init__(*positional, **{**named, "petsc_options": options})

            def solve(self, *positional: Any, **named: Any) -> Any:
                found = None
                if self._feti is not None:
                    start = values(self.u)
                    found = values(self._feti.solve())
                    set_values(self.u, start)
                    result["iterations"] += linear_iterations(self._feti, is_linear)
                solution = super().solve(*positional, **named)
                result["solves"] += 1
                if found is not None:
                    expected = values(self.u)
                    missed = np.linalg.norm(found - expected) / np.linalg.norm(expected)
                    result["difference"] = max(result["difference"], float(missed))
                    result["compared"] += 1
                return solution

        return Both

    def linear_iterations(problem: Any, is_linear: bool) -> int:
        if is_linear:
            return int(problem.solver.getIterationNumber())
        return sum(step.linear_iterations for step in problem.history)

    petsc = dolfinx.fem.petsc
    petsc.LinearProblem = solving_twice(petsc.LinearProblem, dolfinx_feti.LinearProblem, True)
    petsc.NonlinearProblem = solving_twice(
        petsc.NonlinearProblem, dolfinx_feti.NonlinearProblem, False
    )
    sys.argv = [str(script)]
    try:
        runpy.run_path(str(script), run_name="__main__")
    except Exception as error:  # of the script: such as a package for pictures that is missing
        result["end"] = f"{type(error).__name__}: {error}"
    return result


def row(result: dict[str, Any]) -> str:
    """Return a script's row of the table."""
    notes = [*dict.fromkeys(result["refusals"]), *([result["end"]] if result["end"] else [])]
    text = "; ".join(" ".join(note.split())[:MESSAGE_WIDTH] for note in notes)
    difference = f"{result['difference']:.1e}" if result["compared"] else "–"
    return (
        f"| `{result['script']}` | {result['compared']} of {result['solves']} | {difference} | "
        f"{result['iterations']} | {text.replace('|', '/')} |"
    )


def fault(result: dict[str, Any]) -> str:
    """Return what is wrong with the results of a script; nothing if they are right."""
    if result["compared"] and not result["iterations"]:
        return "FETI took no iteration, so that nothing was tested: raise DOLFINX_FETI_SUBDOMAINS"
    if not result["difference"] <= MAX_DIFFERENCE:
        return f"the solutions differ by {result['difference']:.1e}, more than {MAX_DIFFERENCE:g}"
    if not result["solves"] and not result["refusals"]:
        return f"it has solved nothing. {result['end']}"
    return ""


def main(scripts: list[str]) -> int:
    """Print the table of these scripts, and their faults; return an exit status."""
    if scripts[:1] == ["--one"]:
        print(RESULT + json.dumps(run_script(Path(scripts[1]).resolve())))
        return 0
    print("| script | compared | difference | FETI iterations | refused, or ended by |")
    print("|---|--:|--:|--:|---|", flush=True)
    faults = []
    for script in scripts:
        command = [sys.executable, __file__, "--one", str(Path(script).resolve())]
        with tempfile.TemporaryDirectory() as folder:  # where the script leaves its files
            done = subprocess.run(
                command,
                cwd=folder,
                env={**os.environ, "MPLBACKEND": "Agg"},
                capture_output=True,
                text=True,
                check=False,
            )
        found = [line for line in done.stdout.splitlines() if line.startswith(RESULT)]
        if not found:
            faults.append(f"{script}: its process ended with {done.returncode}\n{done.stderr}")
            continue
        result = json.loads(found[-1].removeprefix(RESULT))
        print(row(result), flush=True)
        if wrong := fault(result):
            faults.append(f"{script}: {wrong}")
    for wrong in faults:
        print(f"dolfinx_scripts: {wrong}", file=sys.stderr)
    return 1 if faults or not scripts else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

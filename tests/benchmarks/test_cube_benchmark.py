# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The benchmark of the paper's cube: mesh, exact solution, memory, records, report."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

from petsc4py import PETSc

import numpy as np
import paper_cube
import pytest
from collective import COMM, agree, equal, small, whole
from wall_files import ROOT, on_first

import dolfinx
import ufl

sys.path.append(str(ROOT))

from benchmarks import bar, cube, cube_memory, cube_solvers, linear, machine, paper, report, study
from benchmarks.cube_case import Case
from benchmarks.cube_mesh import create_cube
from benchmarks.cube_problem import PATTERNS
from benchmarks.linear_checks import checks, error_scale, speed_checks
from benchmarks.linear_growth import fit_growth
from benchmarks.linear_tables import deviations, tables

#: What a record has to hold, whatever else it holds.
KEYS = (
    "degree level type pc scaling gluing subdomains dofs_local_max dofs multipliers coarse_size "
    "iterations condition_number lambda_min lambda_max l2_error seconds_setup seconds_solve "
    "peak_mib"
).split()
#: A study of a second, with a subdomain for each of three processes.
SMALL = ["--subdomains-per-edge", "2", "--pc", "dirichlet", "--type", "all_floating"]


@pytest.fixture
def study_of(tmp_path):
    """Run the benchmark; return its exit status and the records of its file."""
    file = tmp_path / "records.json"

    def run(*arguments: str) -> tuple[int, list[dict]]:
        status = cube.main([*map(str, arguments), "--json", str(file)], COMM)
        return status, on_first(lambda: json.loads(file.read_text() or "[]"))

    return run


# -- the mesh


@pytest.mark.parametrize(("subdomains", "cells"), [(2, 1), (2, 2), (3, 1)])
def test_mesh_fills_the_cube_and_keeps_subcubes_together(subdomains, cells):
    mesh, part = create_cube(COMM, subdomains, cells)
    n = mesh.topology.index_map(3).size_local
    agree(len(part) == n and mesh.topology.index_map(3).num_ghosts == 0)
    volume = COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(1.0 * ufl.dx(mesh))))
    small(volume - 1.0, 1e-12)
    edge = subdomains * cells
    nodes = (edge + 1) ** 3 + edge**3 + 3 * edge**2 * (edge + 1)
    agree(mesh.topology.index_map(0).size_global == nodes)
    middle = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(n, dtype=np.int32))
    place = np.floor(subdomains * middle).astype(int)
    equal(np.ravel_multi_index(tuple(place.T), (subdomains,) * 3), part)
    count = np.bincount(whole(part), minlength=subdomains**3)
    agree(np.all(count == 24 * cells**3), count)
    mine = COMM.allgather(set(part.tolist()))
    agree(sum(map(len, mine)) == subdomains**3, mine)  # none on two processes


def test_patterns_of_stiff_subcubes():
    place = np.stack(np.meshgrid(*3 * [np.arange(4)], indexing="ij"), axis=-1).reshape(-1, 3)
    stiff = {name: mark(place, 4).reshape(4, 4, 4) for name, mark in PATTERNS.items()}
    agree(not stiff["none"].any() and stiff["checkerboard"].sum() == 32)
    agree(not np.any(stiff["checkerboard"][1:] & stiff["checkerboard"][:-1]))
    agree(stiff["layer"].sum() == 16 and stiff["layer"][:, :, 2].all())


# -- what is computed


@pytest.mark.parametrize(("degree", "levels"), [(1, (2, 3)), (2, (1, 2))])
def test_error_converges_to_the_fundamental_solution(degree, levels, study_of):
    """Order two for linear and three for quadratic elements."""
    level = ",".join(map(str, levels))
    status, records = study_of(*SMALL, "--degree", degree, "--level", level)
    agree(status == 0 and [r["level"] for r in records] == list(levels))
    coarse, fine = (r["l2_error"] for r in records)
    agree(np.log2(coarse / fine) > degree + 0.9, (coarse, fine))


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
def test_records_say_what_the_hand_torn_cube_says(kind, study_of, feti):
    """Two codes that share the solver alone agree on counts and on the condition number."""
    status, records = study_of("--subdomains-per-edge", "3", "--type", kind)
    agree(status == 0 and len(records) == 3)
    problem = paper_cube.cube(3, 1)
    for record in records:
        agree(set(KEYS) <= set(record), set(KEYS) - set(record))
        options = {"type": kind, "pc_type": record["pc"], "scaling": "multiplicity"}
        options |= {"coarse_q": "identity", "coarse_modes": 0, "dual_ksp_rtol": 1e-8}
        ksp = feti(problem.A, **{f"feti_{name}": value for name, value in options.items()})
        load = np.random.default_rng(5).standard_normal(len(problem.dirichlet))
        b = problem.vector(np.where(problem.dirichlet, load, 0.0))
        ksp.solve(b, problem.A.createVecRight())
        context = ksp.getPythonContext()
        found = context.report()
        agree(record["multipliers"] == found.multipliers)
        agree(record["coarse_size"] == found.coarse_size)
        agree(record["dofs"] == found.dofs and record["dofs_local_max"] == 45)
        agree(record["subdomains"] == 27 and record["kernels"] == list(found.kernels))
        small(record["condition_number"] / context.condition_number - 1.0, 0.02)
        small(record["lambda_max"] / record["lambda_min"] / record["condition_number"] - 1, 1e-12)
        if record["pc"] != "identity":
            agree(record["lambda_min"] > 1.0 - 1e-6, record["lambda_min"])
    problem.destroy()


def corners_and_edges(x: np.ndarray) -> np.ndarray:
    """Conditions on a cube of 3³ subcubes that leave kernels of all dimensions.

    A face of one subcube is clamped, and so an edge or a vertex of its neighbours; components are
    fixed in an edge of another one (two of them), and in two corners (one of them, and two).
    """
    face = (x[:, 0] == 0) & np.all(x <= 1, axis=1)
    mark = np.repeat(face[:, None], 3, axis=1)
    mark[(x[:, 0] == 3) & (x[:, 1] == 3) & (x[:, 2] <= 1), :2] = True
    mark[np.all(x == (3, 0, 0), axis=1), :2] = True
    mark[np.all(x == (3, 3, 3), axis=1), 0] = True
    return mark


@pytest.mark.parametrize("gluing", ["full", "nonred"])
def test_kernels_of_all_dimensions_in_one_decomposition(gluing, feti, tmp_path):
    """Theory bounds the eigenvalues from below by one, whatever is left of the rigid motions."""
    problem = paper_cube.cube(3, 1, fixed=corners_and_edges)
    options = {"type": "classical", "pc_type": "dirichlet", "scaling": "multiplicity"}
    options |= {"coarse_q": "identity", "coarse_modes": 0, "gluing": gluing}
    ksp = feti(problem.A, **{f"feti_{name}": value for name, value in options.items()})
    load = np.random.default_rng(5).standard_normal(len(problem.dirichlet))
    b, x = problem.vector(load), problem.A.createVecRight()
    ksp.solve(b, x)
    context = ksp.getPythonContext()
    agree(context.report().kernels == (1, 2, 1, 1, 2, 1, 19), context.report().kernels)
    agree(context.eigenvalues[0] >= 1.0 - 1e-6, context.eigenvalues)
    small(context.residual, 1e-8)
    path = COMM.bcast(str(tmp_path / "view.txt"))
    viewer = PETSc.Viewer().createASCII(path, comm=COMM)
    ksp.view(viewer)
    viewer.destroy()
    said = on_first(Path(path).read_text)
    agree("1 of dimension 0, 2 of dimension 1, 1 of dimension 2, 1 of dimension 3" in said, said)
    agree("2 of dimension 4, 1 of dimension 5, 19 of dimension 6; 27 exact" in said, said)
    problem.destroy()


def test_stiffness_scaling_and_weight_bear_a_jump(study_of):
    """Neither the scaling alone nor the weight Q alone does."""
    choices = ["--scaling", "multiplicity,stiffness", "--coarse-q", "identity,diagonal"]
    jump = ["--jump", "1e4", "--pattern", "layer", "--level", "2"]
    status, records = study_of(*SMALL, *choices, *jump)
    agree(status == 0 and all(r["l2_error"] is None for r in records))
    condition = {(r["scaling"], r["coarse_q"]): r["condition_number"] for r in records}
    bounded = condition.pop(("stiffness", "diagonal"))
    agree(bounded < 20.0 and min(condition.values()) > 10 * bounded, (bounded, condition))


def test_reorthogonalisation_gives_the_same_condition_number(study_of):
    study_of(*SMALL, "--level", "2")
    _, records = study_of(*SMALL, "--level", "2", "--reorthogonalize")
    agree([r["reorthogonalize"] for r in records] == [False, True])
    plain, full = (r["condition_number"] for r in records)
    small(plain / full - 1.0, 1e-3)


# -- the memory


def test_kinds_of_subdomains_are_all_of_them():
    for edge in (1, 2, 3, 8):
        for floating in (False, True):
            kinds = cube_memory._kinds(edge, floating)
            agree(sum(kinds.values()) == edge**3)
    agree(cube_memory._kinds(8, False) == {(0, 0, 0): 216, (0, 0, 1): 216, (0, 1, 1): 72,
                                           (1, 1, 1): 8})  # fmt: skip
    agree(cube_memory._kinds(1, False) == {(2, 2, 2): 1})


def estimated(**changes: object) -> cube_memory.Estimate:
    case = {"degree": 1, "cells": 2, "subdomains": 3, "all_floating": True, "processes": 1}
    case |= {"pc_type": "lumped", "coarse_q": "identity", "interior": "keep"}
    return cube_memory.estimate(**(case | changes))


def test_estimate_follows_what_a_case_needs():
    usual = estimated()
    for more in ({"degree": 2}, {"cells": 4}, {"subdomains": 4}, {"pc_type": "dirichlet"}):
        agree(estimated(**more).mib > usual.mib, more)
        agree(estimated(**more).streamed > usual.streamed, more)
    agree(estimated(all_floating=False).mib < usual.mib < estimated(coarse_q="preconditioner").mib)
    agree(estimated(processes=2).mib - usual.mib > 100.0)
    n = 3 * 71  # dofs of a subdomain, and six columns of the border
    least, most = (27 * 2 * 8.0 * entries for entries in (n + 6 * n, (n + 6) ** 2))
    agree(least < usual.streamed < most, (least, usual.streamed, most))


def test_estimate_decides_on_the_interior_as_the_solver_does(study_of):
    for level in ("1", "2", "3"):
        _, records = study_of(*SMALL, "--level", level)
        names = {"cells": 2 ** (int(level) - 1), "subdomains": 2, "pc_type": "dirichlet"}
        chosen = "eliminate" if records[-1]["interior_is"] == "eliminated" else "keep"
        auto = estimated(**names, interior="auto")
        agree(auto == estimated(**names, interior=chosen), level)


def test_case_that_does_not_fit_is_refused(study_of, capsys):
    status, records = study_of(*SMALL, "--level", "2", "--memory", "50")
    said = COMM.bcast(capsys.readouterr().err)
    agree(status == 1 and len(records) == 1)
    agree(records[0]["available_mib"] == 50.0 < records[0]["estimated_mib"], records)
    agree("refused: P1, level 2, 2³ subdomains" in said and "needs about 0." in said, said)
    agree("GiB, and 0.0 GiB are available: choose a lower --level" in said, said)
    status, records = study_of(*SMALL, "--level", "2")
    agree(status == 0 and len(records) == 1 and "available_mib" not in records[0])
    enough = 150.0 + COMM.size * cube_memory.PROCESS / 2**20
    status, records = study_of(*SMALL, "--level", "2,4", "--memory", enough)
    agree(status == 1)  # and the other case is run
    agree([(r["level"], "iterations" in r) for r in records] == [(2, True), (4, False)])


def test_available_memory_is_what_the_kernel_and_the_container_leave(tmp_path, monkeypatch):
    def write() -> None:
        (tmp_path / "meminfo").write_text("MemTotal: 4096000 kB\nMemAvailable: 2048000 kB\n")

    on_first(write)
    monkeypatch.setattr(machine, "PROC", tmp_path)
    monkeypatch.setattr(machine, "CGROUP", tmp_path)
    small(machine.available_mib(COMM) - 2000.0, 1e-9)
    on_first(lambda: (tmp_path / "memory.max").write_text(f"{900 * 2**20}\n"))
    on_first(lambda: (tmp_path / "memory.current").write_text(f"{200 * 2**20}\n"))
    small(machine.available_mib(COMM) - 700.0, 1e-9)
    on_first(lambda: (tmp_path / "memory.max").write_text("max\n"))
    small(machine.available_mib(COMM) - 2000.0, 1e-9)
    on_first(lambda: (tmp_path / "meminfo").unlink())
    agree(np.isinf(machine.available_mib(COMM)))


# -- records


def test_finished_cases_are_not_run_again(study_of, capsys, monkeypatch):
    _, first = study_of(*SMALL, "--level", "1")
    _, second = study_of(*SMALL, "--level", "1,2")
    said = COMM.bcast(capsys.readouterr().out)
    agree("1 case(s) stand in the records already" in said, said)
    agree(second[:1] == first and [r["level"] for r in second] == [1, 2])
    with monkeypatch.context() as patched:
        patched.setattr(study, "run", lambda *_: pytest.fail("a finished case was run"))
        status, third = study_of(*SMALL, "--level", "1,2")
    agree(status == 0 and third == second)
    _, again = study_of(*SMALL, "--level", "1", "--again")
    agree(again[1:] == second[1:] and again[0]["condition_number"] is not None)
    agree(again[0]["seconds_solve"] != second[0]["seconds_solve"])


def test_records_are_written_after_each_case(study_of, monkeypatch):
    """Whoever ends a study finds what was finished."""
    real = study.run

    def run(case: Case, *rest: object) -> dict:
        if case.level == 2:
            raise KeyboardInterrupt
        return real(case, *rest)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(study, "run", run)
        study_of(*SMALL, "--level", "1,2")
    _, records = study_of(*SMALL, "--level", "1")
    agree(len(records) == 1)


# -- the whole study, and other solvers


def test_plan_holds_the_papers_table_first_and_no_case_twice():
    plan = linear.plan()
    agree(len(plan) == len(set(plan)) > 100)
    agree(set(plan[:18]) == {Case(type=kind, pc=pc, level=level)
                             for kind, pc, level in paper.SOLVES if level < 4})  # fmt: skip
    agree({case.jump for case in plan} == {1.0, 1e2, 1e4, 1e6})
    agree({case.subdomains_per_edge for case in plan} == {2, 4, 8, 16, 32})
    agree({case.gluing for case in plan} == {"full", "nonred"})


def test_whole_study_is_resumed(tmp_path, monkeypatch, capsys):
    cases = [Case(subdomains_per_edge=2, level=level) for level in (1, 2)]
    monkeypatch.setattr(linear, "plan", lambda sets: cases if sets == ["jumps"] else [])
    arguments = ["--sets", "jumps", "--json", str(tmp_path / "study.json")]
    agree(linear.main(arguments, COMM) == 0)
    records = on_first(lambda: json.loads((tmp_path / "study.json").read_text()))
    agree([r["level"] for r in records] == [1, 2])
    agree(all(0.0 < r["seconds_coarse"] < r["seconds_setup"] for r in records), records)
    agree(all(r["coarse_size"] == 48 and r["coarse_mib"] >= 0.0 for r in records))
    agree(linear.main(arguments, COMM) == 0)
    said = COMM.bcast(capsys.readouterr().out)
    agree("2 case(s) stand in the records already" in said, said)


def test_solvers_of_the_assembled_matrix_agree_with_feti(tmp_path):
    path = tmp_path / "solvers.json"
    arguments = ["--level", "2", "--subdomains-per-edge", "2", "--json", str(path)]
    agree(cube_solvers.main(arguments, COMM) == 0)
    records = on_first(lambda: json.loads(path.read_text()))
    agree([r["solver"] for r in records] == list(cube_solvers.SOLVERS))
    for record in records:
        agree(record["converged_reason"] > 0 and record["dofs"] == 1287, record)
        small(record["relative_residual"], 1e-8)
        small(record.get("difference_to_feti", 0.0), 1e-6)
        agree(record["seconds_setup"] > 0.0 and record["seconds_solve"] > 0.0)
    before = on_first(path.read_text)
    agree(cube_solvers.main(arguments, COMM) == 0)
    agree(on_first(path.read_text) == before, "nothing is run again")


@pytest.mark.parametrize(
    ("program", "arguments", "match"),
    [
        (linear, "--sets jump", "argument --sets: 'jump' is none of: papers, choices, jumps"),
        (linear, "--memory 0", "argument --memory: '0' is not a positive number"),
        (cube_solvers, "--level 0", "argument --level: '0' is none of: 1, 2, 3, 4, 5"),
        (cube_solvers, "--solvers lu", "argument --solvers: 'lu' is none of: feti_all_floating"),
    ],
)
def test_bad_input_of_the_whole_study(program, arguments, match, capsys, monkeypatch):
    monkeypatch.setattr(Case, "problem", lambda *_: pytest.fail("work was done"))
    with pytest.raises(SystemExit) as caught:
        program.main(arguments.split(), COMM)
    agree(caught.value.code == 2)
    said = COMM.bcast(capsys.readouterr().err)
    agree(match in said, said)


# -- bad input


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ("--level 0", "argument --level: '0' would make more subdomains than cells"),
        ("--level 6", "argument --level: '6' is none of: 1, 2, 3, 4, 5"),
        ("--level 1,two", "argument --level: 'two' is none of"),
        ("--degree 3", "argument --degree: '3' is none of: 1, 2"),
        ("--pc ilu", "argument --pc: 'ilu' is none of: dirichlet, lumped, identity, none"),
        ("--subdomains-per-edge 0", "'0' is not a number 1, 2, 3"),
        ("--source 0.5,0.5,0.5", "'0.5,0.5,0.5' lies in the unit cube"),
        ("--source 1,0,0.2", "lies in the unit cube"),
        ("--source nan,2,2", "'nan,2,2' is not a point X,Y,Z"),
        ("--source 2,2", "'2,2' is not a point X,Y,Z"),
        ("--jump 1e3", "give both, how stiff and which subdomains"),
        ("--jump 0 --pattern layer", "'0' is not a positive number"),
        ("--memory many", "'many' is not a positive number"),
        ("--levels 1", "unrecognized arguments: --levels 1"),
    ],
)
def test_bad_input_ends_before_any_work(arguments, match, capsys, monkeypatch):
    monkeypatch.setattr(study.Study, "run", lambda _: pytest.fail("work was done"))
    with pytest.raises(SystemExit) as caught:
        cube.main(arguments.split(), COMM)
    agree(caught.value.code == 2)
    said = COMM.bcast(capsys.readouterr().err)
    agree(match in said, said)


@pytest.mark.skipif(COMM.size == 1, reason="one process can have all subdomains")
def test_more_processes_than_subdomains(capsys):
    with pytest.raises(SystemExit):
        cube.main(["--subdomains-per-edge", "1"], COMM)
    said = COMM.bcast(capsys.readouterr().err)
    agree(f"gives 1 subdomain(s) to {COMM.size} processes" in said, said)


def test_file_that_cannot_hold_the_records(tmp_path, capsys, monkeypatch):
    """A folder, a place below a file, and files with something else in them."""
    monkeypatch.setattr(study.Study, "run", lambda _: pytest.fail("work was done"))

    def write() -> None:
        (tmp_path / "text").write_text("mine")
        (tmp_path / "object").write_text('{"level": 1}')

    on_first(write)
    for name in (".", "text/records.json", "text", "object"):
        with pytest.raises(SystemExit) as caught:
            cube.main(["--json", str(tmp_path / name)], COMM)
        agree(caught.value.code == 2)
        said = COMM.bcast(capsys.readouterr().err)
        agree("--json is" in said and "Name another file" in said, said)
    agree(on_first(lambda: (tmp_path / "text").read_text()) == "mine")


# -- the bar


def test_bar_on_a_terminal_and_nowhere_else(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr(sys, "stderr", stream)
        shown = bar.Bar(2, COMM)
        shown.begin("the case")
        shown.monitor(None, 3, 1e-5)
        shown.end()
        text = stream.getvalue()
        if COMM.rank == 0 and stream.isatty():
            agree("0/2  the case: iteration 3, ‖b − A x‖ = 1.0e-05" in text, text)
            assert text.endswith("\r\x1b[K")
        else:
            agree(True)
            assert text == ""


# -- the report


def record_of(kind: str, pc: str, level: int, **changes: object) -> dict:
    """A record with the paper's own values."""
    its, condition = paper.SOLVES[kind, pc, level]
    key = Case(type=kind, pc=pc, level=level).key()
    values = {"iterations": its, "condition_number": condition, "lambda_min": 1.0}
    values |= {"lambda_max": condition, "l2_error": 0.5 * paper.L2_ERRORS[kind, level]}
    values |= {"dofs": 1, "dofs_torn": 2, "multipliers": 38052, "coarse_size": 3072}
    times = ("seconds_setup", "seconds_solve", "seconds_coarse", "seconds_streaming")
    values |= dict.fromkeys((*times, "cpu_seconds_setup", "cpu_seconds_solve"), 1.0)
    values |= {"coarse_mib": 12.0}
    values |= {"interior_is": "kept", "peak_mib": 1234.0, "estimated_mib": 1300.0}
    values |= {"machine": machine.describe(), "processes": 1, "bandwidth_gb_s": 10.0}
    values |= {"date": "2026-01-02T03:04:05+00:00"}
    return key | values | changes


EVERYTHING = [record_of(*key) for key in paper.SOLVES]


def test_tables_hold_the_papers_values_against_ours():
    agree(deviations(EVERYTHING) == (0.0, 0))
    small(error_scale(EVERYTHING) - 2.0, 1e-12)
    table = next(t for t in tables(EVERYTHING) if t.title.startswith("P1, classical"))
    row = [*table.rows[2]]
    agree(row[:3] == ["3", "2", "38 052"], row)
    agree(row[3:5] == ["140 (140)", "295.7 (295.7, +0.0 %)"], row)
    worse = record_of("classical", "lumped", 3, condition_number=100.0, iterations=90)
    agree(deviations([worse])[1] == 5)
    small(deviations([worse])[0] - (1.0 - 100.0 / 105.9), 1e-12)
    table = tables([worse])[0]
    agree("90 (85) | 100 (105.9, −5.6 %) |" in table.markdown(), table.markdown())
    agree(r"90 (85) & 100 (105.9, $-$5.6 \%) &" in table.latex(), table.latex())


def test_tables_are_made_of_what_is_there():
    """A jump, another number of subdomains or level, another scaling: each in its own table."""
    usual = record_of("all_floating", "dirichlet", 2)
    names = {
        "Young's modulus jumps": {"jump": 1e3, "pattern": "layer"},
        "More subdomains": {"subdomains_per_edge": 4},
        "Larger subdomains": {"level": 1},
        "Other choices": {"gluing": "nonred"},
    }
    for title, change in names.items():
        titles = [table.title for table in tables([usual, usual | change])]
        found = {name for name in names if any(t.startswith(name) for t in titles)}
        agree(found == {title}, titles)
    agree(tables([]) == [])


def test_refusals_have_a_table_of_their_own():
    case = Case(level=4).key() | {"estimated_mib": 27940.0, "available_mib": 15360.0}
    failed = Case(level=1).key() | {"failure": "stagnation"}
    (table,) = tables([case, failed])
    agree(table.title == "Cases without results")
    agree([row[5:] for row in table.rows] == [["did not converge", "–", "–"],
                                              ["does not fit", "27 940", "15 360"]])  # fmt: skip


def test_growth_is_fitted_to_the_square_of_a_logarithm():
    levels = np.arange(1, 5)
    values = (2.0 + 0.7 * np.log(2.0 ** (levels - 1))) ** 2
    records = [
        record_of("classical", "dirichlet", int(level), condition_number=float(value))
        for level, value in zip(levels, values, strict=True)
    ]
    a, b, worst = fit_growth(records)
    small(a - 2.0, 1e-13)
    small(b - 0.7, 1e-13)
    small(worst, 1e-13)
    records[-1]["condition_number"] *= 2.0
    agree(fit_growth(records).worst > 0.1)


def test_checks_see_what_does_not_hold():
    agree(all(check.holds for check in checks(EVERYTHING)), list(checks(EVERYTHING)))
    usual = ("classical", "dirichlet", 2)
    jump = {"jump": 1e6, "pattern": "layer", "coarse_q": "preconditioner"}
    for changes, what in (
        ({"condition_number": 20.0}, "κ, P1, off the paper's"),
        ({"iterations": 44}, "iterations, P1, off the paper's"),
        ({"l2_error": 3e-5}, "L2 errors, P1, off the paper's after one factor"),
        ({"lambda_min": 0.99}, "λ_min with the Dirichlet preconditioner"),
        (jump | {"scaling": "stiffness", "iterations": 61}, "iterations over jumps to 1e6, stiff"),
    ):
        worse = [*EVERYTHING, record_of(*usual, **changes)]
        wrong = [check.what for check in checks(worse) if not check.holds]
        agree(any(each.startswith(what) for each in wrong), (what, wrong))
    sizes = [record_of(*usual, subdomains_per_edge=edge, iterations=30) for edge in (4, 16)]
    agree([c.holds for c in checks(sizes) if "from 4³" in c.what] == [])
    flat = [*sizes, record_of(*usual, iterations=34)]
    agree([c.holds for c in checks(flat) if "from 4³" in c.what] == [True])
    growing = [*sizes, record_of(*usual, iterations=35)]
    agree([c.holds for c in checks(growing) if "from 4³" in c.what] == [False])


def test_speed_is_held_against_streaming():
    record = {"solver": "feti_classical", "level": 3, "subdomains": 512, "processes": 2}
    record |= {"seconds_setup": 8.0, "seconds_coarse": 0.7, "iterations": 40}
    record |= {"seconds_solve": 9.0, "seconds_iterations": 6.0, "seconds_streaming": 0.11}
    agree([check.holds for check in speed_checks([record])] == [True] * 3)
    slow = record | {"seconds_setup": 8.1, "seconds_coarse": 0.9, "seconds_streaming": 0.09}
    agree([check.holds for check in speed_checks([slow])] == [False] * 3)
    agree(list(speed_checks([record | {"level": 2}, record | {"solver": "gamg"}])) == [])


def test_report_of_a_study(study_of, tmp_path, capsys):
    """From records on disk to Markdown, LaTeX and pictures."""
    study_of("--subdomains-per-edge", "2", "--level", "1,2", "--pc", "dirichlet")
    folder = tmp_path / "report"
    solver = {"solver": "mumps", "level": 3, "subdomains": 512, "processes": 2, "dofs": 9}
    solver |= {"converged_reason": -11, "peak_mib": 99.0, "estimated_mib": 4321.0}
    solver |= {"machine": machine.describe(), "date": "2026-01-02T03:04:05+00:00"}

    def write() -> tuple[str, str, list[str]]:
        (tmp_path / "more.json").write_text(json.dumps([*EVERYTHING, solver]))
        files = [str(tmp_path / name) for name in ("records.json", "more.json")]
        assert report.main([*files, "--output", str(folder), "--remark", "Quiet."]) == 0
        names = sorted(path.name for path in folder.iterdir())
        return (folder / "linear.md").read_text(), (folder / "linear.tex").read_text(), names

    markdown, latex, names = on_first(write)
    agree(names == ["linear.md", "linear.tex", "linear_p1.png"], names)
    agree("source at (2, 2, 2)" in markdown and "2026-01-02" in markdown, markdown)
    agree("the condition numbers differ by at most 0.0 %" in markdown, markdown)
    agree("\n\nQuiet.\n\n" in markdown, markdown)
    agree("| MUMPS | 9 | 2 | needs 4 321 MiB |" in markdown, markdown)
    agree("| 2³ |" in markdown and "![" in markdown, markdown)
    agree(latex.count(r"\toprule") == latex.count(r"\end{table}") == markdown.count("--: |\n"))


@pytest.mark.parametrize("text", ["", "{}", "[]", "[1, 2]", '[{"level": 1}]'])
def test_report_of_no_records(text, tmp_path, capsys):
    def write() -> int:
        (tmp_path / "file.json").write_text(text)
        with pytest.raises(SystemExit) as caught:
            report.main([str(tmp_path / "file.json"), "--output", str(tmp_path)])
        return caught.value.code

    agree(on_first(write) == 2)
    said = COMM.bcast(capsys.readouterr().err)
    agree("file.json holds no" in said, said)
    agree(not Path(tmp_path / "linear.md").exists())

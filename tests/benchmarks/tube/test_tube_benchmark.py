# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The benchmark of the inflated tube, small: its records, their truth, and what it refuses."""

from __future__ import annotations

import json
import math

import pytest
from collective import COMM, agree, small
from wall_files import on_first

from benchmarks.common.walls.inflated_tube import TANGENTS
from benchmarks.common.walls.oracle import KPA_PER_MMHG, Wall, inflate
from benchmarks.tube import run as tube
from dolfinx_feti.runtime.petsc_options import inserted

COARSE = ["--quarter", "--size", "0.26", "--subdomains", "4"]
KEYS = set(
    "pressure_mmhg u_r_inner u_r_inner_exact newton_iterations linear_iterations "
    "max_linear_ratio steps min_J max_J kappa c size element degree subdomains processes "
    "tangent augmented thickness thickness_exact mean_J mean_J_exact stress_rr_error "
    "stress_tt_error".split()
)


@pytest.fixture
def no_work(monkeypatch):
    """Whatever is wrong is found before there is a tube."""

    def refuse(*_args, **_options):
        raise AssertionError("a tube is made")

    monkeypatch.setattr(tube, "create_slice", refuse)


def inflated(*words: object) -> list[dict[str, object]]:
    return tube.main([*COARSE, *map(str, words)])


@pytest.mark.serial
@pytest.mark.parametrize(("degree", "element"), [(1, "p1-p0"), (2, "p2-p0")])
def test_degree_is_an_element(degree, element):
    (record,) = tube.main([*COARSE, "--size", "0.3", "--pressures", "2", "--degree", str(degree)])
    agree((record["element"], record["degree"]) == (element, degree), record)


def test_records(tmp_path, capfd):
    """One for each pressure, in the file too, with costs from rest and the truth at its κ."""
    path = tmp_path / "new/tube.json"
    records = inflated("--pressures", "2,10", "--c", 4, "--kappa", 500, "--json", path)
    agree(on_first(lambda: json.loads(path.read_text())) == records and len(records) == 2)
    for record, pressure in zip(records, (2.0, 10.0), strict=True):
        agree(record.keys() >= KEYS, record)
        agree(record["pressure_mmhg"] == pressure and record["processes"] == COMM.size)
        agree(record["tangent"] == "symmetric" and "cg" in record["linear_methods"], record)
        truth = inflate(pressure * KPA_PER_MMHG, Wall(c=4.0, kappa=500.0))
        for name, exact in (
            ("u_r_inner", truth.inner_displacement),
            ("thickness", truth.thickness),
            ("mean_J", truth.mean_jacobian),
        ):
            small(record[f"{name}_exact"] / exact - 1.0, 1e-12)
            small(record[name] / exact - 1.0, 0.03)
        agree(0.5 < record["min_J"] < record["mean_J"] < record["max_J"] < 1.5)
        agree(0.0 < record["stress_tt_error"] < 0.3 and 0.0 < record["stress_rr_error"] < 0.6)
        small(record["max_linear_ratio"], 1.0)
    for name in ("steps", "newton_iterations", "linear_iterations"):
        agree(0 < records[0][name] < records[1][name], "counted from rest")
    said = capfd.readouterr().out
    agree((" 10.0 mmHg" in said and said.count("\n") == 2) if COMM.rank == 0 else said == "", said)


@pytest.mark.serial
def test_refinement():
    """Errors of the second order: those of the chords in place of circles."""
    coarse, fine = (inflated("--pressures", 10, "--size", size)[-1] for size in (0.26, 0.13))
    for name, rate in (("u_r_inner", 2.5), ("mean_J", 2.0), ("stress_tt_error", 1.4)):
        errors = [
            record[name] if name.endswith("error") else record[name] / record[f"{name}_exact"] - 1.0
            for record in (coarse, fine)
        ]
        agree(abs(errors[0]) >= rate * abs(errors[1]), (name, errors))


@pytest.mark.serial
def test_second_order_elements():
    """At κ = 1e5, and with no more dofs than P2–P0."""
    words = ("--pressures", 10, "--kappa", 1e5)
    record, old = (inflated(*words, "--element", e)[-1] for e in ("q2-p1d", "p2-p0"))
    agree(record["u_r_inner_error"] <= 5e-4 and 0.98 <= record["min_J"] <= record["max_J"] <= 1.02)
    for name in ("recovered_rr_error", "recovered_tt_error"):
        agree(record[name] <= 0.5 * old[name], (name, record[name], old[name]))


@pytest.mark.serial
def test_taylor_hood_on_the_same_cells():
    """MUMPS on u and p together leads to the same tube, with less accurate stresses."""
    words = ("--pressures", "5,10", "--kappa", 1e5)
    (_, record), (_, ours) = (inflated(*words, "--element", e) for e in ("q2-q1", "q2-p1d"))
    agree(record["linear_methods"] == ["mumps"] and record["steps"] == 2, record)
    agree(record["newton_iterations"] == record["linear_iterations"] and record["dofs"] > 0)
    small(record["u_r_inner"] / ours["u_r_inner"] - 1.0, 0.01)
    agree(ours["recovered_tt_error"] < record["recovered_tt_error"] < 0.1, record)


@pytest.mark.serial
def test_the_whole_tube_is_four_quarters():
    whole = tube.main(["--size", "0.26", "--subdomains", "6", "--pressures", "5"])[-1]
    quarter = inflated("--pressures", 5)[-1]
    agree(whole["quarter"] is False and quarter["quarter"] is True)
    for name in ("u_r_inner", "thickness", "mean_J"):
        small(whole[name] / quarter[name] - 1.0, 5e-3)


@pytest.mark.serial
def test_tangents_lead_to_one_state():
    records = {kind: inflated("--pressures", 4, "--tangent", kind)[-1] for kind in TANGENTS}
    for kind in ("full", "none"):
        agree("error" not in records[kind], records[kind])
        small(records[kind]["u_r_inner"] / records["symmetric"]["u_r_inner"] - 1.0, 1e-6)
    agree("gmres" in records["full"]["linear_methods"], "the pressure is zero at first")
    agree(records["none"]["newton_iterations"] > records["full"]["newton_iterations"])


@pytest.mark.serial
@pytest.mark.parametrize("multipliers", [(), ("--augmented",)])
def test_a_run_that_goes_on(tmp_path, multipliers):
    """The costs of the first part count; multipliers are in the checkpoint."""
    words = ["--checkpoint", tmp_path / "run", *multipliers]
    first = inflated("--pressures", 4, *words)[-1]
    last = inflated("--pressures", "4,12", *words, "--restart")
    agree([record["pressure_mmhg"] for record in last] == [12.0])
    agree(last[0]["steps"] > first["steps"] == 1)
    agree(last[0]["newton_iterations"] > first["newton_iterations"])
    whole = inflated("--pressures", "4,12", *multipliers)[-1]
    small(last[0]["u_r_inner"] / whole["u_r_inner"] - 1.0, 1e-6)
    if multipliers:
        agree(last[0]["volume_change"] <= 1e-6 and last[0]["updates"] > 1)
        small(last[0]["mean_J"] - 1.0, 1e-6)


@pytest.mark.serial
def test_a_run_that_does_not_arrive(monkeypatch, tmp_path):
    """A record says how far it came; JSON without numbers that are none."""
    monkeypatch.setattr(tube, "STEPS", tube.Steps(first=400.0, least=400.0))
    path = tmp_path / "tube.json"
    with inserted("tube_", {"snes_max_it": 5}):
        first, last = inflated("--pressures", "1,400", "--json", path)
    agree(first["pressure_mmhg"] == 1.0 and "error" not in first)
    agree(last["pressure_mmhg"] == 400.0 and last["reached_mmhg"] == 1.0)
    agree("No equilibrium was found beyond" in last["error"] and "u_r_inner" not in last)
    agree("NaN" not in on_first(path.read_text))


@pytest.mark.serial
@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["--pressures", "10,nan"], "'nan' is not a positive number"),
        (["--pressures", "10,-1"], "'-1' is not a positive number"),
        (["--pressures", "100,10"], r"argument --pressures: \[100.0, 10.0\] do not rise"),
        (["--kappa", "0"], "'0' is not a positive number"),
        (["--c", "inf"], "'inf' is not a positive number"),
        (["--size", "x"], "'x' is not a positive number"),
        (["--element", "q9"], "invalid choice: 'q9'"),
        (["--subdomains", "0"], "'0' is not a number 1, 2, 3"),
        (["--tangent", "half"], "invalid choice: 'half'"),
        (["--presure"], "unrecognized arguments: --presure"),
        (["--element", "p2-p1", "--augmented"], "p2-p1 goes without --augmented"),
        (["--restart"], "--restart: it needs --checkpoint FOLDER"),
    ],
)
def test_wrong_words(no_work, capfd, words, match):
    with pytest.raises(SystemExit):
        tube.main(words)
    said = capfd.readouterr().err
    assert match.replace("\\", "") in said


@pytest.mark.parametrize("words", [["--checkpoint"], ["--restart", "--checkpoint"], ["--json"]])
def test_wrong_places(no_work, tmp_path, capfd, words):
    """A file where a folder should be, and nothing to restart from."""
    on_first(lambda: (tmp_path / "notes").write_text("mine"))
    with pytest.raises(SystemExit) as caught:
        tube.main([*words, str(tmp_path / "notes/run")])
    agree(caught.value.code == 2)
    said = capfd.readouterr().err
    agree(("notes/run" in said) == (COMM.rank == 0), said)


@pytest.mark.serial
def test_default_mesh_is_within_its_bound():
    """One percent at the pressure where this κ is hardest, of those that take a second."""
    record = tube.main(["--quarter", "--pressures", "20", "--kappa", "1e5"])[-1]
    small(record["u_r_inner"] / record["u_r_inner_exact"] - 1.0, 0.01)
    agree(math.isfinite(record["u_r_inner_error"]) and record["u_r_inner_error"] < 0.015)

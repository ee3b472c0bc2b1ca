# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""`scripts/with-fenicsx` and its helpers on a fake machine, one for each process."""

from __future__ import annotations

import re
import signal
import subprocess
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_machine import CHECKOUT, STUBS, Machine, wait_for

import dolfinx_feti

pytestmark = pytest.mark.serial

OWN_FAILURE = 125


@pytest.fixture
def machine() -> Iterator[Machine]:
    with tempfile.TemporaryDirectory(prefix="dolfinx_feti-") as folder:
        yield Machine(Path(folder).resolve())


# ---- the machine's own Python ---------------------------------------------------------------


def test_own_python_is_used_and_nothing_installed(machine: Machine) -> None:
    """Status, arguments and input pass through."""
    machine.stub("python3", "exit 0")
    machine.stub("id", "echo 1000")
    script = 'pwd; echo $PYTHONPATH; printf "[%s]" "$@"; cat; exit 7'
    words = ("sh", "-c", script, "sh", "two words", "", "'\"$HOME")
    result = machine.run(*words, text="typed", PYTHONPATH="/mine")
    assert (result.returncode, result.stderr) == (7, "")
    here = f"{machine.folder}\n{machine.checkout}:/mine\n"
    assert result.stdout == f"{here}[two words][]['\"$HOME]typed"
    calls = (machine.folder / "calls").read_text().splitlines()
    assert {line.split()[0] for line in calls} == {"python3", "id"}
    assert not machine.trees.exists()


@pytest.mark.parametrize(("user", "allowed"), [("0", "1"), ("1000", "")])
def test_only_root_is_allowed_to_run_as_root(machine: Machine, user: str, allowed: str) -> None:
    machine.stub("python3", "exit 0")
    machine.stub("id", f"echo {user}")
    result = machine.run("sh", "-c", "echo $OMPI_ALLOW_RUN_AS_ROOT,$PRTE_ALLOW_RUN_AS_ROOT")
    assert result.stdout == f"{allowed},{allowed}\n"


# ---- when FEniCSx cannot be had -------------------------------------------------------------

IN_TREE = 'case "$*" in *"{}"*) echo "{}"; exit 1 ;; esac; ' + STUBS["chroot"]
#: A Python without dolfinx that can make an environment, whose Python has it.
PYTHON = """
    case "$*" in
        *check_fenicsx*) echo "it has no dolfinx" >&2; exit 1 ;;
        *requirements*) shift; echo numpy; echo "dolfinx-solver-real; groups: $*" ;;
        -m*venv*)
            mkdir -p "$3/bin"
            printf '#!/bin/sh\necho "environment $*" >>"$CALLS"; exit 0\n' >"$3/bin/python3"
            chmod +x "$3/bin/python3" ;;
    esac
    """
VISITOR = {"id": "echo 1000", "cc": "", "python3": PYTHON}
NO_PYTHON = 'case "$*" in *ensurepip*|*check*) exit 1 ;; esac'
NO_ROUTE = PYTHON.replace("exit 0", "echo ERROR: no route; exit 1")
NO_VENV = "cannot set up a virtual environment: .*"
PIP = {"FENICSX_SUITE": "pip"}

#: Stubs of programs, None for a program to remove; variables; and the expected message.
FAILURES = {
    "not root": ({"id": "echo 1000"}, {}, "this is not root"),
    "mounts forbidden": ({"unshare": "exit 1"}, {}, "mounting is not allowed"),
    "no space": ({"df": "echo Avail; echo 2097152"}, {}, "2048 MiB free, 5120 are needed"),
    "no network": (
        {"apt-helper": "echo \"E: Failed to fetch x  Could not resolve 'mirror'\"; exit 100"},
        {},
        "no network, or .* out of reach:\n.*Could not resolve 'mirror'",
    ),
    "unknown suite": (
        {"apt-helper": "echo 'E: Failed to fetch x  404  Not Found'; exit 100"},
        {"FENICSX_SUITE": "nosuch"},
        "no suite 'nosuch'",
    ),
    "no name of a suite": ({}, {"FENICSX_SUITE": "../sid"}, "'../sid' is not the name"),
    "no folder": ({}, {"DOLFINX_FETI_ENV": "/dev/null/x"}, "cannot write to /dev/null/x"),
    "wrong signature": (
        {"debootstrap": "echo 'E: Release signed by unknown key'; exit 1"},
        {},
        "debootstrap cannot .*:\n.*signed by unknown key",
    ),
    "lists": ({"chroot": IN_TREE.format("update", "E: x.invalid")}, {}, "update fails.*:\n.*E: x"),
    "packages": ({"chroot": IN_TREE.format("g++", "E: no such")}, {}, "cannot install.*:\n.*E: no"),
    "useless tree": (
        {"chroot": IN_TREE.format("python3 -", "its dolfinx is 0.5")},
        {},
        "does not serve:\n.*dolfinx is 0.5",
    ),
    "nothing to install": ({"debootstrap": None, "apt-get": None}, {}, "neither .* nor apt-get"),
    "no compiler": (VISITOR | {"cc": None}, PIP, f"{NO_VENV}Python 3.12 or newer .* compiler"),
    "no Python": (VISITOR | {"python3": NO_PYTHON}, PIP, f"{NO_VENV}Python 3.12 or newer"),
    "no route to PyPI": (VISITOR | {"python3": NO_ROUTE}, PIP, f"{NO_VENV}ERROR: no route"),
}


@pytest.mark.parametrize("case", FAILURES)
def test_one_message_names_the_cause_and_the_ways_out(machine: Machine, case: str) -> None:
    stubs, variables, cause = FAILURES[case]
    for tool, body in stubs.items():
        machine.stub(tool, body)
    result = machine.run("echo", "must not run", **variables)
    assert result.returncode == OWN_FAILURE
    assert result.stdout == ""
    message = result.stderr[result.stderr.rindex("with-fenicsx: ") :]
    assert re.search(cause, message, re.DOTALL)
    for way in "conda create", "docker run", "apt install python3-dolfinx", "as root":
        assert result.stderr.count(way) == 1
    assert machine.left() == set()


def test_missing_debootstrap_is_installed(machine: Machine) -> None:
    (machine.bin / "debootstrap").rename(machine.folder / "debootstrap")
    move = f'mv "{machine.folder}/debootstrap" "{machine.bin}"'
    machine.stub("apt-get", f'{STUBS["apt-get"]}case "$*" in *"install "*) {move} ;; esac')
    result = machine.run("true")
    assert result.returncode == 0
    assert "installing it with apt-get" in result.stderr
    assert machine.left() == {"trixie"}


# ---- the Debian tree ------------------------------------------------------------------------


def test_tree_is_made_once_from_the_machines_mirror(machine: Machine) -> None:
    """Also installed again after a change of the list of packages; its MPI has its parameters."""
    first = machine.run("sh", "-c", "exit 7")
    assert first.returncode == 7
    assert "base system" in first.stderr
    (call,) = machine.calls("debootstrap")
    assert {"http://mirror.invalid/debian", "--force-check-gpg"} <= set(call.split())
    parameters = machine.trees / "trixie/etc/openmpi/openmpi-mca-params.conf"
    assert parameters.read_text().split("\n") == ["osc = old", "", "btl = self,sm", ""]
    second = machine.run("pwd")
    assert (second.returncode, second.stderr) == (0, "")
    assert second.stdout == f"{machine.folder}\n"  # of the caller
    assert len(machine.calls("debootstrap")) == 1
    with (machine.checkout / "scripts/debian-packages").open("a") as packages:
        packages.write("apt another\n")
    assert machine.run("true").returncode == 0
    assert len(machine.calls("debootstrap")) == 2
    assert [call for call in machine.calls("chroot") if "another" in call.split()] != []
    assert machine.left() == {"trixie"}


def test_what_the_tree_gets_from_outside(machine: Machine) -> None:
    kept = {"OMP_NUM_THREADS": "2", "PETSC_OPTIONS": "-a -b", "TERM": "dumb"}
    dropped = {"PETSC_DIR": "/host", "PYTHONPATH": "/host", "LD_PRELOAD": ""}
    result = machine.run("env", **kept, **dropped)
    inside = dict(line.split("=", 1) for line in result.stdout.splitlines())
    assert kept.items() <= inside.items()
    assert inside["PYTHONPATH"] == str(machine.checkout)
    assert inside["MPLBACKEND"] == "Agg"
    assert inside["HOME"] != str(machine.folder)
    assert not {"PETSC_DIR", "LD_PRELOAD", "CALLS"} & inside.keys()


@pytest.mark.parametrize("inside", ["trixie", ""])
def test_asking_for_a_suite_asks_for_a_tree(machine: Machine, inside: str) -> None:
    """Inside one, its own Python is used."""
    machine.stub("python3", "exit 0")
    result = machine.run("echo", "here", FENICSX_SUITE="trixie", DOLFINX_FETI_INSIDE=inside)
    assert (result.returncode, result.stdout) == (0, "here\n")
    assert len(machine.calls("debootstrap")) == (0 if inside else 1)


def test_packages_of_the_docs_have_a_tree_of_their_own(machine: Machine) -> None:
    machine.run("true")
    assert machine.run("true", FENICSX_PACKAGES="docs").returncode == 0
    assert machine.left() == {"trixie", "trixie-docs"}
    installs = [call.split() for call in machine.calls("chroot") if "install" in call.split()]
    assert sum("python3-dolfinx" in call for call in installs) == 2
    assert sum("python3-myst-nb" in call for call in installs) == 1
    assert machine.run("true").returncode == 0
    assert len(machine.calls("debootstrap")) == 2


def test_own_python_has_to_have_what_the_docs_need(machine: Machine) -> None:
    machine.stub("python3", 'case "$*" in *docs) echo "it has no myst_nb" >&2; exit 1 ;; esac')
    assert machine.run("true").returncode == 0
    assert not machine.calls("debootstrap")
    result = machine.run("true", FENICSX_PACKAGES="docs", FENICSX_SUITE="trixie")
    assert "FENICSX_SUITE is trixie" in result.stderr
    machine.stub("id", "echo 1000")
    result = machine.run("true", FENICSX_PACKAGES="docs", DOLFINX_FETI_ENV="/nowhere")
    assert result.returncode == OWN_FAILURE
    assert "it has no myst_nb" in result.stderr and "scripts/debian-packages-docs" in result.stderr


# ---- the virtual environment ------------------------------------------------------------------


@pytest.fixture
def visitor(machine: Machine) -> Machine:
    """A machine without root access, with Python and a compiler."""
    for tool, body in VISITOR.items():
        machine.stub(tool, body)
    return machine


def test_without_root_pip_brings_dolfinx(visitor: Machine) -> None:
    result = visitor.run("sh", "-c", 'echo "$VIRTUAL_ENV,$PYTHONPATH"; python3 it')
    assert result.returncode == 0
    assert result.stdout == f"{visitor.trees}/pip,{visitor.checkout}\n"
    first, check, it = visitor.calls("environment")
    assert "install" in first and "numpy dolfinx-solver-real; groups: test lint" in first
    assert "check_fenicsx" in check and it == "environment it"
    again = visitor.run("true", FENICSX_SUITE="pip")
    assert (again.returncode, again.stderr) == (0, "")
    assert len(visitor.calls("environment")) == 3
    assert visitor.left() == {"pip"}
    assert visitor.run("true", FENICSX_PACKAGES="docs").returncode == 0
    assert "groups: test lint docs" in visitor.calls("environment")[3]
    assert visitor.left() == {"pip", "pip-docs"}


def test_pip_in_place_of_a_tree(visitor: Machine) -> None:
    """Where mounting is not allowed, or if asked for; not where a suite of Debian is."""
    visitor.stub("id", "echo 0")
    assert visitor.run("true", FENICSX_SUITE="pip").returncode == 0
    assert visitor.left() == {"pip"}
    visitor.stub("unshare", "exit 1")
    assert visitor.run("true").returncode == 0
    assert visitor.run("true", FENICSX_SUITE="trixie").returncode == OWN_FAILURE
    assert not visitor.calls("debootstrap")


# ---- two at once, and interruptions ---------------------------------------------------------


@pytest.fixture
def slow(machine: Machine) -> Machine:
    """A machine on which debootstrap begins, and goes on when the file `go` appears."""
    hold = f'while [ ! -e "{machine.folder}/go" ]; do sleep 0.05; done'
    machine.stub("debootstrap", STUBS["debootstrap"] + hold)
    return machine


def begun(machine: Machine, *command: str) -> subprocess.Popen[str]:
    """Start a command; its tree is half made."""
    process = machine.start(*command)
    half = "trixie.partial"
    wait_for(lambda: bool(machine.calls("debootstrap")) and half in machine.left())
    return process


def test_two_at_once_make_one_tree(slow: Machine) -> None:
    first = begun(slow, "echo", "first")
    second = slow.start("echo", "second")
    assert second.stderr is not None
    assert "another run is setting up" in second.stderr.readline()
    (slow.folder / "go").touch()
    assert first.communicate(timeout=60)[0] == "first\n"
    assert second.communicate(timeout=60)[0] == "second\n"
    assert len(slow.calls("debootstrap")) == 1
    assert slow.left() == {"trixie"}


def test_a_tree_in_use_is_not_replaced(machine: Machine) -> None:
    user = machine.start("sh", "-c", "echo inside; cat")
    assert user.stdout is not None
    assert user.stdout.readline() == "inside\n"
    (machine.trees / "trixie/etc/dolfinx_feti").write_text("of an older checkout\n")
    other = machine.start("true")
    assert other.stderr is not None
    assert "other runs still use" in other.stderr.readline()
    assert len(machine.calls("debootstrap")) == 1
    assert user.communicate("typed", timeout=60)[0] == "typed"
    other.communicate(timeout=60)
    assert other.returncode == 0
    assert len(machine.calls("debootstrap")) == 2


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupted_set_up_leaves_nothing(slow: Machine, name: str) -> None:
    process = begun(slow, "true")
    process.send_signal(signal.Signals[name])
    _, messages = process.communicate(timeout=60)
    assert process.returncode == OWN_FAILURE
    assert "interrupted" in messages
    assert slow.left() == set()


def test_a_killed_set_up_is_cleared_by_the_next(slow: Machine) -> None:
    process = begun(slow, "true")
    process.kill()
    process.communicate(timeout=60)
    assert "trixie" not in slow.left()
    (slow.trees / "trixie.partial/left-over").touch()
    (slow.folder / "go").touch()
    assert slow.run("true").returncode == 0
    assert slow.left() == {"trixie"}
    assert not (slow.trees / "trixie/left-over").exists()


# ---- what has to agree ----------------------------------------------------------------------


def test_one_version_of_ruff_and_of_the_package() -> None:
    groups = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["dependency-groups"]
    (ruff,) = (need for need in groups["lint"] if need.startswith("ruff=="))
    assert ruff in (CHECKOUT / "scripts/debian-packages").read_text().split()
    assert f"\nversion: {dolfinx_feti.__version__}\n" in (CHECKOUT / "CITATION.cff").read_text()


def test_no_host_name_in_the_scripts() -> None:
    for script in filter(Path.is_file, (CHECKOUT / "scripts").iterdir()):
        assert not re.search(r"(https?|ftp)://[a-z]", script.read_text()), script.name

# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Run tests of programs that others wrote, with this package as their solver.

FENICSX_SUITE=pip scripts/with-fenicsx python3 scripts/clients.py [--all] [PYTEST ARGUMENT…]

fenicsx-pulse and what it needs are installed from PyPI, in the versions below, into a folder of
their own: build/clients, or DOLFINX_FETI_CLIENTS. The environment itself is not changed. A second
run installs nothing. Six of pulse's tests run on one process and one on two; --all runs all of
its 32 tests of a left ventricle on one. Exit status 125: this environment has no dolfinx 0.11,
whose elements on real spaces pulse needs here.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDER = Path(os.environ.get("DOLFINX_FETI_CLIENTS", ROOT / "build/clients"))

#: Wheels that are installed without their dependencies. The environment of scripts/with-fenicsx has
#: the dependencies that the tests need; the others are imported only by code that is not tested.
WHEELS = (
    "annotated-types==0.8.0",
    "cardiac-geometries-core==1.5.0",
    "cardiac-geometriesx==0.16.0",
    "click==8.5.1",
    "fenicsx-compat==0.4.0",
    "fenicsx-pulse==0.12.0",
    "flexcache==0.3",
    "flexparser==0.4",
    "io4dolfinx==1.5.0",
    "pint==0.26.2",
    "rich-argparse==1.8.0",
    "rich-click==1.9.9",
    "structlog==26.1.0",
)
#: Source archive with pulse's tests.
PULSE = "fenicsx-pulse==0.12.0"
#: Source archive of scifem. Its C++ part cannot be compiled against the wheel of dolfinx; only its
#: Python part is installed.
SCIFEM = "scifem==0.27.0"

#: Module in place of scifem's C++ part, of which pulse calls nothing with dolfinx 0.11.
STUB = '''"""Names of scifem's C++ part, which is not built."""


def __getattr__(name):
    if name.startswith("__"):
        raise AttributeError(name)

    def missing(*arguments, **named):
        raise NotImplementedError(f"{name}: scifem's C++ part is not installed")

    return missing
'''

#: All of pulse's tests of a left ventricle.
TESTS = "test_static_problem.py::test_static_problem_lv"
#: Both materials, loaded by pressure and by volume, with rigid motions held by multipliers or
#: springs, in metres and in millimetres; each choice occurs in two of the four.
ON_ONE_PROCESS = (
    "Compressible2-pressure-False-geo_no_flat_base_m-free",
    "Compressible2-volume-True-geo_flat_base_mm-fixed",
    "Incompressible-pressure-True-geo_no_flat_base_m-fixed",
    "Incompressible-volume-False-geo_flat_base_mm-free",
)
#: How pulse reports a solve that fails, with and without ``raise_on_failure``.
FAILURES = (
    "test_solve_convergence_reporting.py::test_failed_solve_returns_false_instead_of_raising",
    "test_solve_convergence_reporting.py::test_raise_on_failure_argument_restores_the_exception",
)
#: An incompressible one on a mesh in two parts.
ON_TWO_PROCESSES = ("Incompressible-volume-False-geo_flat_base_mm-free",)

#: Seconds after which a run of pytest counts as stuck: ten times what one takes on an idle machine.
PATIENCE = float(os.environ.get("DOLFINX_FETI_TEST_PATIENCE", "1800"))

NOT_AVAILABLE = 125


def pip(*arguments: str | Path) -> None:
    """Run pip, or exit with a message that shows its output."""
    command = [sys.executable, "-m", "pip", *map(str, arguments)]
    result = subprocess.run(
        [*command, "--disable-pip-version-check", "--quiet", "--no-deps"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if result.returncode != 0:
        sys.exit(
            f"clients: pip {arguments[0]} failed, so that no test of fenicsx-pulse has run. Is "
            f"PyPI within reach? The command was\n  {' '.join(command)}\nand says\n{result.stdout}"
        )


def unpacked(archives: Path, requirement: str) -> Path:
    """Unpack the source archive of a requirement; return the folder of its sources."""
    name = requirement.replace("==", "-").replace("fenicsx-pulse", "fenicsx_pulse")
    with tarfile.open(archives / f"{name}.tar.gz") as archive:
        archive.extractall(archives, filter="data")
    return archives / name


def install(folder: Path) -> None:
    """Install pulse, its tests and what it needs, unless this folder has them already."""
    stamp = folder / "installed"
    wanted = "\n".join((*WHEELS, PULSE, SCIFEM, STUB))
    if stamp.exists() and stamp.read_text(encoding="utf-8") == wanted:
        return
    for name in ("site", "archives"):
        shutil.rmtree(folder / name, ignore_errors=True)
    site = folder / "site"
    archives = folder / "archives"
    print(f"clients: installing {PULSE} and what it needs in {folder}", flush=True)
    pip("install", "--only-binary", ":all:", "--target", site, *WHEELS)
    pip("download", "--no-binary", "fenicsx-pulse,scifem", "--dest", archives, PULSE, SCIFEM)
    unpacked(archives, PULSE)
    source = unpacked(archives, SCIFEM)
    shutil.copytree(source / "src/scifem", site / "scifem")
    (site / "scifem/_scifem.py").write_text(STUB, encoding="utf-8")
    metadata = (
        site / f"{SCIFEM.replace('==', '-')}.dist-info"
    )  # which scifem reads its version from
    metadata.mkdir()
    shutil.copy(source / "PKG-INFO", metadata / "METADATA")
    stamp.write_text(wanted, encoding="utf-8")


def run_pulse(folder: Path, processes: int, tests: list[str], arguments: list[str]) -> int:
    """Run tests of pulse by FETI; return pytest's exit status."""
    paths = [ROOT, ROOT / "tests/clients", folder / "site"]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, paths)),
        "OMP_NUM_THREADS": "1",
        "XDG_CONFIG_HOME": str(ROOT / "tests/config"),
    }
    command = [] if processes == 1 else ["mpirun", "-n", str(processes)]
    command += [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-s",
        "-p",
        "pulse_with_feti",
        "-o",
        "addopts=",
    ]
    command += ["-p", "no:cacheprovider", "-p", "no:warnings", "--tb=short", *tests, *arguments]
    where = folder / "archives" / PULSE.replace("==", "-").replace("-pulse", "_pulse") / "tests"
    try:
        result = subprocess.run(command, cwd=where, env=environment, timeout=PATIENCE, check=False)
    except subprocess.TimeoutExpired:
        print(f"clients: stopped after {PATIENCE:g} s on {processes} processes", file=sys.stderr)
        return 1
    return result.returncode


def main(arguments: list[str]) -> int:
    """Install and run the chosen clients; return an exit status."""
    try:
        if not version("dolfinx-solver-real").startswith("0.11"):
            raise PackageNotFoundError
    except PackageNotFoundError:
        print("clients: pulse's tests take the wheels of dolfinx 0.11 here", file=sys.stderr)
        return NOT_AVAILABLE
    folder = FOLDER.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    install(folder)
    begin = time.monotonic()
    if "--all" in arguments:
        arguments.remove("--all")
        runs = [(1, [TESTS])]
    else:
        one = [f"{TESTS}[{case}]" for case in ON_ONE_PROCESS]
        two = [f"{TESTS}[{case}]" for case in ON_TWO_PROCESSES]
        runs = [(1, [*FAILURES, *one]), (2, two)]
    for processes, tests in runs:
        status = run_pulse(folder, processes, tests, arguments)
        if status != 0:
            return status
    print(f"clients: pulse's tests pass by FETI, after {time.monotonic() - begin:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

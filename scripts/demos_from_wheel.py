#!/usr/bin/env python3
# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Run the demos as a user does who has installed the wheel and downloaded a demo.

    scripts/with-fenicsx python3 scripts/demos_from_wheel.py [DEMO…] [--processes 1 2]

1. The sdist is built from a copy of the repository's files, and the wheel from the sdist.
2. The wheel is installed into a new folder outside of the checkout, without dependencies.
3. Each demo is copied into an empty folder, without the files beside it in ``demos/``, and run
   there on one and on two processes. No variable names the checkout.

All demos run unless some are named, such as ``demo_poisson``; ``demo_case`` runs with its defaults.
A line for each run shows whether it failed. The output of each is in ``build/demos_from_wheel/``.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from run_tests import launcher

ROOT = Path(__file__).resolve().parents[1]
DEMOS = ROOT / "demos"
OUT = ROOT / "build/demos_from_wheel"

#: Seconds after which a demo is stopped: four times what the longest one takes.
PATIENCE = 1200.0

#: What is not in the repository: at the top of a checkout; in docs, where `make docs` may be
#: writing meanwhile; caches anywhere.
NOT_IN_REPOSITORY = shutil.ignore_patterns(".*", "build", "dist", "output", "*.egg-info")
NOT_IN_DOCS = shutil.ignore_patterns("demos", "modules.md")
CACHES = shutil.ignore_patterns("__pycache__")

#: Variables that could lead a program to the checkout.
OF_THE_CHECKOUT = ("PYTHONPATH", "XDG_CONFIG_HOME")


@dataclass(frozen=True)
class Outcome:
    """How a demo ended.

    Attributes:
        demo: Name of the file without suffix.
        processes: Number of processes.
        seconds: Wall time.
        failure: Empty if it succeeded; otherwise its status, or that it was stopped.
    """

    demo: str
    processes: int
    seconds: float
    failure: str


def environment(site: Path | None = None) -> dict[str, str]:
    """Return the variables of a program that does not know the checkout.

    Args:
        site: Folder of installed packages that the program is to find; None for none.
    """
    variables = {name: value for name, value in os.environ.items() if name not in OF_THE_CHECKOUT}
    if site is not None:
        variables["PYTHONPATH"] = str(site)
    return variables


def run(*command: str | Path, cwd: Path, site: Path | None = None) -> str:
    """Run a command that does not know the checkout; return its output.

    Raises:
        RuntimeError: The command failed; the message is its output.
    """
    result = subprocess.run(
        list(map(str, command)),
        cwd=cwd,
        env=environment(site),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300.0,
        check=False,
    )
    if result.returncode != 0:
        raise RuntimeError(result.stdout)
    return result.stdout


def build(kind: str, source: Path, out: Path) -> Path:
    """Build with the back end of ``pyproject.toml``; return the file.

    Args:
        kind: ``sdist`` or ``wheel``.
        source: Folder with the sources.
        out: Folder of the file; it is created.
    """
    code = f"from setuptools import build_meta; print(build_meta.build_{kind}({str(out)!r}))"
    out.mkdir(exist_ok=True)
    return out / run(sys.executable, "-c", code, cwd=source).splitlines()[-1]


def build_sdist(folder: Path) -> Path:
    """Build the sdist from a copy of the repository's files in a folder; return the file."""
    source = folder / "source"

    def ignored(where: str, names: list[str]) -> set[str]:
        left_out = CACHES(where, names)
        if Path(where) == ROOT:
            left_out |= NOT_IN_REPOSITORY(where, names)
        if Path(where) == ROOT / "docs":
            left_out |= NOT_IN_DOCS(where, names)
        return left_out

    shutil.copytree(ROOT, source, ignore=ignored, symlinks=True)
    return build("sdist", source, folder / "dist")


def build_wheel(sdist: Path) -> Path:
    """Build the wheel from the files of an sdist, beside it; return the file."""
    with tarfile.open(sdist) as archive:
        archive.extractall(sdist.parent, filter="data")
    return build("wheel", sdist.parent / sdist.name.removesuffix(".tar.gz"), sdist.parent)


def install(wheel: Path, site: Path) -> None:
    """Install a wheel alone into a folder, which Python finds by ``PYTHONPATH``.

    A virtual environment would not find the MPI of its parent.

    Raises:
        RuntimeError: pip failed, or Python imports the package from elsewhere.
    """
    offline = ("--no-deps", "--no-index", "--no-build-isolation")
    pip = (sys.executable, "-m", "pip", "install", *offline, "--target", site, wheel)
    run(*pip, cwd=wheel.parent)
    code = "import dolfinx_feti; print(dolfinx_feti.__file__)"
    found = run(sys.executable, "-c", code, cwd=site.parent, site=site).splitlines()[-1]
    if not Path(found).is_relative_to(site):
        raise RuntimeError(f"dolfinx_feti is imported from {found}, not from {site}")


def run_demo(demo: str, processes: int, site: Path, log: Path) -> Outcome:
    """Run a demo alone in an empty folder; its output goes to a file.

    Args:
        demo: Name of the file without suffix.
        processes: Number of processes.
        site: Folder with the installed package.
        log: File for the output.
    """
    variables = environment(site) | {"OMP_NUM_THREADS": "1"}
    failure = ""
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="demo-") as folder, log.open("w") as output:
        shutil.copy(DEMOS / f"{demo}.py", folder)
        command = [*launcher(processes), sys.executable, f"{demo}.py"]
        try:
            result = subprocess.run(
                command,
                cwd=folder,
                env=variables,
                stdout=output,
                stderr=subprocess.STDOUT,
                timeout=PATIENCE,
                check=False,
            )
            if result.returncode != 0:
                failure = f"status {result.returncode}"
        except subprocess.TimeoutExpired:
            failure = f"stopped after {PATIENCE:g} s"
    return Outcome(demo, processes, time.monotonic() - begin, failure)


def main() -> int:
    """Build, install, run; return 1 if a demo failed."""
    names = sorted(path.stem for path in DEMOS.glob("demo_*.py"))
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("demos", nargs="*", metavar="DEMO", help="these demos only")
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2], metavar="N")
    parser.add_argument("--output", type=Path, default=OUT, metavar="FOLDER", help="of the logs")
    args = parser.parse_args()
    demos = [name.removesuffix(".py") for name in args.demos] or names
    unknown = set(demos) - set(names)
    if unknown:
        parser.error(f"no demo {', '.join(sorted(unknown))}; there are {', '.join(names)}")

    args.output.mkdir(parents=True, exist_ok=True)
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory(prefix="dolfinx_feti-wheel-") as temporary:
        folder = Path(temporary)
        site = folder / "site"
        install(build_wheel(build_sdist(folder)), site)
        for processes in args.processes:
            for demo in demos:
                log = args.output / f"{demo}.np{processes}.log"
                outcome = run_demo(demo, processes, site, log)
                outcomes.append(outcome)
                result = outcome.failure or "ok"
                print(f"{demo:32} {processes} {outcome.seconds:6.0f} s  {result}", flush=True)
                if outcome.failure:
                    print(*log.read_text(errors="replace").splitlines()[-20:], sep="\n")
    failed = [outcome for outcome in outcomes if outcome.failure]
    print(f"demos_from_wheel: {len(outcomes)} runs, {len(failed)} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

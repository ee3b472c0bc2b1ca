# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Run the suite on 1, 2 and 3 processes, and on 4 and 8 what is marked for them (`make test`).

scripts/with-fenicsx python3 scripts/run_tests.py [PYTEST ARGUMENT…]

A run goes on as long as tests finish: it is stopped after DOLFINX_FETI_TEST_PATIENCE seconds
(600) without one, and at once when a process fails a test that another is still in, since that
one may wait for ever. A failure is shown when it happens; each minute has its line. All outputs
are in build/tests/. DOLFINX_FETI_TEST_PROCESSES="2 4" selects the numbers of processes. One
process shares the files among as many workers as there are cores (at most four), if pytest-xdist
is installed.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "build/tests"

#: Seconds that other processes have to finish a test that one process has failed.
GRACE = float(os.environ.get("DOLFINX_FETI_TEST_GRACE", "30"))
#: Seconds between two lines of progress.
MINUTE = 60.0

#: Age in seconds from which a source without its compiled form counts as left by an interrupted
#: compilation. Later runs would wait for it.
COMPILATION = 600.0


class Recorder:
    """Plugin of pytest that writes each report of one process to a file as it comes."""

    def __init__(self, name: str) -> None:
        """Open ``name.progress`` and ``name.failures``."""
        self._progress = (OUT / f"{name}.progress").open("w", buffering=1, encoding="utf-8")
        self._failures = (OUT / f"{name}.failures").open("w", buffering=1, encoding="utf-8")

    def pytest_runtest_logreport(self, report) -> None:  # type: ignore[no-untyped-def]
        """Record set-up, call and teardown of a test."""
        if report.failed:
            print(f"---- {report.nodeid}\n{report.longreprtext}", file=self._failures)
        print(report.when, report.outcome, report.nodeid, file=self._progress)

    def pytest_collectreport(self, report) -> None:  # type: ignore[no-untyped-def]
        """Record a file that cannot be imported."""
        if report.failed:
            print(f"---- {report.nodeid}\n{report.longreprtext}", file=self._failures)
            print("collect failed", report.nodeid, file=self._progress)


def one_process(np: int, arguments: list[str]) -> int:
    """Run pytest on one of the processes; end all of them if pytest itself breaks down."""
    rank = int(os.environ.get("OMPI_COMM_WORLD_RANK", os.environ.get("PMI_RANK", "0")))
    name = f"np{np}.rank{rank}"
    with (OUT / f"{name}.log").open("w") as log:
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
    from mpi4py import MPI

    import pytest

    status = pytest.main(["-q", "-p", "no:cacheprovider", *arguments], plugins=[Recorder(name)])
    ends = (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.NO_TESTS_COLLECTED)
    tests_have_run = status in ends
    if np > 1 and not tests_have_run:
        MPI.COMM_WORLD.Abort(int(status))
    # A process that left with a failure would end the others before they have reported.
    return int(status) if np == 1 else 0


@dataclass
class Rank:
    """What one process has reported so far; ``called`` has the tests whose call is over."""

    name: str
    read: int = 0
    called: set[str] = field(default_factory=set)
    failed: dict[str, float] = field(default_factory=dict)
    skipped: set[str] = field(default_factory=set)
    finished: int = 0

    def update(self) -> None:
        """Read what has been added to its file."""
        path = OUT / f"{self.name}.progress"
        if not path.exists():
            return
        with path.open(encoding="utf-8") as file:
            file.seek(self.read)
            text = file.read()
        text = text[: text.rfind("\n") + 1]
        self.read += len(text.encode())
        for line in text.splitlines():
            when, outcome, test = line.split(" ", 2)
            if outcome == "failed":
                self.failed.setdefault(test, time.monotonic())
            if outcome == "skipped":
                self.skipped.add(test)
            if when == "call" or outcome != "passed":
                self.called.add(test)
            if when == "teardown":
                self.finished += 1

    @property
    def passed(self) -> int:
        """Number of tests that have passed."""
        return len(self.called - self.skipped - self.failed.keys())


@dataclass
class Run:
    """The suite on ``np`` processes, and what has become of it."""

    np: int
    seconds: float = 0.0
    complaint: str = ""
    ranks: list[Rank] = field(init=False)

    def __post_init__(self) -> None:
        """Expect a report of each process."""
        self.ranks = [Rank(f"np{self.np}.rank{rank}") for rank in range(self.np)]

    @property
    def failed(self) -> dict[str, float]:
        """Tests that have failed on any process, and when."""
        return {test: when for rank in self.ranks[::-1] for test, when in rank.failed.items()}

    @property
    def ok(self) -> bool:
        """Whether all tests have passed on all processes."""
        return not self.complaint and not self.failed

    def follow(self, process: subprocess.Popen[bytes], patience: float) -> None:
        """Wait for the end, with a line a minute; say in ``complaint`` why it was stopped."""
        begin = last = minute = time.monotonic()
        shown: set[str] = set()
        finished = 0
        running = True
        while running:
            running = process.poll() is None
            time.sleep(0.1 if running else 0.0)
            for rank in self.ranks:
                rank.update()
            now = time.monotonic()
            self.seconds = now - begin
            for rank in self.ranks:
                for test in rank.failed.keys() - shown:
                    shown.add(test)
                    print(excerpt(OUT / f"{rank.name}.failures", test), flush=True)
            if (count := sum(rank.finished for rank in self.ranks)) > finished:
                finished = count
                last = now
            if now - minute > MINUTE:
                minute = now
                print(f"np {self.np}: {self.counts()}, {self.seconds:.0f} s", flush=True)
            if alone := self.failed_alone(now):
                self.complaint = f"stopped: other processes are still in {alone}"
            elif now - last > patience:
                self.complaint = f"stopped: no test has finished for {patience:g} s"
            if running and self.complaint:
                stop(process)
                running = False
        if process.returncode and not self.complaint and not self.failed:
            self.complaint = f"pytest or mpirun ended with status {process.returncode}"

    def failed_alone(self, now: float) -> str:
        """Return a test that a process has failed, and another has not come out of for a while."""
        for test, when in self.failed.items():
            if now - when > GRACE and any(test not in rank.called for rank in self.ranks):
                return test
        return ""

    def counts(self) -> str:
        """Return how many tests have passed, failed, and been skipped."""
        first = self.ranks[0]
        return f"{first.passed} passed, {len(self.failed)} failed, {len(first.skipped)} skipped"


def excerpt(path: Path, test: str) -> str:
    """Return what a file of failures says about one test."""
    _, _, text = path.read_text(encoding="utf-8").partition(f"---- {test}\n")
    text, *_ = text.split("\n---- ")
    return f"---- {test}\n{text}"


def stop(process: subprocess.Popen[bytes]) -> None:
    """End mpirun, which ends its processes, and after ten seconds whatever is left."""
    for number, seconds in ((signal.SIGTERM, 10.0), (signal.SIGKILL, 10.0)):
        try:
            os.killpg(process.pid, number)
            process.wait(seconds)
        except (ProcessLookupError, subprocess.TimeoutExpired):
            continue


def launcher(np: int) -> list[str]:
    """Return the words that start several processes; Open MPI has to be allowed to share cores."""
    if np == 1:
        return []
    said = subprocess.run(["mpirun", "--version"], capture_output=True, text=True, check=False)
    return ["mpirun", "-n", str(np), *(["--oversubscribe"] if "Open MPI" in said.stdout else [])]


def workers() -> list[str]:
    """Return pytest's words for several workers, one for each core."""
    cores = min(4, len(os.sched_getaffinity(0)))
    try:
        import xdist  # noqa: F401
    except ImportError:
        return []
    return [f"--numprocesses={cores}", "--dist=loadfile"] if cores > 1 else []


def marked() -> list[str]:
    """Return the files with tests for particular numbers of processes."""
    return [
        str(path)
        for path in sorted((ROOT / "tests").rglob("test_*.py"))
        if "mark.processes" in path.read_text(encoding="utf-8")
    ]


def drop_unfinished_kernels() -> None:
    """Remove sources whose compilation a killed run has left undone."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    for source in Path(home, "fenics").glob("libffcx_*.c"):
        done = source.with_name(source.name + ".cached").exists()
        if not done and time.time() - source.stat().st_mtime > COMPILATION:
            source.unlink()


def run_on(np: int, arguments: list[str]) -> Run:
    """Run the suite on ``np`` processes and show what went wrong."""
    print(f"==== tests on {np} process(es)", flush=True)
    arguments = [*(workers() if np == 1 else []), *arguments]
    if np > 3 and len(arguments) == 0:
        arguments = marked()
    command = [*launcher(np), sys.executable, __file__, "--one-process", str(np), *arguments]
    environment = os.environ | {
        "OMP_NUM_THREADS": os.environ.get("DOLFINX_FETI_TEST_THREADS", "1"),
        "XDG_CONFIG_HOME": str(ROOT / "tests/config"),  # compiles forms quickly
        "OMPI_MCA_mpi_yield_when_idle": "1",  # a waiting process leaves the core to others
    }
    run = Run(np)
    with (OUT / f"np{np}.log").open("w") as log:
        process = subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=log, stderr=log, start_new_session=True
        )
    try:
        run.follow(process, float(os.environ.get("DOLFINX_FETI_TEST_PATIENCE", "600")))
    finally:
        stop(process)
    if run.complaint:
        print(f"error: {run.complaint}")
        for name in [f"np{np}", *(rank.name for rank in run.ranks)]:
            path = OUT / f"{name}.log"
            if lines := path.read_text(errors="replace").splitlines() if path.exists() else []:
                print(f"---- the end of {path.relative_to(ROOT)}", *lines[-40:], sep="\n")
    print(f"np {np}: {run.counts()} in {run.seconds:.1f}s", flush=True)
    return run


def main(arguments: list[str]) -> int:
    """Run on each number of processes, even after a failure; close with a table."""
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir(parents=True)
    drop_unfinished_kernels()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    numbers = re.findall(r"\d+", os.environ.get("DOLFINX_FETI_TEST_PROCESSES", "1 2 3 4 8"))
    runs = [run_on(int(number), arguments) for number in numbers]
    print("\n processes   result   passed   failed   skipped   seconds")
    for run in runs:
        first = run.ranks[0]
        result = "ok" if run.ok else "FAILED"
        print(
            f"{run.np:10d} {result:>8s} {first.passed:8d} {len(run.failed):8d} "
            f"{len(first.skipped):9d} {run.seconds:9.0f}"
        )
    return 0 if all(run.ok for run in runs) else 1


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one-process"]:
        sys.exit(one_process(int(sys.argv[2]), sys.argv[3:]))
    sys.exit(main(sys.argv[1:]))

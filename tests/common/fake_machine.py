# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A machine for tests of the scripts, which run from a copied checkout.

Programs that would change the system are replaced by stubs, which are small shell scripts.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from time import monotonic, sleep

CHECKOUT = Path(__file__).resolve().parents[2]

# Programs that the scripts may use; all others are stubs or do not exist.
REAL_TOOLS = (
    "awk basename bash cat chmod cp cut dirname echo env find flock grep head mkdir mktemp mv "
    "printf realpath rm sed sh sha256sum sleep sync tail tee timeout touch tr true"
).split()

# By default: root on Debian, with space and network, without FEniCSx. $CALLS records all calls.
STUBS = {
    "python3": "echo 'it has no dolfinx' >&2; exit 1",
    "id": "echo 0",
    "df": "echo Avail; echo 99999999",
    "mount": ":",
    "unshare": '[ "$2" != -- ] || shift; shift; exec "$@"',
    "apt-config": ":",
    "apt-get": """
        if [ "$1" = indextargets ]; then
            echo "Packages http://elsewhere.invalid/linux/"
            echo "Packages http://mirror.invalid/debian/"
        fi
        """,
    "apt-helper": """
        for url; do [ "${url#http}" = "$url" ] || break; done
        for file; do :; done
        case $url in
            http://mirror.invalid/debian/dists/trixie/InRelease) echo "Label: Debian" >"$file" ;;
            *) echo "Label: Elsewhere" >"$file" ;;
        esac
        """,
    "debootstrap": """
        for tree; do case $tree in */*.partial) break ;; esac; done
        mkdir -p "$tree/etc/apt/apt.conf.d" "$tree/etc/dpkg/dpkg.cfg.d" "$tree/etc/ssl/certs"
        mkdir -p "$tree/etc/openmpi" "$tree/usr/sbin" "$tree/var/lib/apt/lists"
        examples=$tree/usr/share/doc/gmsh-doc/doc/gmsh/examples/api
        mkdir -p "$examples"
        touch "$examples/aneurysm_data.stl.gz"
        printf 'osc = old\\nbtl = old' >"$tree/etc/openmpi/openmpi-mca-params.conf"
        """,
    # In the tree being made, programs do nothing; in the finished one, they run outside.
    "chroot": """
        case $1 in *.partial) exit 0 ;; esac
        shift
        exec "$@"
        """,
}


class Machine:
    """A checkout, a home and a PATH, all below `folder`."""

    def __init__(self, folder: Path) -> None:
        """Copy the scripts, link the real tools and write the stubs."""
        self.folder = folder
        self.checkout = folder / "check out"  # the blank has to survive all quoting
        self.bin = folder / "bin"
        self.trees = folder / "trees"  # all of PATH, and Debian's trees
        shutil.copytree(CHECKOUT / "scripts", self.checkout / "scripts")
        self.bin.mkdir()
        for tool in REAL_TOOLS:
            found = shutil.which(tool)
            assert found is not None, f"these tests need the program {tool}"
            (self.bin / tool).symlink_to(found)
        for tool, body in STUBS.items():
            self.stub(tool, body)

    def stub(self, tool: str, body: str | None) -> None:
        """Replace a program by the lines of a shell script, or remove it if there are none."""
        path = self.bin / tool
        path.unlink(missing_ok=True)
        if body is not None:
            path.write_text(f'#!/bin/sh\necho "{tool} $*" >>"$CALLS"\n{body}\n')
            path.chmod(0o755)

    def calls(self, tool: str) -> list[str]:
        """Return the command lines with which a stub has been called."""
        log = self.folder / "calls"
        lines = log.read_text().splitlines() if log.exists() else []
        return [line for line in lines if line.split()[0] == tool]

    def start(self, *command: str, **variables: str) -> subprocess.Popen[str]:
        """Start one of the checkout's scripts; without its name, `scripts/with-fenicsx`."""
        if not command[0].startswith("scripts/"):
            command = ("scripts/with-fenicsx", *command)
        # Nothing of the environment of these tests, MPI's above all, may reach it.
        own = {
            "PATH": str(self.bin),
            "CALLS": str(self.folder / "calls"),
            "HOME": str(self.folder),
            "DOLFINX_FETI_ENV": str(self.trees),
        }
        return subprocess.Popen(
            [self.checkout / command[0], *command[1:]],
            cwd=self.folder,
            env=own | variables,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            process_group=0,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # not a shell's
        )

    def run(
        self, *command: str, text: str = "", **variables: str
    ) -> subprocess.CompletedProcess[str]:
        """Run a command to its end; `text` is its standard input."""
        process = self.start(*command, **variables)
        out, err = process.communicate(text, timeout=60)
        return subprocess.CompletedProcess(command, process.returncode, out, err)

    def left(self) -> set[str]:
        """Return the names in the folder of trees, without locks and logs."""
        names = os.listdir(self.trees) if self.trees.is_dir() else []
        return {name for name in names if not name.endswith((".lock", ".log"))}


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait until the condition holds, at most half a minute."""
    end = monotonic() + 30
    while not condition():
        assert monotonic() < end, "the awaited condition does not come true"
        sleep(0.02)

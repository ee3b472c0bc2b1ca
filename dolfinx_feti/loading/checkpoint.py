# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checkpoints: states in a folder, from which a run that was killed goes on.

A state is written cell by cell in the order of the input mesh, by one of several libraries
(``storage``), so that another number of processes reads it with the same mesh. A file names
the mesh, elements and parameters that it belongs to (``identity``); ``states`` replaces the last
one as a whole.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_feti.loading.identity import (
    describe,
    other_parameters,
    other_problem,
    plain,
    plain_record,
)
from dolfinx_feti.loading.states import (
    FORMAT,
    LATEST,
    check_files,
    last_number,
    prepare,
    publish,
    read_latest,
)
from dolfinx_feti.loading.storage import choose_storage
from dolfinx_feti.runtime.collective import on_all, on_first, reason
from dolfinx_feti.runtime.folders import writable_folder

__all__ = ["Checkpoint"]

Array = npt.NDArray[np.float64]


class Checkpoint:
    """The last good state of a run, in a folder.

    Example::

        checkpoint = Checkpoint("run", mesh.comm, parameters={"kappa": 1e3}, restart=True)
        follow_load(problem, set_load, [300.0], steps, state=[u, p], checkpoint=checkpoint)

    Attributes:
        folder: The folder.
        record: The record of the last :meth:`write`; None before the first one.
        restart: Whether the run goes on from what the folder held.
    """

    def __init__(
        self,
        folder: Path | str,
        comm: MPI.Comm,
        *,
        parameters: Mapping[str, object] | None = None,
        restart: bool = False,
    ) -> None:
        """Open the folder, before there is a mesh.

        Args:
            folder: Where the states are kept; it is made, with those above it.
            comm: Communicator of the mesh.
            parameters: What else makes the problem: numbers, strings, and lists of them under
                names. A state of other parameters is refused.
            restart: Go on from the state in the folder, which then has to be there; otherwise there
                must be none.

        Raises:
            ModuleNotFoundError: There is no library to write states with, or not the one that wrote
                the state in the folder.
            OSError: The folder cannot be written, holds a state already, or none to go on from.
            ValueError: What it holds is no checkpoint, damaged, or one of other parameters.

        Note:
            Collective; raises on all processes.
        """
        self._comm = comm
        self.restart = restart
        self._parameters = on_all(lambda: plain(parameters or {}), comm)
        self.folder = Path(folder)
        self._latest: dict[str, Any] | None = on_first(self._open, comm)
        latest = self._latest
        writer = None if latest is None else str(latest.get("storage", "adios4dolfinx"))
        self._storage = choose_storage(comm, writer)
        self._count: int = on_first(lambda: last_number(self.folder), comm)
        self.record: dict[str, Any] | None = self._latest and self._latest["record"]
        writable_folder(self.folder, comm)

    def write(
        self,
        functions: Sequence[dolfinx.fem.Function],
        record: Mapping[str, object],
        past: Sequence[Sequence[Array]] = (),
    ) -> None:
        """Keep the present state in place of the last one.

        Args:
            functions: The state.
            record: What belongs to it, such as the load: what JSON can hold.
            past: Earlier values of the functions, their arrays with ghosts, the oldest first; or
                of the first few of them, if the others have no past.

        Raises:
            OSError: It cannot be written; the last state stays.
            TypeError: The record of the first process has more in it than JSON holds.
            ValueError: A process has no cell, or ``past`` holds other arrays than the functions'.

        Note:
            Collective; raises on all processes.
        """
        on_all(lambda: _check_past(functions, past), self._comm)
        problem = {"parameters": self._parameters, **describe(functions)}
        name = f"step-{self._count + 1:04d}"
        head = {
            "format": FORMAT,
            "state": name,
            "past": [len(values) for values in past],
            **problem,
        }
        head["storage"] = self._storage.name
        latest = on_first(lambda: plain_record(head | {"record": dict(record)}), self._comm)
        self._count += 1
        part = self.folder / f"{name}.part"
        size = sum(sum(map(_size, functions[: len(v)])) for v in [*past, functions])
        try:
            on_first(lambda: prepare(part, size), self._comm)
            self._write_state(part / self._storage.file, functions, past)
            latest = on_first(lambda: publish(part, latest), self._comm)
        except Exception as error:
            on_first(lambda: shutil.rmtree(part, ignore_errors=True), self._comm)
            kept = "there is none yet" if self._latest is None else "the one before it is kept"
            raise OSError(
                f"The checkpoint {part} cannot be written ({reason(error)}): {kept}."
            ) from error
        self._latest, self.record = latest, latest["record"]

    def read(self, functions: Sequence[dolfinx.fem.Function]) -> list[list[Array]]:
        """Set the functions to the state in the folder.

        Args:
            functions: The state, on the same mesh and elements; any number of processes.

        Returns:
            The earlier values.

        Raises:
            ValueError: The state is of another mesh or other elements, damaged, or there is none,
                or a process has no cell. The functions are left as they were.

        Note:
            Collective; raises on all processes.
        """
        if self._latest is None:
            raise ValueError(f"There is no state in {self.folder} yet: write one first.")
        latest, present = self._latest, describe(functions)
        self._refuse(self._comm.bcast(other_problem(latest, present), root=0))
        path = self.folder / latest["state"] / self._storage.file
        try:
            values = self._read_state(path, functions)
        except Exception as error:
            raise ValueError(f"{path} cannot be read ({reason(error)}).") from error
        for f, array in zip(functions, values.pop(), strict=True):
            f.x.array[:] = array
        return values

    def _open(self) -> dict[str, Any] | None:
        """Read what the folder holds; on the first process."""
        path = self.folder / LATEST
        if not path.exists():
            if self.restart:
                raise FileNotFoundError(
                    f"There is no {path} to restart from: name the folder of an earlier run, or "
                    "start again."
                )
            return None
        if not self.restart:
            raise FileExistsError(
                f"{self.folder} holds the checkpoint of an earlier run: restart from it, or name "
                "another folder."
            )
        latest = read_latest(path)
        check_files(self.folder, latest)
        self._refuse(other_parameters(latest["parameters"], self._parameters))
        return latest

    def _refuse(self, differences: list[str]) -> None:
        if differences:
            raise ValueError(
                f"The checkpoint in {self.folder} is one of another problem: "
                f"{'; '.join(differences)}. Restart with that problem, or name another folder."
            )

    def _write_state(
        self,
        path: Path,
        functions: Sequence[dolfinx.fem.Function],
        past: Sequence[Sequence[Array]],
    ) -> None:
        """Write the functions, one instant of time for each equilibrium."""
        write = self._storage.write
        present = [f.x.array for f in functions]
        for t, values in enumerate([*past, present]):
            for i, (f, array) in enumerate(zip(functions, values, strict=False)):
                copy = dolfinx.fem.Function(f.function_space)
                copy.x.array[:] = array
                on_all(partial(write, path, copy, time=float(t), name=f"state{i}"), self._comm)

    def _read_state(
        self, path: Path, functions: Sequence[dolfinx.fem.Function]
    ) -> list[list[Array]]:
        """Read all instants, the present one at the end."""
        read = self._storage.read
        found: list[list[Array]] = []
        assert self._latest is not None
        for t, count in enumerate([*self._latest["past"], len(functions)]):
            found.append([])
            for i, f in enumerate(functions[:count]):
                copy = dolfinx.fem.Function(f.function_space)
                on_all(partial(read, path, copy, time=float(t), name=f"state{i}"), self._comm)
                found[-1].append(copy.x.array)
        return found


def _check_past(functions: Sequence[dolfinx.fem.Function], past: Sequence[Sequence[Array]]) -> None:
    """Require arrays of the sizes of the first functions in each state of the past.

    Raises:
        ValueError: One is missing or has another size.
    """
    sizes = [len(f.x.array) for f in functions]
    for i, values in enumerate(past):
        if not values or [len(array) for array in values] != sizes[: len(values)]:
            raise ValueError(
                f"past[{i}] holds arrays of {[len(a) for a in values]} values, but the functions "
                f"have {sizes}: give the x.array of each or of the first, ghosts included."
            )


def _size(f: dolfinx.fem.Function) -> int:
    """Return the bytes of a function: values, and each cell's dofs, offset and permutation."""
    V = f.function_space
    cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_global
    values = V.dofmap.index_map.size_global * V.dofmap.index_map_bs
    return 8 * values + cells * (8 * V.dofmap.list.shape[1] * V.dofmap.bs + 12)

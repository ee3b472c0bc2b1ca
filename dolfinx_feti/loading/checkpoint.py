# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checkpoints: the last state of a run in one file, from which a run that was killed goes on.

The file is a NumPy archive, replaced as a whole. For each process p that wrote, it holds
``p/cells``, the places of its cells in the input mesh, ``p/dofs i``, their dofs in the function i,
and ``p/values i t``, that function at the instant t. A process finds its own cells in it, so any
number of them restart. ``head.json`` names mesh, elements, forms, constants, parameters, version.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_feti.fem.content import Content
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all, on_first, reason, warn
from dolfinx_feti.runtime.compat import geometry_dofmap, package_version
from dolfinx_feti.runtime.folders import writable_folder

__all__ = ["Checkpoint"]


FILE, FORMAT = "state.npz", 3

Stored = npt.NDArray[Any]

#: How closely the mesh has to agree, relative to its extent: digits that a file of text may lose.
CLOSE = 1e-10


class Checkpoint:
    """The last good state of a run, in a folder.

    Example::

        checkpoint = Checkpoint("run", mesh.comm, parameters={"kappa": 1e3}, restart=True)
        follow_load(problem, set_load, [300.0], steps, state=[u, p], checkpoint=checkpoint)

    Attributes:
        folder: The folder; its file is ``state.npz``.
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
        allow_changes: bool = False,
    ) -> None:
        """Open the folder, before there is a mesh. Collective.

        Args:
            folder: Where the state is kept; it is made, with those above it.
            comm: Communicator of the mesh.
            parameters: What else makes the problem: numbers, strings, and lists of them under
                names. A state of other parameters is refused.
            restart: Go on from the state in the folder, which then has to be there; otherwise there
                must be none.
            allow_changes: Go on although parameters, forms, or constants in them have changed.

        Raises:
            OSError: The folder cannot be written, holds a state already, or none to go on from.
            ValueError: What it holds is no checkpoint, damaged, or one of other parameters; or JSON
                cannot hold a parameter.
        """
        self._comm, self.restart, self._allow_changes = comm, restart, allow_changes
        given = (parameters or {}).items()
        self._parameters = on_all(lambda: {str(n): _plain_parameter(n, v) for n, v in given}, comm)
        self.folder = Path(folder)
        self._path = self.folder / FILE
        self._head: dict[str, Any] | None = on_first(self._open, comm)
        self.record: dict[str, Any] | None = None if self._head is None else self._head["record"]
        writable_folder(self.folder, comm)
        if self._head is not None and self._head["version"] != (here := package_version()):
            warn(f"{self._path} is of dolfinx_feti {self._head['version']}, this is {here}.", comm)

    def write(
        self,
        functions: Sequence[dolfinx.fem.Function],
        record: Mapping[str, object],
        past: Sequence[Sequence[Array]] = (),
        *,
        content: Content | None = None,
        moving: Sequence[int] = (),
    ) -> None:
        """Keep the present state in place of the last one. Collective.

        Args:
            functions: The state.
            record: What belongs to it, such as the load: what JSON can hold.
            past: Earlier arrays, with ghosts, of the first of the functions; the oldest first.
            content: What the forms of the problem hold, by which a restart knows it.
            moving: Places of the constants in them whose values a restart need not share.

        Raises:
            OSError: It cannot be written; the last state stays.
            TypeError: The record of the first process has more in it than JSON holds.
        """
        head = {
            "format": FORMAT,
            "version": package_version(),
            "processes": self._comm.size,
            "past": [len(values) for values in past],
            "parameters": self._parameters,
            **_describe(functions, content, moving),
        }
        head["record"] = on_first(lambda: _plain("record", dict(record)), self._comm)
        parts, first = _gathered(_arrays(functions, past), self._comm), self._comm.rank == 0
        try:
            on_all(
                lambda: self._write(head, parts) if first else deque(parts, maxlen=0), self._comm
            )
        except Exception as error:
            kept = "there is none yet" if self._head is None else "the one before it is kept"
            raise OSError(
                f"The checkpoint {self._path} cannot be written ({reason(error)}): {kept}."
            ) from error
        self._head, self.record = head, head["record"]

    def read(
        self, functions: Sequence[dolfinx.fem.Function], *, content: Content | None = None
    ) -> list[list[Array]]:
        """Set the functions to the state in the folder; return the earlier values. Collective.

        Args:
            functions: The state, on the same mesh and elements; any number of processes.
            content: What the forms of the problem hold.

        Raises:
            ValueError: The state is of another mesh, of other elements, forms or constants,
                damaged, or there is none. The functions are left as they were.
        """
        if self._head is None:
            raise ValueError(f"There is no state in {self.folder} yet: write one first.")
        head = self._head
        here = _describe(functions, content, head["moving"])
        known = content is not None and head["forms"] is not None and not self._allow_changes
        self._refuse(on_first(lambda: _differences(head, here, forms=known), self._comm))
        try:
            values = on_all(lambda: self._read(functions), self._comm)
        except Exception as error:
            raise ValueError(f"{self._path} cannot be read ({reason(error)}).") from error
        for f, array in zip(functions, values.pop(), strict=True):
            f.x.array[:] = array
        return values

    def _open(self) -> dict[str, Any] | None:
        """Read what the folder holds; on the first process."""
        if not self._path.exists():
            if self.restart:
                raise FileNotFoundError(
                    f"There is no {self._path} to restart from: name the folder of an earlier run, "
                    "or start again."
                )
            return None
        if not self.restart:
            raise FileExistsError(
                f"{self.folder} holds the checkpoint of an earlier run: restart from it, or name "
                "another folder."
            )
        try:
            with zipfile.ZipFile(self._path) as file:
                damaged, head = file.testzip(), json.loads(file.read("head.json"))
        except (KeyError, ValueError, zipfile.BadZipFile):
            damaged, head = None, {}
        if damaged is not None or not isinstance(head, dict) or head.get("format") != FORMAT:
            raise ValueError(
                f"{self._path} is damaged, or no checkpoint of this version: name another folder, "
                "or start again."
            )
        if not self._allow_changes:
            there, here = head["parameters"], self._parameters
            both = {n: [p.get(n, "not given") for p in (there, here)] for n in sorted(there | here)}
            self._refuse([f"{n} is {a} there and {b} here" for n, (a, b) in both.items() if a != b])
        return head

    def _refuse(self, differences: list[str]) -> None:
        if differences:
            raise ValueError(
                f"The checkpoint in {self.folder} is one of another problem: "
                f"{'; '.join(differences)}. Restart with that problem, or name another folder; "
                "allow_changes=True accepts other parameters, forms and constants."
            )

    def _write(self, head: Mapping[str, Any], parts: Iterator[tuple[str, Stored]]) -> None:
        """Write the state beside the last one, bring it to the disk, and let it take its place."""
        aside = self._path.with_suffix(".part")
        try:
            with zipfile.ZipFile(aside, "w") as file:
                for name, array in parts:
                    with file.open(f"{name}.npy", "w", force_zip64=True) as entry:
                        np.lib.format.write_array(entry, array, allow_pickle=False)
                file.writestr("head.json", json.dumps(head))
            _sync(aside)
            os.replace(aside, self._path)
            _sync(self.folder)
        finally:
            deque(parts, maxlen=0)  # others wait until it is received
            aside.unlink(missing_ok=True)

    def _read(self, functions: Sequence[dolfinx.fem.Function]) -> list[list[Array]]:
        """Read all instants, the present one at the end; each process for its cells and ghosts."""
        head = self._head or {}
        counts = [*head["past"], len(functions)]
        found = [[np.zeros_like(f.x.array) for f in functions[:count]] for count in counts]
        mine = np.asarray(functions[0].function_space.mesh.topology.original_cell_index)
        with np.load(self._path, allow_pickle=False) as file:
            for p in range(head["processes"]):
                _, here, there = np.intersect1d(mine, file[f"{p}/cells"], return_indices=True)
                if len(here) == 0:
                    continue
                turned = file[f"{p}/turned"][there]
                for i, f in enumerate(functions):
                    dofs = file[f"{p}/dofs {i}"][there]
                    for t, count in enumerate(counts):
                        if i < count:
                            bs, new = f.function_space.dofmap.bs, f.function_space.dofmap.list[here]
                            values = file[f"{p}/values {i} {t}"].reshape(-1, bs)[dofs]
                            _turn(values, f, turned, here)
                            found[t][i].reshape(-1, bs)[new] = values
        return found


def _arrays(
    functions: Sequence[dolfinx.fem.Function], past: Sequence[Sequence[Array]]
) -> Iterator[tuple[str, Stored]]:
    """Yield what this process writes, and its names."""
    mesh = functions[0].function_space.mesh
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    yield "cells", np.asarray(mesh.topology.original_cell_index)[:owned]
    yield "turned", _turned(mesh)[:owned]
    for i, f in enumerate(functions):
        yield f"dofs {i}", np.asarray(f.function_space.dofmap.list)[:owned]
        for t, values in enumerate([*past, [g.x.array for g in functions]]):
            if i < len(values):
                yield f"values {i} {t}", values[i]


def _turned(mesh: dolfinx.mesh.Mesh) -> Stored:
    """Return how the edges and faces of each cell are turned, which numbers of vertices decide."""
    mesh.topology.create_entity_permutations()
    return np.asarray(mesh.topology.get_cell_permutation_info(), dtype=np.uint32)


def _turn(values: Array, f: dolfinx.fem.Function, turned: Stored, cells: Stored) -> None:
    """Turn the values of cells, (cells, dofs, bs), by way of those of the reference cell."""
    element, bs, flat = f.function_space.element, values.shape[2], values.reshape(-1)
    if element.needs_dof_transformations:
        element.Tt_apply(flat, turned, bs)
        element.Tt_inv_apply(flat, _turned(f.function_space.mesh)[cells], bs)


def _gathered(mine: Iterator[tuple[str, Stored]], comm: MPI.Comm) -> Iterator[tuple[str, Stored]]:
    """Yield what all processes have on the first one, array by array; send it on the others."""
    for name, array in mine:
        if comm.rank > 0:
            comm.send(array, 0)
            continue
        yield f"0/{name}", array
        yield from ((f"{p}/{name}", comm.recv(source=p)) for p in range(1, comm.size))


def _describe(
    functions: Sequence[dolfinx.fem.Function], content: Content | None, moving: Sequence[int]
) -> dict[str, Any]:
    """Describe mesh, elements, forms, and Constants that no step moves. Collective.

    Of the coordinates it is a mean of the vertices of cells with weights by places in the input.
    """
    mesh = functions[0].function_space.mesh
    cells = mesh.topology.index_map(mesh.topology.dim)
    nodes = geometry_dofmap(mesh)[: cells.size_local]
    place = np.asarray(mesh.topology.original_cell_index)[: cells.size_local, None]
    place = place * nodes.shape[1] + np.arange(nodes.shape[1])
    weights = 2.0 * np.modf(place * ((np.sqrt(5.0) - 1.0) / 2.0))[0] - 1.0  # equidistributed
    x = mesh.geometry.x
    sums = mesh.comm.allreduce(np.einsum("ck,ckd->d", weights, x[nodes]), op=MPI.SUM)
    constants = () if content is None else enumerate(content.constants)
    return {
        "cells": cells.size_global,
        "vertices": mesh.geometry.index_map().size_global,
        "elements": [str(f.function_space.ufl_element()) for f in functions],
        "extent": mesh.comm.allreduce(float(np.abs(x).max(initial=0.0)), op=MPI.MAX),
        "coordinates": (sums / cells.size_global).tolist(),
        "forms": None if content is None else content.signature,
        "constants": {
            str(i): np.asarray(c.value).tolist() for i, c in constants if i not in moving
        },
        "moving": list(moving),
    }


def _differences(there: Mapping[str, Any], here: Mapping[str, Any], *, forms: bool) -> list[str]:
    """Say in what two problems differ."""
    found = [
        f"{name} are {there[name]} there and {here[name]} here"
        for name in ("cells", "vertices", "elements")
        if there[name] != here[name]
    ]
    x, y = ([head["extent"], *head["coordinates"]] for head in (there, here))
    if not np.allclose(x, y, rtol=0.0, atol=CLOSE * x[0]):
        found.append("the extent of the mesh or the order of its cells are others")
    if forms and there["forms"] != here["forms"]:
        found.append("its forms, such as the energy of a material, or numbers in them, are others")
    elif forms:
        values = [(value, here["constants"][i]) for i, value in there["constants"].items()]
        found += [f"a Constant of the forms is {a} there and {b} here" for a, b in values if a != b]
    return found


def _plain_parameter(name: str, value: object) -> Any:
    """Return a parameter as it comes back from a file."""
    try:
        return _plain(name, value)
    except TypeError as error:
        raise ValueError(
            f"parameters[{name!r}] is {value!r}: give numbers, strings, or lists of them."
        ) from error


def _plain(name: str, value: object) -> Any:
    """Return what JSON makes of a value, and of NumPy's numbers and arrays in it."""

    def of_numpy(part: object) -> object:
        if isinstance(part, np.generic | np.ndarray):
            return part.tolist()
        raise TypeError(f"{name} holds {part!r}: give numbers, strings, or lists of them.")

    return json.loads(json.dumps(value, default=of_numpy))


def _sync(path: Path) -> None:
    """Bring a file or a folder to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

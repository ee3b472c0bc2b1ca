# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checkpoints: states in a folder, from which a run that was killed goes on.

The folder holds `step-N`, written by adios4dolfinx cell by cell in the order of the input mesh, so
that another number of processes reads it with the same mesh; and `latest.json`, which names it and
says to which mesh, elements and parameters it belongs. A new state is written into `step-N.part`,
brought to the disk and renamed; then `latest.json` is replaced, and only then goes the older state.
Each of these is one act of the file system: a run may be killed at any moment.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import zlib
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_feti._compat import geometry_dofmap
from dolfinx_feti.collective import on_all, on_first, reason
from dolfinx_feti.folders import writable_folder

__all__ = ["Checkpoint"]

Array = npt.NDArray[np.float64]
T = TypeVar("T")

LATEST, STATE = "latest.json", "state.bp"
FORMAT = 1

#: How closely the mesh has to agree, relative to its extent: digits that a file of text may lose.
CLOSE = 1e-10

#: Room for what ADIOS2 writes beside the numbers, in bytes.
OVERHEAD = 1 << 20


class Checkpoint:
    """The last good state of a run, in a folder.

    Example::

        checkpoint = Checkpoint("run", mesh.comm, parameters={"kappa": 1e3}, restart=True)
        follow_load(problem, set_load, [300.0], steps, state=[u, p], checkpoint=checkpoint)

    Attributes:
        folder: The folder.
        record: What was said at the last :meth:`write`; None before the first one.
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
            ModuleNotFoundError: adios4dolfinx is missing.
            OSError: The folder cannot be written, holds a state already, or none to go on from.
            ValueError: What it holds is no checkpoint, damaged, or one of other parameters.

        Note:
            Collective; raises on all processes.
        """
        self._adios4dolfinx = _import_adios4dolfinx(comm)
        self._comm = comm
        self.restart = restart
        self._parameters = _plain(parameters or {})
        self.folder = Path(folder)
        self._latest: dict[str, Any] | None = on_first(self._open, comm)
        self._count: int = on_first(lambda: _last_number(self.folder), comm)
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
            past: Earlier values of the functions, their arrays with ghosts, the oldest first.

        Raises:
            OSError: It cannot be written; the last state stays.
            ValueError: A process has no cell.

        Note:
            Collective; raises on all processes.
        """
        self._count += 1
        name = f"step-{self._count:04d}"
        part = self.folder / f"{name}.part"
        problem = {"parameters": self._parameters, **describe(functions)}
        text = json.dumps(
            {"format": FORMAT, "state": name, "past": len(past), **problem, "record": dict(record)},
            default=_plain_number,
        )
        size = (1 + len(past)) * sum(map(_size, functions))
        try:
            on_first(lambda: _prepare(part, size), self._comm)
            self._write_state(part / STATE, functions, past)
            latest = on_first(lambda: _publish(part, json.loads(text)), self._comm)
        except Exception as error:
            on_first(lambda: shutil.rmtree(part, ignore_errors=True), self._comm)
            said = f"The checkpoint {part} cannot be written ({reason(error)}): "
            kept = "there is none yet." if self._latest is None else "the one before it is kept."
            raise OSError(said + kept) from error
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
        self._refuse(self._comm.bcast(_other_problem(latest, present), root=0))
        path = self.folder / latest["state"] / STATE
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
                    "begin anew."
                )
            return None
        if not self.restart:
            raise FileExistsError(
                f"{self.folder} holds the checkpoint of an earlier run: restart from it, or name "
                "another folder."
            )
        latest = _read_latest(path)
        _check_files(self.folder, latest)
        self._refuse(_other_parameters(latest["parameters"], self._parameters))
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
        write = self._adios4dolfinx.write_function_on_input_mesh
        present = [f.x.array for f in functions]
        for t, values in enumerate([*past, present]):
            for i, (f, array) in enumerate(zip(functions, values, strict=True)):
                copy = dolfinx.fem.Function(f.function_space)
                copy.x.array[:] = array
                on_all(partial(write, path, copy, time=float(t), name=f"state{i}"), self._comm)

    def _read_state(
        self, path: Path, functions: Sequence[dolfinx.fem.Function]
    ) -> list[list[Array]]:
        """Read all instants, the present one at the end."""
        read = self._adios4dolfinx.read_function
        found: list[list[Array]] = []
        assert self._latest is not None
        for t in range(self._latest["past"] + 1):
            found.append([])
            for i, f in enumerate(functions):
                copy = dolfinx.fem.Function(f.function_space)
                on_all(partial(read, path, copy, time=float(t), name=f"state{i}"), self._comm)
                found[-1].append(copy.x.array)
        return found


def describe(functions: Sequence[dolfinx.fem.Function]) -> dict[str, Any]:
    """Describe mesh and elements, equally for any number of processes.

    Args:
        functions: Functions on one mesh.

    Returns:
        Numbers of cells and vertices; the mean over the cells of their vertices, each weighted by a
        number that follows from its place in the input, so that it depends on their order;
        the extent of the mesh, and the elements.

    Raises:
        ValueError: A process has no cell, which adios4dolfinx does not know how to handle.

    Note:
        Collective.
    """
    mesh = functions[0].function_space.mesh
    cells = mesh.topology.index_map(mesh.topology.dim)
    if mesh.comm.allreduce(cells.size_local, op=MPI.MIN) == 0:
        raise ValueError(
            f"{cells.size_global} cells on {mesh.comm.size} processes leave one without a cell: "
            "checkpoints need fewer processes or a finer mesh."
        )
    nodes = geometry_dofmap(mesh)[: cells.size_local]
    place = np.asarray(mesh.topology.original_cell_index)[: cells.size_local, None]
    place = place * nodes.shape[1] + np.arange(nodes.shape[1])
    weights = 2.0 * np.modf(place * ((np.sqrt(5.0) - 1.0) / 2.0))[0] - 1.0  # equidistributed
    x = mesh.geometry.x
    sums = mesh.comm.allreduce(np.einsum("ck,ckd->d", weights, x[nodes]), op=MPI.SUM)
    extent = mesh.comm.allreduce(float(np.abs(x).max(initial=0.0)), op=MPI.MAX)
    return {
        "cells": cells.size_global,
        "vertices": mesh.geometry.index_map().size_global,
        "extent": extent,
        "coordinates": (sums / cells.size_global).tolist(),
        "elements": [str(f.function_space.ufl_element()) for f in functions],
    }


def _other_problem(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """Say in what mesh and elements differ."""
    found = [
        f"{name} are {there[name]} there and {here[name]} here"
        for name in ("cells", "vertices", "elements")
        if there[name] != here[name]
    ]
    for name in ("extent", "coordinates"):
        if not np.allclose(there[name], here[name], rtol=0.0, atol=CLOSE * there["extent"]):
            found.append(f"the {name} of the mesh or the order of its cells are others")
            break
    return found


def _other_parameters(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """Say which parameters differ."""
    names = sorted(there.keys() | here.keys())
    values = [(name, there.get(name, "not given"), here.get(name, "not given")) for name in names]
    return [f"{name} is {a} there and {b} here" for name, a, b in values if a != b]


# -- files, on the first process


def _prepare(part: Path, size: int) -> None:
    """Make the folder of a new state, where its bytes have room; clear away half ones."""
    for path in _states(part.parent, suffix=".part"):
        shutil.rmtree(path)
    part.mkdir()
    room = part / "room"
    with room.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, size + OVERHEAD)
    room.unlink()


def _publish(part: Path, latest: dict[str, Any]) -> dict[str, Any]:
    """Give a state that is on the disk its name, let `latest.json` name it, remove older ones."""
    files = sorted(path for path in part.rglob("*") if path.is_file())
    for path in [*files, *sorted({path.parent for path in files} | {part})]:
        _sync(path)
    latest["files"] = {str(path.relative_to(part)): _checksum(path) for path in files}
    folder = part.parent
    os.rename(part, part.with_suffix(""))
    _sync(folder)
    whole = folder / f"{LATEST}.part"
    with whole.open("w") as file:
        json.dump(latest, file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(whole, folder / LATEST)
    _sync(folder)
    for path in _states(folder):
        if path.name != latest["state"]:
            shutil.rmtree(path, ignore_errors=True)  # next time, if not now
    return latest


def _read_latest(path: Path) -> dict[str, Any]:
    """Read `latest.json`.

    Raises:
        ValueError: It is none.
    """
    keys = {"state", "past", "parameters", "record", "files", "cells", "vertices", "extent"}
    keys |= {"coordinates", "elements"}
    try:
        latest = json.loads(path.read_text())
    except ValueError:
        latest = None
    if not isinstance(latest, dict) or latest.get("format") != FORMAT or not keys <= latest.keys():
        raise ValueError(
            f"{path} is no checkpoint of this version: name another folder, or begin anew."
        )
    return latest


def _check_files(folder: Path, latest: Mapping[str, Any]) -> None:
    """Compare the files with what was written.

    Raises:
        ValueError: One is missing or another.
    """
    for name, expected in latest["files"].items():
        path = folder / latest["state"] / name
        if not path.is_file() or _checksum(path) != expected:
            raise ValueError(f"{path} is missing or damaged: begin anew in another folder.")


def _states(folder: Path, suffix: str = "") -> list[Path]:
    """List the folders of states."""
    pattern = re.compile(r"step-\d{4,}" + re.escape(suffix))
    return [path for path in folder.iterdir() if pattern.fullmatch(path.name)]


def _last_number(folder: Path) -> int:
    """Return the highest number of a state, of one that was never named by `latest.json` too."""
    states = _states(folder) if folder.is_dir() else []
    return max((int(path.name.removeprefix("step-")) for path in states), default=0)


def _checksum(path: Path) -> list[int]:
    """Return size and CRC-32 of a file."""
    size = crc = 0
    with path.open("rb") as file:
        while block := file.read(1 << 22):
            size, crc = size + len(block), zlib.crc32(block, crc)
    return [size, crc]


def _sync(path: Path) -> None:
    """Bring a file or a folder to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _size(f: dolfinx.fem.Function) -> int:
    """Return the bytes of a function: values, and each cell's dofs, offset and permutation."""
    V = f.function_space
    cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_global
    values = V.dofmap.index_map.size_global * V.dofmap.index_map_bs
    return 8 * values + cells * (8 * V.dofmap.list.shape[1] * V.dofmap.bs + 12)


def _import_adios4dolfinx(comm: MPI.Comm) -> ModuleType:
    """Import adios4dolfinx.

    Raises:
        ModuleNotFoundError: It is not there for one of the processes.
    """
    try:
        return on_all(lambda: importlib.import_module("adios4dolfinx"), comm)
    except RuntimeError as error:
        raise ModuleNotFoundError(
            f"Checkpoints need adios4dolfinx, which cannot be imported ({error}): install Debian's "
            "python3-adios4dolfinx or PyPI's adios4dolfinx, with a dolfinx that has ADIOS2.",
            name="adios4dolfinx",
        ) from error


def _plain(parameters: Mapping[str, object]) -> dict[str, Any]:
    """Return parameters as they come back from a file.

    Raises:
        ValueError: A value is something else than what JSON holds.
    """
    for name, value in parameters.items():
        try:
            json.dumps(value, default=_plain_number)
        except TypeError as error:
            raise ValueError(
                f"parameters[{name!r}] is {value!r}: give numbers, strings, or lists of them."
            ) from error
    return json.loads(json.dumps(dict(parameters), default=_plain_number))


def _plain_number(value: object) -> object:
    """Return NumPy's numbers and arrays as Python's."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{value!r} is no number, string, or list")

# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Storage: the library that writes the functions of a state, and reads them.

All of them write cell by cell in the order of the input mesh, so that another number of processes
reads the state with the same mesh. The first that is there is taken:

============================ ============== ====================================================
name                         file           needs
============================ ============== ====================================================
``adios4dolfinx``            ``state.bp``   ADIOS2 in dolfinx
``io4dolfinx with adios2``   ``state.bp``   ADIOS2 for Python
``io4dolfinx with h5py``     ``state.h5``   h5py; on several processes one that was built with MPI
============================ ============== ====================================================
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from mpi4py import MPI

from dolfinx_feti.runtime.collective import on_all, reason

__all__ = ["LIBRARIES", "Storage", "choose_storage"]

LIBRARIES = ("adios4dolfinx", "io4dolfinx with adios2", "io4dolfinx with h5py")


@dataclass(frozen=True, slots=True)
class Storage:
    """A library that keeps functions.

    Attributes:
        name: One of :data:`LIBRARIES`.
        file: Name of the file or folder that it writes.
        write: ``write(path, f, time=…, name=…)`` adds a function to a file; collective.
        read: ``read(path, f, time=…, name=…)`` sets a function; collective.
    """

    name: str
    file: str
    write: Callable[..., object]
    read: Callable[..., object]


def choose_storage(comm: MPI.Comm, name: str | None = None) -> Storage:
    """Return the first library that is there, or the one of a name.

    Args:
        comm: Communicator of the mesh.
        name: The library that a state was written by; any if None.

    Raises:
        ModuleNotFoundError: There is none for one of the processes.

    Note:
        Collective; raises on all processes.
    """
    causes = []
    for library in LIBRARIES if name is None else (name,):
        try:
            return on_all(partial(_load, library, comm), comm)
        except Exception as error:
            causes.append(reason(error))
    raise ModuleNotFoundError(
        f"Checkpoints need {name or 'adios4dolfinx or io4dolfinx'}, which cannot be imported "
        f"({'; '.join(causes)}): install Debian's python3-adios4dolfinx or python3-io4dolfinx, or "
        "PyPI's, with ADIOS2 or, for io4dolfinx, h5py.",
        name="adios4dolfinx",
    )


def _load(name: str, comm: MPI.Comm) -> Storage:
    """Import a library and what it writes with.

    Raises:
        ImportError: It is not there, or does not serve this number of processes.
    """
    library, _, backend = name.partition(" with ")
    module = importlib.import_module(library)
    chosen = {}
    if backend:
        chosen["backend"] = backend
        writer = importlib.import_module(backend)
        if backend == "h5py" and comm.size > 1 and not writer.get_config().mpi:
            raise ImportError("h5py was built without MPI and serves one process only")
    return Storage(
        name,
        "state.h5" if backend == "h5py" else "state.bp",
        partial(module.write_function_on_input_mesh, **chosen),
        partial(module.read_function, **chosen),
    )

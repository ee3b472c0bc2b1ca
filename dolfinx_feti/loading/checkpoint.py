# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checkpoints: the last state of a run in one file, from which a killed run can continue.

The file holds the values of functions, at the present and at earlier instants, and a record
(``archive``): numbers such as the load, in the user's units. It is replaced as a whole, so that
there always is one complete state. Any number of processes can read it.

The file also names mesh, elements, forms, Constants (``identity``) and the user's parameters: the
state of another problem is refused.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_feti.fem.user_forms.form_content import FormContent
from dolfinx_feti.loading.archive import (
    exhaust,
    gathered_arrays,
    read_head,
    read_values,
    write_archive,
)
from dolfinx_feti.loading.identity import describe_problem, differences
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import error_message, on_all, on_root, warn
from dolfinx_feti.runtime.compat import package_version
from dolfinx_feti.runtime.folders import writable_folder

__all__ = ["Checkpoint"]

#: Name of the file in the folder of a checkpoint.
FILE = "state.npz"

#: Version of the file's format. A file of another version is refused.
FORMAT = 4


class Checkpoint:
    """The last good state of a run, in a folder.

    Example::

        problem = NonlinearProblem(energy, u, bcs=bcs)
        steps = Steps(first=0.2, least=0.01)
        checkpoint = Checkpoint("run", mesh.comm, parameters={"kappa": 100.0})
        follow_load(problem, set_load, [0.4], steps, checkpoint=checkpoint)

        # in another run of the program
        checkpoint = Checkpoint("run", mesh.comm, parameters={"kappa": 100.0}, restart=True)
        follow_load(problem, set_load, [0.4, 0.5], steps, checkpoint=checkpoint)

    Attributes:
        folder: The folder; its file is ``state.npz``.
        record: The record of the last :meth:`write`, of this run or of the one that it continues;
            None before the first one.
        restart: Whether the run continues from the state in the folder.
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
        """Open the folder; the mesh need not exist yet. Collective.

        Args:
            folder: The folder; it is created, with its parents.
            comm: Communicator of the mesh.
            parameters: Further parameters of the problem by name: numbers, strings, and lists of
                them. A state of other parameters is refused.
            restart: Whether to continue from the state in the folder. If False, the folder must not
                hold a state.
            allow_changes: Whether to accept a state of other parameters, forms, or Constants.

        Raises:
            OSError: The folder cannot be written, holds a state already, or none to continue from.
            ValueError: The file is no checkpoint, damaged, or one of other parameters; or JSON
                cannot hold a parameter.
        """
        self._comm = comm
        self.restart = restart
        self._allow_changes = allow_changes
        self._parameters = on_all(partial(_json_parameters, parameters or {}), comm)
        self.folder = Path(folder)
        self._path = self.folder / FILE
        self._head: dict[str, Any] | None = on_root(self._open, comm)
        self.record: dict[str, Any] | None = None
        writable_folder(self.folder, comm)
        if self._head is None:
            return
        self.record = self._head["record"]
        version = package_version()
        if self._head["version"] != version:
            warn(
                f"{self._path} is of dolfinx_feti {self._head['version']}, this is {version}.", comm
            )

    def write(
        self,
        functions: Sequence[dolfinx.fem.Function],
        record: Mapping[str, object],
        past: Sequence[Sequence[Array]] = (),
        *,
        content: FormContent | None = None,
        changing: Sequence[int] = (),
    ) -> None:
        """Write the present state in place of the last one. Collective.

        Args:
            functions: The state, on one mesh.
            record: Further data of the state, such as the load: what JSON can hold. That of the
                first process is written.
            past: Values at earlier instants, the oldest first: those of the first of the functions,
                with ghosts, as in ``x.array``.
            content: Forms and Constants of the problem, which a restart compares.
            changing: Indices, among these Constants, of those that steps change: a restart does not
                compare their values.

        Raises:
            OSError: It cannot be written; the last state stays.
            TypeError: JSON cannot hold the record of the first process.
        """
        head = {
            "format": FORMAT,
            "version": package_version(),
            "processes": self._comm.size,
            "past": [len(values) for values in past],
            "parameters": self._parameters,
            **describe_problem(functions, content, changing),
        }
        # the first process alone writes; all keep the record as it will be read
        head["record"] = on_root(partial(_json_value, "record", dict(record)), self._comm)
        arrays = gathered_arrays(functions, past, self._comm)

        def write() -> None:
            if self._comm.rank == 0:
                write_archive(self._path, head, arrays)
            else:
                exhaust(arrays)  # sends them to the first process

        try:
            on_all(write, self._comm)
        except Exception as error:
            last = "there is none yet" if self._head is None else "the one before it is kept"
            raise OSError(
                f"The checkpoint {self._path} cannot be written ({error_message(error)}): {last}."
            ) from error
        self._head = head
        self.record = head["record"]

    def read(
        self, functions: Sequence[dolfinx.fem.Function], *, content: FormContent | None = None
    ) -> list[list[Array]]:
        """Set the functions to the state in the folder. Collective.

        Args:
            functions: The functions of the state, on the same input mesh and with the same
                elements; the number of processes may differ.
            content: Forms and Constants of the problem.

        Returns:
            The values at earlier instants, the oldest first: those of the first of the functions,
            with ghosts, as in ``x.array``.

        Raises:
            ValueError: The state is of another mesh, of other elements, forms or Constants,
                damaged, or there is none. The functions are left as they were.
        """
        if self._head is None:
            raise ValueError(f"There is no state in {self.folder} yet: write one first.")
        head = self._head
        # Indices of Constants are valid only if the forms agree. If forms are allowed to differ,
        # Constants are not compared.
        here = describe_problem(functions, content, head["changing"])
        has_forms = content is not None and head["forms"] is not None
        compare_forms = has_forms and not self._allow_changes
        compare = partial(differences, head, here, compare_forms=compare_forms)
        self._require_no_differences(on_root(compare, self._comm))
        counts = [*head["past"], len(functions)]
        try:
            instants = on_all(
                partial(
                    read_values, self._path, functions, processes=head["processes"], counts=counts
                ),
                self._comm,
            )
        except Exception as error:
            raise ValueError(f"{self._path} cannot be read ({error_message(error)}).") from error
        *past, present = instants
        for f, values in zip(functions, present, strict=True):
            f.x.array[:] = values
        return past

    def _open(self) -> dict[str, Any] | None:
        """Return the head of the file in the folder, None if there is no file; on one process.

        Raises:
            OSError: There is a file although the run does not restart, or none although it does.
            ValueError: The file is no checkpoint, damaged, or one of other parameters.
        """
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
        head = read_head(self._path)
        if not isinstance(head, dict) or head.get("format") != FORMAT:
            raise ValueError(
                f"{self._path} is damaged, or no checkpoint of this version: name another folder, "
                "or start again."
            )
        if not self._allow_changes:
            self._require_no_differences(
                _parameter_differences(head["parameters"], self._parameters)
            )
        return head

    def _require_no_differences(self, messages: list[str]) -> None:
        """Raise an error if the state in the folder is one of another problem.

        Args:
            messages: The differences, in words.

        Raises:
            ValueError: There is one.
        """
        if messages:
            raise ValueError(
                f"The checkpoint in {self.folder} is one of another problem: "
                f"{'; '.join(messages)}. Restart with that problem, or name another folder; "
                "allow_changes=True accepts other parameters, forms and constants."
            )


def _parameter_differences(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """Return the differences of parameters, there in the file and here in the run, in words."""
    messages = []
    for name in sorted({*there, *here}):
        value_there = there.get(name, "not given")
        value_here = here.get(name, "not given")
        if value_there != value_here:
            messages.append(f"{name} is {value_there} there and {value_here} here")
    return messages


def _json_parameters(parameters: Mapping[str, object]) -> dict[str, Any]:
    """Return parameters as they are read from a file.

    Raises:
        ValueError: JSON cannot hold a parameter.
    """
    read = {}
    for name, value in parameters.items():
        try:
            read[str(name)] = _json_value(name, value)
        except TypeError as error:
            raise ValueError(
                f"parameters[{name!r}] is {value!r}: give numbers, strings, or lists of them."
            ) from error
    return read


def _json_value(name: str, value: object) -> Any:
    """Return a value as it is read from a JSON file; NumPy's numbers and arrays become Python's.

    Raises:
        TypeError: JSON cannot hold it.
    """

    def of_numpy(part: object) -> object:
        if isinstance(part, np.generic | np.ndarray):
            return part.tolist()
        raise TypeError(f"{name} holds {part!r}: give numbers, strings, or lists of them.")

    return json.loads(json.dumps(value, default=of_numpy))

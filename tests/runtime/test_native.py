# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""C code is compiled at first use and cached; functions of PETSc are called that petsc4py lacks."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, equal, raises

from dolfinx_feti.fem.condensation import condensation
from dolfinx_feti.runtime import native, petsc_library
from dolfinx_feti.runtime.petsc_library import c_function, csr_of


@pytest.fixture
def write_source(tmp_path, monkeypatch) -> Callable[[str, str], Path]:
    """Write a source on the first process, into a folder that holds the cache, too."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def once(name: str, text: str) -> Path:
        if COMM.rank == 0:
            (tmp_path / name).write_text(text, encoding="utf-8")
        COMM.barrier()
        return tmp_path / name

    return once


def test_code_is_compiled_once_and_cached(write_source, monkeypatch):
    """A second call returns the loaded module, and another run loads the file."""
    source = write_source("twice.c", "void twice(int n, double *x) { for (; n--;) x[n] *= 2.0; }")
    module = native.load(source, "void twice(int, double *);", COMM)
    x = np.arange(3.0)
    module.lib.twice(3, native.pointer(module, x))
    equal(x, [0.0, 2.0, 4.0])
    agree(native.load(source, "void twice(int, double *);", COMM) is module)
    files = list((source.parent / "dolfinx_feti").iterdir())
    agree(len(files) == 1 and files[0].name.startswith("twice_"))
    with monkeypatch.context() as patch:  # nothing is waited for, or read
        patch.setattr(native, "on_all", lambda *_: agree(False))
        patch.setattr(native, "_read_code", lambda *_: agree(False))
        native.load(source, "void twice(int, double *);", COMM)
    monkeypatch.setattr(native, "_loaded", {})
    monkeypatch.setattr(native.cffi.FFI, "compile", lambda *_, **__: agree(False))
    native.load(source, "void twice(int, double *);", COMM).lib.twice(3, native.pointer(module, x))
    equal(x, [0.0, 4.0, 8.0])


def test_compiler_flags_are_part_of_the_file_name(write_source, monkeypatch):
    """Code with further flags is another file, and they reach the compiler."""
    source = write_source("number.c", "int number(void) { return NUMBER; }")
    for number in (4, 7):
        monkeypatch.setenv("DOLFINX_FETI_CFLAGS", f"-g0 '-DNUMBER={number}'")
        agree(native.load(source, "int number(void);", COMM).lib.number() == number)
    agree(len(list((source.parent / "dolfinx_feti").iterdir())) == 2)


def test_failed_compilation_is_one_error_with_a_remedy(write_source, monkeypatch):
    """All processes raise it, also without a compiler."""
    source = write_source("wrong.c", "void wrong(int n) { no C; }")
    with raises(RuntimeError, r"wrong\.c cannot be compiled \(.*CompileError.*XDG_CACHE_HOME"):
        native.load(source, "void wrong(int);", COMM)

    def fails(*_, **__):
        raise OSError("no compiler here")

    monkeypatch.setattr(native.cffi.FFI, "compile", fails)
    with raises(RuntimeError, r"wrong\.c .*no compiler here.*variable CC"):
        native.load(source, "void wrong(int);", COMM)


def test_arrays_of_another_layout_are_refused():
    """A copy would take what the code writes, and the code reads rows or columns."""
    module = native.load(condensation.SOURCE, condensation.DECLARATIONS, COMM)
    x = np.zeros((4, 6))
    agree(all(native.pointer(module, each) for each in (x, x[1:3], x[0])))
    agree(all(native.pointer(module, each, order="F") for each in (x.T, x[0])))
    for array, order in ((x[:, ::2], "C"), (x.T, "C"), (x, "F"), (x[0, ::2], "C")):
        with raises(ValueError, f"not contiguous in {order} order"):
            native.pointer(module, array, order=order)


@pytest.mark.parametrize(
    "dtype", ["c16", "u4", "i2", "?", ">f8"], ids=["complex", "unsigned", "short", "bool", "order"]
)
def test_arrays_of_another_type_are_refused(dtype):
    """The code would read their bytes as other numbers."""
    module = native.load(condensation.SOURCE, condensation.DECLARATIONS, COMM)
    with raises(ValueError, "give float32, float64, int32 or int64"):
        native.pointer(module, np.zeros(3, dtype=dtype))


def test_code_that_one_process_has_loaded_is_still_loaded_together():
    """That process waits for the others like any other one."""
    source = condensation.SOURCE
    declarations = condensation.DECLARATIONS
    flags = ("-O3", "-DANOTHER")
    own = native.load(source, declarations, MPI.COMM_SELF, flags=flags) if COMM.rank == 0 else None
    module = native.load(source, declarations, COMM, flags=flags)
    agree(own in (None, module))


@pytest.mark.parametrize("busy", [False, True])
def test_unwritable_cache_is_replaced_for_the_run(busy, write_source, monkeypatch):
    """The first process compiles, perhaps in a folder with files that are in use."""
    source = write_source("half.c", "int half(int n) { return n / 2; }")
    monkeypatch.setenv("XDG_CACHE_HOME", str(source))
    if busy:
        monkeypatch.setattr(os, "rmdir", lambda *_, **__: os.listdir(source))  # an OSError
    module = native.load(source, "int half(int);", COMM, flags=(f"-DBUSY={busy}",))
    agree(module.lib.half(8) == 4)
    agree(len(set(COMM.allgather(module.__file__))) == 1, module.__file__)
    again = native.load(source, "int half(int);", MPI.COMM_SELF, flags=(f"-DBUSY={busy}",))
    agree(again is module)


def test_code_for_another_processor_has_another_name(write_source, monkeypatch):
    """Nodes of a cluster with different processors may share a cache."""
    source = write_source("one.c", "int one(void) { return 1; }")
    folder = source.parent / "kept"
    for text in ("model name: A\nflags: avx2", "model name: B\nflags: avx512f"):
        with monkeypatch.context() as patch:
            patch.setattr(native.Path, "read_text", read_text_with(text))
            flags = native.processor_flags()
        if COMM.rank == 0 and flags:
            native.load(source, "int one(void);", MPI.COMM_SELF, flags=flags, cache=folder)
    cached = COMM.bcast(sorted(p.name for p in folder.glob("one_*")))
    agree(len(cached) == (2 if native.platform.machine() in native.MACHINES else 0))


def read_text_with(text: str):
    """A ``read_text`` of /proc/cpuinfo on another machine."""
    read = Path.read_text
    return lambda path, **how: text if path == Path("/proc/cpuinfo") else read(path, **how)


@pytest.mark.serial
def test_concurrent_jobs_load_complete_files(tmp_path):
    """Both compile the same code into one cache."""
    source = tmp_path / "three.c"
    source.write_text("int three(void) { return 3; }", encoding="utf-8")
    program = f"""
from pathlib import Path
from mpi4py import MPI
from dolfinx_feti.runtime.native import load
code = load(Path({str(source)!r}), "int three(void);", MPI.COMM_SELF)
assert code.lib.three() == 3
"""
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    jobs = [
        subprocess.Popen([sys.executable, "-c", program], env=environment, stderr=subprocess.PIPE)
        for _ in range(2)
    ]
    for job in jobs:
        _, errors = job.communicate(timeout=120)
        assert job.returncode == 0, errors.decode()
    assert len(list((tmp_path / "dolfinx_feti").iterdir())) == 1


def test_long_compilations_are_logged(write_source, monkeypatch, caplog):
    """The first process logs the file and the cache; short compilations are not logged."""
    source = write_source("slow.c", "int slow(void) { return 5; }")
    folder = source.parent / "kept"
    compiled = native.cffi.FFI.compile

    def compile_slowly(*arguments, **options):
        time.sleep(0.3)
        return compiled(*arguments, **options)

    monkeypatch.setattr(native.cffi.FFI, "compile", compile_slowly)
    for log_after, lines in ((60.0, 0), (0.1, 1)):
        monkeypatch.setattr(native, "LOG_AFTER", log_after)
        monkeypatch.setattr(native.logger, "disabled", False)
        caplog.clear()
        flags = (f"-DPATIENCE={log_after}",)
        native.load(source, "int slow(void);", COMM, flags=flags, cache=folder)
        announced = [m for m in caplog.messages if "slow.c" in m and str(folder) in m]
        agree(len(announced) == (lines if COMM.rank == 0 else 0), caplog.messages)


def test_address_of_a_blas_function_can_be_called():
    """dnrm2 of (3, 4) is 5."""
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
    dnrm2 = kind(native.address_of("dnrm2"))
    x = np.array([3.0, 4.0])
    n = ctypes.c_int(2)
    step = ctypes.c_int(1)
    norm = dnrm2(ctypes.addressof(n), x.ctypes.data, ctypes.addressof(step))
    agree(norm == 5.0 and native.address_of("dpotrf") != 0)


@pytest.mark.parametrize("copied", [False, True])
def test_csr_of_returns_the_arrays_of_a_matrix(copied, monkeypatch):
    """They are the matrix's own, or copies if the library lacks the functions."""
    if copied:
        monkeypatch.setattr(petsc_library, "c_function", lambda *_: None)
    csr = ([0, 2, 3, 4], [0, 2, 1, 2], [1.0, 7.0, 2.0, 3.0])
    K = PETSc.Mat().createAIJ((3, 3), csr=csr, comm=PETSc.COMM_SELF)
    with csr_of(K) as rows:
        agree(tuple(array.tolist() for array in rows) == csr)
        agree(all(array.dtype == np.int32 for array in rows[:2]))
        if not copied:
            agree([array.flags.writeable for array in rows] == 3 * [False])
        K.setValue(0, 0, 5.0)
        K.assemble()
        agree(rows.values[0] == (1.0 if copied else 5.0))
    K.destroy()


@pytest.mark.parametrize("n", [0, 2])
def test_csr_of_a_matrix_without_entries_is_empty(n):
    """The row pointers are zero."""
    K = PETSc.Mat().createAIJ((n, n), nnz=0, comm=PETSc.COMM_SELF)
    K.assemble()
    with csr_of(K) as rows:
        agree(rows.indptr.tolist() == [0] * (n + 1))
        agree(len(rows.indices) == len(rows.values) == 0)
    K.destroy()


def test_csr_of_refuses_other_matrix_types_and_missing_functions_are_none():
    """Only a SeqAIJ matrix has such arrays."""
    K = PETSc.Mat().createDense((2, 2), comm=PETSc.COMM_SELF)
    K.setUp()
    K.assemble()
    with raises(RuntimeError, "SeqAIJ"), csr_of(K):
        pass
    K.destroy()
    agree(c_function("MatNoSuchFunction", (ctypes.c_void_p,)) is None)

# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""C code that is compiled at first use."""

from __future__ import annotations

import ctypes

import numpy as np
from collective import COMM, agree, raises

from dolfinx_feti.runtime import native
from dolfinx_feti.runtime.connectivity import load_graph_code

TWICE = """
void twice(int n, double *x) { for (int i = 0; i < n; ++i) x[i] *= 2.0; }
"""


def test_compiled_once_and_kept(tmp_path, monkeypatch):
    """The first process compiles; a second call finds what is loaded, another run the file."""
    folder = COMM.bcast(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    source = folder / "twice.c"
    if COMM.rank == 0:
        source.write_text(TWICE, encoding="utf-8")
    COMM.barrier()
    module = native.load(source, "void twice(int, double *);", COMM)
    x = np.arange(3.0)
    module.lib.twice(3, native.pointer(module, x))
    agree(np.array_equal(x, [0.0, 2.0, 4.0]))
    agree(native.load(source, "void twice(int, double *);", COMM) is module)
    files = list((folder / "dolfinx_feti").iterdir())
    agree(len(files) == 1 and files[0].name.startswith("twice_"))
    monkeypatch.setattr(native, "_loaded", {})
    monkeypatch.setattr(native.cffi.FFI, "compile", lambda *_, **__: agree(False))
    native.load(source, "void twice(int, double *);", COMM).lib.twice(3, native.pointer(module, x))
    agree(np.array_equal(x, [0.0, 4.0, 8.0]))


def test_flags_are_part_of_the_name(tmp_path, monkeypatch):
    """Code with further flags is another file, and they reach the compiler."""
    folder = COMM.bcast(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    source = folder / "number.c"
    if COMM.rank == 0:
        source.write_text("int number(void) { return NUMBER; }", encoding="utf-8")
    COMM.barrier()
    for number in (4, 7):
        monkeypatch.setenv("DOLFINX_FETI_CFLAGS", f"-g0 '-DNUMBER={number}'")
        agree(native.load(source, "int number(void);", COMM).lib.number() == number)
    agree(len(list((folder / "dolfinx_feti").iterdir())) == 2)


def test_code_that_does_not_compile(tmp_path, monkeypatch):
    """One error with the remedy, on all processes."""
    folder = COMM.bcast(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    source = folder / "wrong.c"
    if COMM.rank == 0:
        source.write_text("void wrong(int n) { no C; }", encoding="utf-8")
    COMM.barrier()
    with raises(RuntimeError, r"wrong\.c cannot be compiled \(.*CompileError.*XDG_CACHE_HOME"):
        native.load(source, "void wrong(int);", COMM)


def test_no_compiler(tmp_path, monkeypatch):
    """Without a compiler the torn matrix itself is refused."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(COMM.bcast(tmp_path)))
    monkeypatch.setattr(native, "_loaded", {})

    def fails(*_, **__):
        raise OSError("no compiler here")

    monkeypatch.setattr(native.cffi.FFI, "compile", fails)
    with raises(RuntimeError, r"connectivity\.c .*no compiler here.*variable CC"):
        load_graph_code(COMM)


def test_arrays_with_gaps_are_refused():
    """A copy would take what the code writes."""
    module = load_graph_code(COMM)
    x = np.zeros((4, 6))
    agree(all(native.pointer(module, each) for each in (x, x.T, x[1:3])))
    with raises(ValueError, r"shape \(4, 3\) is not contiguous"):
        native.pointer(module, x[:, ::2])


def test_addresses_of_blas_and_lapack():
    """A function found by name does what it should."""
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
    dnrm2 = kind(native.address_of("dnrm2"))
    x = np.array([3.0, 4.0])
    n, step = ctypes.c_int(2), ctypes.c_int(1)
    norm = dnrm2(ctypes.addressof(n), x.ctypes.data, ctypes.addressof(step))
    agree(norm == 5.0 and native.address_of("dpotrf") != 0)

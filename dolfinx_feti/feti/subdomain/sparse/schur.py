# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The Schur complement of a subdomain, by a factorisation that stops at the interface.

.. math:: S = K_{ΓΓ} - K_{ΓI} K_{II}^{-1} K_{IΓ}

(eq. 51). MUMPS eliminates the interior dofs of a sparse K and leaves S as
a dense front: a quarter of the time that :math:`n_Γ` right-hand sides of :math:`K_{II}` take. PETSc
offers it as ``MatFactorSetSchurIS``, which petsc4py does not wrap; the functions are looked up in
the library that petsc4py has loaded. The factor is not kept: it is several times as large as S and
the factor of :math:`K_{II}` together, and its analysis takes a tenth of the time.
"""

from __future__ import annotations

import ctypes
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.blocks import index_set
from dolfinx_feti.feti.subdomain.dense import pack
from dolfinx_feti.feti.subdomain.direct import Choice, create_factor, takes_ldlt
from dolfinx_feti.petsc_library import function

__all__ = ["partial_factorisation_is_there", "schur_complement"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

_Handle = ctypes.c_void_p
_SIGNATURES = {
    "MatFactorSetSchurIS": (_Handle, _Handle),
    "MatFactorGetSchurComplement": (_Handle, ctypes.POINTER(_Handle), ctypes.POINTER(ctypes.c_int)),
    "MatFactorRestoreSchurComplement": (_Handle, ctypes.POINTER(_Handle), ctypes.c_int),
    "MatDenseGetArrayRead": (_Handle, ctypes.POINTER(ctypes.POINTER(ctypes.c_double))),
    "MatDenseRestoreArrayRead": (_Handle, ctypes.POINTER(ctypes.POINTER(ctypes.c_double))),
}


def partial_factorisation_is_there(choice: Choice) -> bool:
    """Tell whether PETSc has the functions, and these options leave the work to MUMPS."""
    return takes_ldlt(choice) and bool(_functions())


def schur_complement(K: PETSc.Mat, interface: Indices, choice: Choice) -> Array:
    """Eliminate all dofs but those of the interface.

    Args:
        K: Sequential symmetric matrix of a subdomain, (n, n).
        interface: Rows of Γ, (n_Γ,).
        choice: How to factor.

    Returns:
        S in packed format, (n_Γ (n_Γ + 1) / 2,), see ``dense``.

    Raises:
        FactorError: The factorisation failed.
    """
    Γ = index_set(interface)
    pc = create_factor(K, choice, lambda F: _call("MatFactorSetSchurIS", F.handle, Γ.handle))
    F = _Handle(pc.getFactorMatrix().handle)
    S, status = _Handle(), ctypes.c_int()
    values = ctypes.POINTER(ctypes.c_double)()
    _call("MatFactorGetSchurComplement", F, ctypes.byref(S), ctypes.byref(status))
    _call("MatDenseGetArrayRead", S, ctypes.byref(values))
    n = len(interface)
    result = pack(np.ctypeslib.as_array(values, (n, n)).T)  # its lower triangle is S
    _call("MatDenseRestoreArrayRead", S, ctypes.byref(values))
    _call("MatFactorRestoreSchurComplement", F, ctypes.byref(S), status)
    pc.destroy()
    Γ.destroy()
    return result


def _functions() -> dict[str, Any]:
    """Look the functions up; empty if one is missing."""
    found = {name: function(name, arguments) for name, arguments in _SIGNATURES.items()}
    return {} if None in found.values() else found


def _call(name: str, *arguments: object) -> None:
    error = _functions()[name](*arguments)
    if error:
        raise FactorError(f"PETSc's {name} returned error {error}")

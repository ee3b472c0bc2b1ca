# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Names for types of arrays; the concatenation of arrays, and the slices of the parts in it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Single: TypeAlias = npt.NDArray[np.float32]

#: Dofs, nodes and cells of one process, as dolfinx and PETSc number them.
Indices: TypeAlias = npt.NDArray[np.int32]

#: Dofs, nodes and cells numbered over all processes; counts; indices that numpy returns (64 bits).
Numbers: TypeAlias = npt.NDArray[np.int64]

Integers: TypeAlias = npt.NDArray[np.integer]
Mask: TypeAlias = npt.NDArray[np.bool_]

#: The result of local work in an iteration: NaN if the work failed. A ``collective.DeferredErrors``
#: has the error until the iteration ends. A function that returns an ``Array`` raises its errors.
ArrayOrNaN: TypeAlias = Array

#: A linear map of columns, (n, r) → (n, r), such as the product or a solve with a matrix.
ColumnMap: TypeAlias = Callable[[Array], Array]


def concatenate(
    parts: Sequence[npt.NDArray[Any]], dtype: npt.DTypeLike = float
) -> npt.NDArray[Any]:
    """Return the concatenation of one-dimensional arrays; an empty array if there are none."""
    return np.concatenate([np.zeros(0, dtype), *parts], dtype=dtype)


def consecutive_slices(sizes: Sequence[int]) -> list[slice]:
    """Return the slices of parts of the given sizes in their concatenation."""
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(start, stop) for start, stop in itertools.pairwise(ends)]

# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Check of det F between the quadrature points of accepted states, with warnings."""

from __future__ import annotations

import enum
from functools import cached_property

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_feti.diagnosis.advice import Advice
from dolfinx_feti.diagnosis.cell_volumes import CellVolumes, advise_on_volumes, summarise_volumes
from dolfinx_feti.fem.cell_samples import CellSamples, CellValues
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.user_forms.deformation import VolumeRatio
from dolfinx_feti.runtime.collective import on_all, warn

__all__: list[str] = []  # users call NonlinearProblem.diagnose


class Warned(enum.IntEnum):
    """The most severe warning about the cells that the user has had."""

    NOTHING = 0
    DISTORTED = 1
    INVERTED = 2


class CellCheck:
    """Check of the volumes of the cells in accepted states of a problem."""

    def __init__(
        self,
        ratio: VolumeRatio,
        u: dolfinx.fem.Function,
        fields: tuple[dolfinx.fem.Function, ...],
        compiler: Compiler,
        *,
        quadrature_degree: int,
    ) -> None:
        """Create the check; its expressions are compiled when it is first used.

        Args:
            ratio: The volume ratio, det F or an expression given by the user.
            u: The displacement.
            fields: Condensed fields.
            compiler: Compiler of the expressions.
            quadrature_degree: Degree of the quadrature. Newton's method keeps the ratio positive at
                its points.
        """
        self._ratio = ratio
        self._u = u
        self._compiler = compiler
        self._quadrature_degree = quadrature_degree
        degrees = [p.function_space.ufl_element().embedded_superdegree for p in fields]
        self._has_constant_pressure = any(degree == 0 for degree in degrees)
        self._warned = Warned.NOTHING

    def measure(self, dirichlet: npt.NDArray[np.bool_]) -> CellVolumes | None:
        """Return the volumes of the cells in the current state. Collective.

        Args:
            dirichlet: Mask of the dofs whose values are prescribed, (owned,).

        Returns:
            The volumes; None if the ratio has values at quadrature points only.
        """
        samples = self._samples
        if samples is None:
            return None
        mesh = self._u.function_space.mesh
        values: CellValues = on_all(samples.evaluate, mesh.comm)
        return summarise_volumes(
            values,
            mesh,
            name="det F" if self._ratio.is_determinant else "volume_ratio",
            is_determinant=self._ratio.is_determinant,
            has_clamped_node=self._has_clamped_node(dirichlet),
        )

    def advise(self, volumes: CellVolumes) -> list[Advice]:
        """Return advice on inverted and distorted cells."""
        return advise_on_volumes(volumes, has_constant_pressure=self._has_constant_pressure)

    def warn(self, dirichlet: npt.NDArray[np.bool_]) -> None:
        """Warn of inverted or distorted cells in the current state, once of each. Collective.

        Args:
            dirichlet: Mask of the dofs whose values are prescribed, (owned,).
        """
        if self._warned == Warned.INVERTED:
            return
        volumes = self.measure(dirichlet)
        if volumes is None or volumes.is_sound:
            return
        kind = Warned.INVERTED if volumes.inverted else Warned.DISTORTED
        if kind <= self._warned:
            return
        self._warned = kind
        remedies = " ".join(advice.text for advice in self.advise(volumes))
        comm = self._u.function_space.mesh.comm
        warn(
            f"{volumes}. Stresses in these cells have no meaning, and displacements near them may "
            f"be wrong. {remedies}",
            comm,
        )

    @cached_property
    def _samples(self) -> CellSamples | None:
        """The ratio at the sample points, compiled when it is first used; collective.

        None if the ratio has values at quadrature points only.
        """
        V = self._u.function_space
        # det F_e, the ratio in the energy, comes first; if it contains data that exist at
        # quadrature points only, det F of the body takes its place
        for expression in (self._ratio.of_energy, self._ratio.of_body):
            try:
                return CellSamples(
                    expression,
                    V.mesh,
                    self._compiler,
                    degree=V.ufl_element().embedded_superdegree,
                    quadrature_degree=self._quadrature_degree,
                )
            except ValueError:  # data at quadrature points; raised on all processes
                continue
        return None

    def _has_clamped_node(self, dirichlet: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Return a mask of the owned cells that have a clamped node, (n_cells,). Collective.

        Args:
            dirichlet: Mask of the dofs whose values are prescribed, (owned,).
        """
        V = self._u.function_space
        bs = V.dofmap.index_map_bs
        is_clamped = dolfinx.la.vector(V.dofmap.index_map, 1)  # 1 at clamped nodes
        n_owned = V.dofmap.index_map.size_local
        is_clamped.array[:n_owned] = dirichlet.reshape(n_owned, bs).all(axis=1)
        is_clamped.scatter_forward()
        n_cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
        is_clamped_in_cells = is_clamped.array[V.dofmap.list[:n_cells]] > 0.5
        return np.asarray(is_clamped_in_cells.any(axis=1), dtype=np.bool_)

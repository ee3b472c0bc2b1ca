# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Records of the nonlinear study with the paper's own values."""

from __future__ import annotations

from benchmarks.common import machine
from benchmarks.nonlinear import paper

__all__ = ["EVERYTHING", "record_of"]

MACHINE = machine.describe()


def record_of(
    layers: int, degree: int, kind: str, kappa: float, pc: str, iterations: int | None
) -> dict:
    """Return the record of a load step of two Newton steps with so many iterations each."""
    record = {"geometry": "vessel", "size": None, "degree": degree, "layers": layers}
    record |= {"subdomains": 480, "processes": 480, "contact": "whole", "kappa": kappa}
    record |= {
        "type": kind,
        "pc": pc,
        "choices": "paper",
        "pressure": 1.0,
        "dofs": 3_000_000,
        "cells": 5_418_594,
    }
    record |= {"machine": MACHINE, "date": "2026-01-02T03:04:05+00:00", "multipliers": 1}
    if iterations is None:
        none = {"iterations_exceed": 10_000, "newton_iterations": 0}
        return record | none | {"linear_iterations_per_newton": []}
    found = {"newton_iterations": 2, "linear_iterations_per_newton": [iterations] * 2}
    found |= {"linear_iterations_mean": float(iterations)}
    found |= {"seconds_setup_per_newton": 1.0, "seconds_krylov_per_newton": 0.01 * iterations}
    found |= {"min_J": 0.9, "mean_J": 1.0, "max_J": 1.1, "share_J": 0.5}
    return record | found | {"mean_deviation_J": 0.01 / degree}


#: The paper's tables.
EVERYTHING = [record_of(*key, solve.iterations) for key, solve in paper.SOLVES.items()]

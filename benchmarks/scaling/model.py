# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A model of the load step on P processes, and the efficiency of strong scaling.

.. math:: \mathrm{eff}(P) = \frac{I\, t_I}{P\, t_P}

with I processes to begin with (eq. 58, Augustin_eq:efficiency, which leaves out the factor I; the
paper's tables have it). The seconds measured on the fewest processes are shared out, and what does
not shrink is added:

.. math::

    t_{local} = β\, t_1 / P, \qquad
    t_{iteration} = β\, t_1 / P + n_m (α + b/W) + n_r\, 2 α \log_2 P + n_c\, t_c(P),

    t_c = 16\, L / V + 8\, K / W, \qquad t_{coarse} = t_1 / P + Φ / R,

n_m messages of b bytes (the mean of the processes), n_r reductions and n_c coarse solves in an
iteration are those that were counted on the most processes; α, W, V and R are in :class:`Machine`.
β is the unevenness of whole subdomains, ⌈S/P⌉ P/S. The coarse matrix of K unknowns, with L entries
in its factor and Φ operations to make it, is factored and solved by every process, as if by one;
each solve gathers K numbers on all, which is one of the reductions. Beyond S processes there are as
many subdomains as processes; K grows with them, L as K ln K and Φ as K^{3/2}, those of a wall,
which is nearly two-dimensional. Reading the mesh is on one process; what else the program does is
shared.

A mesh with ρ times the dofs, in the same subdomains, takes ρ times the work, and ρ^{2/3} times the
bytes; its factors take more than that, so that this is a cautious estimate of the efficiency.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

from benchmarks.common.records import Record

__all__ = ["KRYLOV", "PARTS", "Machine", "Model", "Prediction", "create_model", "efficiency"]


#: Parts of the iterations.
KRYLOV = ("work", "messages", "reductions", "gathering", "coarse_solves")


@dataclass(frozen=True, slots=True)
class Machine:
    """A cluster of today, stated and not measured."""

    latency: float = 2e-6  # α, of a message [s]
    bandwidth: float = 2e9  # W, of a process into the network [bytes/s]
    stream: float = 5e9  # V, at which a process reads a factor [bytes/s]
    rate: float = 5e9  # R, at which a process factors [flops/s]


@dataclass(frozen=True, slots=True)
class Prediction:
    """Seconds of a load step on so many processes, by what they are spent for."""

    processes: int
    local: float  # assembly and factorisations of the subdomains
    work: float  # the subdomains' part of the iterations
    messages: float  # between neighbours
    reductions: float  # over all processes
    gathering: float  # of the coarse right-hand sides, to all processes
    coarse_solves: float
    coarse_shared: float  # the part of the coarse set-up that all share
    coarse_factor: float
    reading: float  # and distributing the mesh
    rest: float

    @property
    def krylov(self) -> float:
        """Seconds of all iterations."""
        return sum(getattr(self, name) for name in KRYLOV)

    @property
    def coarse(self) -> float:
        """Seconds of the coarse set-up."""
        return self.coarse_shared + self.coarse_factor

    @property
    def total(self) -> float:
        """Seconds of the program."""
        return self.local + self.krylov + self.coarse + self.reading + self.rest

    def shares(self, names: Sequence[str] = ()) -> dict[str, float]:
        """Return the share of some parts in their sum; of all parts if there are no names."""
        seconds = {name: getattr(self, name) for name in names or PARTS}
        whole = sum(seconds.values())
        return {name: value / whole for name, value in seconds.items()}


#: Parts of the time.
PARTS = tuple(field.name for field in fields(Prediction))[1:]


@dataclass(frozen=True, slots=True)
class Model:
    """The model with its numbers."""

    base: Record  # of the measured case on the fewest processes
    sent: Record  # of the counted case on the most processes
    machine: Machine

    def predict(self, processes: int, refined: float = 1.0) -> Prediction:
        """Predict the seconds on P processes; ρ times the dofs make a mesh ``refined``."""
        base, sent, m, P = self.base, self.sent, self.machine, processes
        iterations = sum(base["linear_iterations_per_newton"])
        solves = iterations * sent["coarse_solves"]
        subdomains = max(base["subdomains_in_all"], P)
        grown = subdomains / base["subdomains_in_all"]
        K = base["coarse_size"]
        longer = grown * math.log(grown * K) / math.log(K)
        reading_factor = 16.0 * sent["coarse_entries"] / m.stream
        factoring = base["newton_iterations"] * sent["coarse_flops"] / m.rate
        uneven = math.ceil(subdomains / P) * P / subdomains  # β
        share = refined * base["processes"] * uneven / P
        parts = ("local", "krylov", "coarse", "reading")
        rest = base["seconds_total"] - sum(base[f"seconds_{part}"] for part in parts)
        each, hops = sent["iteration"], math.log2(P)
        message = each["messages"]["mean"] * m.latency
        message += refined ** (2.0 / 3.0) * each["bytes"]["mean"] / m.bandwidth
        return Prediction(
            processes=P,
            local=base["seconds_local"] * share,
            work=max(0.0, base["seconds_krylov"] - solves * reading_factor) * share,
            messages=iterations * message if P > 1 else 0.0,
            reductions=iterations * each["reductions"]["max"] * 2.0 * m.latency * hops,
            gathering=solves * 8.0 * grown * K / m.bandwidth if P > 1 else 0.0,
            coarse_solves=solves * reading_factor * longer,
            coarse_shared=max(0.0, base["seconds_coarse"] - factoring) * share,
            coarse_factor=factoring * grown**1.5,
            reading=refined * base["seconds_reading"],
            rest=max(0.0, rest) * share,
        )


def create_model(
    measured: Sequence[Record], counted: Sequence[Record], machine: Machine | None = None
) -> Model | None:
    """Make a model of cases in the order of their processes; None without both kinds."""
    if not measured or not counted:
        return None
    return Model(measured[0], counted[-1], machine or Machine())


def efficiency(first: int, seconds_first: float, processes: int, seconds: float) -> float:
    """Return eff = I t_I / (P t_P)."""
    return first * seconds_first / (processes * seconds)

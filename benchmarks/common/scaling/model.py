# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A model of the load step on P processes, and the efficiency of strong scaling.

.. math:: \mathrm{eff}(P) = \frac{I\, t_I}{P\, t_P}

with I processes to begin with (eq. 58, Augustin_eq:efficiency, which leaves out the factor I; the
paper's tables have it). The seconds measured on the fewest processes, t_1, are shared out, and what
does not shrink is added: n_m messages of b bytes (the mean of the processes), n_r reductions and
n_c coarse solves in an iteration, as counted on the most processes,

.. math::

    t_{local} = β\, t_1 / P, \qquad
    t_{iteration} = β\, t_1 / P + n_m (α + b/W) + n_r\, 2 α \log_2 P + n_c\, t_c(P), \\
    β = \left\lceil \frac{S}{P} \right\rceil \frac{P}{S}
    \left( 1 + σ \sqrt{2 \ln P\, P / S} \right) γ, \qquad γ = \max(1, p / p_b) .

β is that of P processes over that of the measured ones: the unevenness of whole subdomains, the
wait for the process with the most work, and the bus that p = min(P, p_n) processes of a node share.
A coarse matrix of K unknowns, with L entries in its factor and Φ operations to make it, is solved
as ``coarse.gathered`` does: by its inverse, of which six rows take the time of a solve, or by a
factor on every node, or above 2²⁶ entries on every c = ⌈K/4000⌉ processes,

.. math::

    t_c = 2 α \log_2 P + 8\, K / W + 8\, γ K^2 / (P V) \text{ up to } K = 128\, P,
    \quad 2 \cdot 8\, K / W + 16\, L / (c V) \text{ above}, \qquad
    t_{coarse} = β\, t_1 / P + Φ / (c R) + \frac{K}{6 P} \frac{16\, γ L}{V} .

Beyond S processes there are as many subdomains as processes; K grows with them, L as K ln K and Φ
as K^{3/2}, those of a wall, which is nearly two-dimensional. Of reading, the file's bytes take
their time at D, mesh and tags t_1 / P, what two processes take beyond that log₂ P times as long,
and what it sends was counted. What a load step of a tiny wall takes does not shrink. A mesh with ρ
times the dofs in each subdomain takes ρ times the work, and ρ^{2/3} times the bytes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

from benchmarks.common.records import Record
from dolfinx_feti.feti.coarse.gathered import SPREAD
from dolfinx_feti.feti.coarse.group import ROWS
from dolfinx_feti.feti.coarse.whole import MOST

__all__ = [
    "CELLS",
    "KRYLOV",
    "PARTS",
    "SCATTER",
    "Machine",
    "Model",
    "Prediction",
    "create_model",
    "efficiency",
]

#: Rows of the inverse that take the time of a solve with the factor.
BLOCKED = 6.0

#: σ: standard deviation of the work of a subdomain over its mean, of the squared interface dofs of
#: 36 to 92 subdomains of 2000 dofs: tube, vessel and block have 0.16 to 0.20, and at most 1.6.
SCATTER = 0.17

#: The same of the cells of 16 to 128 parts of tube and vessel, which fibres, tearing and patterns
#: depend on: 0.01 to 0.02, where a splinter has joined a part up to 0.17, in the mean square 0.06.
CELLS = 0.06

#: Parts of the iterations.
KRYLOV = ("work", "messages", "reductions", "gathering", "coarse_solves")


@dataclass(frozen=True, slots=True)
class Machine:
    """A cluster of today, stated and not measured."""

    latency: float = 2e-6  # α, of a message [s]
    bandwidth: float = 2e9  # W, of a process into the network [bytes/s]
    stream: float = 5e9  # V, at which a process reads a factor [bytes/s]
    node: int = 16  # p_n, processes of a node
    bus: float = 12.0  # p_b, those that read memory at V together: measured on 16 cores of a Xeon
    rate: float = 2e10  # R, at which a process factors by fronts: 3.2e10 on a core here [flops/s]
    disk: float = 5e9  # D, of the file system to all processes together [bytes/s]


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
    coarse_factor: float  # and the rows of the inverse
    reading: float  # and distributing the mesh
    rest: float  # fibres, tearing, patterns
    fixed: float

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
        return self.local + self.krylov + self.coarse + self.reading + self.rest + self.fixed

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
    two: Record  # on two, or the most below that
    sent: Record  # of the counted case on the most processes
    machine: Machine

    def predict(self, processes: int, refined: float = 1.0) -> Prediction:
        """Predict the seconds on P processes; ρ times the dofs make a mesh ``refined``."""
        base, sent, m, P = self.base, self.sent, self.machine, processes
        first = base["processes"]
        iterations = sum(base["linear_iterations_per_newton"])
        solves = iterations * sent["coarse_solves"]
        subdomains = max(base["subdomains_in_all"], P)
        grown = subdomains / base["subdomains_in_all"]
        K, L, flops = max(2, base["coarse_size"]), sent["coarse_entries"], sent["coarse_flops"]
        longer = grown * math.log(grown * K) / math.log(K)
        gather, solve, factor = self._coarse(grown * K, longer * L, grown**1.5 * flops, P)
        _, solved, factored = self._coarse(K, L, flops, first)
        slowed = (self._slowed(P, σ) / self._slowed(first, σ) for σ in (SCATTER, CELLS))  # β
        share, of_cells = (refined * first * β / P for β in slowed)
        steps = base["newton_iterations"]
        parts = ("local", "krylov", "coarse", "reading", "fixed")
        rest = base["seconds_total"] - sum(base[f"seconds_{part}"] for part in parts)
        each, hops = sent["iteration"], math.log2(P)
        message = each["messages"]["mean"] * m.latency
        message += (refined / grown) ** (2.0 / 3.0) * each["bytes"]["mean"] / m.bandwidth
        return Prediction(
            processes=P,
            local=base["seconds_local"] * share,
            work=max(0.0, base["seconds_krylov"] - solves * solved) * share,
            messages=iterations * message if P > 1 else 0.0,
            reductions=iterations * each["reductions"]["max"] * 2.0 * m.latency * hops,
            gathering=solves * gather,
            coarse_solves=solves * solve,
            coarse_shared=max(0.0, base["seconds_coarse"] - steps * factored) * share,
            coarse_factor=steps * factor,
            reading=self._reading(P, refined),
            rest=max(0.0, rest) * of_cells,
            fixed=base["seconds_fixed"],
        )

    def _bus(self, P: int) -> float:
        """Return γ, how much longer a process reads memory that others of its node read, too."""
        return max(1.0, min(P, self.machine.node) / self.machine.bus)

    def _slowed(self, P: int, scatter: float) -> float:
        """Return the time of the work over that of an even share of it on an idle node."""
        each = max(self.base["subdomains_in_all"], P) / P
        waiting = 1.0 + scatter * math.sqrt(2.0 * math.log(P) / each)
        return math.ceil(each) / each * waiting * self._bus(P)

    def _coarse(self, K: float, L: float, flops: float, P: int) -> tuple[float, float, float]:
        """Return the seconds of gathering, of a solve, and of a set-up, on P processes."""
        m, hops, stream = self.machine, math.log2(P), self.machine.stream / self._bus(P)
        group = 1 if L <= MOST else min(P, max(1, math.ceil(K / ROWS)))
        make = flops / (group * m.rate)
        if K > SPREAD * P:
            gather = 16.0 * K / m.bandwidth if P > 1 else 0.0  # b to the node, x from it
            return gather, 16.0 * L / (group * m.stream), make  # read twice
        gather = 2.0 * m.latency * hops + 8.0 * K / m.bandwidth if P > 1 else 0.0
        inverse = K / (BLOCKED * P) * 16.0 * L / stream
        return gather, 8.0 * K**2 / (P * stream), make + inverse

    def _reading(self, P: int, refined: float) -> float:
        """Return the seconds of reading and distributing the wall on P processes."""
        m, most, hops = self.machine, self.sent["processes"], math.log2(P)
        first, two = (r["seconds_reading"] * r["processes"] for r in (self.base, self.two))
        if P == 1:
            return refined * first
        work = (first + max(0.0, two - first) * hops) / P
        disk, counted = self.sent["reading_bytes"] * most / m.disk, self.sent["reading"]
        into_network = counted["bytes"]["mean"] * most / (P * m.bandwidth)
        waits = counted["messages"]["mean"] + 2.0 * hops * counted["reductions"]["max"]
        return refined * (work + disk + into_network) + waits * m.latency


def create_model(
    measured: Sequence[Record], counted: Sequence[Record], machine: Machine | None = None
) -> Model | None:
    """Make a model of cases in the order of their processes; None without both kinds."""
    if not measured or not counted:
        return None
    two = [r for r in measured if r["processes"] <= 2][-1:] or measured[:1]
    return Model(measured[0], two[0], counted[-1], machine or Machine())


def efficiency(first: int, seconds_first: float, processes: int, seconds: float) -> float:
    """Return eff = I t_I / (P t_P)."""
    return first * seconds_first / (processes * seconds)

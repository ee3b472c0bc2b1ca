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

Of S subdomains, β has three factors: processes with ⌈S/P⌉ whole subdomains have more than an even
share, all wait for the process with the most work, and p = min(P, p_n) processes of a node share a
bus. In these times β is divided by that of the measured run. The numbers of the cluster (α, W, V,
p_n, p_b, R, D) and σ are the constants below.
A coarse matrix of K unknowns, with L entries in its factor and Φ operations to make it, is solved
as :mod:`dolfinx_feti.feti.coarse.solver` does. Up to K = 128 P each process keeps rows of the
inverse; computing six rows takes as long as one solve. Above that a factor is used: one on each
node (c = 1), or, with more than 2²⁶ entries, one for every c = ⌈K/4000⌉ processes,

.. math::

    t_c = 2 α \log_2 P + 8\, K / W + 8\, γ K^2 / (P V) \text{ up to } K = 128\, P,
    \quad 2 \cdot 8\, K / W + 16\, L / (c V) \text{ above}, \qquad
    t_{coarse} = β\, t_1 / P + Φ / (c R) + \frac{K}{6 P} \frac{16\, γ L}{V} .

Beyond S processes there are as many subdomains as processes. K grows with their number, L as K ln K
and Φ as K^{3/2}, as for a nearly two-dimensional body, which a wall is. Reading has four parts: the
bytes of the file at the bandwidth D; the work on mesh and tags, t_1 / P; what two processes need in
addition to one, times log₂ P; and the messages, which were counted. The time of a load step of a
tiny wall is a part that does not shrink. A mesh with ρ times the dofs in each subdomain takes ρ
times the work, and ρ^{2/3} times the bytes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.common.records import Record
from dolfinx_feti.feti.coarse.fronts import MAX_FRONT_ENTRIES
from dolfinx_feti.feti.coarse.group import ROWS_PER_PROCESS
from dolfinx_feti.feti.coarse.solver import INVERSE_ROWS_PER_PROCESS

#: Bytes of a number.
NUMBER = 8.0

# The cluster: plausible values of today, which are assumed and not measured.

#: α: latency of a message [s].
LATENCY = 2e-6
#: W: bandwidth of a process into the network [bytes/s].
BANDWIDTH = 2e9
#: V: speed at which a process reads a factor from memory [bytes/s].
STREAM = 5e9
#: p_n: processes of a node.
NODE = 16
#: p_b: processes of a node that can read memory at the speed V together, measured on 16 cores of a
#: Xeon.
BUS = 12.0
#: R: rate at which a process factors by fronts [flops/s]; 3.2e10 were measured on a core.
RATE = 2e10
#: D: bandwidth of the file system for all processes together [bytes/s].
DISK = 5e9

#: Number of rows of the inverse that are computed in the time of one solve with the factor.
BLOCKED = 6.0

#: σ: standard deviation of the work of a subdomain over its mean. The work is measured by squared
#: numbers of interface dofs. 36 to 92 subdomains of 2000 dofs of tube, vessel and block have a σ of
#: 0.16 to 0.20, and at most 1.6 times the mean work.
SCATTER = 0.17

#: The same for the numbers of cells, on which the time of fibres, tearing and patterns depends. 16
#: to 128 parts of tube and vessel have 0.01 to 0.02, and up to 0.17 if a part was joined with a
#: small disconnected one; their mean square is 0.06.
CELLS = 0.06

#: Parts of the time.
PARTS = (
    "local",  # assembly and factorisations of the subdomains
    "work",  # the subdomains' part of the iterations
    "messages",  # between neighbours
    "reductions",  # over all processes
    "gathering",  # of the coarse right-hand sides, to all processes
    "coarse_solves",
    "coarse_shared",  # the part of the coarse set-up that all share
    "coarse_factor",  # and the rows of the inverse
    "reading",  # and distributing the mesh
    "rest",  # fibres, tearing, patterns
    "fixed",
)
KRYLOV = PARTS[1:6]
COARSE = PARTS[6:8]


@dataclass(frozen=True, slots=True)
class Model:
    """The model, and the records that its numbers come from."""

    base: Record  # of the measured case on the fewest processes
    two: Record  # on two, or the most below that
    sent: Record  # of the counted case on the most processes

    def predict(self, processes: int, refined: float = 1.0) -> dict[str, float]:
        """Return the seconds of a load step on P processes.

        Args:
            processes: P.
            refined: ρ, dofs of the mesh over those of the measured one.

        Returns:
            Seconds of each of :data:`PARTS`, and the sums ``krylov``, ``coarse`` and ``total``.
        """
        base = self.base
        sent = self.sent
        P = processes
        first = base["processes"]
        iterations = sum(base["linear_iterations_per_newton"])
        solves = iterations * sent["coarse_solves"]
        subdomains = max(base["subdomains_in_all"], P)
        grown = subdomains / base["subdomains_in_all"]
        K = max(2, base["coarse_size"])
        L = sent["coarse_entries"]
        flops = sent["coarse_flops"]
        grown_entries = grown * math.log(grown * K) / math.log(K)
        gather, solve, factor = _coarse(grown * K, grown_entries * L, grown**1.5 * flops, P)
        _, measured_solve, measured_factor = _coarse(K, L, flops, first)
        β = self._slowed(P, SCATTER) / self._slowed(first, SCATTER)
        β_cells = self._slowed(P, CELLS) / self._slowed(first, CELLS)
        share = refined * first * β / P
        share_of_cells = refined * first * β_cells / P
        steps = base["newton_iterations"]
        parts = ("local", "krylov", "coarse", "reading", "fixed")
        rest = base["seconds_total"] - sum(base[f"seconds_{part}"] for part in parts)
        each = sent["iteration"]
        hops = math.log2(P)
        message = each["messages"]["mean"] * LATENCY
        message += (refined / grown) ** (2.0 / 3.0) * each["bytes"]["mean"] / BANDWIDTH
        seconds = {
            "local": base["seconds_local"] * share,
            "work": max(0.0, base["seconds_krylov"] - solves * measured_solve) * share,
            "messages": iterations * message if P > 1 else 0.0,
            "reductions": iterations * each["reductions"]["max"] * 2.0 * LATENCY * hops,
            "gathering": solves * gather,
            "coarse_solves": solves * solve,
            "coarse_shared": max(0.0, base["seconds_coarse"] - steps * measured_factor) * share,
            "coarse_factor": steps * factor,
            "reading": self._reading(P, refined),
            "rest": max(0.0, rest) * share_of_cells,
            "fixed": base["seconds_fixed"],
        }
        sums = {"krylov": KRYLOV, "coarse": COARSE, "total": PARTS}
        return seconds | {name: sum(seconds[n] for n in names) for name, names in sums.items()}

    def _slowed(self, P: int, scatter: float) -> float:
        """Return β: the time of the work over that of an even share of it on an idle node.

        Args:
            P: Number of processes.
            scatter: σ, standard deviation of the work of a subdomain over its mean.
        """
        each = max(self.base["subdomains_in_all"], P) / P
        waiting = 1.0 + scatter * math.sqrt(2.0 * math.log(P) / each)
        return math.ceil(each) / each * waiting * _bus(P)

    def _reading(self, P: int, refined: float) -> float:
        """Return the seconds of reading and distributing the wall on P processes."""
        most = self.sent["processes"]
        hops = math.log2(P)
        first, two = (r["seconds_reading"] * r["processes"] for r in (self.base, self.two))
        if P == 1:
            return refined * first
        work = (first + max(0.0, two - first) * hops) / P
        disk = self.sent["reading_bytes"] * most / DISK
        counted = self.sent["reading"]
        into_network = counted["bytes"]["mean"] * most / (P * BANDWIDTH)
        waits = counted["messages"]["mean"] + 2.0 * hops * counted["reductions"]["max"]
        return refined * (work + disk + into_network) + waits * LATENCY


def _bus(P: int) -> float:
    """Return γ: by which factor the other processes of a node slow down reading from memory."""
    return max(1.0, min(P, NODE) / BUS)


def _coarse(K: float, L: float, flops: float, P: int) -> tuple[float, float, float]:
    """Return the seconds of gathering, of a solve, and of a set-up, on P processes.

    A solve reads the factor twice, forwards and backwards.

    Args:
        K: Coarse unknowns.
        L: Entries of the factor.
        flops: Φ, operations that make it.
        P: Number of processes.
    """
    stream = STREAM / _bus(P)
    group = 1 if L <= MAX_FRONT_ENTRIES else min(P, max(1, math.ceil(K / ROWS_PER_PROCESS)))
    make = flops / (group * RATE)
    if K > INVERSE_ROWS_PER_PROCESS * P:
        gather = 2.0 * NUMBER * K / BANDWIDTH if P > 1 else 0.0  # b to the node, x from it
        return gather, 2.0 * NUMBER * L / (group * STREAM), make  # read twice
    gather = 2.0 * LATENCY * math.log2(P) + NUMBER * K / BANDWIDTH if P > 1 else 0.0
    inverse = K / (BLOCKED * P) * (2.0 * NUMBER) * L / stream
    return gather, NUMBER * K**2 / (P * stream), make + inverse


def create_model(measured: Sequence[Record], counted: Sequence[Record]) -> Model | None:
    """Make a model of cases in the order of their processes; None without both kinds."""
    if not measured or not counted:
        return None
    two = [r for r in measured if r["processes"] <= 2][-1:] or measured[:1]
    return Model(measured[0], two[0], counted[-1])


def efficiency(first: int, seconds_first: float, processes: int, seconds: float) -> float:
    """Return eff = I t_I / (P t_P).

    Args:
        first: I, the fewest processes.
        seconds_first: t_I, seconds on them.
        processes: P.
        seconds: t_P.
    """
    return first * seconds_first / (processes * seconds)

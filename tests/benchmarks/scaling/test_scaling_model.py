# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The model of strong scaling: what it gives back, what shrinks, what grows."""

from __future__ import annotations

import math

import pytest

from benchmarks.scaling import paper
from benchmarks.scaling.model import INNER, PARTS, Machine, create_model, efficiency
from benchmarks.scaling.traffic import COUNTERS

pytestmark = pytest.mark.serial

BASE = {"processes": 1, "subdomains_in_all": 512, "coarse_size": 3072, "newton_iterations": 5}
BASE |= {"linear_iterations_per_newton": [300] * 5, "seconds_local": 400.0, "seconds_total": 2000.0}
BASE |= {"seconds_krylov": 1300.0, "seconds_coarse": 20.0, "seconds_reading": 3.0}
BASE |= {"seconds_fixed": 2.0}
SENT = {"processes": 64, "coarse_solves": 2.0, "coarse_entries": 1e6, "coarse_flops": 1e9}
SENT |= {
    kind: {name: {"mean": 10.0, "max": 10.0} for name in COUNTERS}
    for kind in ("iteration", "reading")
} | {"reading_bytes": 1e6}


def test_papers_efficiencies():
    """Closed form: the printed efficiencies of the paper's last rows."""
    for layers, krylov, total in ((1, 0.606, 0.394), (2, 0.497, 0.305)):
        first, last = (paper.TIMES[layers][P] for P in (paper.FIRST, 512))
        assert efficiency(16, first.krylov, 512, last.krylov) == pytest.approx(krylov, abs=5e-4)
        assert efficiency(16, first.total, 512, last.total) == pytest.approx(total, abs=5e-4)


def test_model_gives_back_what_it_begins_with():
    model = create_model([BASE], [SENT])
    first = model.predict(1)
    for part in ("local", "krylov", "coarse", "reading", "fixed", "total"):
        assert getattr(first, part) == pytest.approx(BASE[f"seconds_{part}"], rel=1e-12)
    assert sum(first.shares().values()) == pytest.approx(1.0)
    assert set(first.shares()) == set(PARTS)


def test_work_shrinks_and_what_is_sent_does_not():
    model = create_model([BASE], [SENT])
    two, many, beyond = (model.predict(P) for P in (2, 512, 1024))
    assert two.local == 256 * many.local == 200.0
    assert many.messages == two.messages > 0.0
    assert many.reductions == pytest.approx(9 * two.reductions)  # log₂ P
    solves, m = 1500 * SENT["coarse_solves"], Machine()
    assert two.gathering == pytest.approx(solves * 8 * 3072 / m.bandwidth)  # on all
    for found, K, P in ((many, 3072, 512), (beyond, 6144, 1024)):
        each = 2 * m.latency * math.log2(P) + 8 * K / m.bandwidth
        assert found.gathering == pytest.approx(solves * each)
    assert model.predict(3).local > 400.0 / 3  # 171 of 512 subdomains


def test_coarse_solves_shrink_where_the_inverse_is_spread():
    """Up to 128 unknowns a process."""
    model = create_model([BASE], [SENT])
    few, some, many = (model.predict(P) for P in (16, 256, 512))
    solves = 1500 * SENT["coarse_solves"]
    assert few.coarse_solves == pytest.approx(solves * 16e6 / Machine().stream)
    assert some.coarse_solves == pytest.approx(solves * 8 * 3072**2 / 256 / Machine().stream)
    assert many.coarse_solves == pytest.approx(some.coarse_solves / 2)
    assert few.coarse_factor < many.coarse_factor < some.coarse_factor  # rows of the inverse


@pytest.mark.parametrize("columns", [6, 8])
def test_third_level_reads_its_rows_and_waits(columns):
    """20 000 subdomains in 2500 clusters, each exchange with the neighbours that were counted."""
    sent = SENT | {"neighbours": 10.0}
    found = create_model([BASE | {"coarse_size": 512 * columns}], [sent]).predict(20_000)
    assert found.gathering == 0.0  # within the third level's iterations
    inner, entries, numbers, exchanges = INNER[columns > 6]
    m, K_1, P = Machine(), 15_000, 20_000
    each = (12 * entries + 8 * numbers) * columns / m.stream + 10 * exchanges * m.latency
    each += 2 * m.latency * math.log2(20_000)
    each += 2 * m.latency * math.log2(P) + 8 * K_1 / m.bandwidth + 8 * K_1**2 / (P * m.stream)
    assert found.coarse_solves == pytest.approx(1500 * sent["coarse_solves"] * inner * each)


def test_partition_is_measured_on_two():
    """A process alone does not partition; on P there are log₂ P bisections."""
    two = BASE | {"processes": 2, "seconds_reading": 2.5}
    ideal = Machine(latency=0.0, bandwidth=float("inf"), disk=float("inf"))
    model = create_model([BASE, two], [SENT], ideal)
    assert model.predict(2).reading == pytest.approx(2.5)
    assert model.predict(64).reading == pytest.approx((3.0 + 6 * 2.0) / 64)
    slow = create_model([BASE, two], [SENT])
    assert slow.predict(64).reading > model.predict(64).reading


def test_faster_machine_and_finer_mesh():
    slow, fast = (create_model([BASE], [SENT], Machine(latency=a)) for a in (1e-5, 1e-6))
    assert slow.predict(512).reductions == pytest.approx(10 * fast.predict(512).reductions)
    coarse, fine = (fast.predict(512, refined) for refined in (1.0, 8.0))
    assert fine.local == 8 * coarse.local
    assert fine.coarse_solves == coarse.coarse_solves


def test_no_model_without_both():
    assert create_model([], [SENT]) is None
    assert create_model([BASE], []) is None

# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The shift: from nothing to the largest one, and back to nothing."""

from __future__ import annotations

import pytest

from dolfinx_feti.problems.direction import LARGEST_SHIFT, LEAST_SHIFT, SHIFT_GROWTH, fallen, raised


@pytest.mark.serial
def test_it_grows_from_nothing_to_the_largest():
    sigma, seen = raised(0.0), []
    while sigma is not None:
        seen.append(sigma)
        sigma = raised(sigma)
    assert seen == [LEAST_SHIFT * SHIFT_GROWTH**k for k in range(8)] and seen[-1] == LARGEST_SHIFT


@pytest.mark.serial
@pytest.mark.parametrize(("grown", "steps"), [(True, 9), (False, 5)])
def test_it_falls_to_nothing(grown, steps):
    sigma, seen = LARGEST_SHIFT, []
    while sigma > 0.0:
        sigma = fallen(sigma, grown=grown)
        seen.append(sigma)
    assert len(seen) == steps and all(s >= LEAST_SHIFT / SHIFT_GROWTH for s in seen[:-1])
    assert fallen(0.0, grown=grown) == 0.0


@pytest.mark.serial
def test_what_falls_slowly_had_to_grow():
    assert (
        fallen(LARGEST_SHIFT, grown=True)
        == LARGEST_SHIFT / SHIFT_GROWTH
        > fallen(LARGEST_SHIFT, grown=False)
    )

# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The bodies of the contact study agree with their closed forms, on coarser meshes."""

from __future__ import annotations

from collective import COMM, agree, small
from wall_files import ROOT

from benchmarks.contact import STUDY, hertz, ring, tube


def test_sphere_on_a_half_space():
    """A sphere on a half-space has Hertz's contact radius, pressure and force."""
    found = hertz(COMM, cells=8)
    small(found["radius_error"], 0.02)
    small(found["pressure_error"], 0.03)
    small(found["force_error"], 0.01)


def test_tube_on_a_growing_cylinder():
    """A tube on a growing cylinder has its closed-form pressure and outer radius."""
    found = tube(COMM, cells=2)
    small(found["pressure_error"], 0.005)
    small(found["outer_radius_error"], 0.001)


def test_work_on_a_ring_is_its_energy():
    """The work of the contact force on a ring is the energy stored in it."""
    found = ring(COMM, cells=16)
    small(found["energy_error"], 0.005)


def test_page_shows_the_records(tmp_path):
    """The study's page shows the site's records."""
    records = ROOT / "docs/results/contact.json"
    text = STUDY.write_page([records], COMM.bcast(tmp_path) / str(COMM.rank))
    agree("Iterations in contact" in text and "[dofs]" not in text, text)
